"""Analog Devices ADXL202, ADXL202E and ADXL210 accelerometers at their duty-cycle outputs, with virtual parts.

Each axis is a pulse of length T1 in a period T2 that both share; the reading is the duty cycle T1/T2, nominally 0.5 at
0 g and 0.125 more for each g (0.04 for the ADXL210). T2 drifts, so T1 alone is never a reading. The pulses arrive as
sentences of a microcontroller that times them, framed as in NMEA 0183::

    $PTCDC,seq,t1x,t1y,t2x,t2y[,temperature]*hh

where ``seq`` counts the sentences, four times are in timer ticks, the temperature is in °C, and ``hh`` is the XOR of
all between ``$`` and ``*``; or as edges of two lines with their times, from a GPIO chip or a logic analyser's file. The
maker's application notes show two arrangements of the two pulse trains::

    rising    x and y rise together in each period; T2 from one rise to the next
    centred   the pulses of x and y have a common centre; T2 from the centre of a pulse of x to the centre of the pulse
              of y in the next period (with edges Ta, Tb of x and Tc, Td of y, and Ta = 0:
              T2 = Td - T1y/2 - T1x/2)

Every pair of pulses shows the arrangement, except if both are equally long; then both give the same result.

Sources: ADXL202/210 data sheet Rev. B, ADXL202E data sheet Rev. A, application notes AN-603 and AN-604.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial, reduce
from operator import xor
from typing import TYPE_CHECKING, NamedTuple

from tiltcal.drivers.bus.gpio import RECORD, Edge, pack_edges, unpack_edges
from tiltcal.drivers.columns import UNUSABLE, LineBuffer, shown
from tiltcal.drivers.converters import SCHEMES as CONVERTERS
from tiltcal.drivers.model import Model, Reading, deviation_within, link_in_words
from tiltcal.drivers.virtual import (
    JIG,
    TIME_CONSTANT,
    HeldPose,
    StreamingPart,
    Truth,
    VirtualLine,
    part_errors,
    uniform,
)
from tiltcal.errors import BusError, DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

ROUND_NUMBERS = (100, 128, 256, 1000, 1024, 10_000, 65_536, 100_000, 1_000_000, 1 << 24, 1 << 31, 1 << 32)
"""Values at which a counter may wrap to 0: the widths of counters and of printed digits."""

FEW = 16
"""Largest number of missing sentences at a wrap; more than these count as a restart of the device."""

_TICKS = rb"([0-9]{1,12}(?:\.[0-9]{1,9})?)"
_SENTENCE = re.compile(
    rb"PTCDC,([0-9]{1,12})," + rb",".join([_TICKS] * 4) + rb"(?:,([+-]?[0-9]{1,4}(?:\.[0-9]{0,9})?)?)?"
)


@dataclass(frozen=True, slots=True)
class Sentence:
    """The content of one sentence.

    number: its place in the sequence.
    duty: T1/T2 of x and of y, each with its own period.
    periods: T2 of x and of y, ticks.
    temperature: °C; None if the sentence has none.
    """

    number: int
    duty: tuple[float, float]
    periods: tuple[float, float]
    temperature: float | None


def parse_sentence(line: bytes) -> Sentence | None:
    """Return the sentence of a line without its end.

    None if its frame, checksum or fields are damaged, or a pulse is longer than its period.
    """
    inside = content(line)
    fields = _SENTENCE.fullmatch(inside) if inside is not None else None
    if fields is None:
        return None
    number, *times, temperature = fields.groups()
    t1x, t1y, t2x, t2y = map(float, times)
    if not (0.0 < t2x >= t1x and 0.0 < t2y >= t1y):
        return None
    return Sentence(int(number), (t1x / t2x, t1y / t2y), (t2x, t2y), float(temperature) if temperature else None)


def checksum(content: bytes) -> int:
    """Return the XOR of the bytes between ``$`` and ``*``."""
    return reduce(xor, content, 0)


def content(sentence: bytes) -> bytes | None:
    """Return the content between ``$`` and ``*`` of a sentence; None if the frame or the checksum is wrong."""
    body, star, digits = sentence.rpartition(b"*")
    if not star or not body.startswith(b"$") or len(digits) != 2:
        return None
    try:
        stated = int(digits, 16)
    except ValueError:
        return None
    return body[1:] if stated == checksum(body[1:]) else None


def missing(before: int, now: int) -> int | None:
    """Return how many sentences are missing between two numbers of a sequence.

    The counter may wrap to 0 at any of the :data:`ROUND_NUMBERS`. None if it went back: the device restarted.
    """
    if now > before:
        return now - before - 1
    for modulus in ROUND_NUMBERS:
        if before < modulus and modulus - before - 1 + now < FEW:
            return modulus - before - 1 + now
    return None


ALONE = 8
"""Pulses on one line, without one on the other, that indicate a broken wire."""

MOST_APART = 1 / 8
"""Fraction of a period by which the pulses of one sensor may deviate from both arrangements (late timestamps)."""


class Pulse(NamedTuple):
    """One pulse of one line.

    rise, fall: any unit of time.
    """

    rise: int
    fall: int

    @property
    def length(self) -> int:
        """T1."""
        return self.fall - self.rise

    @property
    def centre(self) -> float:
        """Midway between the edges."""
        return (self.rise + self.fall) / 2


class Cycle(NamedTuple):
    """One measurement of both axes.

    x, y: T1 of each, in the unit of the edges.
    period: T2, likewise.
    """

    x: float
    y: float
    period: float

    @property
    def duty(self) -> tuple[float, float]:
        """T1/T2 of x and of y."""
        return self.x / self.period, self.y / self.period


def centred_cycle(x: Pulse, y: Pulse) -> Cycle:
    """Return the cycle of a pulse of x and the pulse of y in the next period, with common centres."""
    # Integer arithmetic, so that a timestamp of 2**60 ns keeps all digits.
    period = (y.rise - x.rise + y.fall - x.fall) / 2
    return Cycle(x.length, y.length, period)


def rising_cycle(x: Pulse, y: Pulse, next_x: Pulse) -> Cycle:
    """Return the cycle of the pulses of one period and the next pulse of x, with common rises."""
    return Cycle(x.length, y.length, next_x.rise - x.rise)


class PulseTrains:
    """Converts the edges of both lines to cycles, one per period.

    lost: edges that were captured and never arrived; their periods give no cycle.
    torn: periods without a cycle because a pulse of one line is missing, although no edge was lost.
    """

    def __init__(self) -> None:
        self.lost = 0
        self.torn = 0
        self.restart()

    def restart(self) -> None:
        """Discard the edges so far; edges until the next one do not count as lost."""
        self._number: int | None = None
        self._clear()

    def take(self, edge: Edge) -> Cycle | None:
        """Add an edge, and return the cycle that it completes, if any.

        DeviceFault: the two trains do not belong together, or one line is dead.
        """
        if self._number is not None:
            gap = (edge.number - self._number - 1) & 0xFFFFFFFF
            if gap:
                self.lost += gap
                self._clear()
        self._number = edge.number
        if edge.rising:
            self._rise[edge.line] = edge.time_ns
            return None
        rise, self._rise[edge.line] = self._rise[edge.line], None
        if rise is None:
            return None
        self._pulses[edge.line].append(Pulse(rise, edge.time_ns))
        return self._cycle()

    def _clear(self) -> None:
        self._rise: list[int | None] = [None, None]
        self._pulses: tuple[deque[Pulse], deque[Pulse]] = (deque(), deque())

    def _cycle(self) -> Cycle | None:
        xs, ys = self._pulses
        self._require_both()
        while len(xs) > 1 and len(ys) > 1:
            x, y = xs[0], ys[0]
            about = xs[1].rise - x.rise
            if about <= 0:
                self._clear()
                raise DeviceFault("two pulses of x rise at one time, or in wrong order: check the times of the edges")
            if y.centre - x.centre > about / 2:
                xs.popleft()
                continue
            if x.centre - y.centre > about / 2:
                ys.popleft()
                continue
            next_x, next_y = xs[1], ys[1]
            xs.popleft()
            ys.popleft()
            if abs(next_y.rise - y.rise - about) > MOST_APART * about:
                # A pulse of one line is missing, so the next pulses are not the next period.
                self.torn += 1
                continue
            return _arranged(x, y, next_x, next_y, about)
        return None

    def _require_both(self) -> None:
        for line, name, other in ((0, "x", "y"), (1, "y", "x")):
            if not self._pulses[line] and len(self._pulses[1 - line]) >= ALONE:
                self._clear()
                raise DeviceFault(
                    f"{other} pulses and {name} does not: check the wire of {name}, and whether the axis is at its rail"
                )


def _arranged(x: Pulse, y: Pulse, next_x: Pulse, next_y: Pulse, about: float) -> Cycle:
    """Return the cycle for the arrangement of the pulses; ``about`` is the approximate period."""
    rises, centres = abs(y.rise - x.rise), abs(y.rise - x.rise + y.fall - x.fall) / 2
    if min(rises, centres) > MOST_APART * about:
        raise DeviceFault(
            "the pulses of x and y share neither their rising edges nor their centres: are both lines of one sensor?"
        )
    return centred_cycle(x, next_y) if centres < rises else rising_cycle(x, y, next_x)


ZERO = 0.5
"""Nominal duty cycle at 0 g."""

EDGES_AT_ONCE = 256
"""The largest number of edges to take in one transaction."""

TROUBLED = 256
"""Transactions with edges, but without a cycle, before the driver raises an error."""


class Adxl202Sentences:
    """The driver of an ADXL202 behind a microcontroller that sends sentences on a serial line."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._lines = LineBuffer(link, clock)
        self._number: int | None = None
        self._damaged_since = 0
        self._used = self._damaged = self._lost = self._restarts = 0

    def probe(self) -> Mapping[str, str]:
        """Return a new sentence, and the link statistics, as text; the errors are those of :meth:`read`."""
        self.discard()
        sentence = self._next()
        said = _in_words(sentence.duty)
        said["period"] = f"{sentence.periods[0]:g} ticks"
        if sentence.temperature is not None:
            said["temperature"] = f"{sentence.temperature:.1f} °C"
        return said | {"link": link_in_words(self.link_statistics())}

    def read(self) -> Reading:
        """Return the next undamaged sentence: the duty cycles of x and y, and the temperature where it is sent, °C.

        BusError: no data, or no valid sentence.
        """
        sentence = self._next()
        return Reading(sentence.duty, sentence.temperature)

    def discard(self) -> None:
        """Discard queued data; they do not count as lost."""
        self._lines.discard()
        self._number = None

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of used, damaged and lost sentences (gaps in the sequence), and its restarts."""
        return {"sentences": self._used, "damaged": self._damaged, "lost": self._lost, "restarts": self._restarts}

    def _next(self) -> Sentence:
        for _ in range(UNUSABLE):
            line, whole = self._lines.next()
            # After a lost line end, a second sentence follows; the part before its "$" is damaged.
            garbage, _, _ = line.rpartition(b"$")
            sentence = parse_sentence(line[len(garbage) :])
            if (garbage or sentence is None) and (whole or line.startswith(b"$")):
                self._damaged += 1
                self._damaged_since += 1
            if sentence is not None and self._in_sequence(sentence.number):
                self._used += 1
                return sentence
        raise BusError(
            f"{UNUSABLE} lines arrived and none was a sentence $PTCDC,seq,t1x,t1y,t2x,t2y*hh with its checksum; "
            f"the last was {shown(line)}: is the baud rate right, and does the microcontroller time both axes?"
        )

    def _in_sequence(self, number: int) -> bool:
        """Count the missing sentences before this one, and return whether it is new."""
        before, self._number = self._number, number
        damaged, self._damaged_since = self._damaged_since, 0
        if number == before:
            return False
        if before is not None:
            gap = missing(before, number)
            if gap is None:
                self._restarts += 1
            else:
                # A damaged sentence leaves a gap too, and is already counted.
                self._lost += max(gap - damaged, 0)
        return True


class Adxl202Edges:
    """The driver of an ADXL202 on two lines that are captured edge by edge."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._trains = PulseTrains()
        self._ready: deque[Cycle] = deque()
        self._used = 0

    def probe(self) -> Mapping[str, str]:
        """Return a new period, and the link statistics, as text; the errors are those of :meth:`read`."""
        self.discard()
        cycle = self._next()
        said = _in_words(cycle.duty)
        return said | {"period": f"{cycle.period / 1e6:.6g} ms", "link": link_in_words(self.link_statistics())}

    def read(self) -> Reading:
        """Return the next period: the duty cycles of x and y.

        BusError: no edges.
        DeviceFault: one line is dead, or the lines do not belong together.
        """
        return Reading(self._next().duty)

    def discard(self) -> None:
        """Discard queued data; they do not count as lost."""
        self._trains.restart()
        self._ready.clear()
        self._link.exchange(b"", 0)

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of used periods, lost edges (gaps in their numbers), and periods with a missing pulse."""
        return {"periods": self._used, "lost edges": self._trains.lost, "torn periods": self._trains.torn}

    def _next(self) -> Cycle:
        for _ in range(TROUBLED):
            if self._ready:
                self._used += 1
                return self._ready.popleft()
            for edge in self._edges():
                cycle = self._trains.take(edge)
                if cycle is not None:
                    self._ready.append(cycle)
        raise DeviceFault("edges arrive, but no complete period of both lines: are the wires of x and y loose?")

    def _edges(self) -> Iterator[Edge]:
        try:
            return unpack_edges(self._link.exchange(b"", EDGES_AT_ONCE * RECORD.size))
        except BusError:
            # After a reconnection the edges are numbered from the start.
            self._trains.restart()
            raise


def _in_words(duty: tuple[float, float]) -> dict[str, str]:
    return {channel: f"{share:.6f} duty" for channel, share in zip("xy", duty, strict=True)}


PERIOD = 0.010
"""T2 with a set resistor of 1.25 MΩ, seconds: the longest period, with the finest resolution."""

TIMER = 8_000_000
"""Ticks a second of the virtual microcontroller's timer."""


class Pulses:
    """Duty cycles and period of a virtual part, cycle by cycle."""

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        self._truth = truth
        self._fixture = fixture
        self._clock = clock

    @property
    def period(self) -> float:
        """T2 at the reference temperature, seconds: within 5 % of nominal, because resistors and parts vary."""
        return PERIOD * (1.0 + 0.05 * (2.0 * uniform(self._truth.seed, "period", 0) - 1.0))

    @property
    def warm_period(self) -> float:
        """T2 now, seconds: 0.1 % longer per °C, so that T1 alone is wrong."""
        return self.period * (1.0 + 1e-3 * (self._fixture.temperature() - self._truth.reference))

    def duty(self, channel: str, number: int) -> float:
        """Return T1/T2 of one axis in one cycle, between 0 and 1."""
        temperature = self._fixture.temperature(self._truth.lag)
        reading = self._truth.sample(channel, self._fixture.gravity, temperature, self._clock.now_ns(), number)
        return min(max(reading, 0.0), 1.0)


def virtual_sentences(truth: Truth, fixture: HeldPose, clock: Clock) -> StreamingPart:
    """Return a microcontroller that times both pulses and sends 100 sentences per second."""
    pulses = Pulses(truth, fixture, clock)

    def sentence(number: int) -> bytes:
        ticks = round(pulses.warm_period * TIMER)
        x, y = (round(pulses.duty(channel, number) * ticks) for channel in ("x", "y"))
        temperature = fixture.temperature() + truth.thermometer_error
        inside = f"PTCDC,{number},{x},{y},{ticks},{ticks},{temperature:.2f}".encode()
        return b"$%s*%02X\r\n" % (inside, checksum(inside))

    return StreamingPart(truth, fixture, clock, sentence)


class VirtualEdges(VirtualLine):
    """Both outputs of a virtual part on two captured lines, the pulses of x and y with common centres.

    The answer depends on the time alone: the edges of the next whole period. An edge that was not read at once is lost,
    and leaves a gap in the numbers.

    clock: advances to the end of that period.
    """

    letter = "e"

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, fixture, clock)
        self._pulses = Pulses(truth, fixture, clock)
        self._period_ns = round(self._pulses.period * 1e9)

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Wait for the edges of a period; see :class:`~tiltcal.drivers.bus.link.Link`."""
        self._require_line(silent=count > 0)
        if not count:
            return b""
        now_ns = self._clock.now_ns()
        cycle = -(-now_ns // self._period_ns)
        # To the end of the period, not to its last edge, which moves while the temperature of the chamber changes.
        self._clock.sleep(((cycle + 1) * self._period_ns - now_ns) / 1e9)
        edges = self._edges(cycle)[: max(count // RECORD.size, 1)]
        return pack_edges(edges)

    def _edges(self, cycle: int) -> list[Edge]:
        """Return the four edges of a period in the order of time."""
        centre = cycle * self._period_ns + self._period_ns // 2
        found = []
        for line, channel in enumerate(("x", "y")):
            half = round(self._pulses.duty(channel, cycle) * self._period_ns / 2)
            found += [(centre - half, line, True), (centre + half, line, False)]
        return [Edge(time, line, rising, 4 * cycle + place) for place, (time, line, rising) in enumerate(sorted(found))]


@dataclass(frozen=True, slots=True)
class Adxl202Variant:
    """The constants of one part.

    duty_per_g: nominal sensitivity.
    noise_density: g/√Hz.
    """

    duty_per_g: float
    noise_density: float


SENSITIVITY_LIMIT = 0.2
"""Largest relative error of the sensitivity between parts: 10 to 15 %/g around 12.5 (AN-603)."""

OFFSET_SPREAD = 0.5
"""Standard deviation of the offset between parts, g; our estimate, because the notes state only that it varies."""


def draw_truth(variant: Adxl202Variant, seed: int) -> Truth:
    """Return a plausible part.

    Returns: sensitivity within the part's spread; offset within ±0.4 g, a cross-axis sensitivity within 2 %, drifts
        within the typical 2 mg/°C and 0.02 %/°C, noise at 10 Hz of bandwidth, a jig of 0.01° and a chamber with a time
        constant of 20 s. Where no note states a number, these are ours.
    """
    channels = ("x", "y")

    within = part_errors(seed)

    def row(channel: str) -> dict[str, float]:
        own = variant.duty_per_g * (1.0 + within(SENSITIVITY_LIMIT, f"sensitivity {channel}"))
        other = "y" if channel == "x" else "x"
        return {
            channel: own,
            other: own * within(0.02, f"cross {channel}"),
            "z": own * within(0.02, f"cross {channel} z"),
        }

    return Truth(
        channels=channels,
        offset={channel: ZERO + variant.duty_per_g * within(0.4, f"offset {channel}") for channel in channels},
        sensitivity={channel: row(channel) for channel in channels},
        reference=24.0,
        drift={channel: (variant.duty_per_g * within(0.002, f"drift {channel}"),) for channel in channels},
        gain={channel: (within(2e-4, f"gain {channel}"),) for channel in channels},
        noise=dict.fromkeys(channels, variant.duty_per_g * variant.noise_density * (1.57 * 10.0) ** 0.5),
        thermometer_error=within(0.5, "thermometer"),
        seed=seed,
        jig=JIG,
        time_constant=TIME_CONSTANT,
    )


def _configured(model: Model, address: Address) -> Model:
    """Return the model for an address; at a ``sim:`` address ``wiring=edges`` selects edges."""
    if address.scheme in CONVERTERS:
        from tiltcal.drivers import find_model

        return find_model(f"{model.name}-analog").at(address)
    if "wiring" in address.options and not address.simulated:
        address.refuse("option 'wiring' is for sim: addresses; the scheme of a real address states it")
    wiring = address.text("wiring", "sentences")
    if wiring not in ("sentences", "edges"):
        address.refuse(f"option wiring={wiring} is neither sentences nor edges")
    if wiring == "sentences" and address.scheme in ("serial", "sim"):
        return model
    return replace(
        model,
        schemes=("gpio", "vcd", "serial"),
        thermometer=False,
        driver=Adxl202Edges,
        twin=VirtualEdges,
    )


def _model(name: str, title: str, variant: Adxl202Variant) -> Model:
    model = Model(
        name=name,
        title=title,
        channels=("x", "y"),
        unit="duty",
        schemes=("serial", "gpio", "vcd"),
        addresses=(
            "serial:///dev/ttyUSB0?baudrate=115200",
            "gpio:///dev/gpiochip0?x=17&y=27",
            "vcd:capture.vcd?x=D0&y=D1",
            "ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2",
        ),
        offset=ZERO,
        sensitivity=variant.duty_per_g,
        offset_spread=OFFSET_SPREAD,
        sensitivity_spread=deviation_within(SENSITIVITY_LIMIT),
        rails=(0.0, 1.0),
        resolution=0.0,
        # The sensor streams: a read waits for the next sentence.
        interval=0.0,
        thermometer=True,
        driver=Adxl202Sentences,
        twin=virtual_sentences,
        not_modelled=(
            "response time and bandwidth: a new position takes effect at once, the noise of two samples is independent",
            "self-test",
            "supply: ratiometric error, digital noise on the supply",
            "late timestamps, loss and damage on the line",
            "a receive buffer: sentences that are not read at once are missing from the sequence",
            "the period's drift with temperature, on edges (sentences have it)",
            "the memory fault (parity) of other parts: this part has no such memory",
        ),
        default_truth=partial(draw_truth, variant),
        options=("wiring",),
    )
    return replace(model, configure=partial(_configured, model))


MODELS = {
    name: _model(name, f"Analog Devices {name.upper()} accelerometer, {extent}, duty cycle", variant)
    for name, extent, variant in (
        ("adxl202", "±2 g", Adxl202Variant(0.125, 500e-6)),
        ("adxl202e", "±2 g", Adxl202Variant(0.125, 200e-6)),
        ("adxl210", "±10 g", Adxl202Variant(0.04, 500e-6)),
    )
}
"""By the name that the user types."""
