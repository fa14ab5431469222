"""How a calibrated sensor sits in its application, from its readings in known positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import degrees, inf, radians

import numpy as np

from tiltcal.calibration.estimate_record import rounded_covariance
from tiltcal.calibration.joint_fit import observations_of
from tiltcal.calibration.measurement import Measurement, missing_temperature
from tiltcal.core.attitude import (
    UNKNOWN_ANGLE,
    UNKNOWN_FACTOR,
    MountingEstimate,
    angle_derivatives,
    is_locked,
    mounting_matrix,
    mounting_rotation,
    rotation_vector,
    solve_mounting,
)
from tiltcal.core.compensation import Compensation
from tiltcal.core.estimation.positions import Observation
from tiltcal.core.model import AXES, Array, Coefficients, Mounting
from tiltcal.core.named_coefficients import vector_of, with_vector
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.uncertain import TURN, Uncertain, central_differences
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.results import CompletingRun, MountingFit
from tiltcal.files.uncertainty import uncertain_coefficients

TURNS = tuple(f"{TURN}{axis}" for axis in AXES)


def mount(
    base: CalibrationRecord, measurements: Sequence[Measurement], *, jig: float | None = None
) -> CalibrationRecord:
    """Return a calibration with the mounting that the positions show; all else is the base's, in its own frame.

    The gravity of the measurements is in the application's frame; ``jig`` is the standard uncertainty of a set angle,
    degrees. EstimateError: one direction of gravity alone, a sensor without x and y, or a temperature is missing and
    counts.
    """
    why = next(filter(None, (missing_temperature(base, measurement) for measurement in measurements)), "")
    if why:
        raise EstimateError(why)
    seen = observations_of(measurements, base.coefficients.channels)
    up, own = np.array([one.gravity for one in seen]), replace(base.coefficients, mounting=None)
    found, side, sigma = _solved(own, seen, up, jig)
    if sigma is not None and all(position.noise_unknown for position in seen) and found.chi_square > found.dof:
        # Nothing is stated of the noise, and the residuals show more than the jig.
        found, side, sigma = _solved(own, seen, up, None)

    start = mounting_rotation(_directions(own, seen, side), up, sigma)
    known = uncertain_coefficients(base.uncertainty, own).without(TURN)

    def errors(vector: Array) -> Array:
        """Return the directions and the turn that other coefficients would give, shape (3 positions + 3,)."""
        directions = _directions(with_vector(own, known.names, vector), seen, side)
        return np.concatenate([directions.ravel(), rotation_vector(mounting_rotation(directions, up, sigma) @ start.T)])

    slopes = central_differences(errors, vector_of(own, known.names), known.u)
    size = len(known.names)
    follows = np.eye(size + 3)
    follows[size:, :size] = slopes[-3:]
    positions = Uncertain.errors(TURNS, found.covariance, inf if found.stated else float(found.dof))
    joint = known.beside(positions).through(follows, (*known.names, *TURNS))
    p = None
    if sigma is not None and jig:
        from scipy.special import chdtrc

        of_base = np.einsum("ik,kl,il->i", slopes[:-3], known.covariance, slopes[:-3]).reshape(-1, 3).sum(axis=1) / 2.0
        p = significant(float(chdtrc(found.dof, np.sum(found.residuals**2 / (sigma**2 + of_base)))), 3)
    fit = MountingFit(
        residuals_degrees={
            one.position: round(degrees(float(r)), 4) for one, r in zip(seen, found.residuals, strict=True)
        },
        degrees_of_freedom=found.dof,
        uncertainty_from="stated jig" if found.stated else "residuals",
        chi_square=significant(found.chi_square, 4) if found.stated and jig else None,
        p_value=p,
    )
    completed = replace(
        base,
        fit=base.fit.replaced(mounting=fit),
        procedure=base.procedure.replaced(mounting=CompletingRun(positions=tuple(one.position for one in seen))),
        positions=base.positions_with(mounting=[m.record(list(m.summaries)).replaced(u=None) for m in measurements]),
    )
    return _with_angles(completed, found, joint)


def _with_angles(base: CalibrationRecord, found: MountingEstimate, joint: Uncertain) -> CalibrationRecord:
    """Return a calibration with the angles of a mounting, with the digits that their uncertainty warrants."""
    mounting, before, locked = found.mounting, base.uncertainty, True
    u: dict[str, float] = {}
    turns = joint.named(TURNS)
    factors = joint.by_name(joint.factors)
    if found.u is not None:
        angles = turns.through(angle_derivatives(mounting_matrix(mounting)), ANGLES)
        u = {name: degrees(value) for name, value in angles.by_name(angles.u).items()}
        locked = is_locked(mounting.pitch, float(angles.u[ANGLES.index("pitch")]))
        # Where roll and yaw cannot be separated their sum or difference is as well known as the pitch.
        digits = dict.fromkeys(ANGLES, u["pitch"]) if locked else u
        mounting = Mounting(
            **{name: radians(round_to(degrees(getattr(mounting, name)), digits[name])) for name in ANGLES}
        )
        factors |= {f"mounting.{name}": k for name, k in angles.by_name(angles.factors).items()}
        if locked:
            u |= dict.fromkeys(("roll", "yaw"), degrees(UNKNOWN_ANGLE))
            factors |= dict.fromkeys(("mounting.roll", "mounting.yaw"), UNKNOWN_FACTOR)
    stated = {f"mounting.{name}": significant(value, 4) for name, value in u.items()}
    return replace(
        base,
        coefficients=replace(base.coefficients, mounting=mounting),
        uncertainty=replace(
            before,
            standard={**before.without_mounting().standard, **stated},
            coverage_factor={name: round(k, 3) for name, k in factors.items()},
            covariance=rounded_covariance(joint),
        ),
        derived=base.derived.replaced(gimbal_lock=base.derived.gimbal_lock or locked),
    )


def _solved(
    coefficients: Coefficients, seen: Sequence[Observation], up: Array, jig: float | None
) -> tuple[MountingEstimate, float, Array | None]:
    """Return the mounting, the side of z, and the uncertainty of each direction that it was found with, radians.

    A sensor of two axes may hang upside down (side -1): the side whose residuals are smaller is taken.
    """
    candidates = []
    for side in (1.0,) if len(coefficients.channels) == 3 else (1.0, -1.0):
        start = _directions(coefficients, seen, side)
        sigma = None
        if jig is not None:
            noise = np.diag(np.ones(len(coefficients.channels)))[:, None] * [position.u for position in seen]
            moved = [_directions(coefficients, seen, side, shift) - start for shift in noise]
            square = np.sum(np.square(moved), axis=(0, 2)) / 2.0  # a direction has two angles
            sigma = np.maximum(np.hypot(radians(jig), np.sqrt(square)), 1e-6)
        candidates.append((solve_mounting(start, up, sigma), side, sigma))
    return min(candidates, key=lambda candidate: float(np.sum(candidate[0].residuals ** 2)))


def _directions(
    coefficients: Coefficients, seen: Sequence[Observation], side: float, shift: Array | float = 0.0
) -> Array:
    """Return up in the sensor's frame, unit vectors of shape (positions, 3), of readings that are shifted.

    The kernel takes the z that two channels do not see for up. Upside down (``side`` -1) that is -z: the z column is
    negated, so that the right coupling is taken out of x and y, and z is turned back.
    """
    if not {"x", "y"} <= set(coefficients.channels):
        raise EstimateError("the mounting is found from the x and y channels at least, and this sensor lacks one")
    sensitivity = coefficients.sensitivity * [side if axis == "z" else 1.0 for axis in coefficients.axes]
    compensation = Compensation(replace(coefficients, sensitivity=sensitivity, mounting=None))
    temperatures = np.array([position.temperature for position in seen], dtype=float)
    gravity = compensation(np.array([position.mean for position in seen]) + shift, temperatures).gravity
    if gravity.shape[1] == 2:
        rest = np.sqrt(np.maximum(1.0 - np.sum(gravity**2, axis=1), 0.0))
        gravity = np.column_stack([gravity, rest])
    return np.asarray(gravity * (1.0, 1.0, side) / np.linalg.norm(gravity, axis=1, keepdims=True))
