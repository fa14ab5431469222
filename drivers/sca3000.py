"""VTI (Murata) SCA3000 three-axis accelerometer, on SPI or I2C.

Registers hold one byte each. A transaction names the first register, and the address counts DOWN from byte to byte::

    SPI   command byte (register << 2), then data while chip select stays low
    I2C   register, repeated start, then data

    0x00 REVID   major and minor revision, 4 bits each
    0x02 STATUS  bit 5 unlocked, bit 1 EEPROM checksum error, bit 0 the previous SPI frame was bad
    0x04-0x09    X_LSB X_MSB Y_LSB Y_MSB Z_LSB Z_MSB: 13 bits, two's complement, left-aligned
    0x12-0x13    TEMP_LSB TEMP_MSB: 9 bits below the two highest
    0x14 MODE    bits 1 and 0: 0 normal, 1 and 2 the part's options, 3 motion detection

This driver never writes a register: a wrong reserved bit can block the part, and a calibration needs only reads.

Sources: Linux ``drivers/iio/accel/sca3000.c``; openmag ``sca3000.h``; SCA3000 Series product family specification,
VTI 8257300A.07, page 12. The last one states that addresses count down on I2C as well. That the pointer there is the
plain register address is inferred, so ``pointer=command`` sends the SPI command byte in its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from tiltcal.drivers.device import Model, Reading, SpiPort, from_twin
from tiltcal.drivers.registers import RegisterPort, check_data_line, in_counts, slowest_clock
from tiltcal.errors import BusError, DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

REVID, STATUS, MODE = 0x00, 0x02, 0x14
X_LSB, Z_MSB = 0x04, 0x09
TEMP_LSB, TEMP_MSB = 0x12, 0x13

UNLOCKED, CHECKSUM_ERROR, FRAME_ERROR = 0x20, 0x02, 0x01
"""Bits of STATUS."""

MODES = ("normal", "option 1", "option 2", "motion detection")
"""By bits 1 and 0 of MODE."""

OVERFLOW = (-3456.0, 3455.0)
"""The words 0x9400 and 0x6BFF, which mean an overloaded channel, count."""

COMMAND_SHIFT, WRITING = 2, 0b10
"""An SPI command byte has the register in its upper six bits; the lower two are 0 for a read."""


@dataclass(frozen=True, slots=True)
class Sca3000Part:
    """One part of the family: its constants as far as they are known, and its wiring.

    name: of the model.
    schemes, addresses: how it can be connected, and an example of each way.
    rate: output data rate in normal mode, Hz.
    any_range: whether the address of a real part must state ``counts_per_g``.
    pointer_shift: on I2C the register pointer is the address shifted left by this many bits.
    """

    name: str
    title: str
    schemes: tuple[str, ...]
    addresses: tuple[str, ...]
    counts_per_g: float
    rate: float
    thermometer: bool = False
    any_range: bool = False
    pointer_shift: int = 0


class Sca3000:
    """The driver of an SCA3000 of any range on either bus."""

    def __init__(self, part: Sca3000Part, link: Link, clock: Clock) -> None:
        self._part = part
        self._link = link
        self._setting: tuple[int, int] | None = None
        """The lock in STATUS and the content of MODE, as the first sample found them."""
        shift = part.pointer_shift
        self._port = RegisterPort(
            link,
            read_command=lambda register: register << COMMAND_SHIFT,
            write_command=lambda register: register << COMMAND_SHIFT | WRITING,
            pointer=lambda register: register << shift,
        )

    def probe(self) -> Mapping[str, str]:
        """Check that the device answers plausibly; the errors are those of :meth:`read`.

        Returns
        -------
        mapping of str to str
            Its revision, lock and mode, the words of x, y and z, and the temperature if it has a thermometer. A mode
            that is not normal is reported and not refused.
        """
        self._setting = None
        (revision,) = self._port.read(REVID, 1)
        reading, (lock, mode) = self._sample()
        said = {
            "revision": f"{revision >> 4}.{revision & 0b1111}",
            "registers": _lock_in_words(lock),
            "mode": _mode_in_words(mode),
        }
        said |= in_counts(reading.values)
        if reading.temperature is not None:
            said["temperature"] = f"{reading.temperature:.1f} °C"
        return said

    def read(self) -> Reading:
        """Take one sample: x, y and z in counts, -4096 to 4095, and the temperature in °C where there is one.

        Raises
        ------
        BusError
            The transaction failed, every bit of the sample is the same, or the part reports the SPI frame of the data
            as damaged.
        DeviceFault
            The checksum of the part's own memory is wrong, or its mode or lock is not that of the first sample.
        """
        return self._sample()[0]

    def discard(self) -> None:
        """Do nothing: every read returns the latest conversion."""

    def _sample(self) -> tuple[Reading, tuple[int, int]]:
        """Return a reading, and the lock and the mode in which it was taken."""
        temperature = self._port.read(TEMP_MSB, 2) if self._part.thermometer else b""
        data = self._port.read(Z_MSB, 6)
        # STATUS speaks of the SPI frame before it, which is that of the data.
        (status,) = self._port.read(STATUS, 1)
        (mode,) = self._port.read(MODE, 1)
        check_data_line(data + temperature)
        self._check_status(status)
        setting = (status & UNLOCKED, mode)
        self._require_unchanged(setting)
        z, y, x = (float(decode_word(data[at : at + 2])) for at in (0, 2, 4))
        return Reading((x, y, z), decode_temperature(temperature) if temperature else None), setting

    def _require_unchanged(self, setting: tuple[int, int]) -> None:
        """Raise an error where a reset, which the part does not report, shows in its lock or mode."""
        before = self._setting = self._setting or setting
        if setting != before:
            was, now = (
                f"{MODES[mode & 0b11]} (MODE 0x{mode:02X}), {_lock_in_words(lock)}" for lock, mode in (before, setting)
            )
            raise DeviceFault(
                "the part was reset, its supply failed, or another program has set it since the session began: its "
                f"mode was {was}, and is {now}: check the supply; if it stays, begin the session anew"
            )

    def _check_status(self, status: int) -> None:
        if status & CHECKSUM_ERROR:
            raise DeviceFault(
                "the part reports a checksum error of its EEPROM (STATUS bit 1), so its own trimming is lost: switch "
                "its supply off and on; if it stays, replace the part"
            )
        if status & FRAME_ERROR and self._link.letter == "s":
            raise BusError(
                "the part reports that the previous SPI frame was damaged (STATUS bit 0): try a slower clock (such as "
                "speed=100000), shorter wires, and see that nothing else shares its chip select"
            )


def decode_word(pair: bytes) -> int:
    """Return the 13-bit word of an MSB and an LSB, -4096 to 4095 count; the low 3 bits of the LSB have no meaning."""
    return int.from_bytes(pair, "big", signed=True) >> 3


def decode_temperature(pair: bytes) -> float:
    """Return the temperature in TEMP_MSB and TEMP_LSB, °C; the two highest and the five lowest bits have no meaning."""
    raw = (pair[0] & 0x3F) << 3 | pair[1] >> 5
    return 23.0 + (raw - 256) / 1.8


def _lock_in_words(lock: int) -> str:
    return "unlocked" if lock else "locked"


def _mode_in_words(mode: int) -> str:
    name = MODES[mode & 0b11]
    if name == "normal":
        return name
    return (
        f"{name}, not normal: bandwidth and data rate differ from the data sheet's normal mode (tiltcal only reads: "
        "switch the sensor's supply off and on to leave it)"
    )


def _configured(part: Sca3000Part, address: Address) -> Model:
    """Return the model with the options of the address."""
    required = part.any_range and not address.simulated
    return _model(
        replace(
            part,
            # ±1 g must stay clear of the overflow codes, and one count must be less than 1 g.
            counts_per_g=address.number(
                "counts_per_g", None if required else part.counts_per_g, low=1.0, high=OVERFLOW[1]
            ),
            rate=address.number("rate", part.rate, low=1.0, high=10_000.0),
            thermometer=address.choice("thermometer", {"no": False, "yes": True}, part.thermometer),
            pointer_shift=address.choice("pointer", {"register": 0, "command": COMMAND_SHIFT}, part.pointer_shift),
        )
    )


def _model(part: Sca3000Part) -> Model:
    return Model(
        name=part.name,
        title=part.title,
        channels=("x", "y", "z"),
        unit="count",
        schemes=part.schemes,
        addresses=part.addresses,
        offset=0.0,
        sensitivity=part.counts_per_g,
        # No tolerance of the family is known: wide enough for any part, narrow enough to distinguish the faces of a
        # cube.
        offset_spread=0.1,
        sensitivity_spread=0.05,
        rails=OVERFLOW,
        resolution=1.0,
        interval=1.0 / part.rate,
        thermometer=part.thermometer,
        thermometer_step=1.0 / 1.8,
        driver=partial(Sca3000, part),
        twin=from_twin("sca3000", "sca3000_twin", part),
        not_modelled=(
            "the real noise, tolerances and drift, which no source states: a virtual part has ours (noise 1.5 count)",
            "response time and bandwidth: a new position takes effect at the next output word, without ringing",
            "modes other than normal, ring buffer, motion detection, free fall, interrupts",
            "writes, which the driver never sends: they change nothing",
            "supply: start-up time, brown-out",
            "bytes damaged by noise, clock too fast, clock stretching",
        ),
        default_truth=from_twin("sca3000", "draw_truth", part),
        # No source states the fastest clock; 4 MHz has been used, and 500 kHz suits the other parts of the maker.
        # A burst must end before the next word is due, or it mixes bytes of two words.
        spi=SpiPort(modes=(0,), fastest=None, speed=500_000, slowest=slowest_clock(6, part.rate))
        if "spi" in part.schemes
        else None,
        options=("counts_per_g", "rate", "thermometer", *(("pointer",) if "i2c" in part.schemes else ())),
        configure=partial(_configured, part),
    )


SPI, I2C_BUS = "spi:///dev/spidev0.0", "i2c:///dev/i2c-1?address=0x1d"
"""Example addresses; the user must state the I2C address."""


def _on_spi(variant: str, counts_per_g: float, rate: float) -> Model:
    title = f"VTI (Murata) SCA3000-{variant} three-axis accelerometer, {counts_per_g:g} count/g, SPI"
    return _model(Sca3000Part(f"sca3000-{variant.lower()}", title, ("spi",), (SPI,), counts_per_g, rate))


# The D01 has a bit that switches its I2C off, so it has I2C as well.
D01 = _model(
    Sca3000Part(
        "sca3000-d01",
        "VTI (Murata) SCA3000-D01 three-axis accelerometer, ±2 g, SPI or I2C",
        ("spi", "i2c"),
        (SPI, I2C_BUS),
        counts_per_g=1333.0,
        rate=250.0,
        thermometer=True,
    )
)
E02 = _on_spi("E02", counts_per_g=1000.0, rate=125.0)
E04 = _on_spi("E04", counts_per_g=500.0, rate=100.0)
E05 = _on_spi("E05", counts_per_g=160.0, rate=200.0)
I2C = _model(
    Sca3000Part(
        "sca3000-i2c",
        "VTI (Murata) SCA3000 three-axis accelerometer of any range, I2C",
        ("i2c",),
        (f"{I2C_BUS}&counts_per_g=1333",),
        # Of a virtual part; that of a real one must be stated.
        counts_per_g=1333.0,
        # The slowest normal one of the known parts, the E04's.
        rate=100.0,
        any_range=True,
    )
)
