"""From measured positions to the mounting of a sensor that is calibrated already."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import degrees, radians

import numpy as np

from tiltcal.calibration.estimate_record import rounded_covariance
from tiltcal.calibration.joint_fit import observations_of
from tiltcal.calibration.measurement import Measurement, missing_temperature
from tiltcal.core.compensation import Compensation
from tiltcal.core.coverage_factor import NORMAL_FACTOR, coverage_factor
from tiltcal.core.model import AXES, Array, Coefficients, Mounting, vector_of, with_vector
from tiltcal.core.mounting_angles import UNKNOWN_ANGLE, UNKNOWN_FACTOR, mounting_matrix
from tiltcal.core.mounting_rotation import (
    MountingEstimate,
    angle_derivatives,
    angle_uncertainty,
    mounting_rotation,
    rotation_vector,
    solve_mounting,
)
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.uncertainty_budget import central_differences
from tiltcal.core.uncertainty_inputs import TURN, UncertaintyInputs
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.results import CompletingRun, MountingFit
from tiltcal.files.uncertainty import Uncertainty, uncertainty_inputs


def mount(
    base: CalibrationRecord, measurements: Sequence[Measurement], *, jig: float | None = None
) -> CalibrationRecord:
    """Return a calibration with the mounting that the positions show; all else is the base's.

    Parameters
    ----------
    base : CalibrationRecord
        Of the same sensor, in its own frame.
    measurements : sequence of Measurement
        In positions whose gravity is given in the application's frame.
    jig : float, optional
        Standard uncertainty of a set angle, degrees.

    EstimateError: one direction of gravity alone, a sensor without x and y, or a temperature is missing and counts.
    """
    why = next(filter(None, (missing_temperature(base, measurement) for measurement in measurements)), "")
    if why:
        raise EstimateError(why)
    known = np.array([measurement.gravity for measurement in measurements])
    found, side, sigma = _best(base.coefficients, measurements, known, jig)
    seen = observations_of(measurements, base.coefficients.channels)
    if sigma is not None and all(position.noise_unknown for position in seen) and found.chi_square > found.dof:
        # Nothing is stated of the noise, and the residuals show more than the jig.
        found, side, sigma = _best(base.coefficients, measurements, known, None)
    p = None if sigma is None else _probability(base, found, lambda c: _unit(_directions(c, measurements, side)), sigma)
    joint = _joined(base, found, lambda c: mounting_rotation(_directions(c, measurements, side), known, sigma))
    mounting, u = _rounded(found, joint)
    locked = found.gimbal_lock or u.get("roll") == significant(degrees(UNKNOWN_ANGLE), 4)
    return replace(
        base,
        coefficients=replace(base.coefficients, mounting=mounting),
        uncertainty=_uncertainty(base.uncertainty, joint, mounting, u, locked=locked),
        derived=base.derived.replaced(gimbal_lock=base.derived.gimbal_lock or locked),
        fit=base.fit.replaced(mounting=_record(found, measurements, jig, p)),
        procedure=base.procedure.replaced(mounting=CompletingRun(positions=tuple(m.position for m in measurements))),
        positions=base.positions_with(mounting=[m.record(list(m.summaries)).replaced(u=None) for m in measurements]),
    )


def _best(
    coefficients: Coefficients, measurements: Sequence[Measurement], known: Array, jig: float | None
) -> tuple[MountingEstimate, float, Array | None]:
    """Return the mounting with the side of z and the uncertainty of each direction that it was found with, radians.

    A sensor of two axes may hang upside down (side -1): the side whose residuals are smaller is taken.
    """
    candidates = []
    for side in (1.0,) if len(coefficients.channels) == 3 else (1.0, -1.0):
        sigma = None if jig is None else _sigma(coefficients, measurements, side, jig)
        candidates.append((solve_mounting(_directions(coefficients, measurements, side), known, sigma), side, sigma))
    return min(candidates, key=lambda candidate: float(np.sum(candidate[0].residuals ** 2)))


def _sigma(coefficients: Coefficients, measurements: Sequence[Measurement], side: float, jig: float) -> Array:
    """Return the standard uncertainty of each direction, from the jig and the noise of its reading, radians."""
    start, square = _unit(_directions(coefficients, measurements, side)), np.zeros(len(measurements))
    noise = np.array([observation.u for observation in observations_of(measurements, coefficients.channels)])
    for k in range(len(coefficients.channels)):
        shift = noise * (np.arange(noise.shape[1]) == k)
        moved = _unit(_directions(coefficients, measurements, side, shift))
        square += np.sum((moved - start) ** 2, axis=1) / 2.0  # a direction has two angles
    return np.asarray(np.maximum(np.hypot(radians(jig), np.sqrt(square)), 1e-6))


def _probability(
    base: CalibrationRecord, found: MountingEstimate, seen: Callable[[Coefficients], Array], sigma: Array
) -> float:
    """Return the probability of so large a chi-square or a larger one, the uncertainty of the base among the causes.

    Parameters
    ----------
    seen : callable
        From coefficients to up in the sensor's frame in every position, shape (positions, 3).
    sigma : ndarray, shape (positions,)
        Of each direction, from the jig and the noise, radians.
    """
    from scipy.special import chdtrc

    coefficients = replace(base.coefficients, mounting=None)
    own = uncertainty_inputs(base.uncertainty, coefficients).without_turn
    by = central_differences(
        lambda vector: seen(with_vector(coefficients, own.names, vector)).ravel(),
        vector_of(coefficients, own.names),
        np.sqrt(np.diag(own.covariance)),
    )
    shared = np.einsum("ik,kl,il->i", by, own.covariance, by).reshape(len(sigma), 3).sum(axis=1) / 2.0
    return float(chdtrc(found.dof, np.sum(found.residuals**2 / (sigma**2 + shared))))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _joined(
    base: CalibrationRecord, found: MountingEstimate, rotation: Callable[[Coefficients], Array]
) -> UncertaintyInputs:
    """Return the base's coefficients and the turn of the mounting that was found with it, with their covariance."""
    coefficients = replace(base.coefficients, mounting=None)
    own = uncertainty_inputs(base.uncertainty, coefficients).without_turn
    names, covariance, factors = own.names, own.covariance, own.factors
    vector, u = vector_of(coefficients, names), np.sqrt(np.diag(covariance))
    moved = np.zeros((3, len(names)))
    for k in np.flatnonzero(u > 0.0):
        step = np.where(np.arange(len(names)) == k, u[k], 0.0)
        ends = [rotation(with_vector(coefficients, names, vector + side * step)) for side in (1.0, -1.0)]
        moved[:, k] = rotation_vector(ends[0] @ ends[1].T) / (2.0 * u[k])
    all_moved = np.vstack([np.eye(len(names)), moved])
    joint = all_moved @ covariance @ all_moved.T
    joint[-3:, -3:] += found.covariance
    stretched = all_moved @ (covariance * np.outer(factors, factors)) @ all_moved.T
    factor = NORMAL_FACTOR if found.stated else coverage_factor(np.array([float(found.dof)]))[0]
    wide = np.diag(stretched)[-3:] + factor**2 * np.diag(found.covariance)
    return UncertaintyInputs(
        (*names, *(f"{TURN}{axis}" for axis in AXES)),
        joint,
        np.concatenate([factors, np.sqrt(wide / np.diag(joint)[-3:])]),
    )


def _uncertainty(
    before: Uncertainty, joint: UncertaintyInputs, mounting: Mounting, u: Mapping[str, float], *, locked: bool
) -> Uncertainty:
    """Return the base's uncertainty with the mounting's in it, degrees."""
    own = before.without_mounting().standard
    turn, by = joint.covariance[-3:, -3:], angle_derivatives(mounting_matrix(mounting))
    wide = by @ (turn * np.outer(joint.factors[-3:], joint.factors[-3:])) @ by.T
    variances = np.diag(by @ turn @ by.T)
    wider = np.divide(np.diag(wide), variances, out=np.ones(3), where=variances > 0.0)
    factors = dict(zip(ANGLES, np.sqrt(wider).tolist(), strict=True))
    if locked:
        factors |= dict.fromkeys(("roll", "yaw"), UNKNOWN_FACTOR)
    return replace(
        before,
        standard={**own, **{f"mounting.{angle}": value for angle, value in u.items()}},
        coverage_factor={n: round(float(f), 3) for n, f in zip(joint.names, joint.factors, strict=True)}
        | {f"mounting.{angle}": round(factors[angle], 3) for angle in u},
        covariance=rounded_covariance(joint.names, joint.covariance),
    )


def _directions(
    coefficients: Coefficients, measurements: Sequence[Measurement], side: float, shift: Array | float = 0.0
) -> Array:
    """Return up in the sensor's frame in every position, as its calibration reads it, of readings that are shifted.

    The kernel takes the z that two channels do not see for up. Upside down (``side`` -1) that is -z: the z column is
    negated, so that the right coupling is taken out of x and y, and z is turned back.
    """
    if not {"x", "y"} <= set(coefficients.channels):
        raise EstimateError("the mounting is found from the x and y channels at least, and this sensor lacks one")
    seen = coefficients.sensitivity * [side if axis == "z" else 1.0 for axis in coefficients.axes]
    compensation = Compensation(replace(coefficients, sensitivity=seen, mounting=None))
    readings = np.array([[m.summaries[c].mean for c in coefficients.channels] for m in measurements])
    temperatures = np.array([np.nan if m.temperature is None else m.temperature for m in measurements])
    gravity = compensation(readings + shift, temperatures).gravity
    if gravity.shape[1] == 2:
        rest = np.sqrt(np.maximum(1.0 - np.sum(gravity**2, axis=1), 0.0))
        gravity = np.column_stack([gravity, rest])
    return gravity * (1.0, 1.0, side)


def _rounded(found: MountingEstimate, joint: UncertaintyInputs) -> tuple[Mounting, dict[str, float]]:
    """Return the angles with the digits that their uncertainty warrants, radians; and that, degrees."""
    if found.u is None:
        return found.mounting, {}
    known = angle_uncertainty(mounting_matrix(found.mounting), joint.covariance[-3:, -3:])
    u = {name: degrees(getattr(known, name)) for name in ANGLES}
    # Where roll and yaw cannot be separated their sum or difference is as well known as the pitch.
    digits = dict.fromkeys(ANGLES, min(u.values())) if known.roll == UNKNOWN_ANGLE else u
    angles = {name: radians(round_to(degrees(getattr(found.mounting, name)), digits[name])) for name in u}
    return Mounting(**angles), {name: significant(value, 4) for name, value in u.items()}


def _record(
    found: MountingEstimate, measurements: Sequence[Measurement], jig: float | None, p: float | None
) -> MountingFit:
    return MountingFit(
        residuals_degrees={
            m.position: round(degrees(float(r)), 4) for m, r in zip(measurements, found.residuals, strict=True)
        },
        degrees_of_freedom=found.dof,
        uncertainty_from="stated jig" if found.stated else "residuals",
        chi_square=significant(found.chi_square, 4) if found.stated and jig else None,
        p_value=None if p is None or not jig else significant(p, 3),
    )
