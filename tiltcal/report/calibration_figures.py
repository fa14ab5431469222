"""The figures of a calibration: the error of its tilt, its residuals, and its drift with temperature."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.calibration.tilt_uncertainty import USUAL, TiltUncertainty
from tiltcal.core.model import Array, Thermal, polynomial
from tiltcal.core.uncertain import NORMAL_FACTOR
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.report.figure import (
    BLUE,
    CHANNELS,
    GREY,
    INK,
    LEGEND,
    RED,
    THIN,
    SvgFigure,
    picture,
    write_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 81  # temperatures at which a drift is drawn


def tilt_figure(calibration: CalibrationRecord, curves: Mapping[str, TiltUncertainty]) -> SvgFigure | None:
    """Return the figure, with one axis tilted at a time; None if the file states no uncertainty."""
    if not curves:
        return None
    largest = max(float(np.nanmax(curve.alone)) for curve in curves.values())
    known = any(curve.before is not None for curve in curves.values())

    def plot(figure: Figure) -> None:
        *raw, calibrated = figure.subplots(1, 1 + known, squeeze=False).flat
        for axis, curve in curves.items():
            colour, _, line = CHANNELS[axis]
            for panel in raw:
                panel.plot(curve.tilt, curve.before, line, color=colour)
            calibrated.plot(curve.tilt, curve.alone, line, color=colour, label=f"tilt of {axis}")
            calibrated.plot(curve.tilt, curve.reading, line, color=colour, linewidth=THIN)
        for panel in raw:
            panel.axhline(0.0, color=INK)
            panel.set(xlabel="tilt [°]", ylabel="error, data sheet [°]")
        calibrated.set(xlabel="tilt [°]", ylabel="95 % interval, calibrated: ± [°]", ylim=(0.0, None))
        calibrated.legend(**LEGEND)

    sides = "Left: error of the tilt with the coefficients of the data sheet. Right: half" if known else "Half"
    return picture(
        "tilt",
        2.2,
        plot,
        title="Error of the tilt over its range",
        description=f"Tilt of {' and '.join(curves)}: half the 95 % interval of the calibrated tilt is at most "
        f"{largest:.2g}° over the range that is shown.",
        caption=f"{sides} the 95 % interval of the calibrated tilt at the reference temperature: thick from the "
        "coefficients alone, thin of one single reading with its noise. Each axis is tilted by itself."
        + ("" if known else f" There is no error before: no data sheet of a model {calibration.sensor.model} is known.")
        + ("" if calibration.limits.tilt else f" No range of tilts was covered: ±{USUAL:g}° is shown."),
    )


def residual_figure(calibration: CalibrationRecord) -> SvgFigure | None:
    """Return the residuals of every position, one panel per channel; None if the file has none."""
    residuals, coefficients, unit = calibration.fit.residuals, calibration.coefficients, calibration.sensor.fitted_unit
    positions = [name for name, row in residuals.items() if row]
    if not positions:
        return None

    def plot(figure: Figure) -> None:
        panels = figure.subplots(1, len(coefficients.channels), sharey=True, sharex=True, squeeze=False)
        for panel, channel in zip(panels.flat, coefficients.channels, strict=True):
            _plot_residuals_of(panel, calibration, positions, channel)

    worst = "; ".join(
        f"channel {channel}: none beyond {max(abs(row.get(channel, 0.0)) for row in residuals.values()):.3g}"
        for channel in coefficients.channels
    )
    return picture(
        "residuals",
        0.75 + 0.155 * len(positions),
        plot,
        title="Residuals of the positions",
        description=f"Measured minus modelled, in {unit} for {len(positions)} positions; {worst}.",
        caption="Residual of every position, measured minus modelled, with the position as it was set. Bars: ±1.96 "
        "standard uncertainties of the mean, from noise alone.",
    )


def _plot_residuals_of(panel: Axes, calibration: CalibrationRecord, positions: list[str], channel: str) -> None:
    residuals = calibration.fit.residuals
    # The first one where a name occurs twice: positions of a mounting come last and were not fitted.
    u = {one.position: (one.u or {}).get(channel, 0.0) for one in reversed(calibration.positions)}
    colour, mark, _ = CHANNELS[channel]
    panel.axvline(0.0, color=INK)
    for row, name in enumerate(positions):
        if (value := residuals[name].get(channel)) is not None:
            panel.hlines(row, 0.0, value, color=GREY, linewidth=THIN)
            panel.errorbar(value, row, xerr=NORMAL_FACTOR * u.get(name, 0.0), color=colour, marker=mark)
    panel.set_yticks(range(len(positions)), positions)
    panel.set_ylim(len(positions) - 0.4, -0.6)
    panel.set_xlabel(f"residual of {channel} [{calibration.sensor.fitted_unit}]")


def temperature_figure(calibration: CalibrationRecord) -> SvgFigure | None:
    """Return offset over temperature per channel, and the sensitivity drift if there is one; None without both."""
    coefficients, thermal = calibration.coefficients, calibration.coefficients.thermal
    if thermal is None:
        return None
    gains = bool(thermal.gain.any())
    low, high = calibration.limits.temperature or thermal.range or (thermal.reference - 10.0, thermal.reference + 10.0)
    t = np.linspace(low, high, POINTS)

    def plot(figure: Figure) -> None:
        panels = figure.subplots(1 + gains, len(coefficients.channels), sharex=True, squeeze=False)
        for column, channel in enumerate(coefficients.channels):
            offset = panels[0, column]
            curve = coefficients.offset[column] + polynomial(thermal.drift[column], t - thermal.reference)
            powers = [f"temperature.offset.{channel}.{k + 1}" for k in range(thermal.drift.shape[1])]
            half = _half_width(calibration, [f"offset.{channel}", *powers], t - thermal.reference, 0)
            _plot_curve(offset, t, curve, half, channel)
            _plot_positions(offset, calibration, thermal, column)
            offset.set_ylabel(f"offset of {channel} [{calibration.sensor.fitted_unit}]")
            if gains:
                gain = 100.0 * polynomial(thermal.gain[column], t - thermal.reference)
                names = [f"temperature.sensitivity.{channel}.{k + 1}" for k in range(thermal.gain.shape[1])]
                half = _half_width(calibration, names, t - thermal.reference, 1)
                _plot_curve(panels[1, column], t, gain, None if half is None else 100.0 * half, channel)
                panels[1, column].set_ylabel(f"sensitivity of {channel} [%]")
            panels[-1, column].set_xlabel("temperature [°C]")
        for panel in panels.flat:
            panel.axvline(thermal.reference, color=GREY, linestyle=":")
            panel.ticklabel_format(useOffset=False)

    return picture(
        "temperature",
        0.35 + 1.85 * (1 + gains),
        plot,
        title="Drift over temperature",
        description=f"Offset of {', '.join(coefficients.channels)} over temperature from {low:.3g} to {high:.3g} °C: "
        "the fitted polynomial with its 95 % band, and the measured positions.",
        caption="Drift with temperature. Line: the fitted polynomial; band: its 95 % interval; marks: the positions "
        "minus the modelled effect of their tilt, joined in the order of measurement. Dotted: the reference "
        "temperature.",
    )


def _plot_curve(panel: Axes, t: Array, curve: Array, half: Array | None, channel: str) -> None:
    if half is not None:
        panel.fill_between(t, curve - half, curve + half, color=CHANNELS[channel][0], alpha=0.18, linewidth=0)
    panel.plot(t, curve, color=CHANNELS[channel][0])


def _plot_positions(panel: Axes, calibration: CalibrationRecord, thermal: Thermal, column: int) -> None:
    """Plot the curve at the temperature of each position, plus its residual."""
    channel = calibration.coefficients.channels[column]
    fitted: dict[str, tuple[float, float]] = {}
    for record in calibration.positions:
        name, t = record.position, record.temperature
        residual = calibration.fit.residuals.get(name, {}).get(channel)
        if t is not None and residual is not None and name not in fitted:
            fitted[name] = t, residual
    if fitted:
        t, residual = np.array(list(fitted.values())).T
        curve = calibration.coefficients.offset[column] + polynomial(thermal.drift[column], t - thermal.reference)
        panel.plot(t, curve + residual, color=GREY, linewidth=THIN)
        panel.plot(t, curve + residual, CHANNELS[channel][1], color=CHANNELS[channel][0])


def _half_width(calibration: CalibrationRecord, names: list[str], dt: Array, lowest: int) -> Array | None:
    """Return half the 95 % interval of a polynomial from the power ``lowest``; None where no uncertainty is stated."""
    if any(name not in calibration.uncertainty for name in names):
        return None
    uncertain = calibration.uncertain.named(names)
    powers = np.array([dt ** (lowest + names.index(name)) for name in uncertain.names])
    curve = uncertain.through(powers.T.reshape(len(dt), -1), [""] * len(dt))
    return np.asarray(curve.factors * curve.u)


def draw_tilt_error(
    path: Path, time: Array, temperature: Array, before: Mapping[str, Array], after: Mapping[str, Array], title: str
) -> None:
    """Write the errors along a log with known true tilt as SVG: seconds, °C, and tilt errors by axis in degrees."""

    def plot(figure: Figure) -> None:
        panels = figure.subplots(len(before) + 1, 1, sharex=True, height_ratios=[*([2.0] * len(before)), 1.0])
        *errors, below = panels
        for panel, axis in zip(errors, before, strict=True):
            panel.axhline(0.0, color=INK)
            panel.plot(time / 60, before[axis], color=RED, label="data sheet's coefficients")
            panel.plot(time / 60, after[axis], color=BLUE, label="calibrated")
            panel.set_ylabel(f"error of {axis} tilt [°]")
            panel.legend(**LEGEND)
        figure.suptitle(title)
        below.plot(time / 60, temperature, color=GREY)
        below.set(ylabel="T [°C]", xlabel="time [min]")

    write_figure(path, 2.0 + 1.7 * len(before), plot)
