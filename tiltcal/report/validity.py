"""The range of validity of a calibration, and what it does not cover."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees

from tiltcal.files.calibration import CalibrationRecord
from tiltcal.report.number_format import plain, signed
from tiltcal.report.provenance import Fact, notice

ALIKE = 2.0
"""Temperatures that are no further apart count as one, °C."""


def covered(calibration: CalibrationRecord) -> list[Fact]:
    """Return the ranges that the positions covered."""
    limits, unit = calibration.limits, calibration.sensor.unit
    thermal = calibration.coefficients.thermal
    found = [
        Fact(f"Tilt of {axis}", _range(round(degrees(low), 2), round(degrees(high), 2), "°"))
        for axis, (low, high) in limits.tilt.items()
    ]
    temperature = limits.temperature or (thermal.range if thermal else None)
    if temperature:
        found.append(Fact("Temperature", _range(*temperature, " °C")))
    if thermal:
        found.append(Fact("Reference temperature", f"{signed(f'{thermal.reference:g}')} °C"))
    rails = [f"{channel} {_range(low, high, ' ' + unit)}" for channel, (low, high) in limits.reading.items()]
    if rails:
        found.append(Fact("Readings between their rails", ", ".join(rails)))
    return found


def not_covered(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield what the calibration does not cover, in sentences."""
    coefficients, limits = calibration.coefficients, calibration.limits
    if notice(calibration.provenance):
        yield "Any real sensor: the readings are those of a virtual one."
    if limits.tilt:
        yield "Tilts beyond the ranges above; apply flags them."
    else:
        yield "The tilt: no range of tilts was covered."
    if coefficients.thermal is None:
        yield f"Temperature: its effect was not measured{_held(calibration)}."
    elif not coefficients.thermal.gain.any():
        yield "Drift of the sensitivity with temperature."
    if coefficients.nonlinearity is None:
        yield "Nonlinearity: each channel is assumed linear."
    if len(coefficients.axes) < 3:
        missing = " and ".join(axis for axis in ("x", "y", "z") if axis not in coefficients.axes)
        yield f"Sensitivity to {missing}: it was not measured and counts as zero."
    if coefficients.mounting is None:
        yield "The mounting in an application: tilt is that of the sensor’s own frame."
    if calibration.derived.assumed:
        yield "Assumed values, as noted above."
    if calibration.fit.jig_degrees is None and calibration.fit.uncertainty_from != "residuals":
        yield "The angles of the jig: none was stated, and they are not in the uncertainty."
    if not calibration.uncertainty.coverage_factor:
        yield "Intervals of 95 %: the file has no coverage factors."
    if not _closed(calibration):
        yield "A change of the sensor during the session: the first position was not visited again at its end."
    yield "Motion, vibration and ageing: all positions were measured at rest, on the dates above."


def _closed(calibration: CalibrationRecord) -> bool:
    """Return whether the last position was the first one again, at its temperature."""
    positions, attitudes = calibration.positions, calibration.procedure.set
    if len(positions) < 2 or not {positions[0].position, positions[-1].position} <= set(attitudes):
        return False
    first, last = positions[0], positions[-1]
    warmer = (last.temperature or 0.0) - (first.temperature or 0.0)
    return attitudes[first.position] == attitudes[last.position] and abs(warmer) <= ALIKE


def _held(calibration: CalibrationRecord) -> str:
    """Return the temperatures of the positions as text."""
    met = [position.temperature for position in calibration.positions if position.temperature is not None]
    if not met:
        return ""
    low, high = min(met), max(met)
    where = f"from {_range(low, high, ' °C')}" if high > low else f"at {plain(low, 4)} °C"
    return f", and all positions were {where}"


def _range(low: float, high: float, unit: str) -> str:
    return f"{signed(f'{low:.6g}')} to {signed(f'{high:.6g}')}{unit}"
