"""The virtual jig and chamber: the attitude and the temperature of the virtual sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import copysign, cos, exp, radians, sin
from typing import TYPE_CHECKING, Protocol

from tiltcal.drivers.twin.noise import normal

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock

Vector = tuple[float, float, float]


class HeldPose(Protocol):
    """The attitude and temperature of a twin."""

    @property
    def gravity(self) -> Vector:
        """Up in the sensor frame, g."""
        ...

    def temperature(self, lag: float = 0.0) -> float:
        """Return the temperature of the sensor, or of what follows it with a time constant of ``lag`` s, °C."""
        ...


@dataclass(frozen=True)
class Change:
    """A change of the chamber's temperature.

    Attributes
    ----------
    start, target : float
        °C.
    pace : float
        °C/s on a straight way; 0 for an exponential one.
    time_constant : float
        Of the exponential way, s; 0 is an immediate change.
    """

    start_ns: int
    start: float
    target: float
    pace: float
    time_constant: float

    def temperature(self, now_ns: int) -> float:
        """Return the temperature of the chamber, °C."""
        elapsed, way = (now_ns - self.start_ns) / 1e9, self.target - self.start
        if self.pace:
            return self.target if elapsed >= abs(way) / self.pace else self.start + copysign(self.pace * elapsed, way)
        return self.target - way * exp(-elapsed / self.time_constant) if self.time_constant else self.target

    def followed(self, now_ns: int, lag: float, before: float) -> float:
        """Return the temperature of what follows with a lag, s, and had the temperature ``before`` at the start."""
        elapsed, way = (now_ns - self.start_ns) / 1e9, self.target - self.start
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

    Parameters
    ----------
    clock : Clock
        Session time; the chamber approaches its set point along it.
    seed : int
        Seed of the angle errors.
    jig : float
        Standard deviation of each angle error, degrees.
    ambient : float
        Temperature at the start, °C.
    time_constant : float
        Time constant of the chamber, s; 0 is an immediate change.
    """

    def __init__(
        self, clock: Clock, *, seed: int = 0, jig: float = 0.0, ambient: float = 24.0, time_constant: float = 0.0
    ) -> None:
        self._clock = clock
        self._seed = seed
        self._jig = radians(jig)
        self._time_constant = time_constant
        self._moves = 0
        self._asked: Vector | None = None
        self._changes = [Change(0, ambient, ambient, 0.0, time_constant)]
        self.gravity: Vector = (0.0, 0.0, 1.0)

    def move(self, gravity: Vector, temperature: float | None = None, pace: float = 0.0) -> None:
        """Take a position with an angle error, and set the chamber.

        If the position is the present one, its angle error stays the same.

        Parameters
        ----------
        gravity : tuple of float
            Up in the fixture frame, a unit vector.
        temperature : float, optional
            New set point, °C; without it the set point stays the same.
        pace : float
            °C/min by which the chamber goes there; 0 for its time constant.
        """
        if gravity != self._asked:
            self._set(gravity)
        if temperature is not None and temperature != self._changes[-1].target:
            change = Change(self._clock.now_ns(), self.temperature(), temperature, pace / 60.0, self._time_constant)
            self._changes.append(change)

    def _set(self, gravity: Vector) -> None:
        errors = [self._jig * normal(self._seed, f"jig {axis}", self._moves) for axis in "xyz"]
        self._moves += 1
        self._asked = gravity
        self.gravity = _rotated(gravity, errors)

    def turned(self, seen: Callable[[Vector], Vector]) -> Pose:
        """Return the pose of a sensor that is rotated on the fixture."""
        return Pose(self, seen)

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
    """The pose of a sensor on a fixture: gravity in the sensor frame, and the temperature of the chamber.

    Parameters
    ----------
    seen : callable
        Converts a vector of the fixture frame to the sensor frame.
    """

    def __init__(self, fixture: Fixture, seen: Callable[[Vector], Vector]) -> None:
        self._fixture = fixture
        self._seen = seen
        self._held = fixture.gravity
        self._gravity = seen(self._held)

    @property
    def gravity(self) -> Vector:
        """Up in the sensor frame, g."""
        if self._fixture.gravity is not self._held:
            self._held = self._fixture.gravity
            self._gravity = self._seen(self._held)
        return self._gravity

    def temperature(self, lag: float = 0.0) -> float:
        """Return the temperature of the chamber now, °C, or of what follows it with a time constant of ``lag`` s."""
        return self._fixture.temperature(lag)


def _rotated(vector: Vector, angles: list[float]) -> Vector:
    """Return the vector rotated about x, then y, then z by small angles in radians."""
    x, y, z = vector
    (c, s) = cos(angles[0]), sin(angles[0])
    y, z = c * y - s * z, s * y + c * z
    (c, s) = cos(angles[1]), sin(angles[1])
    x, z = c * x + s * z, c * z - s * x
    (c, s) = cos(angles[2]), sin(angles[2])
    x, y = c * x - s * y, s * x + c * y
    return x, y, z
