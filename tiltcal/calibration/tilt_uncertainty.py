"""How uncertain the tilt is that a calibration gives, over its range and in degrees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from tiltcal.calibration.record import model_of
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.compensation import Compensation
from tiltcal.core.model import AXES, Array, Coefficients, Limits
from tiltcal.core.uncertain import TURN
from tiltcal.errors import EstimateError
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
    coefficients, uncertainty = replace(calibration.coefficients, mounting=None), calibration.uncertainty
    try:
        compensation = Compensation(coefficients)
        stated = (stated_uncertainty(uncertainty, coefficients, reading_noise=noise) for noise in (0.0, None))
        kernels = [CompensationWithUncertainty(compensation, coefficients, u.without(TURN)) for u, _ in stated]
    except EstimateError:
        return {}
    channels, model, nominal = coefficients.channels, model_of(calibration), None
    if model is not None and model.scaled:
        sheet = np.full(len(channels), model.offset), model.sensitivity * np.eye(len(channels))
        nominal = Compensation(Coefficients(channels, channels, *sheet), Limits())
    by_axis = {}
    for place, axis in enumerate(compensation.axes):
        low, high = np.degrees(calibration.limits.tilt.get(axis, (radians(-USUAL), radians(USUAL)))).tolist()
        tilt = np.linspace(max(low, -STEEPEST), min(high, STEEPEST), POINTS)
        gravity = np.zeros((POINTS, 3))
        gravity[:, AXES.index(axis)] = np.sin(np.radians(tilt))
        gravity[:, AXES.index("z" if axis != "z" else "x")] = np.cos(np.radians(tilt))
        readings = coefficients.predict(gravity)
        temperature = None if coefficients.thermal is None else np.full(POINTS, coefficients.thermal.reference)
        alone, reading = (kernel(readings, temperature).expanded[:, place] for kernel in kernels)
        before = None if nominal is None else nominal(readings).tilt[:, nominal.axes.index(axis)] - tilt
        by_axis[axis] = TiltUncertainty(tilt, before, alone, reading)
    return by_axis


def tilt_uncertainty_lines(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield by axis half the 95 % interval of a tilt near level and at the ends of its range, from the coefficients."""
    for axis, uncertain in tilt_uncertainty(calibration).items():
        tilt, half = uncertain.tilt, uncertain.alone
        level, low, high = half[np.argmin(np.abs(tilt))], half[0], half[-1]
        ends = f"{low:.2g}° at {tilt[0]:.0f}°, {high:.2g}° at {tilt[-1]:.0f}°"
        largest = float(np.nanmax(half))
        between = f", at most {largest:.2g}° between" if largest > 1.05 * max(level, low, high) else ""
        yield f"  tilt {axis} within  ± {level:.2g}° near level, {ends}{between}  (95 %)"
