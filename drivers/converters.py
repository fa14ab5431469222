"""Analog-to-digital converters, the supply of the sensors behind them, and virtual converters.

The supply is measured with each sample or stated, and the readings of ratiometric sensors are shares of it.

TI ADS1115, I2C: four inputs, 16 bits. Two registers are used, of two bytes each, most significant first, and a pointer
that is written first::

    conversion 0x00   the last result, a signed number; 32768 steps are the full scale
    config     0x01   15 OS, 14:12 input, 11:9 full scale, 8 single shot, 7:5 rate, 4:0 comparator (00011: off)

Writing OS as 1 starts a conversion; OS reads 0 until it is done.

Microchip MCP3208, SPI: eight inputs, 12 bits. One frame of three bytes starts a conversion and returns it::

    out   0 0 0 0 0 1 S D2   D1 D0 x x x x x x   x x x x x x x x
    in    ? ? ? ? ? ? ? ?    ? ? ? 0 B11 .. B8   B7 .. B0

S is 1 for an input against ground, D2 to D0 its number. The result is a share of the voltage at the reference pin:
4096 steps are all of it.

Sources: ADS111x data sheet, the fields' values as in Linux's drivers/iio/adc/ti-ads1015.c; MCP3204/3208 data sheet,
DS21298.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import ClassVar

from tiltcal.drivers.bus import Link, SpiPort, check_data_line, require_length
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.drivers.virtual import HeldPose, Truth, VirtualPart, uniform
from tiltcal.errors import BusError, DeviceFault

SCHEMES = ("ads1115+i2c", "mcp3208+spi")
"""Address schemes of the converters: part and bus of each. A virtual sensor is behind the first one."""

NOMINAL = 5.0  # nominal supply of analog sensors, V


class Converter(ABC):
    """A converter with the settings of an address; it keeps nothing from one conversion to the next.

    inputs, steps: how many it has; of the full scale.
    full_scale: V; a larger voltage reads as full scale.
    reference: voltage at its reference pin, V, if it has one; a sensor with the same supply is then ratiometric.
    description: the converter and its settings, for the operator.
    """

    inputs: ClassVar[int]
    steps: ClassVar[int]
    options: ClassVar[tuple[str, ...]]
    spi: ClassVar[SpiPort | None] = None
    full_scale: float
    reference: float | None = None
    description: str

    @abstractmethod
    def volts(self, link: Link, clock: Clock, number: int) -> float:
        """Measure one input against ground, V; a converter that misbehaves is a HardwareError."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """How a ratiometric sensor is wired to a converter.

    numbers: the inputs of its signals.
    supply: the input that measures its supply; None if that is stated.
    volts: of the supply, as stated; if it is measured, the nominal value.
    low, high: of the supply, within which the sensor is ratiometric, V.
    """

    converter: Converter
    numbers: tuple[int, ...]
    supply: int | None
    volts: float
    low: float
    high: float

    def shares(self, link: Link, clock: Clock) -> tuple[tuple[float, ...], float]:
        """Measure the signals as shares of the supply, and the supply, V.

        The conversions follow each other, so a change of the supply between them would look like tilt. A measured
        supply is therefore read before and after the others and interpolated: drift cancels, and only ripple faster
        than one sample remains.
        """
        measure = partial(self.converter.volts, link, clock)
        if self.supply is None:
            return tuple(measure(number) / self.volts for number in self.numbers), self.volts
        before = self._checked(measure(self.supply))
        volts = [measure(number) for number in self.numbers]
        after = self._checked(measure(self.supply))
        slope = (after - before) / (len(volts) + 1)
        shares = tuple(volt / (before + slope * place) for place, volt in enumerate(volts, start=1))
        return shares, (before + after) / 2.0

    def said(self, volts: float) -> dict[str, str]:
        """Return supply and converter as text, with the voltage of the supply and its source."""
        source = "stated" if self.supply is None else f"measured at input {self.supply}"
        return {"supply": f"{volts:.4f} V, {source}", "converter": self.converter.description}

    def _checked(self, volts: float) -> float:
        # The largest code also means every larger voltage.
        if volts > 0.9995 * self.converter.full_scale:
            raise DeviceFault(
                f"the supply at input {self.supply} reads {volts:.3f} V, the full scale of this converter: state "
                "it with vdd=VOLTS, or give the converter a higher full scale"
            )
        # 1 % allows for the error of the converter, which cancels in the ratio.
        if not 0.99 * self.low <= volts <= 1.01 * self.high:
            raise DeviceFault(
                f"the supply at input {self.supply} reads {volts:.3f} V, where the sensor needs {self.low:g} to "
                f"{self.high:g} V: is it switched on, and wired to this input?"
            )
        return volts


def take_inputs(address: Address, signals: Mapping[str, int], low: float, high: float) -> Inputs:
    """Return how the signals of a sensor are wired at an address, and its supply, which may be ``low`` to ``high``, V.

    The supply is measured (``supply=N``), stated (``vdd=VOLTS``), or the reference of the converter. The inputs of a
    virtual sensor alone have defaults, those of ``signals``.
    """
    if not address.simulated and address.scheme not in SCHEMES:
        known = " or ".join(f"{scheme}:" for scheme in SCHEMES)
        address.refuse(f"{address.scheme}: is not a known converter (analog sensors are connected by {known})")
    converter = Mcp3208(address) if address.scheme == SCHEMES[1] else Ads1115(address)

    def number(option: str, default: int) -> int:
        return address.integer(option, default if address.simulated else None, low=0, high=converter.inputs - 1)

    wires = {name: number(name, default) for name, default in signals.items()}
    volts = min(NOMINAL, high) if converter.reference is None else converter.reference
    if "supply" in address.options and "vdd" in address.options:
        address.refuse("options 'supply' and 'vdd' exclude each other: the supply is either measured or stated")
    if "vdd" in address.options:
        volts = address.number("vdd", low=low, high=high)
    elif "supply" in address.options or address.simulated:
        wires["supply"] = number("supply", 2)
        if converter.full_scale <= low:
            address.refuse(f"{converter.description} cannot measure a supply of {low:g} V or more")
    elif converter.reference is None:
        address.refuse(
            "the supply of the sensor is unknown: wire it to an input and add supply=N, or state it with vdd=VOLTS"
        )
    elif not low <= volts <= high:
        address.refuse(
            f"the sensor needs a supply of {low:g} to {high:g} V, so the reference of {volts:g} V is not its supply: "
            "wire that to an input and add supply=N, or state it with vdd=VOLTS"
        )
    for (one, first), (other, second) in combinations(wires.items(), 2):
        if first == second:
            address.refuse(f"options {one!r} and {other!r} name the same input {first}")
    return Inputs(converter, tuple(wires[name] for name in signals), wires.get("supply"), volts, low, high)


# --- TI ADS1115 ---

CONVERSION, CONFIG = 0x00, 0x01  # registers
START = DONE = 0x8000  # OS: writing it starts a conversion; reading it shows that none is running
RESET = 0x8583  # content of the config register after power-up
RANGES = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256)
"""Full scales, V, by their code. An input may never exceed the converter's own supply, whatever the full scale."""
RATES = (8, 16, 32, 64, 128, 250, 475, 860)  # conversions per second, by their code
TOLERANCE = 0.1  # the converter's clock may be this much slower or faster than nominal
POLLS = 20  # polls of a conversion, a tenth of its duration apart, before it counts as failed
_SINGLE_ENDED, _SINGLE_SHOT, _COMPARATOR_OFF = 0b100, 0x0100, 0b00011


class Ads1115(Converter):
    """An ADS1115, with one single-shot conversion per input: options ``range`` (V) and ``rate`` (per second)."""

    inputs, steps, options = 4, 32768, ("range", "rate")

    def __init__(self, address: Address) -> None:
        self.full_scale = address.choice("range", {f"{volts:g}": volts for volts in RANGES}, RANGES[0])
        self.rate = address.choice("rate", {str(rate): rate for rate in RATES}, 128)
        self.description = f"ADS1115, ±{self.full_scale:g} V, {self.rate} conversions per second"

    def config(self, number: int) -> int:
        """Return the config register that starts one conversion of an input, 0 to 3, against ground."""
        scale, rate = RANGES.index(self.full_scale) << 9, RATES.index(self.rate) << 5
        return START | (_SINGLE_ENDED | number) << 12 | scale | _SINGLE_SHOT | rate | _COMPARATOR_OFF

    def volts(self, link: Link, clock: Clock, number: int) -> float:
        config = self.config(number)
        link.exchange(bytes([CONFIG]) + config.to_bytes(2, "big"))
        clock.sleep((1.0 + TOLERANCE) / self.rate)
        self._wait_until_done(link, clock, config)
        code = int.from_bytes(_register(link, CONVERSION), "big", signed=True)
        if code in (-0x8000, 0x7FFF):
            larger = [full_scale for full_scale in RANGES if full_scale > self.full_scale]
            advice = f"take a larger one (range={min(larger):g})" if larger else "its inputs may not exceed its supply"
            raise DeviceFault(
                f"input {number} is at or beyond ±{self.full_scale:g} V, the full scale of the ADS1115: {advice}, and "
                "check the wiring"
            )
        return code * self.full_scale / 32768

    def _wait_until_done(self, link: Link, clock: Clock, config: int) -> None:
        """Wait until the conversion of this config is done; another config is a dead bus, a reset or another device."""
        for _ in range(POLLS):
            answer = _register(link, CONFIG)
            check_data_line(answer, "config register")
            held = int.from_bytes(answer, "big")
            if held & ~DONE != config & ~DONE:
                raise DeviceFault(
                    f"the config register reads {held:04X} where {config:04X} was written: did the converter's supply "
                    "fail (8583), does another program use it, or is another device at this address?"
                )
            if held & DONE:
                return
            clock.sleep(0.1 / self.rate)
        raise BusError(
            f"the ADS1115 is still busy after {(1.0 + TOLERANCE + 0.1 * POLLS) / self.rate * 1e3:.3g} ms "
            f"with a conversion that takes {1e3 / self.rate:.3g} ms: switch its supply off and on"
        )


def _register(link: Link, pointer: int) -> bytes:
    return require_length(link.exchange(bytes([pointer]), 2), 2)


ADS1115_BIT_SECONDS = 1.0 / 100_000


class VirtualAds1115(VirtualPart):
    """An ADS1115 on the I2C bus at 100 kHz: the pointer, the config register and the last conversion of one input.

    volts: ``volts(number)`` returns the voltage at an input now, V.
    """

    letter = "i"

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock, volts: Callable[[int], float]) -> None:
        super().__init__(truth, fixture, clock)
        self._volts = volts
        self._pointer = CONVERSION
        self._config = RESET & ~START
        self._code = self._former_code = self._done_ns = 0

    def _answered(self, out: bytes, count: int) -> bytes:
        """Write, then read the register of the pointer."""
        # Each byte has a ninth bit for its acknowledge, and each direction begins with the device's address.
        self._clock.sleep(9 * (1 + len(out)) * ADS1115_BIT_SECONDS)
        if out:
            self._pointer = out[0] & 0b11
        busy = self._clock.now_ns() < self._done_ns
        if len(out) >= 3 and self._pointer == CONFIG:
            written = int.from_bytes(out[1:3], "big")
            self._config = written & ~START
            if written & START and not busy:
                self._convert()
                busy = True
        conversion = (self._former_code if busy else self._code) & 0xFFFF
        # The thresholds are not modelled.
        held = {CONFIG: self._config | (0 if busy else DONE), CONVERSION: conversion}.get(self._pointer, 0)
        if count:
            self._clock.sleep(9 * (1 + count) * ADS1115_BIT_SECONDS)
        return (held.to_bytes(2, "big") * (count // 2 + 1))[:count]

    def _convert(self) -> None:
        """Start the conversion of the config register now."""
        seconds = 1.0 - TOLERANCE + 2.0 * TOLERANCE * uniform(self._truth.seed, "oscillator", 0)
        seconds /= RATES[self._config >> 5 & 0b111]
        full_scale = (*RANGES, RANGES[-1], RANGES[-1])[self._config >> 9 & 0b111]
        volts = self._volts(self._config >> 12 & 0b011)
        self._former_code, self._code = self._code, min(max(round(volts / full_scale * 32768), -32768), 32767)
        self._done_ns = self._clock.now_ns() + round(seconds * SECOND)


# --- Microchip MCP3208 ---

CODES = 4096  # steps of the reference voltage
PORT = SpiPort(modes=(0, 3), fastest=2_000_000, speed=1_000_000)
"""20 clocks a sample: 100,000 samples a second at a supply of 5 V are 2 MHz, 50,000 at 2.7 V are 1 MHz."""


class Mcp3208(Converter):
    """An MCP3208 with the option ``vref``, the voltage at its reference pin."""

    inputs, steps, options, spi = 8, CODES, ("vref",), PORT

    def __init__(self, address: Address) -> None:
        # From 0.25 V up to the part's own supply, which may be 5.5 V.
        self.full_scale = self.reference = address.number("vref", low=0.25, high=5.5)
        self.description = f"MCP3208, reference {self.full_scale:g} V"

    def volts(self, link: Link, clock: Clock, number: int) -> float:
        command = bytes([0b110 | number >> 2, (number & 0b11) << 6, 0])
        answer = require_length(link.exchange(command), len(command), "frame")
        # The bit before the result is 0, so a working part never sends only ones; zeros may be an input at ground.
        check_data_line(answer, f"answer for input {number}")
        # The bits before the lowest 12 have no meaning.
        return ((answer[1] & 0x0F) << 8 | answer[2]) * self.full_scale / CODES
