"""Quantities that follow from the sensitivity matrix: cross-axis sensitivity, misalignment, intrinsic parameters.

The intrinsic parameters separate a sensor from the way in which it was mounted. An RQ decomposition of the sensitivity
matrix, ``S = U R``, gives the rotation ``R`` from the frame in which the positions were set to the sensor's own; ``U``
is upper triangular with a positive diagonal, so that the sensor's own z axis is along its z channel's sensitive
direction and its y axis in the plane of y and z. A turn of the sensor changes R and nothing else. Nine numbers do not
change with the mounting: the three offsets, the lengths of the rows of S (how much each channel reads at 1 g along its
sensitive direction) and the three angles between those directions.

(A polar decomposition would put the sensor's axes as near to all three sensitive directions as can be; it is the
triangular form that unit gravity alone determines.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from math import atan2, degrees, hypot, radians

import numpy as np

from tiltcal.core.attitude import UNKNOWN_ANGLE, is_locked, mounting_angles
from tiltcal.core.closed_forms import cross_axis_sensitivity
from tiltcal.core.model import AXES, Array, Coefficients, vector_of, with_vector
from tiltcal.core.uncertain import Uncertain
from tiltcal.errors import EstimateError


def cross_axis(coefficients: Coefficients, uncertain: Uncertain) -> Uncertain:
    """Return the cross-axis sensitivity of each channel that has its own axis, % (Cross-axis Compensation, eq. 1)."""
    return _by_channel(lambda own, others: cross_axis_sensitivity(own, *others), coefficients, uncertain)


def misalignment(coefficients: Coefficients, uncertain: Uncertain) -> Uncertain:
    """Return the angle between each channel's sensitive direction and its nominal axis, by the channel, degrees."""
    return _by_channel(lambda own, others: degrees(atan2(hypot(*others), own)), coefficients, uncertain)


def intrinsic(coefficients: Coefficients, uncertain: Uncertain) -> Uncertain:
    """Return the nine parameters that do not change with the mounting.

    They are ``offset.x``, unit, ``sensitivity.x``, unit/g, and ``angle_degrees.xy`` for all channels and pairs. An
    EstimateError refuses fewer than three channels or axes.
    """
    if len(coefficients.channels) != 3 or set(coefficients.axes) != set(AXES):
        raise EstimateError("a sensor is separated from its mounting where it has three channels over three axes")
    channels = coefficients.channels
    pairs = [first + second for first, second in combinations(channels, 2)]
    names = [f"{kind}.{channel}" for kind in ("offset", "sensitivity") for channel in channels]
    return _following([*names, *(f"angle_degrees.{pair}" for pair in pairs)], _nine, coefficients, uncertain)


def rotation(coefficients: Coefficients, uncertain: Uncertain) -> tuple[Uncertain, bool]:
    """Return ``rotation_degrees.roll``, ``.pitch``, ``.yaw`` of R, and whether roll and yaw are not separated."""
    angles, locked = mounting_angles(separated(_matrix(coefficients))[1])
    turned = np.array([angles.roll, angles.pitch, angles.yaw])

    def off(moved: Coefficients) -> Array:
        around, _ = mounting_angles(separated(_matrix(moved))[1])
        there = np.array([around.roll, around.pitch, around.yaw])
        return np.asarray(np.degrees(np.mod(there - turned + np.pi, 2 * np.pi) - np.pi))

    names = [f"rotation_degrees.{angle}" for angle in ("roll", "pitch", "yaw")]
    found = replace(_following(names, off, coefficients, uncertain), value=np.degrees(turned))
    locked = locked or is_locked(angles.pitch, radians(float(found.u[1])))
    if locked:
        covariance, wide = (
            np.diag([degrees(UNKNOWN_ANGLE) ** 2, matrix[1, 1], degrees(UNKNOWN_ANGLE) ** 2])
            for matrix in (found.covariance, found.wide)
        )
        found = replace(found, covariance=covariance, wide=wide)
    return found, locked


def separated(matrix: Array) -> tuple[Array, Array]:
    """Return a sensitivity matrix as an upper triangle with a positive diagonal times a rotation, each (3, 3)."""
    # The QR decomposition of the rows in reverse order, read backwards.
    q, r = np.linalg.qr(matrix[::-1].T)
    sign = np.where(np.diag(r) < 0.0, -1.0, 1.0)
    rotation = np.asarray((q * sign).T[::-1])
    if abs(np.linalg.det(matrix)) == 0.0:
        raise EstimateError("the sensitivity matrix is singular: two channels measure the same axis")
    if np.linalg.det(rotation) < 0.0:
        raise EstimateError("the channels form a left-handed frame, which no mounting does: are they named right?")
    return np.triu(matrix @ rotation.T), rotation


def _following(
    names: Sequence[str], function: Callable[[Coefficients], Array], coefficients: Coefficients, uncertain: Uncertain
) -> Uncertain:
    """Return a function of the coefficients."""
    at = replace(uncertain, value=vector_of(coefficients, uncertain.names))
    found = at.through_function(names, lambda vector: function(with_vector(coefficients, uncertain.names, vector)))
    return replace(found, value=function(coefficients))


def _by_channel(
    function: Callable[[float, list[float]], float], coefficients: Coefficients, uncertain: Uncertain
) -> Uncertain:
    """Return a function of the sensitivity of each channel to its own axis and to the two others, by the channel."""

    def of_rows(at: Coefficients) -> Array:
        found = []
        for channel, row in zip(at.channels, at.sensitivity.tolist(), strict=True):
            along = dict(zip(at.axes, row, strict=True))
            if channel in along:
                found.append(function(along[channel], [along.get(axis, 0.0) for axis in AXES if axis != channel]))
        return np.array(found)

    return _following([c for c in coefficients.channels if c in coefficients.axes], of_rows, coefficients, uncertain)


def _matrix(coefficients: Coefficients) -> Array:
    """Return S with its columns in the order x, y, z."""
    return coefficients.sensitivity[:, [coefficients.axes.index(axis) for axis in AXES]]


def _nine(coefficients: Coefficients) -> Array:
    """Return the offsets, the lengths of the rows of S, and the angles between each two of them in degrees."""
    rows = _matrix(coefficients)
    first, second = rows[[0, 0, 1]], rows[[1, 2, 2]]
    across = first[:, [1, 2, 0]] * second[:, [2, 0, 1]] - first[:, [2, 0, 1]] * second[:, [1, 2, 0]]
    sine = np.linalg.norm(across, axis=1)
    angles = np.degrees(np.arctan2(sine, np.sum(first * second, axis=1)))
    return np.concatenate([coefficients.offset, np.linalg.norm(rows, axis=1), angles])
