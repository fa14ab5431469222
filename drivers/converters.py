"""Analog-to-digital converters, the supply of the sensors behind them, and virtual converters.

A :class:`Supply` is measured with each sample or stated, and gives the readings of ratiometric sensors as shares of it.

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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Protocol

from tiltcal.drivers.bus import SpiPort
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.bus.link import Link, check_data_line, require_length
from tiltcal.drivers.virtual import HeldPose, Truth, VirtualPart, uniform
from tiltcal.errors import BusError, DeviceFault

SCHEMES = ("ads1115+i2c", "mcp3208+spi")
"""Address schemes of the converters: part and bus of each. The first one is the default of a virtual sensor."""

NOMINAL = 5.0
"""Nominal supply of analog sensors, V."""


class Converter(Protocol):
    """The driver of a converter."""

    def volts(self, number: int) -> float:
        """Measure one input against ground, V; a converter that misbehaves is a HardwareError."""


@dataclass(frozen=True)
class FrontEnd:
    """A converter with the settings of an address.

    name, description: the part of the scheme before ``+``; the converter and its settings, for the operator.
    full_scale, step: V; a larger voltage reads as full scale.
    reference: voltage at its reference pin, V, if it has one; a sensor with the same supply is then ratiometric.
    driver, twin: ``driver(link, clock)`` returns the :class:`Converter`, ``twin(wiring)`` a link that answers as it.
    """

    name: str
    description: str
    inputs: int
    full_scale: float
    step: float
    reference: float | None
    options: tuple[str, ...]
    spi: SpiPort | None
    driver: Callable[[Link, Clock], Converter]
    twin: Callable[[Wiring], Link]

    @property
    def schemes(self) -> tuple[str, ...]:
        """All schemes of converters, this one's first."""
        return tuple(sorted(SCHEMES, key=lambda scheme: not scheme.startswith(f"{self.name}+")))


def find_front_end(address: Address) -> FrontEnd:
    """Return the converter of an address; ``sim:`` selects one with ``adc=``."""
    front_ends = {"ads1115": ads1115_front_end, "mcp3208": mcp3208_front_end}
    name = address.text("adc", "ads1115") if address.simulated else address.scheme.partition("+")[0]
    if name not in front_ends:
        known = " or ".join(f"{scheme}:" for scheme in SCHEMES)
        address.refuse(f"{name!r} is not a known converter (analog sensors are connected by {known})")
    front_end = front_ends[name](address)
    return replace(front_end, options=(*front_end.options, "adc")) if address.simulated else front_end


def take_input(address: Address, option: str, front_end: FrontEnd, default: int) -> int:
    """Return the converter input of an option; only a virtual sensor has a default."""
    return address.integer(option, default if address.simulated else None, low=0, high=front_end.inputs - 1)


@dataclass(frozen=True, slots=True)
class Supply:
    """The supply of a ratiometric sensor.

    number: the input that measures it; None if it is stated.
    volts: as stated; if it is measured, the nominal value.
    low, high: within these limits the sensor is ratiometric, V.
    full_scale: of the converter, V; reference: at its pin, V, None if that is tied to this supply or does not exist.
    """

    number: int | None
    volts: float
    low: float
    high: float
    full_scale: float = inf
    reference: float | None = None

    def shares(self, converter: Converter, numbers: Sequence[int]) -> tuple[tuple[float, ...], float]:
        """Measure inputs as shares of the supply, and the supply, V.

        The conversions follow each other, so a change of the supply between them would look like tilt. A measured
        supply is therefore read before and after the others and interpolated: drift cancels, and only ripple faster
        than one sample remains.
        """
        if self.number is None:
            return tuple(converter.volts(number) / self.volts for number in numbers), self.volts
        before = self._checked(converter.volts(self.number))
        volts = [converter.volts(number) for number in numbers]
        after = self._checked(converter.volts(self.number))
        slope = (after - before) / (len(numbers) + 1)
        shares = tuple(volt / (before + slope * place) for place, volt in enumerate(volts, start=1))
        return shares, (before + after) / 2.0

    def said(self, volts: float) -> str:
        """Return the supply as text, with its voltage and its source."""
        return f"{volts:.4f} V, {'stated' if self.number is None else f'measured at input {self.number}'}"

    def _checked(self, volts: float) -> float:
        # The largest code also means every larger voltage.
        if volts > 0.9995 * self.full_scale:
            raise DeviceFault(
                f"the supply at input {self.number} reads {volts:.3f} V, the full scale of this converter: state "
                "it with vdd=VOLTS, or give the converter a higher full scale"
            )
        # 1 % allows for the error of the converter, which cancels in the ratio.
        if not 0.99 * self.low <= volts <= 1.01 * self.high:
            raise DeviceFault(
                f"the supply at input {self.number} reads {volts:.3f} V, where the sensor needs {self.low:g} to "
                f"{self.high:g} V: is it switched on, and wired to this input?"
            )
        return volts


def take_supply(address: Address, front_end: FrontEnd, low: float, high: float) -> Supply:
    """Return the supply of an address: ``supply=N`` if it is measured, ``vdd=VOLTS`` if it is stated; allowed, V.

    A converter whose reference pin is the sensor's supply needs neither.
    """
    if "supply" in address.options and "vdd" in address.options:
        address.refuse("options 'supply' and 'vdd' exclude each other: the supply is either measured or stated")
    supply = partial(Supply, low=low, high=high, full_scale=front_end.full_scale)
    if "vdd" in address.options:
        return supply(None, address.number("vdd", low=low, high=high), reference=front_end.reference)
    if "supply" in address.options or (front_end.reference is None and address.simulated):
        number = take_input(address, "supply", front_end, 2)
        if front_end.full_scale <= low:
            address.refuse(f"{front_end.description} cannot measure a supply of {low:g} V or more")
        return supply(number, min(NOMINAL, high), reference=front_end.reference)
    if front_end.reference is None:
        address.refuse(
            "the supply of the sensor is unknown: wire it to an input and add supply=N, or state it with vdd=VOLTS"
        )
    if not low <= front_end.reference <= high:
        address.refuse(
            f"the sensor needs a supply of {low:g} to {high:g} V, so the reference of {front_end.reference:g} V is "
            "not its supply: wire that to an input and add supply=N, or state it with vdd=VOLTS"
        )
    return supply(None, front_end.reference)


def require_apart(address: Address, wiring: dict[str, int | None]) -> None:
    """Refuse two signals on one input."""
    seen: dict[int, str] = {}
    for option, number in wiring.items():
        if number in seen:
            address.refuse(f"options {seen[number]!r} and {option!r} name the same input {number}")
        if number is not None:
            seen[number] = option


@dataclass(frozen=True)
class Wiring:
    """The wiring of a virtual converter: its voltages, V, at the inputs; ``share`` is that of an input now."""

    truth: Truth
    fixture: HeldPose
    clock: Clock
    supply: Supply
    share: Callable[[Wiring, int], float]

    @property
    def reference(self) -> float:
        """The true voltage at the converter's reference pin, V."""
        return self.truth.supply if self.supply.reference is None else self.supply.reference

    def volts(self, number: int) -> float:
        """Return the voltage at an input now, V."""
        if number == self.supply.number:
            return self.truth.supply
        return min(max(self.share(self, number), 0.0), 1.0) * self.truth.supply


class VirtualConverter(VirtualPart):
    """A converter whose inputs have the voltages of a wiring."""

    device = "converter"

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring.truth, wiring.fixture, wiring.clock)
        self._wiring = wiring

    def _silent(self) -> bool:
        return self._fault().kind == "silent"


# --- TI ADS1115 ---

CONVERSION, CONFIG = 0x00, 0x01
"""Registers."""
START = DONE = 0x8000
"""OS: writing it starts a conversion; reading it shows that none is running."""
RESET = 0x8583
"""Content of the config register after power-up."""
RANGES = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256)
"""Full scales, V, by their code. An input may never exceed the converter's own supply, whatever the full scale."""
RATES = (8, 16, 32, 64, 128, 250, 475, 860)
"""Conversions per second, by their code."""
ADDRESSES = (0x48, 0x49, 0x4A, 0x4B)
"""Bus addresses, by what ADDR is tied to: GND, VDD, SDA, SCL."""
TOLERANCE = 0.1
"""The converter's clock may be this much slower or faster than nominal."""
POLLS = 20
"""Polls of a conversion, a tenth of its duration apart, before it counts as failed."""

_SINGLE_ENDED, _SINGLE_SHOT, _COMPARATOR_OFF = 0b100, 0x0100, 0b00011


class Ads1115:
    """The driver of an ADS1115, with one single-shot conversion per input: full scale in V, conversions per second."""

    def __init__(self, link: Link, clock: Clock, full_scale: float = 6.144, rate: int = 128) -> None:
        self._link = link
        self._clock = clock
        self._full_scale = full_scale
        self._rate = rate

    def volts(self, number: int) -> float:
        """Convert one input against ground, V."""
        config = ads1115_config(number, self._full_scale, self._rate)
        self._link.exchange(bytes([CONFIG]) + config.to_bytes(2, "big"))
        self._clock.sleep((1.0 + TOLERANCE) / self._rate)
        self._wait_until_done(config)
        code = int.from_bytes(self._register(CONVERSION), "big", signed=True)
        if code in (-0x8000, 0x7FFF):
            larger = [full_scale for full_scale in RANGES if full_scale > self._full_scale]
            advice = f"take a larger one (range={min(larger):g})" if larger else "its inputs may not exceed its supply"
            raise DeviceFault(
                f"input {number} is at or beyond ±{self._full_scale:g} V, the full scale of the ADS1115: {advice}, and "
                "check the wiring"
            )
        return code * self._full_scale / 32768

    def _wait_until_done(self, config: int) -> None:
        """Wait until the conversion of this config is done; another config is a dead bus, a reset or another device."""
        for _ in range(POLLS):
            answer = self._register(CONFIG)
            check_data_line(answer, "config register")
            held = int.from_bytes(answer, "big")
            if held & ~DONE == RESET & ~DONE != config & ~DONE:
                raise DeviceFault("the ADS1115 lost its settings, so its supply failed for a moment: check its supply")
            if held & ~DONE != config & ~DONE:
                raise DeviceFault(
                    f"the config register reads {held:04X} where {config:04X} was written: does another program use "
                    "this converter, or is another device at this address?"
                )
            if held & DONE:
                return
            self._clock.sleep(0.1 / self._rate)
        raise BusError(
            f"the ADS1115 is still busy after {(1.0 + TOLERANCE + 0.1 * POLLS) / self._rate * 1e3:.3g} ms "
            f"with a conversion that takes {1e3 / self._rate:.3g} ms: switch its supply off and on"
        )

    def _register(self, pointer: int) -> bytes:
        return require_length(self._link.exchange(bytes([pointer]), 2), 2)


def ads1115_config(number: int, full_scale: float, rate: int) -> int:
    """Return the config register that starts one single-shot conversion of an input, 0 to 3, against ground."""
    return (
        START
        | (_SINGLE_ENDED | number) << 12
        | RANGES.index(full_scale) << 9
        | _SINGLE_SHOT
        | RATES.index(rate) << 5
        | _COMPARATOR_OFF
    )


def ads1115_front_end(address: Address) -> FrontEnd:
    """Return the ADS1115 with the ``range=`` (V) and ``rate=`` (conversions per second) of an address."""
    if "address" in address.options and not address.simulated and address.integer("address") not in ADDRESSES:
        address.refuse(
            f"an ADS1115 is at {_listed([hex(known) for known in ADDRESSES])}, not at {address.text('address')}"
        )
    full_scale, rate = address.number("range", RANGES[0]), address.integer("rate", 128)
    if full_scale not in RANGES:
        address.refuse(f"option range={address.text('range')} is not a full scale of an ADS1115 ({_listed(RANGES)} V)")
    if rate not in RATES:
        address.refuse(f"option rate={address.text('rate')} is not a rate of an ADS1115 ({_listed(RATES)} per second)")
    return FrontEnd(
        name="ads1115",
        description=f"ADS1115, ±{full_scale:g} V, {rate} conversions per second",
        inputs=4,
        full_scale=full_scale,
        step=full_scale / 32768,
        reference=None,
        options=("range", "rate"),
        spi=None,
        driver=partial(Ads1115, full_scale=full_scale, rate=rate),
        twin=VirtualAds1115,
    )


def _listed(choices: tuple[float, ...] | list[str]) -> str:
    *first, last = (str(choice) for choice in choices)
    return f"{', '.join(first)} or {last}"


ADS1115_BIT_SECONDS = 1.0 / 100_000


class VirtualAds1115(VirtualConverter):
    """An ADS1115 on the I2C bus at 100 kHz: the pointer, the config register and the last conversion of one input."""

    letter = "i"

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        self._pointer = CONVERSION
        self._config = RESET & ~START
        self._code = self._former_code = self._done_ns = 0

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Write, then read the register of the pointer; see :class:`~tiltcal.drivers.bus.link.Link`."""
        if self._silent():
            raise BusError("no device acknowledges, a fault that the virtual sensor's truth sets")
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
        volts = self._wiring.volts(self._config >> 12 & 0b011)
        self._former_code, self._code = self._code, min(max(round(volts / full_scale * 32768), -32768), 32767)
        self._done_ns = self._clock.now_ns() + round(seconds * 1e9)


# --- Microchip MCP3208 ---

CODES = 4096
"""Steps of the reference voltage."""
PORT = SpiPort(modes=(0, 3), fastest=2_000_000, speed=1_000_000)
"""20 clocks a sample: 100,000 samples a second at a supply of 5 V are 2 MHz, 50,000 at 2.7 V are 1 MHz."""


class Mcp3208:
    """The driver of an MCP3208 with this voltage at its reference pin, V."""

    def __init__(self, link: Link, clock: Clock, reference: float) -> None:
        self._link = link
        self._reference = reference

    def volts(self, number: int) -> float:
        """Convert one input, 0 to 7, against ground, V."""
        command = bytes([0b110 | number >> 2, (number & 0b11) << 6, 0])
        answer = require_length(self._link.exchange(command), len(command), "frame")
        # The bit before the result is 0, so a working part never sends only ones; zeros may be an input at ground.
        check_data_line(answer, f"answer for input {number}")
        # The bits before the lowest 12 have no meaning.
        return ((answer[1] & 0x0F) << 8 | answer[2]) * self._reference / CODES


def mcp3208_front_end(address: Address) -> FrontEnd:
    """Return the MCP3208 with the ``vref=`` of an address, the voltage at its reference pin."""
    # From 0.25 V up to the part's own supply, which may be 5.5 V.
    reference = address.number("vref", 5.0 if address.simulated else None, low=0.25, high=5.5)
    return FrontEnd(
        name="mcp3208",
        description=f"MCP3208, reference {reference:g} V",
        inputs=8,
        full_scale=reference,
        step=reference / CODES,
        reference=reference,
        options=("vref",),
        spi=PORT,
        driver=partial(Mcp3208, reference=reference),
        twin=VirtualMcp3208,
    )


MCP3208_BIT_SECONDS = 1.0 / 1_000_000
COMMAND_BITS, SAMPLING_BITS = 5, 1
"""Start, single-ended, and three bits of the input's number; and the clocks between these and the null bit."""


class VirtualMcp3208(VirtualConverter):
    """An MCP3208 on the SPI bus at 1 MHz, bit by bit, without state between frames."""

    letter = "s"

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one frame; see :class:`~tiltcal.drivers.bus.link.Link`."""
        length = 8 * len(out)
        bits = "1" * length if self._silent() else self._answered(f"{int.from_bytes(out, 'big'):0{length}b}")
        self._clock.sleep(length * MCP3208_BIT_SECONDS)
        return int(bits, 2).to_bytes(len(out), "big")

    def _answered(self, bits: str) -> str:
        """Return the answer bits; they are random while the part does not drive the line."""
        floating = f"{int(uniform(self._truth.seed, 'filler', self._clock.now_ns()) * 2**48):048b}"
        command = bits[bits.find("1") :][:COMMAND_BITS]
        if len(command) < COMMAND_BITS or command[:2] != "11":
            return floating[: len(bits)]
        code = round(self._wiring.volts(int(command[2:], 2)) / self._wiring.reference * CODES)
        behind = bits.find("1") + COMMAND_BITS + SAMPLING_BITS
        return f"{floating[:behind]}0{min(max(code, 0), CODES - 1):012b}".ljust(len(bits), "0")[: len(bits)]
