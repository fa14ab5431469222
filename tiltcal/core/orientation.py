"""How a sensor sits on the fixture: which fixture axis each of its axes points along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tiltcal.core.gravity_direction import Vector
from tiltcal.errors import InputError

_UNIT: dict[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Orientation:
    """A turn by right angles from the fixture's frame to a sensor's.

    Attributes
    ----------
    names : tuple of str
        The fixture axis that each sensor axis points along, such as ``("-y", "x", "z")``.
    """

    names: tuple[str, ...] = ("x", "y", "z")

    @property
    def straight(self) -> bool:
        """Whether the sensor's frame is the fixture's."""
        return self.names == ("x", "y", "z")

    @property
    def matrix(self) -> tuple[Vector, Vector, Vector]:
        """Rows: the sensor's axes in the fixture's frame; takes a vector of that frame to the sensor's."""
        first, second, third = (_direction(name) for name in self.names)
        return first, second, third

    def seen(self, vector: Vector) -> Vector:
        """Return a vector of the fixture's frame, such as gravity's direction, in the sensor's."""
        x, y, z = (sum(a * b for a, b in zip(row, vector, strict=True)) for row in self.matrix)
        return x, y, z


STRAIGHT = Orientation()
"""The sensor's frame is the fixture's."""


def orientation(names: Sequence[str]) -> Orientation:
    """Return the orientation that two or three signed axis names state.

    Parameters
    ----------
    names : sequence of str
        ``x``, ``-x``, ``y``, ... for the sensor's x, y and, where it is given, z axis. A third one that is left out
        completes a right-handed frame.

    InputError: not two or three different axes, or a left-handed frame.
    """
    plain = [name.lstrip("+-") for name in names]
    if len(names) not in (2, 3) or any(axis not in _UNIT for axis in plain) or len(set(plain)) < len(plain):
        raise InputError(f"axes [{', '.join(names)}] are not two or three different ones of x, y, z with their signs")
    tidy = [name.removeprefix("+") for name in names]
    third = _named(_cross(_direction(tidy[0]), _direction(tidy[1])))
    if len(tidy) == 3 and tidy[2] != third:
        raise InputError(
            f"axes [{', '.join(names)}] are a left-handed frame, which no turn of a sensor gives; the third is {third}"
        )
    return Orientation((tidy[0], tidy[1], third))


def _direction(name: str) -> Vector:
    x, y, z = _UNIT[name[-1]]
    return (-x, -y, -z) if name.startswith("-") else (x, y, z)


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _named(direction: Vector) -> str:
    axis = max(range(3), key=lambda index: abs(direction[index]))
    return ("-" if direction[axis] < 0 else "") + "xyz"[axis]
