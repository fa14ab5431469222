"""The facts of parts with numbers in byte registers: where these lie, what is written before, ranges and rates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf, sqrt
from typing import Any, Literal, NamedTuple

from tiltcal.drivers.bus import SpiPort
from tiltcal.drivers.virtual import Tolerances

Registers = Mapping[int, int]  # contents by register
ANY_PORT = SpiPort((0,), 10_000_000, 1_000_000)  # of a part whose source states none
ANY_PART = Tolerances(offset=0.1, sensitivity=0.1)  # likewise
SPI, I2C = "spi:///dev/spidev0.0", "i2c:///dev/i2c-1?address="  # examples; the user must state the I2C address


@dataclass(frozen=True, slots=True)
class Field:
    """A number in registers.

    at, size: the first of its registers, and their number.
    bits, shift: its bits, and the bits without a meaning below it.
    order: whether the first register is the ``big`` or the ``little`` end.
    signed: whether it is two's complement.
    """

    at: int
    bits: int
    size: int = 2
    shift: int = 0
    order: Literal["big", "little"] = "big"
    signed: bool = True

    def decode(self, registers: Registers) -> int:
        """Return the number in the registers."""
        raw = int.from_bytes(bytes(registers[self.at + place] for place in range(self.size)), self.order)
        word = raw >> self.shift & (1 << self.bits) - 1
        return word - (1 << self.bits) if self.signed and word >> self.bits - 1 else word

    def encode(self, number: int) -> Registers:
        """Return the registers that hold a number."""
        raw = (number & (1 << self.bits) - 1) << self.shift
        return dict(enumerate(raw.to_bytes(self.size, self.order), self.at))

    @property
    def rails(self) -> tuple[int, int]:
        """The smallest and the largest number."""
        return (-(1 << self.bits - 1), (1 << self.bits - 1) - 1) if self.signed else (0, (1 << self.bits) - 1)


@dataclass(frozen=True, slots=True)
class Thermometer:
    """The thermometer of a part: °C = reference + (number - zero) / slope."""

    field: Field
    zero: float
    slope: float
    reference: float = 25.0

    def celsius(self, registers: Registers) -> float:
        """Return the temperature in the registers, °C."""
        return self.reference + (self.field.decode(registers) - self.zero) / self.slope

    def encode(self, celsius: float) -> Registers:
        """Return the registers of a temperature, °C."""
        low, high = self.field.rails
        return self.field.encode(min(max(round(self.zero + self.slope * (celsius - self.reference)), low), high))


class Range(NamedTuple):
    """A measuring range: its code in the part's registers, count/g, and its rails where they are not the field's."""

    code: int
    counts_per_g: float
    rails: tuple[int, int] | None = None


class Write(NamedTuple):
    """A register that is written, how long the part needs then (s), and whether it keeps what it is told.

    rate, range: the weights of the codes of rate and range in the value, such as 0x10 of one in the upper four bits.
    """

    register: int
    value: int
    seconds: float = 0.0
    kept: bool = True
    rate: int = 0
    range: int = 0


@dataclass(frozen=True, kw_only=True)
class Frame:
    """How registers are asked for on the buses of a part.

    shift, reading, writing: the first byte of an SPI frame is the register, shifted, with the bits that read or write.
    by_command: whether that byte takes the place of the register on I2C.
    several: bits of the first byte, by the letter of the bus, without which a burst repeats its first register.
    count: -1 where the address counts down in a burst.
    fastest_on_i2c: samples per second that the bus carries at 100 kHz.
    """

    shift: int = 0
    reading: int = 0x80
    writing: int = 0x00
    by_command: bool = False
    several: Mapping[str, int] = field(default_factory=dict)
    count: int = 1
    spi: SpiPort = ANY_PORT
    fastest_on_i2c: float = inf


@dataclass(frozen=True, kw_only=True)
class StartUp:
    """What comes before the first sample of a part.

    identity, family: the first register of the part's identity, and the contents that are this part's; what models
        have which.
    begin: in place of the check of the identity and the reset, a function of the sensor.
    set_up: the writes before it measures; each group is read back before the next one begins.
    settling, dropped: sample periods from the last of them to a sample; samples dropped then.
    watched: a register that a reset changes from what is set up, compared before each sample, where no bit shows that.
    """

    identity: tuple[int, tuple[bytes, ...]] | None = None
    family: Mapping[bytes, str] = field(default_factory=dict)
    begin: Callable[[Any], None] = lambda sensor: sensor.begin()
    reset: Write | None = None
    set_up: tuple[tuple[Write, ...], ...] = ()
    settling: int = 0
    dropped: int = 0
    watched: int | None = None


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """The ranges and the rates of a part, and which of them is set.

    ranges, rates: by the word of the option ``range``, such as ``2g``; code by samples per second.
    range, rate: without an option of the address.
    """

    ranges: Mapping[str, Range]
    rates: Mapping[float, int] = field(default_factory=dict)
    range: str = "2g"
    rate: float

    @property
    def counts_per_g(self) -> float:
        """Nominal sensitivity, count/g."""
        return self.ranges[self.range].counts_per_g

    @property
    def extent(self) -> float:
        """Largest acceleration of the range, g."""
        return float(self.range.removesuffix("g"))

    @property
    def in_words(self) -> dict[str, str]:
        """Range, sensitivity and rate, for the operator."""
        return {"range": f"±{self.extent:g} g, {round(self.counts_per_g, 1):g} count/g, {self.rate:g} samples/s"}


@dataclass(frozen=True, kw_only=True)
class VirtualFacts:
    """What a part is like as it is delivered: facts of its virtual part, and of the spread between parts.

    held: contents after power-up that are not 0.
    asleep: a register, and its bits and their value while the part does not measure; without it, it always measures.
    bank: the register that chooses a bank of registers, where the part has banks.
    reset: a reset of the part that its driver does not use.
    memory_fault: the status register and the bit of a fault of the part's memory.
    limits, spread: as delivered; standard deviation of offset (g) and sensitivity (relative), where the limits do not
        say it.
    noise_density, corner, noise_counts: g/√Hz, and the bandwidth as a share of the rate; noise of a sample where no
        source states a density, count.
    nonlinearity: typical, relative to the range.
    """

    held: Registers = field(default_factory=dict)
    asleep: tuple[int, int, int] | None = None
    bank: int | None = None
    reset: Write | None = None
    memory_fault: tuple[int, int] | None = None
    limits: Tolerances = ANY_PART
    spread: tuple[float, float] | None = None
    noise_density: float = 0.0
    corner: float = 0.5
    noise_counts: float = 1.0
    nonlinearity: float = 0.0
    not_modelled: tuple[str, ...] = ("the real tolerances and noise",)

    def noise(self, sampling: Sampling) -> float:
        """Return the standard deviation of a sample, count."""
        density = sampling.counts_per_g * self.noise_density
        return density * sqrt(sampling.rate * self.corner) if density else self.noise_counts
