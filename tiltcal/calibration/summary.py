"""A calibration in a few lines of text: coefficients with their standard uncertainties, and how well the data fit."""

from __future__ import annotations

from collections.abc import Iterator
from math import asin, degrees

import numpy as np

from tiltcal.core.named_coefficients import values
from tiltcal.core.rounding import plus_minus
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.fit_record import FitRecord, MountingFit

INCREDIBLE = 1e-3
"""Probability of a chi-square below which it is not credible."""

NOT_FOLLOWED = (
    "was not seen to follow when the sensor was tipped: a dead converter reads so; look at it with tiltcal probe"
)
"""What a note says of a channel that showed at most two neighbouring values in a whole session."""

SHOWN = 3
"""Positions that are named."""


def summary(calibration: CalibrationRecord, *, notes: bool = True) -> str:
    """Return all coefficients with their standard uncertainties, how well the positions fit, and the notes."""
    lines = [*_lines(calibration), *mounting_lines(calibration)]
    return "\n".join(lines + [f"  {note}" for note in calibration.fit.notes if notes])


def mounting_summary(calibration: CalibrationRecord) -> str:
    """Return how a sensor sits in its application, with standard uncertainties where they are known."""
    sensor = calibration.sensor
    lines = [f"{sensor.model} {sensor.serial}  (± standard uncertainty, k = 1)", *mounting_lines(calibration)]
    fit = calibration.fit.mounting
    if fit is not None and fit.residuals_degrees:
        worst = max(fit.residuals_degrees, key=lambda name: fit.residuals_degrees[name])
        lines.append(f"  worst residual  {worst}: {fit.residuals_degrees[worst]:.3g}°")
        chi_square = "" if fit.chi_square is None else f", chi-square {fit.chi_square:g}"
        lines.append(
            f"  degrees of freedom {fit.degrees_of_freedom}, uncertainty from {fit.uncertainty_from}{chi_square}"
        )
        lines += [f"  {objection}" for objection in _objections_to_mounting(fit)]
    return "\n".join(lines)


def mounting_lines(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield the angles of the mounting, degrees; none where the sensor's frame is the application's."""
    mounting = calibration.coefficients.mounting
    for angle in ANGLES if mounting is not None else ():
        value, u = degrees(getattr(mounting, angle)), calibration.uncertainty.get(f"mounting.{angle}")
        yield f"  {angle:<6}{value:>12.6g}°" if u is None else f"  {angle:<6}{_pair(value, u)}°"
    if calibration.derived.gimbal_lock:
        yield "  gimbal lock: at a pitch of ±90° only roll and yaw together are determined"


def _lines(calibration: CalibrationRecord) -> Iterator[str]:
    sensor, coefficients, u = calibration.sensor, calibration.coefficients, calibration.uncertainty
    yield f"{sensor.model} {sensor.serial}  (± standard uncertainty, k = 1)"
    for name, value in values(coefficients).items():
        match name.split("."):
            case ["offset", channel]:
                label, unit = f"offset {channel}         ", f" {sensor.unit}"
            case ["sensitivity", channel, axis]:
                label, unit = f"sensitivity {channel}{axis}   ", f" {sensor.unit}/g"
            case ["nonlinearity", channel, power]:
                label, unit = f"nonlinearity {channel}^{power}", ""
            case [_, what, channel, power]:
                label = f"{what} {channel} over T  "
                unit = f" {sensor.unit if what == 'offset' else '1'}/°C{'' if power == '1' else f'^{power}'}"
        yield f"  {label} {_pair(value, u[name]) if name in u else f'{value:>12.6g}'}{unit}"
    if coefficients.thermal is not None and coefficients.thermal.lag:
        yield f"  thermal lag       {_pair(coefficients.thermal.lag, u.get('temperature.lag', 0.0))} s"
    yield from _fit_lines(calibration)


def _fit_lines(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield how well the positions agree."""
    fit, sensor, worst = calibration.fit, calibration.sensor, calibration.fit.worst
    if worst is not None:
        own = float(np.max(np.abs(calibration.coefficients.sensitivity)))
        angle = degrees(asin(min(abs(worst.residual) / own, 1.0)))
        yield (
            f"  worst residual  {worst.position}, channel {worst.channel}: {worst.residual:g} {sensor.unit} "
            f"({angle:.3f}° near level)"
        )
    if fit.degrees_of_freedom is not None:
        origin = f", uncertainty from {fit.uncertainty_from}" if fit.uncertainty_from else ""
        chi_square = "" if fit.chi_square is None else f", chi-square {fit.chi_square:g}"
        yield f"  degrees of freedom {fit.degrees_of_freedom}{origin}{chi_square}"
    yield from (f"  {objection}" for objection in objections(fit))
    if fit.jig_estimated_degrees is not None:
        yield f"  the residuals correspond to a jig of {fit.jig_estimated_degrees:g}°"


def objections(fit: FitRecord) -> list[str]:
    """Return what speaks against a fit, or against what was stated of its bench; empty where nothing does."""
    found = []
    p = _probability(fit)
    if p is not None and p < INCREDIBLE:
        shown, warm = "below 1e-9" if p < 1e-9 else f"{p:.1g}", fit.thermometer_estimated_celsius
        cause = "noise, jig or thermometer are worse than stated, and the uncertainties are too small"
        if warm is not None:
            cause = f"temperatures are off by {warm:g} °C, which counts, or noise or jig are worse than stated"
        if fit.noise_estimated is not None:
            cause = f"the means have noise of {fit.noise_estimated:g}, which counts, or the jig is worse than stated"
        found.append(
            f"chi-square {fit.chi_square:g} with {fit.degrees_of_freedom} degrees of freedom (probability {shown}) is "
            f"not credible: {cause}"
        )
    if fit.suspect_positions:
        named = [f"{position} ({suspect.off_degrees:g}°)" for position, suspect in fit.suspect_positions.items()]
        more = f" and {len(named) - SHOWN} more" if len(named) > SHOWN else ""
        found.append(f"further off than the stated jig allows, the worst first: {', '.join(named[:SHOWN])}{more}")
    found += [note for note in fit.notes if NOT_FOLLOWED in note]
    return found + _objections_to_mounting(fit.mounting)


def _objections_to_mounting(fit: MountingFit | None) -> list[str]:
    if fit is None or fit.p_value is None or fit.p_value >= INCREDIBLE:
        return []
    return [
        f"mounting: chi-square {fit.chi_square:g} with {fit.degrees_of_freedom} degrees of freedom is not credible: "
        "the jig is worse than stated, a position was not the one that is named, or a sensor of two axes stands on edge"
    ]


def _probability(fit: FitRecord) -> float | None:
    """Return the probability of so large a chi-square or a larger one; None where the file has none."""
    if fit.chi_square is None or not fit.degrees_of_freedom:
        return None
    if fit.p_value is not None:
        return fit.p_value
    from scipy.special import chdtrc

    return float(chdtrc(fit.degrees_of_freedom, fit.chi_square))


def _pair(value: float, u: float) -> str:
    number, _, uncertainty = plus_minus(value, u).partition(" ")
    return f"{number:>12} {uncertainty}"
