"""Intrinsic parameters of a sensor, separated from the way in which it was mounted.

The sensitivity matrix is separated by an RQ decomposition, ``S = U R``: ``R`` is the rotation from the frame in which
the positions were set to the sensor's own, ``U`` is upper triangular with a positive diagonal, so that the sensor's
own z axis is along its z channel's sensitive direction and its y axis in the plane of y and z. A turn of the sensor
changes R and nothing else. Nine numbers do not change with the mounting: the three offsets, the lengths of the rows of
S (how much each channel reads at 1 g along its sensitive direction) and the three angles between those directions.

(A polar decomposition would put the sensor's axes as near to all three sensitive directions as can be; it is the
triangular form that unit gravity alone determines.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from math import degrees, radians

import numpy as np

from tiltcal.core.derived_quantities import DerivedQuantity, with_uncertainty
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.mounting_angles import UNKNOWN_ANGLE, UNKNOWN_FACTOR, is_locked, mounting_angles
from tiltcal.core.uncertainty_inputs import UncertaintyInputs
from tiltcal.errors import EstimateError


@dataclass(frozen=True)
class Intrinsic:
    """A sensor of three channels, apart from its mounting.

    Attributes
    ----------
    offset : dict of str to DerivedQuantity
        Per channel, unit.
    sensitivity : dict of str to DerivedQuantity
        Per channel, along its own sensitive direction, unit/g.
    angle : dict of str to DerivedQuantity
        Between the sensitive directions of two channels, ``xy``, ``xz``, ``yz``, degrees.
    mounting : dict of str to DerivedQuantity
        Roll, pitch and yaw of R, degrees. Empty where the positions were free and R means nothing, and where there is
        no such rotation.
    gimbal_lock : bool
        At a pitch of ±90°, where only roll and yaw together are determined.
    left_handed : str
        Why there is no rotation, such as channels that form a left-handed frame; empty where there is one.
    """

    offset: dict[str, DerivedQuantity]
    sensitivity: dict[str, DerivedQuantity]
    angle: dict[str, DerivedQuantity]
    mounting: dict[str, DerivedQuantity]
    gimbal_lock: bool
    left_handed: str = ""


def intrinsic(coefficients: Coefficients, uncertain: UncertaintyInputs, *, mounted: bool = True) -> Intrinsic:
    """Separate a calibration into the sensor and its mounting.

    Parameters
    ----------
    coefficients : Coefficients
        Of three channels over three axes.
    uncertain : UncertaintyInputs
        Without turns of the mounting.
    mounted : bool
        False where the positions were free: the rotation is then a choice and no finding.

    EstimateError: fewer than three channels or axes.
    """
    if len(coefficients.channels) != 3 or set(coefficients.axes) != set(AXES):
        raise EstimateError("a sensor is separated from its mounting where it has three channels over three axes")
    channels = coefficients.channels
    pairs = [first + second for first, second in combinations(channels, 2)]
    names = [f"offset.{c}" for c in channels] + [f"sensitivity.{c}" for c in channels] + [f"angle.{ab}" for ab in pairs]
    found = with_uncertainty(names, _nine, coefficients, uncertain)
    own = Intrinsic(
        offset={channel: found[f"offset.{channel}"] for channel in channels},
        sensitivity={channel: found[f"sensitivity.{channel}"] for channel in channels},
        angle={pair: found[f"angle.{pair}"] for pair in pairs},
        mounting={},
        gimbal_lock=False,
    )
    if not mounted:
        return own
    try:
        mounting, gimbal_lock = _mounting(coefficients, uncertain)
    except EstimateError as error:
        return replace(own, left_handed=str(error))
    return replace(own, mounting=mounting, gimbal_lock=gimbal_lock)


def _mounting(coefficients: Coefficients, uncertain: UncertaintyInputs) -> tuple[dict[str, DerivedQuantity], bool]:
    """Return roll, pitch and yaw of R, degrees, and whether they are locked."""
    _, rotation = separated(_matrix(coefficients))
    angles = mounting_angles(rotation)
    turned = (angles.mounting.roll, angles.mounting.pitch, angles.mounting.yaw)

    def roll_pitch_yaw(moved: Coefficients) -> Array:
        around = mounting_angles(separated(_matrix(moved))[1]).mounting
        there = np.array([around.roll, around.pitch, around.yaw])
        return np.asarray(np.degrees(np.mod(there - turned + np.pi, 2 * np.pi) - np.pi))

    off = with_uncertainty(("roll", "pitch", "yaw"), roll_pitch_yaw, coefficients, uncertain)
    found = {
        name: replace(quantity, value=degrees(angle))
        for (name, quantity), angle in zip(off.items(), turned, strict=True)
    }
    if angles.gimbal_lock or is_locked(angles.mounting.pitch, radians(found["pitch"].u)):
        found |= {
            name: replace(found[name], u=degrees(UNKNOWN_ANGLE), factor=UNKNOWN_FACTOR) for name in ("roll", "yaw")
        }
        return found, True
    return found, False


def separated(matrix: Array) -> tuple[Array, Array]:
    """Return the RQ decomposition of a sensitivity matrix.

    Parameters
    ----------
    matrix : ndarray, shape (3, 3)

    Returns
    -------
    triangular : ndarray, shape (3, 3)
        Upper triangular, positive diagonal.
    rotation : ndarray, shape (3, 3)
        ``matrix = triangular @ rotation``.

    EstimateError: the matrix is singular, or its channels form a left-handed frame: no mounting does that.
    """
    # The QR decomposition of the rows in reverse order, read backwards.
    q, r = np.linalg.qr(matrix[::-1].T)
    sign = np.where(np.diag(r) < 0.0, -1.0, 1.0)
    rotation = np.asarray((q * sign).T[::-1])
    if abs(np.linalg.det(matrix)) == 0.0:
        raise EstimateError("the sensitivity matrix is singular: two channels measure the same axis")
    if np.linalg.det(rotation) < 0.0:
        raise EstimateError("the channels form a left-handed frame, which no mounting does: are they named right?")
    return np.triu(matrix @ rotation.T), rotation


def _matrix(coefficients: Coefficients) -> Array:
    """Return S with its columns in the order x, y, z."""
    return coefficients.sensitivity[:, [coefficients.axes.index(axis) for axis in AXES]]


def _nine(coefficients: Coefficients) -> Array:
    """Return the offsets, the lengths of the rows of S, and the angles between each two of them in degrees."""
    rows = _matrix(coefficients)
    first, second = rows[[0, 0, 1]], rows[[1, 2, 2]]
    sine = np.linalg.norm(np.cross(first, second), axis=1)
    angles = np.degrees(np.arctan2(sine, np.sum(first * second, axis=1)))
    return np.concatenate([coefficients.offset, np.linalg.norm(rows, axis=1), angles])
