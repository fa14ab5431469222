"""Analog Devices ADXL355 three-axis accelerometer, on SPI or I2C.

Registers hold one byte each, and the address counts up in a burst::

    SPI   command byte (register << 1, bit 0 to read), then data while chip select stays low
    I2C   register, repeated start, then data

    0x00-0x02    0xAD 0x1D 0xED
    0x04 STATUS  bit 0 a new sample
    0x06-0x07    temperature, 12 bits: the low half of the first byte, then the second
    0x08-0x10    x, y, z: three bytes each, most significant first; 20 bits, two's complement, left-aligned
    0x28 FILTER  4000 / 2**n samples a second
    0x2C RANGE   1, 2, 3: ±2 g, ±4 g, ±8 g; bit 7 as after a reset
    0x2D POWER   bit 0 standby, in which nothing is measured and everything is set
    0x2F RESET   0x52
    0x50-0x54    shadow registers of the factory trim

A reset may fail to load the trim, so the shadow registers are compared with those before it. The offset trim registers
are never written: what they hold is lost with the next reset, and a calibration with it.

Sources: ADXL354/ADXL355 data sheet Rev. 0; of the temperature and the reset what later revisions corrected (Linux
``drivers/iio/accel/adxl355_core.c``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from math import log2
from typing import TYPE_CHECKING

from tiltcal.drivers.device import Model, Reading, SpiPort, deviation_within, from_twin, typical_nonlinearity
from tiltcal.drivers.polled import PolledSensor, Settings
from tiltcal.drivers.registers import RegisterPort, check_data_line, choose_range, slowest_clock
from tiltcal.errors import DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

WHO, STATUS, TEMPERATURE, DATA = 0x00, 0x04, 0x06, 0x08
FILTER, RANGE, POWER, RESET, SHADOW = 0x28, 0x2C, 0x2D, 0x2F, 0x50

IDENTITY = bytes.fromhex("AD1DED")
DATA_READY = 0x01
AFTER_RESET, MEASURE, RESET_CODE = 0x80, 0x00, 0x52
"""Bit 7 of RANGE after a reset; POWER during measurement; the reset code of RESET."""

SHADOWS = 5
RESETS = 5
"""Largest number of resets until the trim is loaded."""
RESET_SECONDS, TURN_ON_SECONDS = 0.010, 0.010

FASTEST = 4000.0
"""Samples per second; each rate is half of the one before."""
SLOWEST_STEP = 10
DEFAULT_STEP = 5

CENTRE, CENTRE_CELSIUS, SLOPE = 1885, 25.0, -9.05
"""The line of the thermometer; later revisions of the data sheet correct the 1852 of the first."""

RANGES = {"2g": 1, "4g": 2, "8g": 3}
"""Code in RANGE."""
COUNTS_PER_G = {1: 256_000.0, 2: 128_000.0, 3: 64_000.0}

OFFSET_LIMIT, SENSITIVITY_LIMIT = 0.075, 0.08
"""Largest error of either sign as delivered, g and relative."""
NONLINEARITY = 0.001
"""Typical, relative to the range."""
DENSITY = 25e-6
"""Noise, g/√Hz."""

HIGHEST_I2C_RATE = 500.0
"""At 100 kHz, reading a sample takes 2 ms, which must be less than the sample period."""


@dataclass(frozen=True, slots=True)
class Adxl355Settings:
    """The settings of an address.

    range: code.
    step: the rate is 4000 Hz halved so often.
    """

    range: int = 1
    step: int = DEFAULT_STEP

    @property
    def counts_per_g(self) -> float:
        """Nominal sensitivity, count/g."""
        return COUNTS_PER_G[self.range]

    @property
    def extent(self) -> float:
        """Largest acceleration, g."""
        return float(2**self.range)

    @property
    def rate(self) -> float:
        """Samples a second; the filter's corner is at a quarter of it."""
        return FASTEST * 0.5**self.step


class Adxl355(PolledSensor):
    """The driver of an ADXL355, on either bus."""

    NAME, PART_ID, NEW_SAMPLE = "ADXL355", (WHO, IDENTITY), (STATUS, DATA_READY)

    def __init__(self, settings: Adxl355Settings, link: Link, clock: Clock) -> None:
        port = RegisterPort(link, lambda register: register << 1 | 1, lambda register: register << 1)
        super().__init__(port, clock, settings.rate)
        self._chosen = settings
        self._trim = b""

    def _identity(self) -> Mapping[str, str]:
        (revision,) = self._port.read(WHO + 3, 1)
        chosen = self._chosen
        return {
            "revision": str(revision),
            "range": f"±{2**chosen.range} g, {chosen.counts_per_g:.0f} count/g, {chosen.rate:g} samples/s",
        }

    def _set_up(self) -> None:
        self._reset()
        *stopped, start = self._settings()
        self._write(stopped)
        self._write([start])
        # The turn-on time, and the group delay of the filter: four samples suffice at every rate.
        self._clock.sleep(TURN_ON_SECONDS + 4 * self._period)

    def _reset(self) -> None:
        """Reset until the shadow registers have the content that they had first; a reset may have lost it since."""
        before = self._port.read(SHADOW, SHADOWS)
        self._trim = self._trim or before
        for _ in range(RESETS):
            self._port.write(RESET, RESET_CODE)
            self._clock.sleep(RESET_SECONDS)
            if self._port.read(SHADOW, SHADOWS) == self._trim:
                return
        raise DeviceFault(
            "the ADXL355 does not load its factory trim after a reset (its shadow registers 0x50 to 0x54 differ): "
            "switch its supply off for a second and on; if it stays, start the command again"
        )

    def _settings(self) -> Settings:
        return (FILTER, self._chosen.step), (RANGE, AFTER_RESET | self._chosen.range), (POWER, MEASURE)

    def _sample(self) -> Reading:
        data = self._port.read(DATA, 9)
        check_data_line(data)
        temperature = self._port.read(TEMPERATURE, 2)
        again = self._port.read(TEMPERATURE, 2)
        # The two bytes are not taken together: the second one of the first pair belongs to its first byte where that
        # stays the same. Where it does not, a measurement has just begun, and the second pair is of that one.
        whole = temperature if temperature[0] & 0x0F == again[0] & 0x0F else again
        x, y, z = (float(decode_word(data[at : at + 3])) for at in (0, 3, 6))
        return Reading((x, y, z), decode_temperature(whole))


def decode_word(three: bytes) -> int:
    """Return the 20-bit word of three registers, -524288 to 524287 count; the low 4 bits have no meaning."""
    return int.from_bytes(three, "big", signed=True) >> 4


def decode_temperature(pair: bytes) -> float:
    """Return the temperature of two registers, °C; the upper half of the first has no meaning."""
    raw = (pair[0] & 0x0F) << 8 | pair[1]
    return CENTRE_CELSIUS + (raw - CENTRE) / SLOPE


def _configured(address: Address) -> Model:
    """Return the model with the range and rate of the address."""
    rate = address.number("rate", FASTEST / 2**DEFAULT_STEP, low=FASTEST / 2**SLOWEST_STEP - 0.01, high=FASTEST)
    step = round(log2(FASTEST / rate))
    if abs(rate * 2**step / FASTEST - 1.0) > 0.01:
        address.refuse(f"option rate={rate:g} is none of 4000, 2000, 1000, 500, 250, 125, 62.5, ... 3.90625")
    if address.scheme == "i2c" and rate > HIGHEST_I2C_RATE:
        address.refuse(f"option rate={rate:g} is too fast for I2C (at most {HIGHEST_I2C_RATE:g})")
    return _model(Adxl355Settings(choose_range(address, RANGES, 1), step))


def _model(settings: Adxl355Settings) -> Model:
    return Model(
        name="adxl355",
        title="Analog Devices ADXL355 three-axis accelerometer, ±2, ±4 or ±8 g, SPI or I2C",
        channels=("x", "y", "z"),
        unit="count",
        schemes=("spi", "i2c"),
        addresses=("spi:///dev/spidev0.0", "i2c:///dev/i2c-1?address=0x1d"),
        offset=0.0,
        sensitivity=settings.counts_per_g,
        offset_spread=deviation_within(OFFSET_LIMIT),
        sensitivity_spread=deviation_within(SENSITIVITY_LIMIT),
        nonlinearity=typical_nonlinearity(NONLINEARITY * settings.extent, settings.extent),
        rails=(-524288.0, 524287.0),
        resolution=1.0,
        # A read waits for the next sample.
        interval=0.0,
        thermometer=True,
        thermometer_step=1.0 / 9.05,
        driver=partial(Adxl355, settings),
        twin=from_twin("adxl355", "adxl355_twin", settings),
        not_modelled=(
            "response time and bandwidth: a new position is there with the next sample, whose noise is independent",
            "overrange, self-test, FIFO, high-pass filter, interrupts, offset trim",
            "a reset that fails to load the trim; the tolerance of the part's clock",
            "settings that are written while it measures: they take effect here",
            "samples of two moments in one burst; thermometer noise",
            "supply: brown-out; the memory fault (parity) of other parts",
        ),
        default_truth=from_twin("adxl355", "draw_truth", settings),
        spi=SpiPort(
            modes=(0,), fastest=10_000_000, speed=1_000_000, slowest=max(100_000, slowest_clock(16, settings.rate))
        ),
        options=("range", "rate"),
        configure=_configured,
    )


ADXL355 = _model(Adxl355Settings())
