"""Parts with numbers in byte registers, on SPI or I2C: a row of facts, from which driver and virtual part are made.

A :class:`RegisterPart` has the facts of :mod:`tiltcal.drivers.register_facts`, by which the driver decodes and the
virtual part encodes. What it does beyond them, such as a factory trim that a reset may lose, is a function in its row.
The rows of tiltcal are in :mod:`tiltcal.drivers.parts`; a row of another package is a sensor model by an entry point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from math import ceil
from typing import Any

from tiltcal.drivers.bus import Bus, Link, check_data_line, require_length
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.drivers.model import Model, Reading, Sensor, deviation_within, in_words, typical_nonlinearity
from tiltcal.drivers.register_facts import (
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
from tiltcal.drivers.virtual import HeldPose, Truth, VirtualPart
from tiltcal.errors import Argument, BusError, DeviceFault

PERIODS = 6  # timeout for a sample, in sample periods
POLLS = 4  # how often the status is read in a sample period
NEAR_RATE = 0.01  # a rate is one of the part's if it is within this share of it
BIT_SECONDS = {"s": 1 / 500_000, "i": 1 / 100_000}  # of the virtual parts, by the letter of the bus


@dataclass(frozen=True, kw_only=True)
class RegisterPart:
    """The facts of a part with registers, with the source of each number beside the row.

    name, title, short: what the user types; maker, part and buses for the list of devices; its name in messages.
    channels: x, y and z, as far as it has them.
    bursts: the transactions of a sample: first register and number of registers.
    addresses: an example for each of its buses, the preferred one first; the virtual part has that one.
    new_sample: status register and bit of a new sample, which the first burst clears; without one a sample is taken at
        any time.
    take, probe: what is special, as functions of the :class:`RegisterSensor`: in place of the bursts, and of what a
        probe tells.
    configure: ``configure(part, address)`` returns the part with the options of an address.
    bus: what opens its ``package:`` addresses, where tiltcal does not have its bus.
    """

    name: str
    title: str
    short: str
    addresses: tuple[str, ...]
    channels: Mapping[str, Field]
    bursts: tuple[tuple[int, int], ...]
    thermometer: Thermometer | None = None
    new_sample: tuple[int, int] | None = None
    frame: Frame = Frame()
    sampling: Sampling
    start_up: StartUp = StartUp()
    virtual: VirtualFacts = VirtualFacts()
    take: Callable[[RegisterSensor], Registers] = lambda sensor: sensor.bursts()
    probe: Callable[[RegisterSensor], Mapping[str, str]] = lambda sensor: {
        **sensor.part.sampling.in_words,
        **in_words(sensor.read()),
    }
    options: tuple[str, ...] = ("range", "rate")
    configure: Callable[[RegisterPart, Address], RegisterPart] = lambda part, address: part.at_range_and_rate(address)
    bus: Bus | None = None

    @property
    def word_rails(self) -> tuple[int, int]:
        """Numbers at or beyond which a word is no measurement."""
        return self.sampling.ranges[self.sampling.range].rails or next(iter(self.channels.values())).rails

    @property
    def writes(self) -> tuple[tuple[Write, ...], ...]:
        """The groups of writes that set it up, at its rate and its range."""
        rate, scale = self.sampling.rates.get(self.sampling.rate, 0), self.sampling.ranges[self.sampling.range].code
        return tuple(
            tuple(one._replace(value=one.value | one.rate * rate | one.range * scale) for one in group)
            for group in self.start_up.set_up
        )

    def at_range_and_rate(self, address: Address) -> RegisterPart:
        """Return the part with the options ``range`` and ``rate`` of an address."""
        rates, ranges = self.sampling.rates, self.sampling.ranges
        rate = address.number("rate", self.sampling.rate)
        known = min(rates, key=lambda one: abs(one - rate), default=rate)
        if abs(known - rate) > NEAR_RATE * known:
            address.refuse(f"option rate={rate:g} is none of {', '.join(f'{one:g}' for one in rates)}")
        if address.scheme == "i2c" and known > self.frame.fastest_on_i2c:
            address.refuse(f"option rate={rate:g} is too fast for I2C (at most {self.frame.fastest_on_i2c:g})")
        scale = address.choice("range", {word: word for word in ranges}, self.sampling.range)
        return replace(self, sampling=replace(self.sampling, rate=known, range=scale))

    def model(self) -> Model:
        """Return the sensor model of the part."""
        virtual, sampling = self.virtual, self.sampling
        limits, extent = virtual.limits, sampling.extent if virtual.nonlinearity else 0.0
        offset, sensitivity = virtual.spread or map(deviation_within, (limits.offset, limits.sensitivity))
        low, high = self.word_rails
        longest = max(count for _, count in self.bursts)
        # A burst must end before the next word is due, or it mixes bytes of two words.
        slowest = max(self.frame.spi.slowest, ceil(8 * (1 + longest) * sampling.rate))
        return Model(
            name=self.name,
            title=self.title,
            channels=tuple(self.channels),
            addresses=self.addresses,
            sensitivity=sampling.counts_per_g,
            offset_spread=offset,
            sensitivity_spread=sensitivity,
            nonlinearity=typical_nonlinearity(virtual.nonlinearity * extent, extent) if extent else (),
            rails=(float(low), float(high)),
            resolution=1.0,
            # Where the part shows a new sample, a read waits for it.
            interval=0.0 if self.new_sample else 1.0 / sampling.rate,
            thermometer=self.thermometer is not None,
            thermometer_step=abs(1.0 / self.thermometer.slope) if self.thermometer else 0.0,
            driver=partial(RegisterSensor, self),
            twin=partial(VirtualRegisters, self),
            not_modelled=virtual.not_modelled,
            memory_fault=virtual.memory_fault is not None,
            default_truth=partial(limits.draw, tuple(self.channels), sampling.counts_per_g, virtual.noise(sampling)),
            spi=replace(self.frame.spi, slowest=slowest) if SPI in self.addresses else None,
            options=self.options,
            configure=lambda address: self.configure(self, address).model(),
            bus=self.bus,
        )


class RegisterSensor(Sensor):
    """The driver of a part.

    The part is set up before the first sample and again after any error. After a reset it measures nothing until it is
    set up, so a reset shows as samples that do not come.

    remembered: what the functions of the row keep of the part from one set-up to the next.
    """

    part: RegisterPart

    def __init__(self, part: RegisterPart, link: Link, clock: Clock) -> None:
        self.part, self.link, self.clock = part, link, clock
        self._ready = False
        self._writes = tuple(chain(*part.writes))
        self.remembered: Any = None

    def probe(self) -> Mapping[str, str]:
        """Set the part up; return what it is and a sample as text. The errors are those of :meth:`read`."""
        self._ready = False
        return self.part.probe(self)

    def read(self) -> Reading:
        """Take the next sample: counts, and the temperature in °C where the part has a thermometer."""
        part = self.part
        ready, self._ready = self._ready, False
        if not ready:
            self._start()
        if not self._sample_comes():
            raise self._no_sample(ready)
        if ready and (wrong := self.unlike(write for write in self._writes if write.register == part.start_up.watched)):
            raise self._was_reset(wrong)
        registers = part.take(self)
        self._ready = True
        values = tuple(float(place.decode(registers)) for place in part.channels.values())
        return Reading(values, part.thermometer.celsius(registers) if part.thermometer else None)

    def reset(self) -> None:
        """Reset the part, where it has a reset."""
        if reset := self.part.start_up.reset:
            self.write(reset)

    def begin(self) -> None:
        """Check that it is the part, and reset it."""
        self.identify()
        self.reset()

    def identify(self) -> None:
        """Check that it is the part."""
        start_up = self.part.start_up
        if start_up.identity is None:
            return
        first, known = start_up.identity
        identity = bytes(self.registers(first, len(known[0])).values())
        if identity not in known:
            # Another part may have 0x00 or 0xFF there; on a line that is stuck, every register has.
            stuck = set(identity) in ({0x00}, {0xFF})
            if stuck and all(self.register(register) == identity[0] for register in range(0x80)):
                check_data_line(identity)
            expected, other = " or ".join(one.hex(" ").upper() for one in known), start_up.family.get(identity)
            raise DeviceFault(
                f"the part says that it is {identity.hex(' ').upper()}, where an {self.part.short} says {expected}",
                advice=("name it with ", Argument("sensor", other))
                if other
                else "is another device on this chip select or address?",
            )

    def _start(self) -> None:
        """Begin, and write the settings."""
        self.part.start_up.begin(self)
        for group in self.part.writes:
            for write in group:
                self.write(write)
            if wrong := self.unlike(group):
                raise BusError(
                    f"the {self.part.short} does not keep what is written to it ({wrong}): check MOSI or SDA, the "
                    "clock and the supply"
                )
        self.clock.sleep(self.part.start_up.settling / self.part.sampling.rate)
        for _ in range(self.part.start_up.dropped):
            if not self._sample_comes():
                raise self._no_sample(was_ready=False)
            self.registers(*self.part.bursts[0])

    def _sample_comes(self) -> bool:
        if self.part.new_sample is None:
            return True
        status, bit = self.part.new_sample
        for _ in range(POLLS * PERIODS):
            # A line that is stuck high has this bit as well; the data show it.
            if self.register(status) & bit:
                return True
            self.clock.sleep(1.0 / self.part.sampling.rate / POLLS)
        return False

    def _was_reset(self, wrong: str) -> DeviceFault:
        return DeviceFault(
            f"the {self.part.short} was reset or its supply failed since it was set up ({wrong}): check the supply and "
            "its wires; it is set up anew"
        )

    def _no_sample(self, was_ready: bool) -> DeviceFault:
        if was_ready and (wrong := self.unlike(self._writes)):
            return self._was_reset(wrong)
        return DeviceFault(
            f"no sample came for {PERIODS * (1.0 / self.part.sampling.rate):.3g} s: the {self.part.short} does not "
            "measure; switch its supply off and on"
        )

    def registers(self, first: int, count: int) -> dict[int, int]:
        """Return the registers of one transaction.

        BusError: the transaction failed, or its answer has another length.
        """
        command = self._command(first, self.part.frame.reading)
        command |= self.part.frame.several.get(self.link.letter, 0) if count > 1 else 0
        if self.link.letter == "i":
            data = require_length(self.link.exchange(bytes([command]), count), count)
        else:
            frame = bytes([command, *bytes(count)])
            data = require_length(self.link.exchange(frame), len(frame))[1:]
        return dict(zip(range(first, first + self.part.frame.count * count, self.part.frame.count), data, strict=True))

    def register(self, register: int) -> int:
        """Return one register."""
        return self.registers(register, 1)[register]

    def bursts(self) -> dict[int, int]:
        """Return the registers of a sample; a line that is stuck is a BusError."""
        registers: dict[int, int] = {}
        for first, count in self.part.bursts:
            registers |= self.registers(first, count)
        check_data_line(bytes(registers.values()))
        return registers

    def write(self, write: Write) -> None:
        """Set a register."""
        self.link.exchange(bytes([self._command(write.register, self.part.frame.writing), write.value]))
        self.clock.sleep(write.seconds)

    def _command(self, register: int, access: int) -> int:
        """Return the first byte of a transaction."""
        plain = self.link.letter == "i" and not self.part.frame.by_command
        return register if plain else register << self.part.frame.shift | access

    def unlike(self, writes: Iterable[Write]) -> str:
        """Return the registers with another content, as text."""
        held = [(write, self.register(write.register)) for write in writes if write.kept]
        return ", ".join(
            f"register 0x{write.register:02X} holds 0x{content:02X}, not 0x{write.value:02X}"
            for write, content in held
            if content != write.value
        )


class VirtualRegisters(VirtualPart):
    """The virtual part of a row, in its state after power-up; any host may set it up.

    truth: in counts of the range that the driver sets.
    """

    def __init__(self, part: RegisterPart, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, fixture, clock)
        self._part = part
        example = part.addresses[0]
        self.letter = part.bus.letter if example.startswith("package:") and part.bus else example[0]
        self.bit_seconds = BIT_SECONDS[self.letter]
        self._resets = [one for one in (part.start_up.reset, part.virtual.reset) if one]
        first, known = part.start_up.identity or (0, (b"",))
        self._after_reset = {**part.virtual.held, **dict(enumerate(known[0], first))}
        self._held = dict(self._after_reset)
        self._pointer = b"\0"
        self._taken = -1

    def _answered(self, out: bytes, count: int) -> bytes:
        """Return the bytes that the part drives; on I2C the length of a transaction says whether it writes."""
        frame, on_spi = self._part.frame, self.letter == "s"
        # A read without a register goes on at the one before.
        self._pointer = out = out or self._pointer
        several, access = frame.several.get(self.letter, 0), frame.reading | frame.writing
        plain = out[0] & ~several
        register = (plain & ~access) >> frame.shift if on_spi or frame.by_command else plain
        step = frame.count if not several or out[0] & several else 0
        # It is unknown what the part sends during the command byte of SPI, so it is random here.
        head = bytes([self._filler()]) if on_spi else b""
        if plain & access != frame.writing if on_spi else len(out) == 1:
            length = len(out) - 1 if on_spi else count
            return head + self._content([register + step * place for place in range(length)])
        for place, content in enumerate(out[1:]):
            self._write(register + step * place, content)
        return head + bytes(len(out) - 1 if on_spi else 0)

    def _write(self, register: int, content: int) -> None:
        if any(one.register == register and content & one.value == one.value for one in self._resets):
            self._held = dict(self._after_reset)
        else:
            self._held[self._place(register)] = content

    def _place(self, register: int) -> int:
        """Return where a register is held: those of the first bank at their own numbers."""
        bank = self._part.virtual.bank
        return register if bank in (None, register) else self._held.get(bank, 0) << 8 | register

    def _range_held(self) -> Range:
        """Return the range that the registers hold."""
        sampling, bank = self._part.sampling, 0
        codes = {one.code: one for one in sampling.ranges.values()}
        for write in chain(*self._part.start_up.set_up):
            bank = write.value if write.register == self._part.virtual.bank else bank
            if write.range:
                bits = (1 << max(codes).bit_length()) - 1
                code = self._held.get(bank << 8 | write.register, 0) // write.range & bits
                return codes.get(code, next(iter(codes.values())))
        return sampling.ranges[sampling.range]

    def _content(self, asked: Sequence[int]) -> bytes:
        """Return registers of one moment."""
        part, held, places = self._part, dict(self._held), [self._place(register) for register in asked]
        if part.virtual.memory_fault and self._fault().kind == "parity":
            status, bit = part.virtual.memory_fault
            held[status] = held.get(status, 0) | bit
        register, bits, value = part.virtual.asleep or (0, 0, 1)
        if held.get(register, 0) & bits != value:
            scale = self._range_held()
            low, high = scale.rails or next(iter(part.channels.values())).rails
            for channel, place in part.channels.items():
                if not {*range(place.at, place.at + place.size)}.isdisjoint(places):
                    counts = scale.counts_per_g / part.sampling.counts_per_g
                    held |= place.encode(self._word(channel, part.sampling.rate, low, high, counts))
            if part.thermometer:
                held |= part.thermometer.encode(self._celsius())
            if part.new_sample:
                status, bit = part.new_sample
                sample = int(self._clock.now_ns() / SECOND * part.sampling.rate)
                held[status] = bit if sample > self._taken else 0
                if part.bursts[0][0] in asked:
                    self._taken = sample
        return bytes(held.get(place, 0) for place in places)
