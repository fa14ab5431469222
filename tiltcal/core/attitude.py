"""Attitudes: the unit vector that points up, how a sensor sits on a fixture and in its application, and small errors.

A position is set to the direction ``g``; its true direction is ``g'``, a great-circle arc away::

    g' = cos|a| g + sin|a| / |a| * (b1 a1 + b2 a2)

``b1, b2`` span the plane perpendicular to ``g`` and ``a`` holds the two angles in radians. A turn about gravity itself
moves no reading, so two angles are all there is. The basis is what the shortest turn from level to ``g`` makes of the
fixture's x and y: a table that leans by ``(t1, t2)`` then adds the same two angles to every position that is set with
the fixture at one heading, and turned ones to a position at another heading.

Sources: *Correcting for SCA3000 Accelerometer Mounting Angle* (VTI Technologies, 2006), for a mounting's angles; G.
Wahba, "A least squares estimate of satellite attitude", SIAM Review 7 (1965), problem 65-1, for its rotation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import asin, atan2, cos, degrees, hypot, isfinite, pi, radians, sin, sqrt

import numpy as np

from tiltcal.core.model import AXES, Array, Mounting
from tiltcal.errors import EstimateError, InputError

Vector = tuple[float, float, float]

LEVEL: Vector = (0.0, 0.0, 1.0)  # up in the frame of what is level

_UNIT: dict[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_UPSIDE_DOWN = 1e-12
_SMALL = 1e-6

UNKNOWN_ANGLE = pi / sqrt(3.0)  # standard uncertainty of an angle of which nothing is known, radians
UNKNOWN_FACTOR = 0.95 * sqrt(3.0)  # its coverage factor: 95 % of the whole circle

# Standard uncertainties of the pitch from ±90° within which roll and yaw are not separated: both errors of the line
# move it away from ±90°, and it is within 1.96 in 85 % of the sensors that are mounted there.
LOCKED = 3.0
ONE_LINE = 1e-3  # second singular value of directions over the first, below which all lie on one line (0.06°)
_LOCK = 1e-8  # cosine of pitch below which roll and yaw turn about one line, within double precision
_ORTHOGONAL = 1e-6
_STEP = 1e-6  # turn by which the angles' derivatives are taken, radians


# Directions


def gravity_from_tilt(tilt: Mapping[str, float]) -> Vector:
    """Return up in the sensor frame where x and y are tilted, degrees: (g_x, g_y, g_z) with a g_z that is not negative.

    Tilt of axis i is asin(g_i); an axis that is left out is level. An InputError for other axes, an angle outside ±90°,
    or two tilts that no direction has.
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
    """Return a direction of gravity as a unit vector; an InputError where it is not three finite numbers, or 0."""
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
    """Return the sine of an angle in degrees; exact at 0°, ±30° and ±90°, where procedures put most positions."""
    return round(sin(radians(angle)), 15)


# How a sensor sits on the fixture


@dataclass(frozen=True)
class Orientation:
    """A turn by right angles from the fixture's frame to a sensor's, whose axes point along ``("-y", "x", "z")``."""

    names: tuple[str, ...] = AXES

    @property
    def straight(self) -> bool:
        """Whether the sensor's frame is the fixture's."""
        return self.names == AXES

    @property
    def matrix(self) -> tuple[Vector, Vector, Vector]:
        """Rows: the sensor's axes in the fixture's frame; takes a vector of that frame to the sensor's."""
        first, second, third = (_direction(name) for name in self.names)
        return first, second, third

    def seen(self, vector: Vector) -> Vector:
        """Return a vector of the fixture's frame, such as gravity's direction, in the sensor's."""
        x, y, z = (sum(a * b for a, b in zip(row, vector, strict=True)) for row in self.matrix)
        return x, y, z


STRAIGHT = Orientation()  # the sensor's frame is the fixture's


def orientation(names: Sequence[str]) -> Orientation:
    """Return the orientation of a sensor whose x, y and, where it is given, z axis point along ``x``, ``-x``, ...

    A third one that is left out completes a right-handed frame. An InputError for other than two or three different
    axes, and for a left-handed frame.
    """
    plain = [name.lstrip("+-") for name in names]
    if len(names) not in (2, 3) or any(axis not in _UNIT for axis in plain) or len(set(plain)) < len(plain):
        raise InputError(f"axes [{', '.join(names)}] are not two or three different ones of x, y, z with their signs")
    tidy = [name.removeprefix("+") for name in names]
    across = np.cross(_direction(tidy[0]), _direction(tidy[1]))
    third = ("-" if across.sum() < 0.0 else "") + AXES[int(np.argmax(np.abs(across)))]
    if len(tidy) == 3 and tidy[2] != third:
        raise InputError(
            f"axes [{', '.join(names)}] are a left-handed frame, which no turn of a sensor gives; the third is {third}"
        )
    return Orientation((tidy[0], tidy[1], third))


def _direction(name: str) -> Vector:
    x, y, z = _UNIT[name[-1]]
    return (-x, -y, -z) if name.startswith("-") else (x, y, z)


# Small errors of what is set


def tangent_basis(gravity: Array) -> Array:
    """Return the two directions in which each unit vector can move, shapes (n, 3) and (n, 3, 2)."""
    x, y, z = gravity.T
    below = 1.0 + z < _UPSIDE_DOWN
    share = 1.0 / np.where(below, 1.0, 1.0 + z)
    basis = np.empty((len(gravity), 3, 2))
    basis[:, :, 0] = np.stack([1.0 - x * x * share, -x * y * share, -x], axis=1)
    basis[:, :, 1] = np.stack([-x * y * share, 1.0 - y * y * share, -y], axis=1)
    basis[below] = np.array([[1.0, 0.0], [0.0, -1.0], [0.0, 0.0]])
    return basis


def turned(gravity: Array, basis: Array, angles: Array) -> tuple[Array, Array]:
    """Turn unit vectors, (n, 3), along arcs in a tangent basis, (n, 2), radians; with the derivatives, (n, 3, 2)."""
    size = np.linalg.norm(angles, axis=1)
    sinc = np.sinc(size / np.pi)
    # (cos r - sin r / r) / r², whose limit is -1/3.
    small = size < _SMALL
    bend = np.where(small, -1.0 / 3.0, (np.cos(size) - sinc) / np.where(small, 1.0, size) ** 2)
    along = np.einsum("nij,nj->ni", basis, angles)
    direction = np.cos(size)[:, None] * gravity + sinc[:, None] * along
    derivative = sinc[:, None, None] * (basis - gravity[:, :, None] * angles[:, None, :])
    derivative += bend[:, None, None] * along[:, :, None] * angles[:, None, :]
    return direction, derivative


def heading_rotations(heading: Array) -> Array:
    """Return the matrices, (n, 2, 2), that take the lean of a table to the angles of positions at headings, (n,).

    A heading is how far the fixture is turned about the vertical, counterclockwise seen from above, radians.
    """
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([np.stack([c, s], axis=1), np.stack([-s, c], axis=1)], axis=1)


# How a sensor sits in its application


def mounting_matrix(mounting: Mounting) -> Array:
    """Return the rotation from the sensor's frame to the application's, ``a' = matrix @ a``, shape (3, 3).

    The sensor was turned from the application's frame by roll about x', then pitch about y', then yaw about z', each
    clockwise seen from the positive side of the axis: ``Rz(-yaw) Ry(-pitch) Rx(-roll)`` with right-handed elementary
    rotations, which written out is the document's formula term by term.
    """
    (c_r, s_r), (c_p, s_p), (c_y, s_y) = ((cos(turn), sin(turn)) for turn in _vector(mounting).tolist())
    roll = np.array([[1.0, 0.0, 0.0], [0.0, c_r, s_r], [0.0, -s_r, c_r]])
    pitch = np.array([[c_p, 0.0, -s_p], [0.0, 1.0, 0.0], [s_p, 0.0, c_p]])
    yaw = np.array([[c_y, s_y, 0.0], [-s_y, c_y, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(yaw @ pitch @ roll)


def mounting_angles(matrix: Array) -> tuple[Mounting, bool]:
    """Return the angles of a mounting matrix, roll and yaw in (-π, π], pitch in [-π/2, π/2], and whether it is locked.

    In gimbal lock, at a pitch of ±90°, only roll + yaw (at +90°) or roll - yaw (at -90°) is determined: all of it is
    reported as roll, with yaw zero. An EstimateError refuses what is no rotation.
    """
    rotation = np.asarray(matrix, dtype=float)
    if (
        rotation.shape != (3, 3)
        or not np.abs(rotation @ rotation.T - np.eye(3)).max() <= _ORTHOGONAL  # nor where one is not a number
        or np.linalg.det(rotation) < 0.0
    ):
        raise EstimateError("a mounting must be a rotation: three perpendicular unit rows, right-handed")
    (xx, xy, _), (yx, yy, _), (zx, zy, zz) = rotation.tolist()
    cosine = hypot(xx, yx)
    pitch = atan2(zx, cosine)
    if cosine < _LOCK:
        together = atan2(xy, yy)
        return Mounting(_wrapped(together if zx > 0.0 else -together), pitch, 0.0), True
    return Mounting(_wrapped(atan2(-zy, zz)), pitch, _wrapped(atan2(-yx, xx))), False


def is_locked(pitch: float, u: float) -> bool:
    """Return whether roll and yaw are not separated, by the pitch and its standard uncertainty, radians."""
    return abs(abs(pitch) - pi / 2.0) <= LOCKED * u


def angle_derivatives(matrix: Array) -> Array:
    """Return the derivatives of roll, pitch and yaw by a small turn about each of the application's axes."""
    columns = []
    for axis in np.eye(3):
        turn = _STEP * np.cross(np.eye(3), axis)
        ahead, behind = (_vector(mounting_angles(matrix + sign * turn @ matrix)[0]) for sign in (1.0, -1.0))
        columns.append(np.angle(np.exp(1j * (ahead - behind))) / (2 * _STEP))
    return np.stack(columns, axis=1)


@dataclass(frozen=True)
class MountingEstimate:
    """A mounting by its rotation matrix, with what the directions leave."""

    matrix: Array
    covariance: Array  # of its rotation vector in the application's frame, (3, 3), rad²
    residuals: Array  # angles between directions as set and as read, (positions,), radians
    chi_square: float  # sum of their squares over those of their uncertainties
    dof: int
    stated: bool  # whether these were stated


def mounting_rotation(read: Array, known: Array, sigma: Array | None) -> Array:
    """Return the rotation matrix from directions as read to those as set, unit, (n, 3), by their u, (n,)."""
    from scipy.spatial.transform import Rotation

    spread = np.linalg.svd(known, compute_uv=False)
    if len(known) < 2 or spread[1] < ONE_LINE * spread[0]:
        raise EstimateError(
            "gravity has the same line in every position, so the rotation about it is undetermined: add a position in "
            "which another axis points up"
        )
    rotation, _ = Rotation.align_vectors(known, read, weights=_weights(known, sigma))
    return np.asarray(rotation.as_matrix())


def solve_mounting(read: Array, known: Array, sigma: Array | None) -> MountingEstimate:
    """Return the mounting by :func:`mounting_rotation`; without ``sigma`` the residuals show the uncertainty."""
    matrix, weights = mounting_rotation(read, known, sigma), _weights(known, sigma)
    turned = read @ matrix.T
    residuals = np.arctan2(np.linalg.norm(np.cross(turned, known), axis=1), np.sum(turned * known, axis=1))
    dof = 2 * len(known) - 3
    variance = 1.0 if sigma is not None else float(np.sum(residuals**2)) / dof
    information = np.einsum("p,pij->ij", weights, np.eye(3) - np.einsum("pi,pj->pij", known, known))
    covariance = variance * np.linalg.inv(information)
    return MountingEstimate(matrix, covariance, residuals, float(weights @ residuals**2), dof, sigma is not None)


def rotation_vector(matrix: Array) -> Array:
    """Return the turn that a rotation matrix makes, radians, shape (3,)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrix).as_rotvec())


def _weights(known: Array, sigma: Array | None) -> Array:
    return np.ones(len(known)) if sigma is None else 1.0 / np.maximum(sigma, 1e-12) ** 2


def _vector(mounting: Mounting) -> Array:
    return np.array([mounting.roll, mounting.pitch, mounting.yaw])


def _wrapped(angle: float) -> float:
    return pi if angle == -pi else angle  # atan2 makes -π of a negative zero
