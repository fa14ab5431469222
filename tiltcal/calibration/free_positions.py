"""Calibration in free positions: the attitude of none is set, and gravity is 1 g in each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import acos, cos, degrees, radians

import numpy as np

from tiltcal.calibration.measurement import MeasuredSensor, Measurement
from tiltcal.core.coverage_factor import NORMAL_FACTOR
from tiltcal.core.estimation.ellipsoid import UNKNOWNS, count_distinct, fit_ellipsoid, misfits
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.rounding import significant
from tiltcal.core.statistics import SampleSummary
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import Procedure

UNCERTAIN, WORTHLESS = 10.0, 50.0
"""Expanded uncertainty of a coefficient above which it is warned of, and above which a recording that lacks a
direction is refused, mg."""

WORTHLESS_ANGLE = 500.0
"""The latter of a recording that lacks none, in which only the angle of two axes can be so uncertain."""

SKEW, UNEQUAL = 15.0, 1.5
"""Axes further from square, degrees, or sensitivities further apart, as a ratio, are those of no sensor."""

REACH = 45.0
"""A direction is missing where no attitude comes as near, degrees."""

UNDETERMINED = (
    "undetermined: gravity alone does not show how the sensor sits. The sensitivity is given in the frame whose z axis "
    "is the direction that channel z senses, and whose y axis lies in the plane of those of channels y and z"
)


def require_no_jig(procedure: Procedure, jig: float | None) -> None:
    """Refuse a stated jig where no position is set by one, with a UsageError."""
    if procedure.determines.free and jig is not None:
        raise UsageError("free positions use no jig: leave --jig out, or name a procedure whose positions are set")


def directed(sensors: Sequence[MeasuredSensor]) -> list[MeasuredSensor]:
    """Return the sensors of a fixture with the directions that their readings show, for the estimator to refine.

    The ellipsoid of the readings of one with three channels gives the directions for all. An EstimateError where no
    sensor has three, or the readings lie on no ellipsoid.
    """
    leader = next((sensor for sensor in sensors if set(AXES) <= set(sensor.sensor.channels)), None)
    if leader is None:
        raise EstimateError("free positions need a sensor of three channels: unit gravity does not determine fewer")
    seen = directions([measurement.summaries for measurement in leader.measurements]) @ np.array(leader.orientation)
    return [replace(sensor, measurements=_turned(sensor, seen)) for sensor in sensors]


def directions(positions: Sequence[Mapping[str, SampleSummary]]) -> Array:
    """Return a first estimate of the direction of gravity in each position, shape (positions, 3), from x, y and z.

    Unit vectors, in the frame in which the sensitivity matrix is upper triangular. An EstimateError where the readings
    are fewer than nine, or lie on no ellipsoid.
    """
    means = np.array([[summaries[channel].mean for channel in AXES] for summaries in positions])
    return fit_ellipsoid(means, np.zeros_like(means)).attitudes


def with_verdict(calibration: CalibrationRecord, measurements: Sequence[Measurement]) -> CalibrationRecord:
    """Add how well the length of gravity is met, what judges it, and what is undetermined.

    Of 728 simulated recordings with an expanded uncertainty below :data:`UNCERTAIN` none was off by more than twice
    that; above :data:`WORTHLESS` 57 % were. Where every axis was up and down, the intervals hold beyond that, too: 97 %
    of 324 between 50 and 1000 mg.

    Parameters
    ----------
    calibration : CalibrationRecord
        From unit gravity alone.
    measurements : sequence of Measurement
        Its positions, in the directions that were found.

    Raises
    ------
    EstimateError
        The coefficients are too uncertain to be of use, or are those of no sensor; the message names the directions
        that are missing.
    """
    coefficients = calibration.coefficients
    attitudes = np.array([measurement.gravity for measurement in measurements])
    distinct = count_distinct(attitudes)
    fit = calibration.fit.replaced(distinct_attitudes=distinct)
    if len(coefficients.channels) == len(coefficients.axes) == len(AXES):
        mean = np.array(
            [[measurement.summaries[channel].mean for channel in coefficients.channels] for measurement in measurements]
        )
        misfit = misfits(mean, coefficients.offset, coefficients.sensitivity)
        fit = fit.replaced(misfit_rms_mg=significant(1e3 * float(np.sqrt(np.mean(misfit**2))), 3))
    warnings = []
    if distinct <= UNKNOWNS:
        warnings.append(
            f"{distinct} different attitudes for {UNKNOWNS} unknowns: zero degrees of freedom are left to show whether "
            "the result is right; add attitudes, 12 to 18 or more"
        )
    worst, expanded = _worst(calibration)
    why, missing = _no_sensor(coefficients), _missing(attitudes)
    most = WORTHLESS if missing else WORTHLESS_ANGLE
    if why is None and expanded > most:
        why = f"{worst} has an expanded uncertainty of {expanded:.2g} mg, more than {most:g} mg"
    advice = _advice(worst, missing)
    if why is not None:
        raise EstimateError(f"the attitudes do not determine the sensor: {why}; {advice}")
    if expanded > UNCERTAIN:
        warnings.append(f"{worst} has an expanded uncertainty of {expanded:.2g} mg: {advice}")
    if warnings:
        fit = fit.replaced(warning="; ".join(warnings))
    return replace(calibration, derived=calibration.derived.replaced(mounting=UNDETERMINED), fit=fit)


def _worst(calibration: CalibrationRecord) -> tuple[str, float]:
    """Return the coefficient with the largest expanded uncertainty (95 %), and that in mg of the mean sensitivity."""
    coefficients, uncertainty = calibration.coefficients, calibration.uncertainty
    scale = float(np.mean(np.linalg.norm(coefficients.sensitivity, axis=1)))
    expanded = {
        name: 1e3 * u * uncertainty.coverage_factor.get(name, NORMAL_FACTOR) / scale
        for name, u in uncertainty.items()
        if name.startswith(("offset.", "sensitivity."))
    }
    worst = max(expanded, key=lambda name: expanded[name])
    return worst, expanded[worst]


def _no_sensor(coefficients: Coefficients) -> str | None:
    """Return why no sensor has these coefficients: axes are nearly square, and sensitivities nearly equal."""
    length = np.linalg.norm(coefficients.sensitivity, axis=1)
    if np.max(length) > UNEQUAL * np.min(length):
        return f"its sensitivities come out {np.max(length) / np.min(length):.1f} times apart"
    unit = coefficients.sensitivity / length[:, None]
    for (first, a), (second, b) in combinations(zip(coefficients.channels, unit, strict=True), 2):
        skew = abs(90.0 - degrees(acos(float(np.clip(a @ b, -1.0, 1.0)))))
        if skew > SKEW:
            return f"the axes {first} and {second} come out {skew:.0f}° from square"
    return None


def _missing(attitudes: Array) -> list[str]:
    """Return the directions that no attitude comes near, as a person holds the sensor."""
    return [
        f"{sign}{axis}"
        for axis, column in zip(AXES, attitudes.T, strict=True)
        for sign, highest in (("+", np.max(column)), ("-", -np.min(column)))
        if highest < cos(radians(REACH))
    ]


def _advice(worst: str, missing: Sequence[str]) -> str:
    """Return which attitudes to add."""
    if missing:
        return f"add attitudes in which {', '.join(missing)} points up"
    axes = worst.split(".")[1:]
    if len(set(axes)) > 1:
        return f"add attitudes between the axes {' and '.join(axes)}, with both about 45° up or down"
    return "hold it still for longer in each attitude, or in more of them"


def _turned(sensor: MeasuredSensor, directions: Array) -> list[Measurement]:
    """Return a sensor's positions in directions of the fixture's frame."""
    own = directions @ np.array(sensor.orientation).T
    return [
        replace(measurement, gravity=(x, y, z), tilt=None)
        for measurement, (x, y, z) in zip(sensor.measurements, own.tolist(), strict=True)
    ]
