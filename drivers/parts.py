"""The register parts that tiltcal has built in: a row each, with the source of its numbers.

ADXL355: ADXL354/ADXL355 data sheet Rev. 0; of the temperature and the reset what later revisions corrected (Linux
``drivers/iio/accel/adxl355_core.c``). IIS2ICLX: data sheet, ST DS13005 Rev. 7. SCA3000: Linux
``drivers/iio/accel/sca3000.c``; openmag ``sca3000.h``; SCA3000 Series product family specification, VTI 8257300A.07,
page 12.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from tiltcal.drivers.bus import SpiPort, check_data_line
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.model import in_words
from tiltcal.drivers.register_facts import (
    I2C,
    SPI,
    Field,
    Frame,
    Range,
    Registers,
    Sampling,
    StartUp,
    Thermometer,
    VirtualFacts,
    Write,
)
from tiltcal.drivers.registers import RegisterPart, RegisterSensor
from tiltcal.drivers.virtual import Tolerances
from tiltcal.errors import BusError, DeviceFault

# --- Analog Devices ADXL355 ---
#
# A reset may fail to load the factory trim, so the shadow registers are compared with those before it. The offset trim
# registers are never written: what they hold is lost with the next reset, and a calibration with it.

SHADOW, SHADOWS = 0x50, 5
RESETS = 5  # largest number of resets until the trim is loaded
TEMPERATURE = 0x06


def load_trim(sensor: RegisterSensor) -> None:
    """Reset an ADXL355 until its shadow registers have the content that they had first; a reset may have lost it."""
    sensor.identify()
    before = sensor.registers(SHADOW, SHADOWS)
    sensor.remembered = sensor.remembered or before
    for _ in range(RESETS):
        sensor.reset()
        if sensor.registers(SHADOW, SHADOWS) == sensor.remembered:
            return
    raise DeviceFault(
        "the ADXL355 does not load its factory trim after a reset (its shadow registers 0x50 to 0x54 differ): switch "
        "its supply off for a second and on; if it stays, start the command again"
    )


def with_whole_temperature(sensor: RegisterSensor) -> Registers:
    """Return a sample of an ADXL355, whose two bytes of temperature are not taken together.

    The second byte of the first pair belongs to its first byte where that stays the same. Where it does not, a
    measurement has just begun, and the second pair is of that one.
    """
    registers = sensor.registers(0x08, 9)
    check_data_line(bytes(registers.values()))
    pair, again = sensor.registers(TEMPERATURE, 2), sensor.registers(TEMPERATURE, 2)
    whole = pair if pair[TEMPERATURE] & 0x0F == again[TEMPERATURE] & 0x0F else again
    return registers | whole


ADXL355 = RegisterPart(
    name="adxl355",
    title="Analog Devices ADXL355 three-axis accelerometer, ±2, ±4 or ±8 g, SPI or I2C",
    short="ADXL355",
    channels={"x": Field(0x08, 20, 3, 4), "y": Field(0x0B, 20, 3, 4), "z": Field(0x0E, 20, 3, 4)},
    bursts=((0x08, 9), (TEMPERATURE, 2)),
    # Later revisions correct the 1852 of the first.
    thermometer=Thermometer(Field(TEMPERATURE, 12, signed=False), zero=1885, slope=-9.05),
    sampling=Sampling(
        ranges={"2g": Range(1, 256e3), "4g": Range(2, 128e3), "8g": Range(3, 64e3)},
        rates={4000 * 0.5**step: step for step in range(11)},
        range="2g",
        rate=125.0,
    ),
    addresses=(SPI, f"{I2C}0x1d"),
    frame=Frame(
        shift=1,
        reading=0b01,
        spi=SpiPort((0,), fastest=10_000_000, speed=1_000_000, slowest=100_000),
        # At 100 kHz, reading a sample takes 2 ms.
        fastest_on_i2c=500.0,
    ),
    start_up=StartUp(
        identity=(0x00, (bytes.fromhex("AD1DED"),)),
        reset=Write(0x2F, 0x52, seconds=0.010),
        begin=load_trim,
        # FILTER and RANGE (bit 7 as after a reset) in standby; then POWER, which ends it.
        set_up=(
            (Write(0x28, 0x00, rate=1), Write(0x2C, 0x80, range=1)),
            # The turn-on time is 10 ms.
            (Write(0x2D, 0x00, seconds=0.010),),
        ),
        # The group delay of the filter: four samples suffice at every rate.
        settling=4,
    ),
    new_sample=(0x04, 0x01),
    take=with_whole_temperature,
    virtual=VirtualFacts(
        held={0x2C: 0x81, 0x2D: 0x01, **dict(enumerate(bytes.fromhex("2A7C05913E"), SHADOW))},
        asleep=(0x2D, 0x01, 0x01),
        limits=Tolerances(offset=0.075, sensitivity=0.08, drift=0.15e-3, gain=1e-4, thermometer=5.0),
        noise_density=25e-6,
        corner=0.25,
        nonlinearity=0.001,
        not_modelled=(
            "overrange, self-test, FIFO, high-pass, interrupts, offset trim; a reset that fails to load the trim",
            "settings that are written while it measures: they take effect here",
            "samples of two moments in one burst; thermometer noise; the tolerance of the part's clock",
        ),
    ),
)

# --- ST IIS2ICLX ---
#
# It measures x and y in the plane of its package and has no z. Reserved registers are never written: that may damage
# the part for good.

IIS2ICLX = RegisterPart(
    name="iis2iclx",
    title="ST IIS2ICLX two-axis inclinometer, ±0.5, ±1, ±2 or ±3 g, SPI or I2C",
    short="IIS2ICLX",
    channels={"x": Field(0x28, 16, order="little"), "y": Field(0x2A, 16, order="little")},
    bursts=((0x28, 4), (0x20, 2)),
    thermometer=Thermometer(Field(0x20, 16, order="little"), zero=0, slope=256.0),
    sampling=Sampling(
        ranges={
            "0.5g": Range(0, 1000 / 0.015),
            "1g": Range(2, 1000 / 0.031),
            "2g": Range(3, 1000 / 0.061),
            "3g": Range(1, 1000 / 0.122),
        },
        rates={12.5: 1, 26.0: 2, 52.0: 3, 104.0: 4, 208.0: 5, 416.0: 6, 833.0: 7},
        range="2g",
        rate=104.0,
    ),
    addresses=(SPI, f"{I2C}0x6a"),
    frame=Frame(spi=SpiPort((0, 3), fastest=10_000_000, speed=1_000_000)),
    start_up=StartUp(
        identity=(0x0F, (b"\x6b",)),
        # The data sheet's turn-on time is 15 ms.
        reset=Write(0x12, 0x01, seconds=0.020),
        # DEVICE_CONF, which has to be set after every reset; whole samples, counting up; rate and range.
        set_up=((Write(0x18, 0xE2), Write(0x12, 0x44), Write(0x10, 0x00, rate=0x10, range=0x04)),),
        dropped=3,
    ),
    new_sample=(0x1E, 0x01),
    probe=lambda sensor: {
        "identity": "0x6B (of other ST parts as well: is it an IIS2ICLX?)",
        **sensor.part.sampling.in_words,
        **in_words(sensor.read()),
    },
    virtual=VirtualFacts(
        held={0x12: 0x04, 0x18: 0xE0},
        asleep=(0x10, 0xF0, 0x00),
        # No source states the cross-axis sensitivity; the limit is ours.
        limits=Tolerances(offset=0.008, sensitivity=0.02, drift=0.075e-3, gain=1.2e-4, thermometer=15.0),
        noise_density=15e-6,
        nonlinearity=0.001,
        not_modelled=(
            "filters, self-test, FIFO, user offset, interrupts; what reserved registers do to a real part",
            "unsettled samples after power-down; bytes of two samples where they are not held",
            "thermometer noise; cross-axis sensitivity of a real part, which no source names",
        ),
    ),
)

# --- VTI (Murata) SCA3000 ---
#
# The address counts DOWN from byte to byte, on I2C as well. That the pointer there is the plain register address is
# inferred, so pointer=command sends the SPI command byte in its place. The driver never writes a register: a wrong
# reserved bit can block the part, and a calibration needs only reads.

REVID, STATUS, MODE = 0x00, 0x02, 0x14
UNLOCKED, CHECKSUM_ERROR, FRAME_ERROR = 0x20, 0x02, 0x01  # bits of STATUS
MODES = ("normal", "option 1", "option 2", "motion detection")  # by bits 1 and 0 of MODE
OVERLOAD = (-3456, 3455)  # the words 0x9400 and 0x6BFF, which mean an overloaded channel, count
SCA3000_THERMOMETER = Thermometer(Field(0x12, 9, shift=5, order="little", signed=False), 256, 1.8, 23.0)


def in_unchanged_mode(sensor: RegisterSensor) -> Registers:
    """Return a sample of an SCA3000 whose status is good, and whose lock and mode are those of the first sample."""
    registers: dict[int, int] = {}
    for first, count in sensor.part.bursts:
        registers |= sensor.registers(first, count)
    # STATUS speaks of the SPI frame before it, which is that of the data.
    status, mode = sensor.register(STATUS), sensor.register(MODE)
    check_data_line(bytes(registers.values()))
    if status & CHECKSUM_ERROR:
        raise DeviceFault(
            "the part reports a checksum error of its EEPROM (STATUS bit 1), so its own trimming is lost: switch its "
            "supply off and on; if it stays, replace the part"
        )
    if status & FRAME_ERROR and sensor.link.letter == "s":
        raise BusError(
            "the part reports that the previous SPI frame was damaged (STATUS bit 0): try a slower clock (such as "
            "speed=100000), shorter wires, and see that nothing else shares its chip select"
        )
    setting = (status & UNLOCKED, mode)
    before = sensor.remembered = sensor.remembered or setting
    if setting != before:
        # A reset, which the part does not report.
        was, now = (
            f"{MODES[mode & 0b11]} (MODE 0x{mode:02X}), {_lock_in_words(lock)}" for lock, mode in (before, setting)
        )
        raise DeviceFault(
            "the part was reset, its supply failed, or another program has set it since the session began: its mode "
            f"was {was}, and is {now}: check the supply; if it stays, begin the session anew"
        )
    return registers


def with_revision_and_mode(sensor: RegisterSensor) -> Mapping[str, str]:
    """Return what an SCA3000 is; a mode that is not normal is reported and not refused."""
    sensor.remembered = None
    revision = sensor.register(REVID)
    said = in_words(sensor.read(), trimmed=True)
    lock, mode = sensor.remembered
    name = MODES[mode & 0b11]
    if name != "normal":
        name += (
            ", not normal: bandwidth and data rate differ from the data sheet's normal mode (tiltcal only reads: "
            "switch the sensor's supply off and on to leave it)"
        )
    return {"revision": f"{revision >> 4}.{revision & 0b1111}", "registers": _lock_in_words(lock), "mode": name, **said}


def _lock_in_words(lock: int) -> str:
    return "unlocked" if lock else "locked"


def at_any_range(part: RegisterPart, address: Address) -> RegisterPart:
    """Return an SCA3000 of any range with the options of an address; a real one has to state its sensitivity."""
    # ±1 g must stay clear of the overload codes, and one count must be less than 1 g.
    stated = part.sampling.counts_per_g if address.simulated else None
    counts = address.number("counts_per_g", stated, low=1.0, high=OVERLOAD[1])
    rate = address.number("rate", part.sampling.rate, low=1.0, high=10_000.0)
    if address.choice("thermometer", {"no": False, "yes": True}, False):
        part = _with_thermometer(part)
    by_command = address.choice("pointer", {"register": False, "command": True}, False)
    frame = replace(part.frame, by_command=by_command)
    return replace(part, sampling=Sampling(ranges={"": Range(0, counts, OVERLOAD)}, range="", rate=rate), frame=frame)


def _with_thermometer(part: RegisterPart) -> RegisterPart:
    return replace(part, thermometer=SCA3000_THERMOMETER, bursts=((0x13, 2), *SCA3000.bursts))


SCA3000 = RegisterPart(
    name="sca3000-i2c",
    title="VTI (Murata) SCA3000 three-axis accelerometer of any range, I2C",
    short="SCA3000",
    channels={axis: Field(at, 13, shift=3, order="little") for axis, at in (("x", 0x04), ("y", 0x06), ("z", 0x08))},
    bursts=((0x09, 6),),
    sampling=Sampling(
        # Of a virtual part; that of a real one must be stated.
        ranges={"": Range(0, 1333.0, OVERLOAD)},
        range="",
        # The slowest normal one of the known parts, the E04's.
        rate=100.0,
    ),
    addresses=(f"{I2C}0x1d&counts_per_g=1333",),
    frame=Frame(
        shift=2,
        reading=0b00,
        writing=0b10,
        count=-1,
        # No source states the fastest clock; 4 MHz has been used, and 500 kHz suits the other parts of the maker.
        spi=SpiPort((0,), fastest=None, speed=500_000),
    ),
    virtual=VirtualFacts(
        # The values of real parts are unknown.
        held={REVID: 0x21},
        memory_fault=(STATUS, CHECKSUM_ERROR),
        # No source states a tolerance: the limits of a virtual part are ours, and the spread is wide enough for any
        # part, narrow enough to distinguish the faces of a cube.
        limits=Tolerances(offset=0.05, sensitivity=0.03, cross=0.02, drift=0.5e-3, gain=1e-4, thermometer=2.0),
        spread=(0.1, 0.05),
        noise_counts=1.5,
        not_modelled=(
            "the real noise, tolerances and drift, which no source states: a virtual part has ours",
            "modes other than normal, ring buffer, motion detection, free fall, interrupts, writes",
        ),
    ),
    take=in_unchanged_mode,
    probe=with_revision_and_mode,
    options=("counts_per_g", "rate", "thermometer", "pointer"),
    configure=at_any_range,
)


def _sca3000(variant: str, counts_per_g: float, rate: float, buses: str = "SPI", extent: str = "") -> RegisterPart:
    """Return a part of the family; one with I2C as well has a thermometer."""
    on_i2c = "I2C" in buses
    extent = extent or f"{counts_per_g:g} count/g"
    part = replace(
        SCA3000,
        name=f"sca3000-{variant.lower()}",
        title=f"VTI (Murata) SCA3000-{variant} three-axis accelerometer, {extent}, {buses}",
        sampling=replace(SCA3000.sampling, ranges={"": Range(0, counts_per_g, OVERLOAD)}, rate=rate),
        addresses=(SPI, f"{I2C}0x1d") if on_i2c else (SPI,),
        options=(),
        configure=lambda part, address: part,
    )
    return _with_thermometer(part) if on_i2c else part


MODELS = {
    part.name: part.model()
    for part in (
        _sca3000("D01", 1333.0, 250.0, "SPI or I2C", "±2 g"),
        _sca3000("E02", 1000.0, 125.0),
        _sca3000("E04", 500.0, 100.0),
        _sca3000("E05", 160.0, 200.0),
        SCA3000,
        ADXL355,
        IIS2ICLX,
    )
}
