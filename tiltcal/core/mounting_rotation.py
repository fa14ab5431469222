"""The mounting rotation from readings in known positions, by Wahba's problem.

Directions of gravity are known in the application's frame, as the positions were set, and read in the sensor's. The
rotation between the two minimises the weighted squares of what is left between them.

Source: G. Wahba, "A least squares estimate of satellite attitude", SIAM Review 7 (1965), problem 65-1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiltcal.core.model import Array, Mounting
from tiltcal.core.mounting_angles import UNKNOWN_ANGLE, is_locked, mounting_angles
from tiltcal.errors import EstimateError

ONE_LINE = 1e-3
"""Second singular value of the directions, relative to the first, below which they all lie on one line (0.06°)."""

STEP = 1e-6
"""Turn by which the angles' derivatives are taken, radians."""


@dataclass(frozen=True)
class MountingEstimate:
    """An estimated mounting: how a sensor sits in its application.

    Attributes
    ----------
    mounting : Mounting
        Radians.
    gimbal_lock : bool
        At a pitch of ±90° only one turn about the vertical is determined; all of it is reported as roll.
    covariance : ndarray, shape (3, 3)
        Of the rotation vector in the application's frame, rad².
    u : Mounting or None
        Standard uncertainty of each angle, radians; None in gimbal lock, where the angles have none of their own.
    residuals : ndarray, shape (positions,)
        Angle between each direction as set and as read, radians.
    chi_square : float
        Their sum of squares, over the squares of their stated uncertainties.
    stated : bool
        Whether the covariance comes from the stated jig, and not from the residuals.
    """

    mounting: Mounting
    gimbal_lock: bool
    covariance: Array
    u: Mounting | None
    residuals: Array
    chi_square: float
    dof: int
    stated: bool


def mounting_rotation(read: Array, known: Array, sigma: Array | None = None) -> Array:
    """Return the rotation matrix of :func:`solve_mounting` alone, with its arguments and errors."""
    return _aligned(*_directions(read, known), _weights(known, sigma))


def solve_mounting(read: Array, known: Array, sigma: Array | None = None) -> MountingEstimate:
    """Return the rotation that takes directions in the sensor's frame to those in the application's.

    Parameters
    ----------
    read : ndarray, shape (positions, 3)
        Up in the sensor's frame, as its calibration reads it.
    known : ndarray, shape (positions, 3)
        Up in the application's frame, as set.
    sigma : ndarray, shape (positions,), optional
        Standard uncertainty of each direction, radians; where it is left out, the residuals show it.

    EstimateError: all directions lie on one line: the turn about it is undetermined.
    """
    read, known = _directions(read, known)
    weights = _weights(known, sigma)
    matrix = _aligned(read, known, weights)
    turned = read @ matrix.T
    residuals = np.arctan2(np.linalg.norm(np.cross(turned, known), axis=1), np.sum(turned * known, axis=1))
    dof = 2 * len(known) - 3
    stated = sigma is not None
    variance = 1.0 if stated else float(np.sum(residuals**2)) / dof
    information = np.einsum("p,pij->ij", weights, np.eye(3) - np.einsum("pi,pj->pij", known, known))
    covariance = variance * np.linalg.inv(information)
    angles = mounting_angles(matrix)
    u = None if angles.gimbal_lock else angle_uncertainty(matrix, covariance)
    locked = u is None or u.roll == UNKNOWN_ANGLE
    chi_square = float(weights @ residuals**2)
    return MountingEstimate(angles.mounting, locked, covariance, u, residuals, chi_square, dof, stated)


def _directions(read: Array, known: Array) -> tuple[Array, Array]:
    """Return both as unit vectors; refuse those that leave a rotation undetermined."""
    read = read / np.linalg.norm(read, axis=1, keepdims=True)
    known = known / np.linalg.norm(known, axis=1, keepdims=True)
    spread = np.linalg.svd(known, compute_uv=False)
    if len(known) < 2 or spread[1] < ONE_LINE * spread[0]:
        raise EstimateError(
            "gravity has the same line in every position, so the rotation about it is undetermined: add a position in "
            "which another axis points up"
        )
    return read, known


def _weights(known: Array, sigma: Array | None) -> Array:
    return np.ones(len(known)) if sigma is None else 1.0 / np.maximum(sigma, 1e-12) ** 2


def _aligned(read: Array, known: Array, weights: Array) -> Array:
    from scipy.spatial.transform import Rotation

    rotation, _ = Rotation.align_vectors(known, read, weights=weights)
    return np.asarray(rotation.as_matrix())


def angle_uncertainty(matrix: Array, covariance: Array) -> Mounting:
    """Return the standard uncertainty of roll, pitch and yaw, by their derivatives with respect to a small turn.

    Parameters
    ----------
    matrix : ndarray, shape (3, 3)
        The mounting's, clear of gimbal lock.
    covariance : ndarray, shape (3, 3)
        Of the rotation vector in the application's frame, rad².
    """
    jacobian = angle_derivatives(matrix)
    roll, pitch, yaw = np.sqrt(np.diag(jacobian @ covariance @ jacobian.T)).tolist()
    if is_locked(mounting_angles(matrix).mounting.pitch, pitch):
        return Mounting(UNKNOWN_ANGLE, pitch, UNKNOWN_ANGLE)
    return Mounting(roll, pitch, yaw)


def angle_derivatives(matrix: Array) -> Array:
    """Return the derivatives of roll, pitch and yaw by a small turn about each of the application's axes."""
    columns = []
    for turn in STEP * np.eye(3):
        ends = [_angles(_small(sign * turn) @ matrix) for sign in (1.0, -1.0)]
        columns.append((np.angle(np.exp(1j * (ends[0] - ends[1])))) / (2 * STEP))
    return np.stack(columns, axis=1)


def rotation_vector(matrix: Array) -> Array:
    """Return the turn that a rotation matrix makes, radians, shape (3,)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrix).as_rotvec())


def _angles(matrix: Array) -> Array:
    mounting = mounting_angles(matrix).mounting
    return np.array([mounting.roll, mounting.pitch, mounting.yaw])


def _small(turn: Array) -> Array:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(turn).as_matrix())
