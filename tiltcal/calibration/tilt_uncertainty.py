"""How uncertain the tilt is that a calibration gives, over its range and in degrees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import degrees, radians

import numpy as np

from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Array, Coefficients, Limits
from tiltcal.core.uncertain import TURN
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.uncertainty import stated_uncertainty

POINTS = 121
"""Tilts of an axis at which the uncertainty is calculated."""

STEEPEST = 80.0
"""Largest tilt, degrees; beyond it the uncertainty of the arcsine grows without limit."""

USUAL = 30.0
"""Range where the calibration covers none, degrees."""


@dataclass(frozen=True)
class TiltUncertainty:
    """The uncertainty of the tilt of one axis while the others are level, shape (n,), degrees.

    before: error with the data sheet's coefficients; None where they are not known.
    alone, reading: half the 95 % interval from the coefficients alone, and with the noise of one reading.
    """

    tilt: Array
    before: Array | None
    alone: Array
    reading: Array


def tilt_uncertainty(calibration: CalibrationRecord) -> dict[str, TiltUncertainty]:
    """Return the uncertainty by axis, in the sensor's frame; empty where the file states none of its coefficients."""
    coefficients, nominal = replace(calibration.coefficients, mounting=None), _nominal(calibration)
    try:
        compensation = Compensation(coefficients)
        stated = (
            stated_uncertainty(calibration.uncertainty, coefficients, reading_noise=noise) for noise in (0.0, None)
        )
        kernels = [CompensationWithUncertainty(compensation, coefficients, u.without(TURN)) for u, _ in stated]
    except EstimateError:
        return {}
    by_axis = {}
    for axis, tilt in _ranges(calibration, compensation.axes).items():
        readings = coefficients.predict(_attitudes(axis, tilt))
        temperature = None if coefficients.thermal is None else np.full(len(tilt), coefficients.thermal.reference)
        place = compensation.axes.index(axis)
        alone, reading = (kernel(readings, temperature).expanded[:, place] for kernel in kernels)
        before = None if nominal is None else nominal(readings).tilt[:, nominal.axes.index(axis)] - tilt
        by_axis[axis] = TiltUncertainty(tilt, before, alone, reading)
    return by_axis


def _ranges(calibration: CalibrationRecord, axes: Sequence[str]) -> dict[str, Array]:
    """Return the tilts of each reported axis over the covered range, degrees."""
    by_axis = {}
    for axis in axes:
        low, high = calibration.limits.tilt.get(axis, (radians(-USUAL), radians(USUAL)))
        by_axis[axis] = np.linspace(max(degrees(low), -STEEPEST), min(degrees(high), STEEPEST), POINTS)
    return by_axis


def _attitudes(axis: str, tilt: Array) -> Array:
    """Return gravity with one axis tilted and the rest along z, or along x for the z axis; shape (n, 3)."""
    other = "z" if axis != "z" else "x"
    gravity = np.zeros((len(tilt), 3))
    gravity[:, "xyz".index(axis)] = np.sin(np.radians(tilt))
    gravity[:, "xyz".index(other)] = np.cos(np.radians(tilt))
    return gravity


def _nominal(calibration: CalibrationRecord) -> Compensation | None:
    """Return the tilt with the coefficients of the data sheet; None if model or scale are unknown."""
    from tiltcal.drivers import find_model

    sensor, coefficients = calibration.sensor, calibration.coefficients
    try:
        model = find_model(sensor.model)
    except UsageError:
        return None
    if model.unit != sensor.unit or not model.scaled:
        return None
    channels = coefficients.channels
    nominal = Coefficients(
        channels, channels, np.full(len(channels), model.offset), model.sensitivity * np.eye(len(channels))
    )
    return Compensation(nominal, Limits())


def tilt_uncertainty_lines(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield by axis half the 95 % interval of a tilt near level and at the ends of its range, from the coefficients."""
    for axis, uncertain in tilt_uncertainty(calibration).items():
        tilt, half = uncertain.tilt, uncertain.alone
        level, low, high = half[np.argmin(np.abs(tilt))], half[0], half[-1]
        ends = f"{low:.2g}° at {tilt[0]:.0f}°, {high:.2g}° at {tilt[-1]:.0f}°"
        yield f"  tilt {axis} within  ± {level:.2g}° near level, {ends}  (95 %)"
