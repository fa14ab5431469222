"""The figure of the residuals: every position and channel, measured minus modelled."""

from __future__ import annotations

from functools import partial
from operator import mul
from typing import TYPE_CHECKING

from tiltcal.core.uncertain import NORMAL_FACTOR
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.report.figure import CHANNELS, GREY, INK, RED, SvgFigure, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
        partial(_plot, calibration=calibration, positions=positions),
        title="Residuals of the positions",
        description=f"Measured minus modelled, in {calibration.sensor.unit} for {len(positions)} positions; {largest}.",
        caption="Residual of every position, measured minus modelled, with the position as it was set. Bars: ±1.96 "
        "standard uncertainties of the mean, from noise alone. Above: the residual as an angle near level.",
    )


def _plot(figure: Figure, calibration: CalibrationRecord, positions: list[str]) -> None:
    coefficients = calibration.coefficients
    panels = figure.subplots(1, len(coefficients.channels), sharey=True, sharex=True, squeeze=False)[0]
    for panel, channel in zip(panels, coefficients.channels, strict=True):
        _plot_channel(panel, calibration, positions, channel)
    first = panels[0]
    first.set_yticks(range(len(positions)), positions)
    first.set_ylim(len(positions) - 0.4, -0.6)
    for label, name in zip(first.get_yticklabels(), positions, strict=True):
        if name in calibration.fit.suspect_positions:
            label.set_color(RED)
            label.set_fontweight("bold")


def _plot_channel(panel: Axes, calibration: CalibrationRecord, positions: list[str], channel: str) -> None:
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
    from math import degrees

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
