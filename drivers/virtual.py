"""Virtual parts: links that answer the bytes of the real ones, the jig and chamber that hold them, and their truth.

Each answer follows from the truth, the pose, the temperature, the time and what was written to the part's registers. A
random number is a function of a seed, a name and a number, so sample number n does not depend on those before it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from hashlib import blake2b
from itertools import pairwise
from math import asin, copysign, cos, exp, pi, radians, sin, sqrt, tan
from typing import TYPE_CHECKING

from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from statistics import NormalDist

Vector = tuple[float, float, float]
Polynomial = tuple[float, ...]
LEVEL = (0.0, 0.0, 1.0)  # up in the frame of a level sensor, g
JIG, AMBIENT, TIME_CONSTANT = 0.01, 24.0, 20.0
"""Jig (°), temperature at the start (°C) and chamber (s) of a virtual part that is drawn."""

REFERENCE = 25.0  # temperature of the errors of a part that is drawn within its tolerances, °C
SILENCE = 5.0  # timeout of a virtual line, s


def uniform(seed: int, name: str, number: int) -> float:
    """Return a number that is uniformly distributed over the open interval (0, 1)."""
    digest = blake2b(f"{seed}/{name}/{number}".encode(), digest_size=8).digest()
    return ((int.from_bytes(digest, "big") >> 11) + 0.5) / 2**53


def normal(seed: int, name: str, number: int) -> float:
    """Return a standard normal number."""
    return _standard().inv_cdf(uniform(seed, name, number))


@cache
def _standard() -> NormalDist:
    from statistics import NormalDist  # which a real sensor does not need

    return NormalDist()


def part_errors(seed: int) -> Callable[[float, str], float]:
    """Return a function that draws an error of a part, uniformly distributed within a limit of either sign, by name."""
    return lambda limit, name: limit * (2.0 * uniform(seed, f"part {name}", 0) - 1.0)


@dataclass(frozen=True)
class Fault:
    """A fault of a virtual sensor, from ``start`` to ``end`` in seconds after the session began.

    kind: ``parity`` (memory error of the part), ``stuck`` (the reading does not change), ``silent`` (the data line
        floats high), ``unplugged`` (every transaction fails); empty for no fault.
    """

    kind: str
    start: float
    end: float


NO_FAULT = Fault("", 0.0, 0.0)


@dataclass(frozen=True)
class Truth:
    """The true coefficients of one virtual sensor, in the terms of the measurement model, by channel.

    offset, sensitivity: unit at the reference temperature (°C); unit/g for each axis x, y, z.
    drift, gain: coefficients of dT, dT², ..., in unit/°C**k and 1/°C**k.
    nonlinearity: coefficients of a², a³, ... where a is the signal in g, in g.
    noise: white, standard deviation of one sample, unit.
    thermometer_error: of the sensor's own thermometer, positive if it reads too high, °C.
    lag: by how much the sensing element is later than the chamber and the thermometer, s.
    supply: of an analog sensor, V; its coefficients always refer to 5 V.
    mounting: rotation of the sensor on the fixture: roll, pitch, yaw, degrees.
    jig, ambient, time_constant: of its :class:`Fixture`.
    angles: the convention where a channel reads its own tilt, radians times its row's length: ``inclination``, the
        arcsine of the component of gravity along its row, or ``euler``, where y is the roll; empty for that component.
    slope: reading of a tangent of 1 where it prints slopes, else 0.
    """

    channels: tuple[str, ...]
    offset: Mapping[str, float]
    sensitivity: Mapping[str, Mapping[str, float]]
    reference: float = REFERENCE
    drift: Mapping[str, Polynomial] = field(default_factory=dict)
    gain: Mapping[str, Polynomial] = field(default_factory=dict)
    nonlinearity: Mapping[str, Polynomial] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    thermometer_error: float = 0.0
    lag: float = 0.0
    supply: float = 5.0
    mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seed: int = 0
    jig: float = 0.0
    ambient: float = AMBIENT
    time_constant: float = 0.0
    faults: tuple[Fault, ...] = ()
    angles: str = ""
    slope: float = 0.0

    def reading(self, channel: str, gravity: Vector, temperature: float) -> float:
        """Return the reading of a channel without noise, in its unit, for up in the sensor frame, g, and °C."""
        row, (x, y, z) = self.sensitivity[channel], gravity
        signal = row.get("x", 0.0) * x + row.get("y", 0.0) * y + row.get("z", 0.0) * z
        if self.angles:
            size = sqrt(sum(value**2 for value in row.values()))
            sine, across = signal / size, row.get("x", 0.0) / size
            if self.angles == "euler" and channel == "y":
                pitch = (x - across * sine) ** 2 / (1.0 - across**2)
                sine /= sqrt(max(1.0 - pitch, 1e-12))
            signal = size * asin(min(max(sine, -1.0), 1.0))
        own = row[channel]
        bend = own * _powers(self.nonlinearity.get(channel, ()), signal / own, 2)
        dt = temperature - self.reference
        drift = _powers(self.drift.get(channel, ()), dt, 1)
        gain = _powers(self.gain.get(channel, ()), dt, 1)
        value = self.offset[channel] + drift + (1.0 + gain) * (signal + bend)
        return self.slope * tan(value / self.slope) if self.slope else value

    def sample(self, channel: str, fixture: HeldPose, clock: Clock, number: int) -> float:
        """Return what a channel reads now with the noise of a sample; of a stuck sensor what it reads when level."""
        if self.fault(clock.now_ns() / SECOND).kind == "stuck":
            # A function of the fault alone, so a resumed session reads the same.
            return self.reading(channel, LEVEL, self.ambient)
        noise = self.noise.get(channel, 0.0)
        drawn = normal(self.seed, f"noise {channel}", number) if noise else 0.0
        return self.reading(channel, fixture.gravity, fixture.temperature(self.lag)) + noise * drawn

    def fault(self, seconds: float) -> Fault:
        """Return the fault that is present ``seconds`` after the session began; :data:`NO_FAULT` if there is none."""
        for fault in self.faults:
            if fault.start <= seconds < fault.end:
                return fault
        return NO_FAULT


def _powers(coefficients: Polynomial, variable: float, lowest: int) -> float:
    """Return a polynomial that begins with a power."""
    return sum((coefficient * variable**power for power, coefficient in enumerate(coefficients, lowest)), 0.0)


@dataclass(frozen=True, slots=True)
class Tolerances:
    """The limits of a part as delivered, within which a virtual part is drawn; every error is evenly distributed.

    offset (g), sensitivity and cross (relative to the nominal sensitivity and to the part's own), drift of the offset
    (g/°C), gain of the sensitivity (1/°C), thermometer (°C).
    """

    offset: float
    sensitivity: float
    cross: float = 0.01
    drift: float = 0.0
    gain: float = 0.0
    thermometer: float = 0.0

    def draw(self, channels: tuple[str, ...], sensitivity: float, noise: float, seed: int, zero: float = 0.0) -> Truth:
        """Draw a plausible part by its nominal sensitivity (unit/g), noise of a sample (unit) and zero (unit)."""
        within = part_errors(seed)

        def row(channel: str) -> dict[str, float]:
            own = sensitivity * (1.0 + within(self.sensitivity, f"sensitivity {channel}"))
            cross, direction = own * within(self.cross, f"cross {channel}"), within(pi, f"direction {channel}")
            first, second = (other for other in "xyz" if other != channel)
            return {channel: own, first: cross * cos(direction), second: cross * sin(direction)}

        return Truth(
            channels=channels,
            offset={channel: zero + sensitivity * within(self.offset, f"offset {channel}") for channel in channels},
            sensitivity={channel: row(channel) for channel in channels},
            drift={channel: (sensitivity * within(self.drift, f"drift {channel}"),) for channel in channels},
            gain={channel: (within(self.gain, f"gain {channel}"),) for channel in channels},
            noise=dict.fromkeys(channels, noise),
            thermometer_error=within(self.thermometer, "thermometer"),
            seed=seed,
            jig=JIG,
            time_constant=TIME_CONSTANT,
        )


@dataclass(frozen=True)
class Change:
    """A change of the chamber's temperature, °C: straight with a pace, °C/s, else exponential (s; 0 is immediate)."""

    start_ns: int
    start: float
    target: float
    pace: float
    time_constant: float

    def temperature(self, now_ns: int) -> float:
        """Return the temperature of the chamber, °C."""
        elapsed, way = (now_ns - self.start_ns) / SECOND, self.target - self.start
        if self.pace:
            return self.target if elapsed >= abs(way) / self.pace else self.start + copysign(self.pace * elapsed, way)
        return self.target - way * exp(-elapsed / self.time_constant) if self.time_constant else self.target

    def followed(self, now_ns: int, lag: float, before: float) -> float:
        """Return the temperature of what follows with a lag, s, and was ``before`` at the start."""
        elapsed, way = (now_ns - self.start_ns) / SECOND, self.target - self.start
        if self.pace:
            slope, arrival = copysign(self.pace, way), abs(way) / self.pace
            ramped = min(elapsed, arrival)
            steady = self.start + slope * (ramped - lag)
            there = steady + (before - self.start + slope * lag) * exp(-ramped / lag)
            return self.target + (there - self.target) * exp(-(elapsed - ramped) / lag)
        constant = self.time_constant
        if constant == lag:
            constant *= 1.0 + 1e-9
        # The chamber's own exponential, amplified by how much slower it is than what follows.
        part = -way * constant / (constant - lag) if constant else 0.0
        own = part * exp(-elapsed / constant) if constant else 0.0
        return self.target + own + (before - self.target - part) * exp(-elapsed / lag)


class Fixture:
    """A jig that takes positions with an angle error, inside a chamber that follows its set point.

    All virtual sensors of one bench share one fixture. Its random numbers are functions of the seed and of the number
    of positions before, so a resumed session continues with the same fixture.

    jig: standard deviation of each angle error, degrees.
    ambient: temperature at the start, °C.
    time_constant: of the chamber, s; 0 is an immediate change.
    """

    def __init__(
        self, clock: Clock, *, seed: int = 0, jig: float = 0.0, ambient: float = AMBIENT, time_constant: float = 0.0
    ) -> None:
        self._clock = clock
        self._seed = seed
        self._jig = radians(jig)
        self._time_constant = time_constant
        self._moves = 0
        self._asked: Vector | None = None
        self._changes = [Change(0, ambient, ambient, 0.0, time_constant)]
        self.gravity: Vector = LEVEL

    def move(self, gravity: Vector, temperature: float | None = None, pace: float = 0.0) -> None:
        """Take a position (up in the fixture frame) with an angle error, and set the chamber, °C, at a pace in °C/min.

        If the position is the present one, its angle error stays the same. Without a pace the chamber has its time
        constant.
        """
        if gravity != self._asked:
            errors = [self._jig * normal(self._seed, f"jig {axis}", self._moves) for axis in "xyz"]
            self._moves += 1
            self._asked = gravity
            self.gravity = _rotated(gravity, errors)
        if temperature is not None and temperature != self._changes[-1].target:
            change = Change(self._clock.now_ns(), self.temperature(), temperature, pace / 60.0, self._time_constant)
            self._changes.append(change)

    def temperature(self, lag: float = 0.0) -> float:
        """Return the temperature of the chamber now, °C, or of what follows it with a time constant of ``lag`` s."""
        now_ns = self._clock.now_ns()
        if lag == 0.0:
            return self._changes[-1].temperature(now_ns)
        follows = self._changes[0].start
        for change, until in pairwise((*self._changes, None)):
            if change is not None:
                follows = change.followed(now_ns if until is None else until.start_ns, lag, follows)
        return follows


class Pose:
    """The pose of a sensor on a fixture; ``seen`` converts a vector of the fixture frame to the sensor frame."""

    def __init__(self, fixture: Fixture, seen: Callable[[Vector], Vector]) -> None:
        self._seen = seen
        self._fixture = fixture
        self._held = fixture.gravity, seen(fixture.gravity)
        self.temperature = fixture.temperature

    @property
    def gravity(self) -> Vector:
        """Up in the sensor frame, g."""
        if self._held[0] is not self._fixture.gravity:
            self._held = self._fixture.gravity, self._seen(self._fixture.gravity)
        return self._held[1]


HeldPose = Fixture | Pose
"""What holds a virtual part: up in the sensor frame (``gravity``, g), and the ``temperature`` (°C)."""


def _rotated(vector: Vector, angles: list[float]) -> Vector:
    """Return the vector rotated about x, then y, then z by small angles in radians."""
    turned = list(vector)
    for (one, next_one), angle in zip(((1, 2), (2, 0), (0, 1)), angles, strict=True):
        a, b = turned[one], turned[next_one]
        turned[one], turned[next_one] = cos(angle) * a - sin(angle) * b, sin(angle) * a + cos(angle) * b
    x, y, z = turned
    return x, y, z


class VirtualPart(ABC):
    """Base of the links to virtual parts.

    letter: the bus in a journal line.
    bit_seconds: the time of a bit on SPI or I2C, by which a transaction moves the clock after its answer; 0 where the
        part moves the clock by itself.
    silence: seconds without an answer that are an error, on the buses where only time shows it.
    """

    letter: str
    bit_seconds: float = 0.0
    silence: float = 0.0

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        self._truth = truth
        self._fixture = fixture
        self._clock = clock

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Carry out one transaction; see :class:`~tiltcal.drivers.bus.Link`."""
        silent = self._fault().kind == "silent" and bool(out or count)
        if silent and self.letter != "s":
            self._clock.sleep(self.silence)
            raise BusError("the virtual sensor does not answer, a fault that its truth sets")
        answer = b"\xff" * len(out) if silent else self._answered(out, count)
        # On I2C each byte has an acknowledge; write and read each begin with an address byte.
        bits = 9 * (1 + len(out) + (1 + count if count else 0)) if self.letter == "i" else 8 * len(out)
        self._clock.sleep(bits * self.bit_seconds)
        return answer

    @abstractmethod
    def _answered(self, out: bytes, count: int) -> bytes:
        """Return the bytes of an answer."""

    def close(self) -> None:  # noqa: B027 - a virtual part holds nothing
        """Do nothing: there is nothing to release."""

    def _fault(self) -> Fault:
        """Return the fault that is present now; of an unplugged part it is a BusError."""
        fault = self._truth.fault(self._clock.now_ns() / SECOND)
        if fault.kind == "unplugged":
            raise BusError("the virtual sensor is unplugged, a fault that its truth sets: resume the session later")
        return fault

    def _word(self, channel: str, rate: float, low: int, high: int, scale: float = 1.0) -> int:
        """Return a channel with the noise of the present conversion, rounded and clipped, count.

        ``scale`` is the counts of the measuring range that is set, to those of the truth.
        """
        number = int(self._clock.now_ns() / SECOND * rate)
        return min(max(round(scale * self._truth.sample(channel, self._fixture, self._clock, number)), low), high)

    def _celsius(self) -> float:
        """Return what the part's own thermometer measures now, °C."""
        return self._fixture.temperature() + self._truth.thermometer_error

    def _filler(self) -> int:
        """Return a random byte, where the data sheet leaves the byte undefined."""
        return int(uniform(self._truth.seed, "filler", self._clock.now_ns()) * 256)


class StreamingPart(VirtualPart):
    """A device on a serial line that sends message number n at ``n * period`` (s); one not read at once is lost.

    message: ``message(number)`` returns its bytes, which take less time than the period.
    baudrate: with ten bits a byte; the clock moves to the arrival of the last byte that is returned.
    """

    letter, silence = "r", SILENCE

    def __init__(
        self,
        truth: Truth,
        fixture: HeldPose,
        clock: Clock,
        message: Callable[[int], bytes],
        *,
        period: float = 0.010,
        baudrate: int = 115_200,
    ) -> None:
        super().__init__(truth, fixture, clock)
        self._message = message
        self._period_ns = round(period * SECOND)
        self._byte_ns = round(10 * SECOND / baudrate)

    def _answered(self, out: bytes, count: int) -> bytes:
        """Wait for the next message."""
        if not count:
            return b""
        now_ns = self._clock.now_ns()
        number = -(-now_ns // self._period_ns)
        arrived = self._message(number)[:count]
        self._clock.sleep((number * self._period_ns + len(arrived) * self._byte_ns - now_ns) / SECOND)
        return arrived
