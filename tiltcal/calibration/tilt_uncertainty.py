"""How uncertain the tilts of a calibration are, over its range."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from tiltcal.calibration.record import model_of
from tiltcal.calibration.stated import stated_uncertainty
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.compensation import Compensation
from tiltcal.core.model import AXES, Array, Coefficients, Limits
from tiltcal.core.uncertain import TURN, Uncertain
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord

POINTS = 121  # tilts of an axis at which the uncertainty is calculated
STEEPEST = 80.0  # largest tilt, degrees; beyond it the uncertainty of the arcsine grows without limit
USUAL = 30.0  # range where the calibration covers none, degrees


@dataclass(frozen=True)
class TiltUncertainty:
    """The uncertainty of the tilt of one axis while the others are level, shape (n,), degrees."""

    tilt: Array
    before: Array | None  # error with the data sheet's coefficients; None where they are not known
    # Half the 95 % interval, from the coefficients alone and with the noise of one reading:
    alone: Array
    reading: Array


def tilt_uncertainty(calibration: CalibrationRecord) -> dict[str, TiltUncertainty]:
    """Return the uncertainty by axis, in the sensor's frame; empty where the file states none of its coefficients."""
    coefficients = replace(calibration.coefficients, mounting=None)
    alone, reading = (stated_half_widths(calibration, noise) for noise in (0.0, None))
    channels, model, nominal = coefficients.channels, model_of(calibration), None
    if alone and model is not None and model.scaled:
        angles, size = coefficients.angles, model.sensitivity
        size = size if angles is None else angles.per_degree(size)
        sheet = np.full(len(channels), model.offset), size * np.eye(len(channels))
        nominal = Compensation(Coefficients(channels, channels, *sheet, angles=angles), Limits())
    by_axis = {}
    for axis, (tilt, half) in alone.items():
        readings = coefficients.predict(_tilted(axis, tilt))
        before = None if nominal is None else nominal(readings).tilt[:, nominal.axes.index(axis)] - tilt
        by_axis[axis] = TiltUncertainty(tilt, before, half, reading[axis][1])
    return by_axis


def stated_half_widths(calibration: CalibrationRecord, noise: float | None = 0.0) -> dict[str, tuple[Array, Array]]:
    """Return :func:`half_widths` of a calibration, with a noise of one reading, unit; empty where the file has none."""
    try:
        stated, _ = stated_uncertainty(calibration, reading_noise=noise)
        return half_widths(replace(calibration.coefficients, mounting=None), stated.without(TURN), calibration.limits)
    except EstimateError:
        return {}


def half_widths(coefficients: Coefficients, uncertain: Uncertain, limits: Limits) -> dict[str, tuple[Array, Array]]:
    """Return by axis tilts over its range and half the 95 % interval of each, shape (n,), degrees."""
    compensation = Compensation(coefficients)
    kernel = CompensationWithUncertainty(compensation, coefficients, uncertain)
    temperature = None if coefficients.thermal is None else np.full(POINTS, coefficients.thermal.reference)
    found = {}
    for place, axis in enumerate(compensation.axes):
        low, high = np.degrees(limits.tilt.get(axis, (radians(-USUAL), radians(USUAL)))).tolist()
        tilt = np.linspace(max(low, -STEEPEST), min(high, STEEPEST), POINTS)
        _, (_, expanded) = kernel(coefficients.predict(_tilted(axis, tilt)), temperature)
        found[axis] = tilt, expanded[place]
    return found


def _tilted(axis: str, tilt: Array) -> Array:
    """Return up where one axis is tilted, degrees, and the others are level, shape (n, 3)."""
    gravity = np.zeros((len(tilt), 3))
    gravity[:, AXES.index(axis)] = np.sin(np.radians(tilt))
    gravity[:, AXES.index("z" if axis != "z" else "x")] = np.cos(np.radians(tilt))
    return gravity


def tilt_lines(by_axis: Mapping[str, tuple[Array, Array]]) -> Iterator[str]:
    """Yield by axis half the 95 % interval of a tilt near level and at the ends of its range, degrees."""
    for axis, (tilt, half) in by_axis.items():
        level, low, high = half[np.argmin(np.abs(tilt))], half[0], half[-1]
        ends = f"{low:.2g}° at {tilt[0]:.0f}°, {high:.2g}° at {tilt[-1]:.0f}°"
        largest = float(np.nanmax(half))
        between = f", at most {largest:.2g}° between" if largest > 1.05 * max(level, low, high) else ""
        yield f"  tilt {axis} within  ± {level:.2g}° near level, {ends}{between}  (95 %)"
