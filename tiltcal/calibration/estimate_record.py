"""The records of an estimate in a calibration file, with the digits that its uncertainty warrants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import degrees

import numpy as np

from tiltcal.core.derived_quantities import DerivedQuantity, cross_axis, derived, misalignment
from tiltcal.core.estimation.estimate import Estimate
from tiltcal.core.estimation.positions import Design
from tiltcal.core.intrinsic_parameters import intrinsic
from tiltcal.core.model import AXES, Array, Coefficients, with_vector
from tiltcal.core.named_coefficients import DeterminedCoefficients, values
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.uncertainty_budget import Budget
from tiltcal.core.uncertainty_inputs import UncertaintyInputs, with_turns_scaled
from tiltcal.files.results import (
    NOISE_ALONE,
    DerivedCoverage,
    DerivedRecord,
    DerivedUncertainty,
    FitRecord,
    IntrinsicCoverage,
    IntrinsicRecord,
    IntrinsicUncertainty,
    SuspectPosition,
    WorstResidual,
)
from tiltcal.files.uncertainty import Covariance, Uncertainty

DIGITS = 4
"""Of an uncertainty."""

MATRIX_DIGITS = 1e4
"""The covariance is rounded to this part of what four digits of its two uncertainties would be."""

SHARE_DIGITS = 3

PRIOR_DIGITS = 9
"""Of an uncertainty that is taken out of a difference again."""


def rounded(found: DeterminedCoefficients) -> Coefficients:
    """Return the coefficients with the digits that their uncertainties warrant."""
    coefficients, u = found.coefficients, found.uncertainty()
    digits = {name: round_to(value, u.get(name, 0.0)) for name, value in values(coefficients).items()}
    coefficients = with_vector(coefficients, list(digits), np.array(list(digits.values())))
    thermal = coefficients.thermal
    if thermal is None or thermal.range is None:
        return coefficients
    low, high = thermal.range
    return replace(coefficients, thermal=replace(thermal, range=(round(low, 3), round(high, 3))))


def uncertainty_of(found: DeterminedCoefficients, reading: Mapping[str, float]) -> Uncertainty:
    """Return the standard uncertainties of an estimate with their covariance and coverage factors.

    ``reading`` has those of a single reading by channel, unit, and of its temperature, °C, where they are known.
    """
    u = found.uncertainty()
    return Uncertainty(
        {name: significant(value, DIGITS) for name, value in u.items()},
        {name: significant(value, DIGITS) for name, value in reading.items()},
        {name: round(factor, 3) for name, factor in found.coverage_factors().items() if u[name] > 0.0},
        rounded_covariance(found.names, found.covariance),
    )


def rounded_covariance(names: Sequence[str], covariance: Array) -> Covariance:
    """Return the covariance of the uncertain coefficients, without the rounding errors that stand for zero.

    Turns of the mounting are in radians here, and in degrees in the record.
    """
    covariance = with_turns_scaled(names, covariance, degrees(1.0))
    u = np.sqrt(np.diag(covariance))
    some = np.flatnonzero(u > 0.0).tolist()
    return Covariance(
        parameters=tuple(names[i] for i in some),
        matrix=tuple(
            tuple(round_to(float(covariance[i, j]), float(u[i] * u[j]) / MATRIX_DIGITS) for j in some) for i in some
        ),
    )


def derived_record(found: DeterminedCoefficients, assumed: str, *, mounted: bool) -> DerivedRecord:
    """Return the cross-axis sensitivities, the misalignments, and what does not change with the mounting.

    Where the sensitivity was ``assumed`` (from what, in words), the record holds nothing but that.
    """
    if assumed:
        return DerivedRecord(assumed=(f"sensitivity: {assumed}",))
    coefficients = found.coefficients
    uncertain = UncertaintyInputs(found.names, found.covariance, found.budget.factors)
    crossed, u_crossed, k_crossed = _printed(derived(cross_axis, coefficients, uncertain))
    turned, u_turned, k_turned = _printed(derived(misalignment, coefficients, uncertain))
    whole = len(coefficients.channels) == 3 and set(coefficients.axes) == set(AXES)
    return DerivedRecord(
        cross_axis_percent=crossed,
        misalignment_degrees=turned,
        uncertainty=DerivedUncertainty(
            cross_axis_percent=u_crossed,
            misalignment_degrees=u_turned,
            coverage_factor=DerivedCoverage(cross_axis_percent=k_crossed, misalignment_degrees=k_turned),
        ),
        intrinsic=intrinsic_record(coefficients, uncertain, mounted=mounted) if whole else None,
    )


def fit_record(found: Estimate, design: Design, noise: float) -> FitRecord:
    """Return how well the positions agree, and where the uncertainty comes from.

    ``noise`` is the largest standard uncertainty of a reading, unit.
    """
    scale = max(noise, float(np.max(np.abs(found.residuals))))
    residuals = {
        position: {c: round_to(float(r), scale) for c, r in zip(design.channels, row, strict=True)}
        for position, row in zip(found.positions, found.residuals, strict=True)
    }
    record = FitRecord(
        residuals=residuals,
        worst=_worst(residuals) if found.dof else None,
        degrees_of_freedom=found.dof,
        uncertainty_from=_source_of_uncertainty(found, design),
        jig_degrees=None if design.free else design.jig,
        table_degrees=design.table,
        heading_degrees=design.heading or None,
        jig_estimated_degrees=None if found.estimated_jig is None else significant(found.estimated_jig, SHARE_DIGITS),
        thermometer_celsius=design.thermometer or None,
        thermometer_estimated_celsius=None
        if found.estimated_thermometer is None
        else significant(found.estimated_thermometer, SHARE_DIGITS),
        noise_estimated=None if found.estimated_noise is None else significant(found.estimated_noise, SHARE_DIGITS),
        budget=budget_record(found.budget, found.names),
        notes=tuple(found.notes),
        priors={}
        if design.assumes_sensitivity
        else {name: significant(prior.u, PRIOR_DIGITS) for name, prior in design.priors.items()},
        not_covered=found.not_covered,
    )
    if found.chi_square is None or found.p is None or not found.stated:
        return record
    return record.replaced(
        chi_square=significant(found.chi_square, 4),
        p_value=significant(found.p, SHARE_DIGITS),
        suspect_positions={
            attitude.position: SuspectPosition(
                off_degrees=significant(float(np.linalg.norm(attitude.turn)), SHARE_DIGITS),
                chi_square=significant(attitude.chi_square, SHARE_DIGITS),
            )
            for attitude in found.suspects()
        },
    )


def intrinsic_record(coefficients: Coefficients, uncertain: UncertaintyInputs, *, mounted: bool) -> IntrinsicRecord:
    """Return the nine intrinsic parameters and, where positions were set (``mounted``), the rotation that is left."""
    own = intrinsic(coefficients, uncertain, mounted=mounted)
    parts = {"offset": own.offset, "sensitivity": own.sensitivity, "angle_degrees": own.angle}
    if own.mounting:
        parts["rotation_degrees"] = own.mounting
    printed = {name: _printed(quantities) for name, quantities in parts.items()}
    return IntrinsicRecord(
        **{name: values for name, (values, _, _) in printed.items()},
        uncertainty=IntrinsicUncertainty(
            **{name: u for name, (_, u, _) in printed.items()},
            coverage_factor=IntrinsicCoverage(**{name: factors for name, (_, _, factors) in printed.items()}),
        ),
        gimbal_lock=own.gimbal_lock,
        left_handed=own.left_handed or None,
    )


def _printed(quantities: Mapping[str, DerivedQuantity]) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Return values, standard uncertainties and coverage factors, rounded; what is exact has no factor."""
    return (
        {name: round_to(quantity.value, quantity.u) for name, quantity in quantities.items()},
        {name: significant(quantity.u, DIGITS) for name, quantity in quantities.items()},
        {name: round(quantity.factor, 3) for name, quantity in quantities.items() if quantity.u > 0.0},
    )


def budget_record(budget: Budget, names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return which share of the variance of each of the first quantities of a budget comes from what.

    Shares that round to nothing are left out, and so is what is certain.
    """
    return {
        name: {
            source: share
            for source, column in budget.shares.items()
            if (share := round(float(column[k]), SHARE_DIGITS) + 0.0)
        }
        for k, name in enumerate(names)
        if budget.u[k] > 0.0
    }


def _source_of_uncertainty(found: Estimate, design: Design) -> str:
    if not found.stated:
        return "residuals"
    if design.free:
        return "noise alone: no position is left over"
    if design.jig is None:
        return NOISE_ALONE
    return "stated noise and jig" if found.estimated_noise is None else "stated jig, residuals for the noise"


def _worst(residuals: Mapping[str, Mapping[str, float]]) -> WorstResidual:
    """Return the largest residual; the rounded ones are compared, so that a tie falls alike on every processor."""
    position, channel = max(
        ((position, channel) for position, row in residuals.items() for channel in row),
        key=lambda place: abs(residuals[place[0]][place[1]]),
    )
    return WorstResidual(position=position, channel=channel, residual=residuals[position][channel])
