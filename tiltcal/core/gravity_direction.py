"""Directions of gravity: from the tilt of axes to the unit vector that points up, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import asin, cos, degrees, hypot, isfinite, pi, radians, sin, sqrt

from tiltcal.errors import InputError

Vector = tuple[float, float, float]

LEVEL: Vector = (0.0, 0.0, 1.0)
"""Up in the frame of what is level."""


def gravity_from_tilt(tilt: Mapping[str, float]) -> Vector:
    """Return up in the sensor frame where axes are tilted: (g_x, g_y, g_z) with g_z = +sqrt(1 - g_x² - g_y²).

    Parameters
    ----------
    tilt : mapping of str to float
        Tilt of axes x and y in degrees; an axis that is left out is level. Tilt of axis i is asin(g_i).

    InputError: an axis other than x and y, an angle outside ±90°, or two tilts that no direction has.
    """
    strange = sorted(set(tilt) - {"x", "y"})
    if strange:
        raise InputError(f"tilt names axis {strange[0]!r}; it may name x and y (give gravity: for other directions)")
    x, y = tilt.get("x", 0.0), tilt.get("y", 0.0)
    for angle in (x, y):
        if not (isfinite(angle) and -90.0 <= angle <= 90.0):
            raise InputError(f"a tilt of {angle}° is not between -90° and 90°")
    g_x, g_y = _sine(x), _sine(y)
    rest = 1.0 - g_x * g_x - g_y * g_y
    if rest < -1e-12:
        raise InputError(f"no direction has a tilt of {x}° on x and {y}° on y at once")
    return g_x, g_y, sqrt(max(rest, 0.0))


def normalised(gravity: Sequence[float]) -> Vector:
    """Return a direction of gravity as a unit vector.

    InputError: not three finite numbers, or all zero.
    """
    if len(gravity) != 3 or not all(isfinite(component) for component in gravity):
        raise InputError("gravity takes three finite numbers [gx, gy, gz]")
    length = hypot(*gravity)
    if length == 0.0:
        raise InputError("gravity [0, 0, 0] has no direction")
    g_x, g_y, g_z = (component / length for component in gravity)
    return g_x, g_y, g_z


def tilt_from_gravity(gravity: Sequence[float]) -> dict[str, float]:
    """Return the tilt of x and y in degrees, the inverse of :func:`gravity_from_tilt` where g_z is positive."""
    g_x, g_y, _ = normalised(gravity)
    return {"x": degrees(asin(g_x)), "y": degrees(asin(g_y))}


def _sine(angle: float) -> float:
    """Return the sine of an angle in degrees, exact at 0° and ±90°, where procedures put most of their positions."""
    if abs(angle) == 90.0:
        return 1.0 if angle > 0 else -1.0
    if abs(angle) == 30.0:
        return 0.5 if angle > 0 else -0.5
    return cos(pi / 2 - radians(angle)) if abs(angle) > 45.0 else sin(radians(angle))
