"""What a calibration file states of an estimate, rounded to its uncertainty, and the errors that follow from it."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, radians
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.angle_uncertainty import length_half_width
from tiltcal.core.attitude import UNKNOWN_FACTOR
from tiltcal.core.compensation import LENGTH_TOLERANCE
from tiltcal.core.derived import cross_axis, intrinsic, misalignment, rotation
from tiltcal.core.model import AXES, Array, Coefficients, values, with_vector
from tiltcal.core.rounding import outwards, round_to, significant
from tiltcal.core.uncertain import ALIGNMENT, NEGLIGIBLE, NORMAL_FACTOR, READING, TURN, Uncertain
from tiltcal.errors import EstimateError
from tiltcal.files import results
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import TURNS, Covariance, Uncertainty

if TYPE_CHECKING:
    from tiltcal.core.estimation.estimate import Estimate
    from tiltcal.core.estimation.positions import Design

DIGITS = 4  # significant digits of an uncertainty
TEMPERATURE_DIGITS = 3  # decimals of the ends of a range, °C
MATRIX_DIGITS = 1e4  # the covariance is rounded to this part of what four digits of its two uncertainties would be
SHARE_DIGITS = 3  # significant digits of a share of a variance
PRIOR_DIGITS = 9  # digits of a prior's u, kept because it is subtracted later


def stated_uncertainty(
    record: CalibrationRecord, *, reading_noise: float | None = None
) -> tuple[Uncertain, tuple[str, ...]]:
    """Return all errors that make an angle uncertain, and remarks; ``reading_noise``, unit, in place of the file's."""
    known, uncertainty, coefficients = record.uncertain, record.uncertainty, record.coefficients
    if not known.names:
        raise EstimateError(
            "the file states no uncertainty of any coefficient: calibrate with `tiltcal measure` or `tiltcal fit`, "
            "which write it, or write standard uncertainties (k = 1) under `uncertainty`, in the shape of `calibration`"
        )
    remarks = []
    if uncertainty.covariance is None:
        remarks.append("the file has no covariance: the coefficients count as uncorrelated")
    silent = [name for name in values(coefficients) if name not in uncertainty and name not in known.names]
    if silent:
        remarks.append(f"no uncertainty is stated of {', '.join(silent)}: they count as exact")
    if coefficients.mounting is not None and not known.named(TURNS).names:
        remarks.append("no uncertainty is stated of the mounting: it counts as exact")
    reading = dict(uncertainty.single_reading)
    if reading_noise is not None:
        reading |= dict.fromkeys(coefficients.channels, reading_noise)
    elif not any(channel in reading for channel in coefficients.channels):
        remarks.append(
            "the file has no uncertainty of a reading: only that of the calibration counts (state --reading-noise)"
        )
    u = [*reading.values(), radians(uncertainty.alignment)]
    other = Uncertain.errors((*(READING + name for name in reading), ALIGNMENT), np.diag(np.array(u) ** 2))
    return known.beside(other), tuple(remarks)


def length_tolerance(record: CalibrationRecord) -> float:
    """Return by how much the length of gravity of three axes may differ from 1 g before a row is suspect."""
    if len(record.coefficients.channels) < 3 or not record.uncertain.names:
        return LENGTH_TOLERANCE
    stated, _ = stated_uncertainty(record)
    return max(LENGTH_TOLERANCE, length_half_width(record.coefficients, record.limits, stated))


def rounded(found: Estimate) -> Coefficients:
    """Return the coefficients with the digits that their uncertainties warrant."""
    coefficients, u = found.coefficients, found.uncertainty()
    digits = {name: round_to(value, u.get(name, 0.0)) for name, value in values(coefficients).items()}
    coefficients = with_vector(coefficients, list(digits), np.array(list(digits.values())))
    thermal = coefficients.thermal
    if thermal is None or thermal.range is None:
        return coefficients
    return replace(coefficients, thermal=replace(thermal, range=outwards(*thermal.range, TEMPERATURE_DIGITS)))


def stated_section(uncertain: Uncertain, before: Uncertainty | None = None) -> Uncertainty:
    """Return uncertain coefficients as a file states them, in place of what it stated ``before`` of the same."""
    before, u = before or Uncertainty(), uncertain.by_name(uncertain.u)
    shown = {name: significant(value, DIGITS) for name, value in u.items() if not name.startswith(TURN)}
    factors = {name: round(k, 3) for name, k in uncertain.by_name(uncertain.factors).items() if u[name] > 0.0}
    return replace(
        before,
        standard={**shown, **{name: value for name, value in before.items() if name not in shown}},
        coverage_factor={**factors, **{n: k for n, k in before.coverage_factor.items() if n not in factors}},
        covariance=rounded_covariance(uncertain),
    )


def rounded_covariance(uncertain: Uncertain) -> Covariance:
    """Return the covariance of what is uncertain, without the rounding errors that stand for zero."""
    known = uncertain.chosen(np.flatnonzero(uncertain.u > 0.0))
    scale = np.array([degrees(1.0) if name.startswith(TURN) else 1.0 for name in known.names])  # as files have turns

    def printed(covariance: Array) -> tuple[tuple[float, ...], ...]:
        table = covariance * np.outer(scale, scale)
        u = np.sqrt(np.diag(table))
        steps = (np.outer(u, u) / MATRIX_DIGITS).tolist()
        return tuple(tuple(map(round_to, row, step)) for row, step in zip(table.tolist(), steps, strict=True))

    # Few degrees of freedom widen the intervals of some quantities, and not of all alike.
    wider = bool(len(known.names) and np.ptp(known.factors) > NEGLIGIBLE * NORMAL_FACTOR)
    wide = printed(known.wide) if wider else ()
    return Covariance(parameters=known.names, matrix=printed(known.covariance), wide=wide)


def derived_record(found: Estimate, assumed: str, *, mounted: bool) -> results.DerivedRecord:
    """Return cross-axis sensitivities, misalignments and what no mounting changes; nothing where S was ``assumed``."""
    if assumed:
        return results.DerivedRecord(assumed=(f"sensitivity: {assumed}",))
    coefficients, uncertain = found.coefficients, found.uncertain
    crossed, u_crossed, k_crossed = _printed(cross_axis(coefficients, uncertain))
    turned, u_turned, k_turned = _printed(misalignment(coefficients, uncertain))
    whole = len(coefficients.channels) == 3 and set(coefficients.axes) == set(AXES)
    return results.DerivedRecord(
        cross_axis_percent=crossed,
        misalignment_degrees=turned,
        uncertainty=results.DerivedUncertainty(
            cross_axis_percent=u_crossed,
            misalignment_degrees=u_turned,
            coverage_factor=results.DerivedCoverage(cross_axis_percent=k_crossed, misalignment_degrees=k_turned),
        ),
        intrinsic=intrinsic_record(coefficients, uncertain, mounted=mounted) if whole else None,
    )


def fit_record(found: Estimate, design: Design, noise: float) -> results.FitRecord:
    """Return how well the positions agree, and where the uncertainty comes from; ``noise`` is the largest u, unit."""

    def shown(estimated: float | None) -> float | None:
        return None if estimated is None else significant(estimated, SHARE_DIGITS)

    scale = max(noise, float(np.max(np.abs(found.residuals))))
    residuals = {
        position: {c: round_to(float(r), scale) for c, r in zip(design.channels, row, strict=True)}
        for position, row in zip(found.positions, found.residuals, strict=True)
    }
    # The rounded ones are compared, so that a tie falls alike on every processor.
    places = [(position, channel) for position, row in residuals.items() for channel in row]
    position, channel = max(places, key=lambda place: abs(residuals[place[0]][place[1]]))
    worst = results.WorstResidual(position=position, channel=channel, residual=residuals[position][channel])
    source = "stated noise and jig" if found.estimated_noise is None else "stated jig, residuals for the noise"
    if not found.stated:
        source = "residuals"
    elif design.free:
        source = "noise alone: no position is left over"
    elif design.jig is None:
        source = results.NOISE_ALONE
    all_stated = found.stated and found.estimated_noise is None
    judged = found.chi_square is not None and found.p is not None and all_stated
    return results.FitRecord(
        residuals=residuals,
        worst=worst if found.dof else None,
        degrees_of_freedom=found.dof,
        uncertainty_from=source,
        jig_degrees=None if design.free else design.jig,
        table_lean_degrees=design.table_lean,
        heading_degrees=design.heading or None,
        jig_estimated_degrees=shown(found.estimated_jig),
        thermometer_celsius=design.thermometer or None,
        thermometer_estimated_celsius=shown(found.estimated_thermometer),
        noise_estimated=shown(found.estimated_noise),
        budget=budget_record(found.uncertain),
        notes=tuple(found.notes),
        priors={}
        if design.assumes_sensitivity
        else {name: significant(prior.u, PRIOR_DIGITS) for name, prior in design.priors.items()},
        not_covered=found.not_covered,
        chi_square=significant(found.chi_square or 0.0, 4) if judged else None,
        p_value=shown(found.p) if judged else None,
        suspect_positions={
            attitude.position: results.SuspectPosition(
                off_degrees=significant(attitude.off, SHARE_DIGITS),
                chi_square=significant(attitude.chi_square, SHARE_DIGITS),
            )
            for attitude in (found.suspects if judged else ())
        },
    )


def intrinsic_record(coefficients: Coefficients, uncertain: Uncertain, *, mounted: bool) -> results.IntrinsicRecord:
    """Return the nine intrinsic parameters and, where positions were set (``mounted``), the rotation that is left."""
    tables, gimbal_lock, left_handed = list(_printed(intrinsic(coefficients, uncertain))), False, None
    if mounted:
        try:
            turned, gimbal_lock = rotation(coefficients, uncertain)
            tables = [{**table, **more} for table, more in zip(tables, _printed(turned), strict=True)]
        except EstimateError as failure:
            left_handed = str(failure)
    if gimbal_lock:
        tables[2] |= {f"rotation_degrees.{angle}": round(UNKNOWN_FACTOR, 3) for angle in ("roll", "yaw")}
    by_kind: list[dict[str, dict[str, float]]] = [{}, {}, {}]
    for kinds, table in zip(by_kind, tables, strict=True):
        for name, number in table.items():
            kind, _, rest = name.partition(".")
            kinds.setdefault(kind, {})[rest] = number
    shown, u, factors = by_kind
    return results.IntrinsicRecord(
        **shown,
        uncertainty=results.IntrinsicUncertainty(**u, coverage_factor=results.IntrinsicCoverage(**factors)),
        gimbal_lock=gimbal_lock,
        left_handed=left_handed,
    )


def _printed(found: Uncertain) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Return values, standard uncertainties and coverage factors, rounded; what is exact has no factor."""
    value, u = found.by_name(found.value), found.by_name(found.u)
    return (
        {name: round_to(number, u[name]) for name, number in value.items()},
        {name: significant(number, DIGITS) for name, number in u.items()},
        {name: round(factor, 3) for name, factor in found.by_name(found.factors).items() if u[name] > 0.0},
    )


def budget_record(uncertain: Uncertain) -> dict[str, dict[str, float]]:
    """Return which share of the variance of each quantity comes from what, but what rounds to nothing."""
    table = {source: np.round(column, SHARE_DIGITS).tolist() for source, column in uncertain.shares.items()}
    return {
        name: {source: column[k] for source, column in table.items() if column[k]}
        for k, name in enumerate(uncertain.names)
        if uncertain.u[k] > 0.0
    }
