"""The tilt error with the coefficients of the data sheet and after calibration: over its range, and along a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import degrees, radians
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Array, Coefficients, Limits
from tiltcal.core.uncertain import TURN
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.uncertainty import stated_uncertainty
from tiltcal.report.figure import BLUE, CHANNELS, GREY, INK, RED, SvgFigure, picture, write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POINTS = 121
STEEPEST = 80.0
"""Largest tilt of the figure, degrees; beyond it the uncertainty of the arcsine grows without limit."""

USUAL = 30.0
"""Range of the figure if the calibration covers none, degrees."""


@dataclass(frozen=True)
class Curves:
    """The curves of one axis, shape (n,), degrees.

    before: error with the data sheet's coefficients; None where they are not known.
    alone, reading: half the 95 % interval from the coefficients alone, and with the noise of one reading.
    """

    tilt: Array
    before: Array | None
    alone: Array
    reading: Array


def tilt_figure(calibration: CalibrationRecord) -> SvgFigure | None:
    """Return the figure, with one axis tilted at a time; None if the file states no uncertainty."""
    try:
        curves = _curves(calibration)
    except EstimateError:
        return None
    largest = max(float(np.nanmax(curve.alone)) for curve in curves.values())
    known = any(curve.before is not None for curve in curves.values())
    sides = "Left: error of the tilt with the coefficients of the data sheet. Right: half" if known else "Half"
    return picture(
        "tilt",
        2.2,
        partial(_plot, curves=curves),
        title="Error of the tilt over its range",
        description=f"Tilt of {' and '.join(curves)}: half the 95 % interval of the calibrated tilt is at most "
        f"{largest:.2g}° over the range that is shown.",
        caption=f"{sides} the 95 % interval of the calibrated tilt at the reference temperature: thick from the "
        "coefficients alone, thin of one single reading with its noise. Each axis is tilted by itself."
        + ("" if calibration.limits.tilt else f" No range of tilts was covered: ±{USUAL:g}° is shown."),
    )


def _plot(figure: Figure, curves: dict[str, Curves]) -> None:
    known = any(curve.before is not None for curve in curves.values())
    panels = figure.subplots(1, 1 + known, squeeze=False)[0]
    for axis, curve in curves.items():
        colour, _, line = CHANNELS[axis]
        if curve.before is not None:
            panels[0].plot(curve.tilt, curve.before, line, color=colour, linewidth=1.1)
        panels[-1].plot(curve.tilt, curve.alone, line, color=colour, linewidth=1.3, label=f"tilt of {axis}")
        panels[-1].plot(curve.tilt, curve.reading, line, color=colour, linewidth=0.5)
    if known:
        panels[0].axhline(0.0, color=INK, linewidth=0.6)
        panels[0].set_ylabel("error, data sheet [°]")
    panels[-1].set_ylabel("95 % interval, calibrated: ± [°]")
    panels[-1].set_ylim(bottom=0.0)
    panels[-1].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)
    for panel in panels:
        panel.axvline(0.0, color=GREY, linewidth=0.4, linestyle=":")
        panel.set_xlabel("tilt [°]")
        panel.margins(x=0.01)


def _curves(calibration: CalibrationRecord) -> dict[str, Curves]:
    """Return the curves by axis; raise EstimateError if the file has no uncertainty of the coefficients."""
    coefficients, nominal = _unmounted(calibration.coefficients), _nominal(calibration)
    compensation = Compensation(coefficients)
    stated = (stated_uncertainty(calibration.uncertainty, coefficients, reading_noise=noise) for noise in (0.0, None))
    kernels = [CompensationWithUncertainty(compensation, coefficients, u.without(TURN)) for u, _ in stated]
    found = {}
    for axis, tilt in _reaches(calibration, compensation.axes).items():
        readings = coefficients.predict(_attitudes(axis, tilt))
        temperature = None if coefficients.thermal is None else np.full(len(tilt), coefficients.thermal.reference)
        place = compensation.axes.index(axis)
        alone, reading = (kernel(readings, temperature).expanded[:, place] for kernel in kernels)
        before = None if nominal is None else nominal(readings).tilt[:, nominal.axes.index(axis)] - tilt
        found[axis] = Curves(tilt, before, alone, reading)
    return found


def _reaches(calibration: CalibrationRecord, axes: Sequence[str]) -> dict[str, Array]:
    """Return the tilts of each reported axis over the covered range, degrees."""
    found = {}
    for axis in axes:
        low, high = calibration.limits.tilt.get(axis, (radians(-USUAL), radians(USUAL)))
        found[axis] = np.linspace(max(degrees(low), -STEEPEST), min(degrees(high), STEEPEST), POINTS)
    return found


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
    plain = replace(
        _unmounted(coefficients),
        axes=channels,
        offset=np.full(len(channels), model.offset),
        sensitivity=model.sensitivity * np.eye(len(channels)),
        thermal=None,
        nonlinearity=None,
    )
    return Compensation(plain, Limits())


def _unmounted(coefficients: Coefficients) -> Coefficients:
    """Return the coefficients in the sensor frame, to which the range of tilts refers."""
    return replace(coefficients, mounting=None)


def draw_tilt_error(
    path: Path, time: Array, temperature: Array, before: Mapping[str, Array], after: Mapping[str, Array], title: str
) -> None:
    """Write the errors along a log with known true tilt as SVG.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Seconds.
    temperature : ndarray, shape (n,)
        °C.
    before, after : mapping of str to ndarray, shape (n,)
        Tilt error per axis, degrees.
    """

    def plot(figure: Figure) -> None:
        panels = figure.subplots(len(before) + 1, 1, sharex=True, height_ratios=[*([2.0] * len(before)), 1.0])
        for panel, axis in zip(panels, before, strict=False):
            panel.axhline(0.0, color="black", linewidth=0.6)
            panel.plot(time / 60, before[axis], color=RED, linewidth=0.9, label="data sheet's coefficients")
            panel.plot(time / 60, after[axis], color=BLUE, linewidth=0.9, label="calibrated")
            panel.set_ylabel(f"error of {axis} tilt [°]")
        figure.suptitle(title, x=0.08, ha="left", fontsize=11)
        panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.1)
        panels[-1].plot(time / 60, temperature, color=GREY, linewidth=1.2)
        panels[-1].set_ylabel("T [°C]")
        panels[-1].set_xlabel("time [min]")
        for panel in panels:
            panel.margins(x=0.01)

    write_figure(path, (8.0, 2.0 + 1.7 * len(before)), plot)
