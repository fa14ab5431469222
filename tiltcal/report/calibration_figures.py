"""The figures of a calibration: the error of its tilt, its residuals, and its drift with temperature."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import degrees
from operator import mul
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.calibration.tilt_uncertainty import USUAL, TiltUncertainty
from tiltcal.core.model import Array, Thermal, polynomial
from tiltcal.core.uncertain import NORMAL_FACTOR
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.report.figure import BLUE, CHANNELS, GREY, INK, RED, SvgFigure, picture, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 81
"""Temperatures at which a drift is drawn."""


def tilt_figure(calibration: CalibrationRecord, curves: Mapping[str, TiltUncertainty]) -> SvgFigure | None:
    """Return the figure, with one axis tilted at a time; None if the file states no uncertainty."""
    if not curves:
        return None
    largest = max(float(np.nanmax(curve.alone)) for curve in curves.values())
    known = any(curve.before is not None for curve in curves.values())
    sides = "Left: error of the tilt with the coefficients of the data sheet. Right: half" if known else "Half"
    return picture(
        "tilt",
        2.2,
        partial(_plot_tilt, curves=curves),
        title="Error of the tilt over its range",
        description=f"Tilt of {' and '.join(curves)}: half the 95 % interval of the calibrated tilt is at most "
        f"{largest:.2g}° over the range that is shown.",
        caption=f"{sides} the 95 % interval of the calibrated tilt at the reference temperature: thick from the "
        "coefficients alone, thin of one single reading with its noise. Each axis is tilted by itself."
        + ("" if calibration.limits.tilt else f" No range of tilts was covered: ±{USUAL:g}° is shown."),
    )


def _plot_tilt(figure: Figure, curves: Mapping[str, TiltUncertainty]) -> None:
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


def residual_figure(calibration: CalibrationRecord) -> SvgFigure | None:
    """Return the residuals of every position, one panel per channel; None if the file has none."""
    residuals = calibration.fit.residuals
    positions = [name for name, row in residuals.items() if row]
    if not positions:
        return None
    channels = calibration.coefficients.channels
    worst = {
        channel: max((abs(residuals[name].get(channel, 0.0)) for name in positions), default=0.0)
        for channel in channels
    }
    largest = "; ".join(f"channel {channel}: none beyond {value:.3g}" for channel, value in worst.items())
    return picture(
        "residuals",
        0.75 + 0.155 * len(positions),
        partial(_plot_residuals, calibration=calibration, positions=positions),
        title="Residuals of the positions",
        description=f"Measured minus modelled, in {calibration.sensor.unit} for {len(positions)} positions; {largest}.",
        caption="Residual of every position, measured minus modelled, with the position as it was set. Bars: ±1.96 "
        "standard uncertainties of the mean, from noise alone. Above: the residual as an angle near level.",
    )


def _plot_residuals(figure: Figure, calibration: CalibrationRecord, positions: list[str]) -> None:
    coefficients = calibration.coefficients
    panels = figure.subplots(1, len(coefficients.channels), sharey=True, sharex=True, squeeze=False)[0]
    for panel, channel in zip(panels, coefficients.channels, strict=True):
        _plot_residuals_of(panel, calibration, positions, channel)
    first = panels[0]
    first.set_yticks(range(len(positions)), positions)
    first.set_ylim(len(positions) - 0.4, -0.6)
    for label, name in zip(first.get_yticklabels(), positions, strict=True):
        if name in calibration.fit.suspect_positions:
            label.set_color(RED)
            label.set_fontweight("bold")


def _plot_residuals_of(panel: Axes, calibration: CalibrationRecord, positions: list[str], channel: str) -> None:
    residuals, uncertainties = calibration.fit.residuals, _uncertainties(calibration, channel)
    colour, mark, _ = CHANNELS[channel]
    panel.axvline(0.0, color=INK, linewidth=0.6)
    held = [
        (row, residuals[name][channel], NORMAL_FACTOR * uncertainties.get(name, 0.0))
        for row, name in enumerate(positions)
        if residuals[name].get(channel) is not None
    ]
    if held:
        rows, values, bars = zip(*held, strict=True)
        panel.hlines(rows, 0.0, values, color=GREY, linewidth=0.4)
        panel.errorbar(
            values, rows, xerr=bars, color=colour, marker=mark, markersize=3.2, linewidth=0.8, linestyle="none"
        )
    panel.set_xlabel(f"residual of {channel} [{calibration.sensor.unit}]")
    panel.tick_params(axis="y", length=0)
    panel.spines["left"].set_visible(False)
    _angle_above(panel, calibration, channel)


def _angle_above(panel: Axes, calibration: CalibrationRecord, channel: str) -> None:
    """Draw a second scale: the residual as an angle near level."""
    from matplotlib.ticker import MaxNLocator

    coefficients = calibration.coefficients
    if channel not in coefficients.axes:
        return
    per_unit = degrees(1.0 / coefficients.own_sensitivity(channel))
    above = panel.secondary_xaxis("top", functions=(partial(mul, per_unit), partial(mul, 1.0 / per_unit)))
    above.spines["top"].set_visible(True)
    above.spines["top"].set_linewidth(0.4)
    above.tick_params(labelsize=7, width=0.4)
    above.set_xlabel("as an angle [°]", fontsize=7)
    above.xaxis.set_major_locator(MaxNLocator(5))


def _uncertainties(calibration: CalibrationRecord, channel: str) -> dict[str, float]:
    """Return the standard uncertainty of the mean by position; the first one if a name occurs twice."""
    found: dict[str, float] = {}
    for record in calibration.positions:
        u = (record.u or {}).get(channel)
        if u is not None:
            found.setdefault(record.position, u)
    return found


def temperature_figure(calibration: CalibrationRecord) -> SvgFigure | None:
    """Return offset over temperature per channel, and the sensitivity drift if there is one; None without both."""
    thermal = calibration.coefficients.thermal
    if thermal is None:
        return None
    rows = 1 + bool(thermal.gain.any())
    low, high = _temperatures(calibration, thermal)
    channels = ", ".join(calibration.coefficients.channels)
    return picture(
        "temperature",
        0.35 + 1.85 * rows,
        partial(_plot_drift, calibration=calibration, thermal=thermal),
        title="Drift over temperature",
        description=f"Offset of {channels} over temperature from {low:.3g} to {high:.3g} °C: the fitted polynomial "
        "with its 95 % band, and the measured positions.",
        caption="Drift with temperature. Line: the fitted polynomial; band: its 95 % interval; marks: the positions "
        "minus the modelled effect of their tilt, joined in the order of measurement. Dotted: the reference "
        "temperature.",
    )


def _plot_drift(figure: Figure, calibration: CalibrationRecord, thermal: Thermal) -> None:
    coefficients = calibration.coefficients
    gains = bool(thermal.gain.any())
    panels = figure.subplots(1 + gains, len(coefficients.channels), sharex=True, squeeze=False)
    t = np.linspace(*_temperatures(calibration, thermal), POINTS)
    for column, channel in enumerate(coefficients.channels):
        curve = coefficients.offset[column] + polynomial(thermal.drift[column], t - thermal.reference)
        names = [f"offset.{channel}", *(f"temperature.offset.{channel}.{k + 1}" for k in range(thermal.drift.shape[1]))]
        powers = np.vander(t - thermal.reference, len(names), increasing=True)
        _curve(panels[0, column], t, curve, _half_width(calibration, names, powers), channel)
        _plot_positions(panels[0, column], calibration, thermal, column)
        panels[0, column].set_ylabel(f"offset of {channel} [{calibration.sensor.unit}]")
        if gains:
            gain = polynomial(thermal.gain[column], t - thermal.reference)
            names = [f"temperature.sensitivity.{channel}.{k + 1}" for k in range(thermal.gain.shape[1])]
            powers = np.vander(t - thermal.reference, len(names) + 1, increasing=True)[:, 1:]
            half = _half_width(calibration, names, powers)
            _curve(panels[1, column], t, 100.0 * gain, None if half is None else 100.0 * half, channel)
            panels[1, column].set_ylabel(f"sensitivity of {channel} [%]")
        panels[-1, column].set_xlabel("temperature [°C]")
        for panel in panels[:, column]:
            panel.axvline(thermal.reference, color=GREY, linewidth=0.6, linestyle=":")
            panel.ticklabel_format(useOffset=False)


def _curve(panel: Axes, t: Array, curve: Array, half: Array | None, channel: str) -> None:
    colour = CHANNELS[channel][0]
    if half is not None:
        panel.fill_between(t, curve - half, curve + half, color=colour, alpha=0.18, linewidth=0)
    panel.plot(t, curve, color=colour, linewidth=1.1)


def _plot_positions(panel: Axes, calibration: CalibrationRecord, thermal: Thermal, column: int) -> None:
    """Plot the curve at the temperature of each position, plus its residual."""
    channel = calibration.coefficients.channels[column]
    fitted: dict[str, tuple[float, float]] = {}
    for record in calibration.positions:
        name, t = record.position, record.temperature
        residual = calibration.fit.residuals.get(name, {}).get(channel)
        if t is not None and residual is not None and name not in fitted:
            fitted[name] = t, residual
    if not fitted:
        return
    t, residual = np.array(list(fitted.values())).T
    at = calibration.coefficients.offset[column] + polynomial(thermal.drift[column], t - thermal.reference) + residual
    panel.plot(t, at, color=GREY, linewidth=0.4)
    panel.plot(t, at, CHANNELS[channel][1], color=CHANNELS[channel][0], markersize=3.2)


def _half_width(calibration: CalibrationRecord, names: list[str], powers: Array) -> Array | None:
    """Return half the 95 % interval of a polynomial; None if the file has no uncertainty of it."""
    covariance = calibration.uncertainty.covariance
    if covariance is None or any(name not in calibration.uncertainty for name in names):
        return None
    own, matrix, parameters = np.zeros((len(names), len(names))), np.array(covariance.matrix), covariance.parameters
    known = [(i, parameters.index(name)) for i, name in enumerate(names) if name in parameters]
    for i, row in known:
        for j, other in known:
            own[i, j] = matrix[row, other]
    factors = calibration.uncertainty.coverage_factor
    factor = max((factors[name] for name in names if name in factors), default=NORMAL_FACTOR)
    return np.asarray(factor * np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", powers, own, powers), 0.0)))


def _temperatures(calibration: CalibrationRecord, thermal: Thermal) -> tuple[float, float]:
    """Return the covered temperatures, or a range around the reference."""
    covered = calibration.limits.temperature or thermal.range
    return covered if covered else (thermal.reference - 10.0, thermal.reference + 10.0)


def draw_tilt_error(
    path: Path, time: Array, temperature: Array, before: Mapping[str, Array], after: Mapping[str, Array], title: str
) -> None:
    """Write the errors along a log with known true tilt as SVG: seconds, °C, and tilt errors by axis in degrees."""

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
