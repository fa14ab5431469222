"""From measured positions to the mounting of a sensor that is calibrated already."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import degrees, inf, radians

import numpy as np

from tiltcal.calibration.estimate_record import rounded_covariance
from tiltcal.calibration.joint_fit import observations_of
from tiltcal.calibration.measurement import Measurement, missing_temperature
from tiltcal.core.compensation import Compensation
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
from tiltcal.core.uncertain import TURN, Uncertain, central_differences
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.results import CompletingRun, MountingFit
from tiltcal.files.uncertainty import Uncertainty, uncertain_coefficients


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
    known = uncertain_coefficients(base.uncertainty, coefficients).without(TURN)
    by = central_differences(
        lambda vector: seen(with_vector(coefficients, known.names, vector)).ravel(),
        vector_of(coefficients, known.names),
        known.u,
    )
    shared = np.einsum("ik,kl,il->i", by, known.covariance, by).reshape(len(sigma), 3).sum(axis=1) / 2.0
    return float(chdtrc(found.dof, np.sum(found.residuals**2 / (sigma**2 + shared))))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _joined(base: CalibrationRecord, found: MountingEstimate, rotation: Callable[[Coefficients], Array]) -> Uncertain:
    """Return the errors of the base's coefficients and of the turn of the mounting that was found with it."""
    coefficients = replace(base.coefficients, mounting=None)
    known = uncertain_coefficients(base.uncertainty, coefficients).without(TURN)
    start = rotation(coefficients)
    moved = central_differences(
        lambda vector: rotation_vector(rotation(with_vector(coefficients, known.names, vector)) @ start.T),
        vector_of(coefficients, known.names),
        known.u,
    )
    names = (*known.names, *(f"{TURN}{axis}" for axis in AXES))
    size = len(known.names)
    by_positions = Uncertain.errors(AXES, found.covariance, inf if found.stated else float(found.dof))
    follows = np.eye(size + 3)
    follows[size:, :size] = moved
    return known.beside(by_positions).through(follows, names)


def _uncertainty(
    before: Uncertainty, joint: Uncertain, mounting: Mounting, u: Mapping[str, float], *, locked: bool
) -> Uncertainty:
    """Return the base's uncertainty with the mounting's in it, degrees."""
    turn = joint.chosen(range(len(joint.names) - 3, len(joint.names)))
    angles = turn.through(angle_derivatives(mounting_matrix(mounting)), ANGLES)
    factors = angles.by_name(angles.factors) | (dict.fromkeys(("roll", "yaw"), UNKNOWN_FACTOR) if locked else {})
    return replace(
        before,
        standard={**before.without_mounting().standard, **{f"mounting.{angle}": value for angle, value in u.items()}},
        coverage_factor={name: round(k, 3) for name, k in joint.by_name(joint.factors).items()}
        | {f"mounting.{angle}": round(factors[angle], 3) for angle in u},
        covariance=rounded_covariance(joint),
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


def _rounded(found: MountingEstimate, joint: Uncertain) -> tuple[Mounting, dict[str, float]]:
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
