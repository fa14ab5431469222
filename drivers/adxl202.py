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
from dataclasses import replace
from functools import partial, reduce
from operator import xor
from typing import NamedTuple

from tiltcal.drivers.bus import Link
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.drivers.bus.gpio import RECORD, Edge, pack_edges, unpack_edges
from tiltcal.drivers.columns import UNUSABLE, LineBuffer, shown
from tiltcal.drivers.converters import SCHEMES as CONVERTERS
from tiltcal.drivers.model import Model, Reading, Sensor, deviation_within, in_words, link_in_words
from tiltcal.drivers.virtual import SILENCE, HeldPose, StreamingPart, Tolerances, Truth, VirtualPart, uniform
from tiltcal.errors import BusError, DeviceFault

ROUND_NUMBERS = (100, 128, 256, 1000, 1024, 10_000, 65_536, 100_000, 1_000_000, 1 << 24, 1 << 31, 1 << 32)
"""Values at which a counter may wrap to 0: the widths of counters and of printed digits."""

FEW = 16  # largest number of missing sentences at a wrap; more than these count as a restart of the device
_TICKS = rb"([0-9]{1,12}(?:\.[0-9]{1,9})?)"
_SENTENCE = re.compile(
    rb"\$PTCDC,([0-9]{1,12})," + rb",".join([_TICKS] * 4) + rb"(?:,([+-]?[0-9]{1,4}(?:\.[0-9]{0,9})?)?)?"
)


class Sentence(NamedTuple):
    """One sentence: its number, T1/T2 of x and y, T2 of x and y in ticks, and °C where the sentence has it."""

    number: int
    duty: tuple[float, float]
    periods: tuple[float, float]
    temperature: float | None


def parse_sentence(line: bytes) -> Sentence | None:
    """Return the sentence of a line without its end; None where it is damaged or a pulse is longer than its period."""
    inside, _, digits = line.rpartition(b"*")
    fields = _SENTENCE.fullmatch(inside)
    if not fields or not re.fullmatch(b"[0-9A-Fa-f]{2}", digits) or int(digits, 16) != reduce(xor, inside[1:], 0):
        return None
    number, *times, temperature = fields.groups()
    t1x, t1y, t2x, t2y = map(float, times)
    if not (0.0 < t2x >= t1x and 0.0 < t2y >= t1y):
        return None
    return Sentence(int(number), (t1x / t2x, t1y / t2y), (t2x, t2y), float(temperature) if temperature else None)


def missing(before: int, now: int) -> int | None:
    """Return how many sentences are missing between two numbers of a sequence.

    The counter may wrap to 0 at any of the :data:`ROUND_NUMBERS`. None if it went back: the device restarted.
    """
    if now > before:
        return now - before - 1
    wrapped = (modulus - before - 1 + now for modulus in ROUND_NUMBERS if before < modulus)
    return next((count for count in wrapped if count < FEW), None)


ALONE = 8  # pulses on one line, without one on the other, that indicate a broken wire
MOST_APART = 1 / 8
"""Fraction of a period by which the pulses of one sensor may deviate from both arrangements (late timestamps)."""


class Pulse(NamedTuple):
    """The edges of one pulse of one line, in any unit of time."""

    rise: int
    fall: int


class Cycle(NamedTuple):
    """One measurement of both axes: T1 of each and T2, in the unit of the edges."""

    x: float
    y: float
    period: float

    @property
    def duty(self) -> tuple[float, float]:
        """T1/T2 of x and of y."""
        return self.x / self.period, self.y / self.period


def _between_centres(x: Pulse, y: Pulse) -> float:
    """Return the time from centre to centre, in integers, so that a timestamp of 2**60 ns keeps all digits."""
    return (y.rise - x.rise + y.fall - x.fall) / 2


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
        """Add an edge, and return the cycle that it completes, if any."""
        gap = 0 if self._number is None else (edge.number - self._number - 1) & 0xFFFFFFFF
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
        try:
            return self._cycle()
        except DeviceFault:
            self._clear()
            raise

    def _clear(self) -> None:
        self._rise: list[int | None] = [None, None]
        self._pulses: tuple[deque[Pulse], deque[Pulse]] = (deque(), deque())

    def _cycle(self) -> Cycle | None:
        xs, ys = self._pulses
        for pulses, others, name, other in ((xs, ys, "x", "y"), (ys, xs, "y", "x")):
            if not pulses and len(others) >= ALONE:
                raise DeviceFault(
                    f"{other} pulses and {name} does not: check the wire of {name}, and whether the axis is at its rail"
                )
        while len(xs) > 1 and len(ys) > 1:
            x, next_x, y, next_y = xs[0], xs[1], ys[0], ys[1]
            about = next_x.rise - x.rise
            if about <= 0:
                raise DeviceFault("two pulses of x rise at one time, or in wrong order: check the times of the edges")
            apart = _between_centres(x, y)
            if abs(apart) > about / 2:
                (xs if apart > 0 else ys).popleft()
                continue
            xs.popleft()
            ys.popleft()
            if abs(next_y.rise - y.rise - about) > MOST_APART * about:
                # A pulse of one line is missing, so the next pulses are not the next period.
                self.torn += 1
                continue
            rises, centres = abs(y.rise - x.rise), abs(apart)
            if min(rises, centres) > MOST_APART * about:
                raise DeviceFault(
                    "the pulses of x and y share neither their rising edges nor their centres: are both lines of one "
                    "sensor?"
                )
            if centres < rises:
                return Cycle(x.fall - x.rise, next_y.fall - next_y.rise, _between_centres(x, next_y))
            return Cycle(x.fall - x.rise, y.fall - y.rise, about)
        return None


ZERO = 0.5  # nominal duty cycle at 0 g
DUTY = "{:.6f} duty"
EDGES_AT_ONCE = 256  # the largest number of edges to take in one transaction
TROUBLED = 256  # transactions with edges, but without a cycle, before the driver raises an error


class Adxl202Sentences(Sensor):
    """The driver of an ADXL202 behind a microcontroller that sends sentences on a serial line."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._lines = LineBuffer(link, clock)
        self._number: int | None = None
        self._damaged_since = 0
        self._counts = {"sentences": 0, "damaged": 0, "lost": 0, "restarts": 0}

    def probe(self) -> Mapping[str, str]:
        """Return a new sentence, and the link statistics, as text; the errors are those of :meth:`read`."""
        self.discard()
        sentence = self._next()
        said = in_words(Reading(sentence.duty, sentence.temperature), "xy", DUTY, trimmed=True)
        return said | {"period": f"{sentence.periods[0]:g} ticks", "link": link_in_words(self._counts)}

    def read(self) -> Reading:
        """Return the next undamaged sentence: the duty cycles of x and y, and the temperature where it is sent, °C."""
        sentence = self._next()
        return Reading(sentence.duty, sentence.temperature)

    def discard(self) -> None:
        """Discard queued data; they do not count as lost."""
        self._lines.discard()
        self._number = None

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of used, damaged and lost sentences (gaps in the sequence), and its restarts."""
        return dict(self._counts)

    def _next(self) -> Sentence:
        for _ in range(UNUSABLE):
            line, whole = self._lines.next()
            # After a lost line end, a second sentence follows; the part before its "$" is damaged.
            garbage, _, _ = line.rpartition(b"$")
            sentence = parse_sentence(line[len(garbage) :])
            if (garbage or sentence is None) and (whole or line.startswith(b"$")):
                self._counts["damaged"] += 1
                self._damaged_since += 1
            if sentence is not None and self._in_sequence(sentence.number):
                self._counts["sentences"] += 1
                return sentence
        raise BusError(
            f"{UNUSABLE} lines arrived and none was a sentence $PTCDC,seq,t1x,t1y,t2x,t2y*hh with its checksum; "
            f"the last was {shown(line)}: is the baud rate right, and does the microcontroller time both axes?"
        )

    def _in_sequence(self, number: int) -> bool:
        """Count the missing sentences before this one, and return whether it is new."""
        before, self._number = self._number, number
        damaged, self._damaged_since = self._damaged_since, 0
        if before is not None and number != before:
            gap = missing(before, number)
            self._counts["restarts"] += gap is None
            # A damaged sentence leaves a gap too, and is already counted.
            self._counts["lost"] += max((gap or 0) - damaged, 0)
        return number != before


class Adxl202Edges(Sensor):
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
        said = in_words(Reading(cycle.duty), "xy", DUTY) | {"period": f"{cycle.period / 1e6:.6g} ms"}
        return said | {"link": link_in_words(self.link_statistics())}

    def read(self) -> Reading:
        """Return the next period: the duty cycles of x and y."""
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
            self._ready.extend(cycle for edge in self._edges() if (cycle := self._trains.take(edge)))
        raise DeviceFault("edges arrive, but no complete period of both lines: are the wires of x and y loose?")

    def _edges(self) -> Iterator[Edge]:
        try:
            return unpack_edges(self._link.exchange(b"", EDGES_AT_ONCE * RECORD.size))
        except BusError:
            # After a reconnection the edges are numbered from the start.
            self._trains.restart()
            raise


PERIOD = 0.010  # T2 with a set resistor of 1.25 MΩ, seconds: the longest period, with the finest resolution
TIMER = 8_000_000  # ticks a second of the virtual microcontroller's timer


def period_of(truth: Truth) -> float:
    """Return T2 at the reference temperature, seconds: within 5 % of nominal, because resistors and parts vary."""
    return PERIOD * (1.0 + 0.05 * (2.0 * uniform(truth.seed, "period", 0) - 1.0))


def duty_cycles(truth: Truth, fixture: HeldPose, clock: Clock, number: int) -> tuple[float, ...]:
    """Return T1/T2 of x and y in one cycle of a virtual part, between 0 and 1."""
    return tuple(min(max(truth.sample(axis, fixture, clock, number), 0.0), 1.0) for axis in "xy")


def virtual_sentences(truth: Truth, fixture: HeldPose, clock: Clock) -> StreamingPart:
    """Return a microcontroller that times both pulses and sends 100 sentences per second."""

    period = period_of(truth)

    def sentence(number: int) -> bytes:
        # 0.1 % longer per °C, so that T1 alone is wrong.
        ticks = round(period * (1.0 + 1e-3 * (fixture.temperature() - truth.reference)) * TIMER)
        x, y = (round(duty * ticks) for duty in duty_cycles(truth, fixture, clock, number))
        temperature = fixture.temperature() + truth.thermometer_error
        inside = f"PTCDC,{number},{x},{y},{ticks},{ticks},{temperature:.2f}".encode()
        return b"$%s*%02X\r\n" % (inside, reduce(xor, inside, 0))

    return StreamingPart(truth, fixture, clock, sentence)


class VirtualEdges(VirtualPart):
    """Both outputs of a virtual part on two captured lines, the pulses of x and y with common centres.

    The answer depends on the time alone: the edges of the next whole period, to whose end the clock advances. An edge
    that was not read at once is lost, and leaves a gap in the numbers.
    """

    letter, silence = "e", SILENCE

    def _answered(self, out: bytes, count: int) -> bytes:
        """Wait for the edges of a period."""
        if not count:
            return b""
        period_ns, now_ns = round(period_of(self._truth) * SECOND), self._clock.now_ns()
        cycle = -(-now_ns // period_ns)
        # To the end of the period, not to its last edge, which moves while the temperature of the chamber changes.
        self._clock.sleep(((cycle + 1) * period_ns - now_ns) / SECOND)
        centre, edges = cycle * period_ns + period_ns // 2, []
        for line, duty in enumerate(duty_cycles(self._truth, self._fixture, self._clock, cycle)):
            half = round(duty * period_ns / 2)
            edges += [(centre - half, line, True), (centre + half, line, False)]
        numbered = [Edge(*edge, 4 * cycle + place) for place, edge in enumerate(sorted(edges))]
        return pack_edges(numbered[: max(count // RECORD.size, 1)])


SENSITIVITY_LIMIT = 0.2  # largest relative error of the sensitivity between parts: 10 to 15 %/g around 12.5 (AN-603)
OFFSET_SPREAD = 0.5
"""Standard deviation of the offset between parts, g; our estimate, because the notes state only that it varies."""

LIMITS = Tolerances(offset=0.4, sensitivity=SENSITIVITY_LIMIT, cross=0.02, drift=2e-3, gain=2e-4, thermometer=0.5)
"""Of a virtual part: the typical drifts of 2 mg/°C and 0.02 %/°C; where no note states a number, these are ours."""


def _configured(model: Model, address: Address) -> Model:
    """Return the model for an address; at a ``sim:`` address ``wiring=edges`` selects edges."""
    if address.scheme in CONVERTERS:
        from tiltcal.drivers import find_model

        return find_model(f"{model.name}-analog").at(address)
    if "wiring" in address.options and not address.simulated:
        address.refuse("option 'wiring' is for sim: addresses; the scheme of a real address states it")
    edges = address.choice("wiring", {"sentences": False, "edges": True}, address.scheme in ("gpio", "vcd"))
    if not edges:
        return model
    serial, *captured = model.addresses
    edged = replace(model, addresses=(*captured, serial), thermometer=False)
    return replace(edged, driver=Adxl202Edges, twin=VirtualEdges)


def _model(name: str, extent: str, duty_per_g: float, noise_density: float) -> Model:
    """Return the model of a part by its nominal sensitivity and its noise, g/√Hz."""
    # The noise is that of a bandwidth of 10 Hz.
    noise = duty_per_g * noise_density * (1.57 * 10.0) ** 0.5
    model = Model(
        name=name,
        title=f"Analog Devices {name.upper()} accelerometer, {extent}, duty cycle",
        channels=("x", "y"),
        unit="duty",
        addresses=(
            "serial:///dev/ttyUSB0?baudrate=115200",
            "gpio:///dev/gpiochip0?x=17&y=27",
            "vcd:capture.vcd?x=D0&y=D1",
            "ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2",
        ),
        offset=ZERO,
        sensitivity=duty_per_g,
        offset_spread=OFFSET_SPREAD,
        sensitivity_spread=deviation_within(SENSITIVITY_LIMIT),
        rails=(0.0, 1.0),
        thermometer=True,
        driver=Adxl202Sentences,
        twin=virtual_sentences,
        not_modelled=(
            "self-test; the ratiometric error of the supply",
            "the period's drift with temperature, on edges (sentences have it)",
        ),
        default_truth=lambda seed: LIMITS.draw(("x", "y"), duty_per_g, noise, seed, ZERO),
        options=("wiring",),
    )
    return replace(model, configure=partial(_configured, model))


MODELS = {
    name: _model(name, extent, duty_per_g, noise_density)
    for name, extent, duty_per_g, noise_density in (
        ("adxl202", "±2 g", 0.125, 500e-6),
        ("adxl202e", "±2 g", 0.125, 200e-6),
        ("adxl210", "±10 g", 0.04, 500e-6),
    )
}
