"""The angles of tilt, from the components of gravity.

``g`` points UP in the sensor frame, in g; level is (0, 0, 1). All angles are degrees::

    tilt of axis i = asin(g_i)                          -90 to  90
    pitch          = atan2(g_x, hypot(g_y, g_z))        -90 to  90
    roll           = atan2(g_y, g_z)                   -180 to 180
    inclination    = atan2(hypot(g_x, g_y), g_z)          0 to 180

Roll has no meaning where g_y and g_z vanish (gimbal lock, pitch ±90°).
"""

from __future__ import annotations

from math import pi

import numpy as np

from tiltcal.core.model import Array

DIRECTIONS = ("pitch", "roll", "inclination")
"""The angles over the full circle that three axes have."""

_DEGREES = 180.0 / pi


def tilt(component: Array, out: Array | None = None) -> Array:
    """Compute the tilt of an axis from its component of gravity; a component beyond ±1 gives ±90°.

    Parameters
    ----------
    component : ndarray
        g.
    out : ndarray, optional
        Memory for the result, degrees.
    """
    angle: Array = np.clip(component, -1.0, 1.0, out=out)
    np.arcsin(angle, out=angle)
    angle *= _DEGREES
    return angle


def pitch(g_x: Array, g_y: Array, g_z: Array, out: Array | None = None) -> Array:
    """Compute the pitch, degrees: how far the x axis points above the horizontal."""
    return _arctangent(g_x, np.hypot(g_y, g_z), out)


def roll(g_x: Array, g_y: Array, g_z: Array, out: Array | None = None) -> Array:
    """Compute the roll, degrees: the turn about the x axis."""
    return _arctangent(g_y, g_z, out)


def inclination(g_x: Array, g_y: Array, g_z: Array, out: Array | None = None) -> Array:
    """Compute the inclination, degrees: the angle between the z axis and the vertical."""
    return _arctangent(np.hypot(g_x, g_y), g_z, out)


def _arctangent(opposite: Array, adjacent: Array, out: Array | None) -> Array:
    angle: Array = np.arctan2(opposite, adjacent, out=out)
    angle *= _DEGREES
    return angle
