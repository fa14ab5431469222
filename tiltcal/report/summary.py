"""A calibration in a few lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import asin, degrees
from typing import Any

import numpy as np

from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES

INCREDIBLE = 1e-3
"""A chi-square of which so little is the probability is no chance."""

SHOWN = 3
"""Positions that are named."""


def summary(calibration: CalibrationRecord) -> str:
    """The coefficients with their standard uncertainties, and how well the positions fit."""
    return "\n".join(_lines(calibration))


def mounting_summary(calibration: CalibrationRecord) -> str:
    """How a sensor sits in its application, with standard uncertainties where they are known."""
    sensor, mounting = calibration.sensor, calibration.coefficients.mounting
    lines = [f"{sensor.model} {sensor.serial}  (± standard uncertainty, k = 1)"]
    for angle in ANGLES if mounting is not None else ():
        value, u = degrees(getattr(mounting, angle)), calibration.uncertainty.get("mounting", {}).get(angle)
        lines.append(f"  {angle:<6}{value:>12.6g}°" if u is None else f"  {angle:<6}{_pair(value, u)}°")
    if calibration.derived.get("gimbal_lock"):
        lines.append("  gimbal lock: at a pitch of ±90° only roll and yaw together are determined")
    return "\n".join(lines)


def _lines(calibration: CalibrationRecord) -> Iterator[str]:
    sensor, coefficients, u = calibration.sensor, calibration.coefficients, calibration.uncertainty
    yield f"{sensor.model} {sensor.serial}  (± standard uncertainty, k = 1)"
    for row, channel in enumerate(coefficients.channels):
        yield f"  offset {channel}          {_pair(coefficients.offset[row], u['offset'][channel])} {sensor.unit}"
    for row, channel in enumerate(coefficients.channels):
        for column, axis in enumerate(coefficients.axes):
            value = _pair(coefficients.sensitivity[row, column], u["sensitivity"][channel][axis])
            yield f"  sensitivity {channel}{axis}    {value} {sensor.unit}/g"
    if coefficients.nonlinearity is not None:
        for row, channel in enumerate(coefficients.channels):
            for power, value in enumerate(coefficients.nonlinearity[row], start=2):
                yield f"  non-linearity {channel}^{power} {_pair(value, u['nonlinearity'][channel][power - 2])}"
    thermal = coefficients.thermal
    if thermal is not None:
        for name, table, units in (("offset", thermal.drift, sensor.unit + "/"), ("sensitivity", thermal.gain, "1/")):
            for row, channel in enumerate(coefficients.channels):
                for power, value in enumerate(table[row], start=1):
                    told = _pair(value, u["temperature"][name][channel][power - 1])
                    yield f"  {name} {channel} over T   {told} {units}°C{'' if power == 1 else f'^{power}'}"
    fit = calibration.fit
    if "worst" in fit:
        worst = fit["worst"]
        own = float(np.max(np.abs(coefficients.sensitivity)))
        angle = degrees(asin(min(abs(worst["residual"]) / own, 1.0)))
        yield (
            f"  worst residual  {worst['position']}, channel {worst['channel']}: {worst['residual']:g} {sensor.unit} "
            f"({angle:.3f}° near level)"
        )
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
