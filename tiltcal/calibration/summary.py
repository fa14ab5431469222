"""A calibration in a few lines of text: coefficients with their standard uncertainties, and how well the data fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import asin, degrees
from typing import Any

import numpy as np

from tiltcal.core.comparison import values
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.uncertainty import named_uncertainties

INCREDIBLE = 1e-3
"""A chi-square of which so little is the probability is no chance."""

SHOWN = 3
"""Positions that are named."""


def summary(calibration: CalibrationRecord) -> str:
    """The coefficients with their standard uncertainties, and how well the positions fit."""
    return "\n".join(_lines(calibration))


def mounting_summary(calibration: CalibrationRecord) -> str:
    """How a sensor sits in its application, with standard uncertainties where they are known."""
    sensor = calibration.sensor
    return "\n".join([f"{sensor.model} {sensor.serial}  (± standard uncertainty, k = 1)", *mounting_lines(calibration)])


def mounting_lines(calibration: CalibrationRecord) -> Iterator[str]:
    """The angles of the mounting, degrees; none where the sensor's frame is the application's."""
    mounting = calibration.coefficients.mounting
    for angle in ANGLES if mounting is not None else ():
        value, u = degrees(getattr(mounting, angle)), calibration.uncertainty.get("mounting", {}).get(angle)
        yield f"  {angle:<6}{value:>12.6g}°" if u is None else f"  {angle:<6}{_pair(value, u)}°"
    if calibration.derived.get("gimbal_lock"):
        yield "  gimbal lock: at a pitch of ±90° only roll and yaw together are determined"


def _lines(calibration: CalibrationRecord) -> Iterator[str]:
    sensor, coefficients = calibration.sensor, calibration.coefficients
    u = dict(named_uncertainties(calibration.uncertainty))
    yield f"{sensor.model} {sensor.serial}  (± standard uncertainty, k = 1)"
    for name, value in values(coefficients).items():
        match name.split("."):
            case ["offset", channel]:
                label, unit = f"offset {channel}         ", f" {sensor.unit}"
            case ["sensitivity", channel, axis]:
                label, unit = f"sensitivity {channel}{axis}   ", f" {sensor.unit}/g"
            case ["nonlinearity", channel, power]:
                label, unit = f"non-linearity {channel}^{power}", ""
            case [_, what, channel, power]:
                label = f"{what} {channel} over T  "
                unit = f" {sensor.unit if what == 'offset' else '1'}/°C{'' if power == '1' else f'^{power}'}"
        yield f"  {label} {_pair(value, u[name]) if name in u else f'{value:>12.6g}'}{unit}"
    yield from _fit_lines(calibration)


def _fit_lines(calibration: CalibrationRecord) -> Iterator[str]:
    """How well the positions agree."""
    fit, sensor = calibration.fit, calibration.sensor
    if "worst" in fit:
        worst = fit["worst"]
        own = float(np.max(np.abs(calibration.coefficients.sensitivity)))
        angle = degrees(asin(min(abs(worst["residual"]) / own, 1.0)))
        yield (
            f"  worst residual  {worst['position']}, channel {worst['channel']}: {worst['residual']:g} {sensor.unit} "
            f"({angle:.3f}° near level)"
        )
    if "degrees_of_freedom" in fit:
        yield f"  degrees of freedom {fit['degrees_of_freedom']}, uncertainty from {fit['uncertainty_from']}" + (
            f", chi-square {fit['chi_square']:g}" if "chi_square" in fit else ""
        )
    yield from _doubts(fit)


def _doubts(fit: Mapping[str, Any]) -> Iterator[str]:
    """What speaks against the fit, or against what was stated of the bench."""
    if fit.get("p_value", 1.0) < INCREDIBLE:
        yield "  that much is not credible: noise, jig or thermometer are worse than stated, and so is the uncertainty"
    suspects = fit.get("suspect_positions", {})
    if suspects:
        told = [f"{position} ({one['off_degrees']:g}°)" for position, one in suspects.items()]
        more = f" and {len(told) - SHOWN} more" if len(told) > SHOWN else ""
        yield f"  further off than the jig should be, the worst first: {', '.join(told[:SHOWN])}{more}"
    if "jig_estimated_degrees" in fit:
        yield f"  the positions scatter as with a jig of {fit['jig_estimated_degrees']:g}°"
    yield from (f"  {note}" for note in fit.get("notes", ()))


def _pair(value: float, u: float) -> str:
    return f"{value:>12.6g} ± {u:.2g}"
