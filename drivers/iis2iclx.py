"""ST IIS2ICLX two-axis inclinometer, on SPI or I2C.

It measures x and y in the plane of its package and has no z. Registers hold one byte each, and the address counts up in
a burst, low byte first::

    SPI   register, bit 7 to read, then data while chip select stays low
    I2C   register, repeated start, then data

    0x0F WHO_AM_I  0x6B, which other parts of the maker answer as well
    0x10 CTRL1_XL  bits 7 to 4 rate, 3 and 2 range
    0x12 CTRL3_C   bit 0 reset, bit 2 count up, bit 6 hold a sample until both of its bytes are read
    0x18 CTRL9_XL  bit 1 has to be set after every reset
    0x1E STATUS    bit 0 a new sample
    0x20-0x21      temperature, 0x28-0x2B x and y: 16 bits, two's complement

Reserved registers are never written: that may damage the part for good.

Source: IIS2ICLX data sheet, ST DS13005 Rev. 7.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from tiltcal.drivers.device import Model, Reading, SpiPort, deviation_within, from_twin, typical_nonlinearity
from tiltcal.drivers.polled import PolledSensor, Settings
from tiltcal.drivers.registers import RegisterPort, check_data_line, choose_range, slowest_clock
from tiltcal.errors import DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

WHO_AM_I, CTRL1, CTRL3, CTRL9, STATUS, TEMPERATURE, DATA = 0x0F, 0x10, 0x12, 0x18, 0x1E, 0x20, 0x28

IDENTITY = 0x6B
READING = 0x80
"""Bit 7 of an SPI command."""
DATA_READY = 0x01
SOFTWARE_RESET, WHOLE_SAMPLES, CONFIGURED = 0x01, 0x44, 0xE2
"""CTRL3 for a reset; CTRL3 during measurement; CTRL9 after every reset."""

RESET_SECONDS = 0.020
"""The data sheet's turn-on time is 15 ms."""
UNSETTLED = 3
"""Samples that are discarded after power-down."""

RATES = {12.5: 1, 26.0: 2, 52.0: 3, 104.0: 4, 208.0: 5, 416.0: 6, 833.0: 7}
"""Code by samples per second; higher codes are reserved."""
RANGES = {"0.5g": 0, "1g": 2, "2g": 3, "3g": 1}
"""Code by range, in the order of the part."""
MILLI_G = {0: 0.015, 2: 0.031, 3: 0.061, 1: 0.122}
"""One count, mg."""

NONLINEARITY = 0.001
"""Typical, relative to the range."""
OFFSET_LIMIT, SENSITIVITY_LIMIT = 0.008, 0.02
DENSITY = 15e-6
"""Noise, g/√Hz."""


@dataclass(frozen=True, slots=True)
class Iis2iclxSettings:
    """The settings of an address.

    range: code.
    rate: samples a second.
    """

    range: int = RANGES["2g"]
    rate: float = 104.0

    @property
    def counts_per_g(self) -> float:
        """Nominal sensitivity, count/g."""
        return 1000.0 / MILLI_G[self.range]

    @property
    def extent(self) -> float:
        """Largest acceleration, g."""
        return next(float(word.removesuffix("g")) for word, code in RANGES.items() if code == self.range)


class Iis2iclx(PolledSensor):
    """The driver of an IIS2ICLX, on either bus."""

    NAME, PART_ID, NEW_SAMPLE = "IIS2ICLX", (WHO_AM_I, bytes([IDENTITY])), (STATUS, DATA_READY)

    def __init__(self, settings: Iis2iclxSettings, link: Link, clock: Clock) -> None:
        port = RegisterPort(link, lambda register: register | READING, int)
        super().__init__(port, clock, settings.rate)
        self._chosen = settings

    def _identity(self) -> Mapping[str, str]:
        chosen = self._chosen
        return {
            "identity": f"0x{IDENTITY:02X} (of other ST parts as well: is it an IIS2ICLX?)",
            "range": f"±{chosen.extent:g} g, {chosen.counts_per_g:.1f} count/g, {chosen.rate:g} samples/s",
        }

    def _set_up(self) -> None:
        self._port.write(CTRL3, SOFTWARE_RESET)
        self._clock.sleep(RESET_SECONDS)
        self._write(self._settings())
        for _ in range(UNSETTLED):
            if not self._sample_comes():
                raise DeviceFault(self._why_no_sample(was_ready=False))
            self._port.read(DATA, 4)

    def _settings(self) -> Settings:
        rate_and_range = RATES[self._chosen.rate] << 4 | self._chosen.range << 2
        return (CTRL9, CONFIGURED), (CTRL3, WHOLE_SAMPLES), (CTRL1, rate_and_range)

    def _sample(self) -> Reading:
        data = self._port.read(DATA, 4)
        temperature = self._port.read(TEMPERATURE, 2)
        check_data_line(data + temperature)
        x, y = (float(decode_word(data[at : at + 2])) for at in (0, 2))
        return Reading((x, y), decode_temperature(temperature))


def decode_word(pair: bytes) -> int:
    """Return the word of two registers, low byte first, -32768 to 32767 count."""
    return int.from_bytes(pair, "little", signed=True)


def decode_temperature(pair: bytes) -> float:
    """Return the temperature of two registers, °C."""
    return 25.0 + decode_word(pair) / 256.0


def _configured(address: Address) -> Model:
    """Return the model with the range and rate of the address."""
    rate = address.number("rate", 104.0)
    if rate not in RATES:
        address.refuse(f"option rate={rate:g} is none of {', '.join(f'{known:g}' for known in RATES)}")
    return _model(Iis2iclxSettings(choose_range(address, RANGES, RANGES["2g"]), rate))


def _model(settings: Iis2iclxSettings) -> Model:
    return Model(
        name="iis2iclx",
        title="ST IIS2ICLX two-axis inclinometer, ±0.5, ±1, ±2 or ±3 g, SPI or I2C",
        channels=("x", "y"),
        unit="count",
        schemes=("spi", "i2c"),
        addresses=("spi:///dev/spidev0.0", "i2c:///dev/i2c-1?address=0x6a"),
        offset=0.0,
        sensitivity=settings.counts_per_g,
        offset_spread=deviation_within(OFFSET_LIMIT),
        sensitivity_spread=deviation_within(SENSITIVITY_LIMIT),
        nonlinearity=typical_nonlinearity(NONLINEARITY * settings.extent, settings.extent),
        rails=(-32768.0, 32767.0),
        resolution=1.0,
        # A read waits for the next sample.
        interval=0.0,
        thermometer=True,
        thermometer_step=1.0 / 256.0,
        driver=partial(Iis2iclx, settings),
        twin=from_twin("iis2iclx", "iis2iclx_twin", settings),
        not_modelled=(
            "response time and bandwidth: a new position is there with the next sample, whose noise is independent",
            "filters, self-test, FIFO, user offset, interrupts, machine learning core",
            "unsettled samples after power-down; bytes of two samples where they are not held",
            "what reserved registers do to a real part",
            "thermometer noise; cross-axis sensitivity of a real part, which no source names",
            "supply: brown-out; the memory fault (parity) of other parts",
        ),
        default_truth=from_twin("iis2iclx", "draw_truth", settings),
        spi=SpiPort(modes=(0, 3), fastest=10_000_000, speed=1_000_000, slowest=slowest_clock(12, settings.rate)),
        options=("range", "rate"),
        configure=_configured,
    )


IIS2ICLX = _model(Iis2iclxSettings())
