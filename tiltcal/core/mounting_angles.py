"""The mounting angles: their rotation from the sensor's frame to the application's, and the angles of a matrix.

Source: *Correcting for SCA3000 Accelerometer Mounting Angle* (VTI Technologies, 2006).
"""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from tiltcal.core.model import Array, Mounting
from tiltcal.errors import EstimateError

UNKNOWN_ANGLE = pi / sqrt(3.0)
"""Standard uncertainty of an angle of which nothing is known, radians."""

UNKNOWN_FACTOR = 0.95 * sqrt(3.0)
"""Its coverage factor: 95 % of the whole circle."""

LOCKED = 3.0
"""Standard uncertainties of the pitch from ±90° within which roll and yaw are not separated."""

_LOCK = 1e-8  # cosine of pitch below which roll and yaw turn about one line, within double precision
_ORTHOGONAL = 1e-6


class MountingAngles(NamedTuple):
    """The angles of a mounting matrix.

    Attributes
    ----------
    mounting : Mounting
        Roll and yaw in (-π, π], pitch in [-π/2, π/2].
    gimbal_lock : bool
        True at a pitch of ±90°, where only roll + yaw (at +90°) or roll - yaw (at -90°) is determined: all of it is
        then reported as roll, with yaw zero.
    """

    mounting: Mounting
    gimbal_lock: bool


def mounting_matrix(mounting: Mounting) -> Array:
    """Return the rotation that takes a vector from the sensor frame to the application frame.

    Parameters
    ----------
    mounting : Mounting
        How the sensor was turned from the application's frame: roll about x', then pitch about y', then yaw about z',
        each clockwise seen from the positive side of the axis; radians.

    Returns
    -------
    ndarray, shape (3, 3)
        ``a' = matrix @ a``.

    Notes
    -----
    ``Rz(-yaw) Ry(-pitch) Rx(-roll)`` with right-handed elementary rotations, which written out is the document's
    formula term by term.
    """
    c_r, s_r = cos(mounting.roll), sin(mounting.roll)
    c_p, s_p = cos(mounting.pitch), sin(mounting.pitch)
    c_y, s_y = cos(mounting.yaw), sin(mounting.yaw)
    roll = np.array([[1.0, 0.0, 0.0], [0.0, c_r, s_r], [0.0, -s_r, c_r]])
    pitch = np.array([[c_p, 0.0, -s_p], [0.0, 1.0, 0.0], [s_p, 0.0, c_p]])
    yaw = np.array([[c_y, s_y, 0.0], [-s_y, c_y, 0.0], [0.0, 0.0, 1.0]])
    matrix: Array = yaw @ pitch @ roll
    return matrix


def mounting_angles(matrix: Array) -> MountingAngles:
    """Return roll, pitch and yaw of a mounting matrix, the inverse of :func:`mounting_matrix`.

    Parameters
    ----------
    matrix : ndarray, shape (3, 3)
        From the sensor frame to the application frame.

    Returns
    -------
    MountingAngles
        The document allows angles from 0 to below 180° only, which does not reach every mounting; these do.

    EstimateError: the matrix is no rotation.
    """
    rotation = np.asarray(matrix, dtype=float)
    if (
        rotation.shape != (3, 3)
        or not np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=_ORTHOGONAL)
        or np.linalg.det(rotation) < 0.0
    ):
        raise EstimateError("a mounting must be a rotation: three perpendicular unit rows, right-handed")
    (xx, xy, _), (yx, yy, _), (zx, zy, zz) = rotation.tolist()
    cosine = hypot(xx, yx)
    pitch = atan2(zx, cosine)
    if cosine < _LOCK:
        together = atan2(xy, yy)
        return MountingAngles(Mounting(_wrapped(together if zx > 0.0 else -together), pitch, 0.0), gimbal_lock=True)
    return MountingAngles(Mounting(_wrapped(atan2(-zy, zz)), pitch, _wrapped(atan2(-yx, xx))), gimbal_lock=False)


def is_locked(pitch: float, u: float) -> bool:
    """Return whether the pitch is ±90° within three standard uncertainties: roll and yaw are not separated; radians.

    Both errors of the line move it away from ±90°: it is within 1.96 in 85 % of the sensors that are mounted there.
    """
    return abs(abs(pitch) - pi / 2.0) <= LOCKED * u


def _wrapped(angle: float) -> float:
    """Return an angle with +π in place of -π, which atan2 makes of a negative zero."""
    return pi if angle == -pi else angle
