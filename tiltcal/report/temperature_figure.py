"""The figure of the temperature drift: the fitted curve with its band, and the positions."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.model import Array, Thermal, polynomial
from tiltcal.core.uncertain import NORMAL_FACTOR
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.report.figure import CHANNELS, GREY, SvgFigure, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 81


def temperature_figure(calibration: CalibrationRecord) -> SvgFigure | None:
    """Return offset over temperature per channel, and the sensitivity drift if there is one; None without both."""
    thermal = calibration.coefficients.thermal
    if thermal is None:
        return None
    rows = 1 + bool(thermal.gain.any())
    low, high = _range(calibration, thermal)
    channels = ", ".join(calibration.coefficients.channels)
    return picture(
        "temperature",
        0.35 + 1.85 * rows,
        partial(_plot, calibration=calibration, thermal=thermal),
        title="Drift over temperature",
        description=f"Offset of {channels} over temperature from {low:.3g} to {high:.3g} °C: the fitted polynomial "
        "with its 95 % band, and the measured positions.",
        caption="Drift with temperature. Line: the fitted polynomial; band: its 95 % interval; marks: the positions "
        "minus the modelled effect of their tilt, joined in the order of measurement. Dotted: the reference "
        "temperature.",
    )


def _plot(figure: Figure, calibration: CalibrationRecord, thermal: Thermal) -> None:
    coefficients = calibration.coefficients
    gains = bool(thermal.gain.any())
    panels = figure.subplots(1 + gains, len(coefficients.channels), sharex=True, squeeze=False)
    t = np.linspace(*_range(calibration, thermal), POINTS)
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


def _range(calibration: CalibrationRecord, thermal: Thermal) -> tuple[float, float]:
    """Return the covered temperatures, or a range around the reference."""
    covered = calibration.limits.temperature or thermal.range
    return covered if covered else (thermal.reference - 10.0, thermal.reference + 10.0)
