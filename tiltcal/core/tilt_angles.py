"""The angles of tilt, from the components of gravity.

``g`` points UP in the sensor frame, in g; level is (0, 0, 1). All angles are degrees::

    tilt of axis i = asin(g_i)                          -90 to  90, of one or two axes
    tilt of axis x = atan2(g_x, hypot(g_y, g_z))        -90 to  90, of three; likewise of y and z
    pitch          = atan2(g_x, hypot(g_y, g_z))        -90 to  90
    roll           = atan2(g_y, g_z)                   -180 to 180
    inclination    = atan2(hypot(g_x, g_y), g_z)          0 to 180

Roll has no meaning where g_y and g_z vanish (gimbal lock, pitch ±90°).
"""

from __future__ import annotations

from math import pi

import numpy as np

from tiltcal.core.model import Array

DIRECTIONS = ("pitch", "roll", "inclination")  # the angles over the full circle that three axes have

_DEGREES = 180.0 / pi


def tilt(component: Array, out: Array | None = None) -> Array:
    """Compute the tilt of an axis, degrees, from its component of gravity, g; a component beyond ±1 gives ±90°."""
    angle: Array = np.clip(component, -1.0, 1.0, out=out)
    np.arcsin(angle, out=angle)
    angle *= _DEGREES
    return angle


def tilts_of_three(gravity: Array, out: Array) -> Array:
    """Compute the tilts of three axes and :data:`DIRECTIONS`, shape (6, n), degrees; return |g|², shape (n,)."""
    x, y, z = squares = gravity * gravity
    tilt_x, tilt_y, tilt_z, pitch, roll, inclination = out
    np.arctan2(gravity[0], np.sqrt(y + z), out=tilt_x)
    np.arctan2(gravity[1], np.sqrt(x + z), out=tilt_y)
    np.arctan2(gravity[1], gravity[2], out=roll)
    np.arctan2(np.sqrt(x + y), gravity[2], out=inclination)
    for angle in (tilt_x, tilt_y, roll, inclination):
        angle *= _DEGREES
    pitch[...] = tilt_x
    np.subtract(90.0, inclination, out=tilt_z)
    return np.asarray(squares.sum(axis=0))
