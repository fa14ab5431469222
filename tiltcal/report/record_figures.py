"""The figures of logs, noise, pairs and fleets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.calibration.season import CoefficientDistribution, ModelFleet
from tiltcal.calibration.wording import label
from tiltcal.core.column_statistics import ColumnStatistics
from tiltcal.core.model import Array
from tiltcal.core.noise import ChannelNoise, NoiseScale
from tiltcal.files.moments import LEAST_SECONDS, MOST_SECONDS
from tiltcal.report.figure import (
    BLUE,
    CHANNELS,
    GREY,
    INK,
    LEGEND,
    RED,
    SvgFigure,
    picture,
    write_figure,
)
from tiltcal.report.numbers import at_place
from tiltcal.report.tables import angle_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ANGLE_BINS = 48  # intervals of the histogram of an angle
SECONDS = (("s", 1.0, 300.0), ("min", 60.0, 4 * 3600.0), ("h", 3600.0, 4 * 86400.0), ("d", 86400.0, float("inf")))
"""Units of a time axis: name, seconds, and the longest log for it."""

FEW = 100  # largest number of rows that are drawn one by one
_KINDS = {
    "offset": "offset",
    "sensitivity": "sensitivity",
    "temperature.offset": "temperature coefficient of the offset",
    "temperature.sensitivity": "temperature coefficient of the sensitivity",
}

_NOISE = {"N": "white noise", "B": "flicker noise", "K": "random walk", "R": "drift"}

_DASHES = {"N": "--", "B": ":", "K": "-.", "R": "-"}
_STAGES = (GREY, RED, BLUE)  # the colours of one accelerometer, the sum after p, the sum after p and q


@dataclass(frozen=True)
class ReportedLog:
    """A log file and its summary; ``timed``: its time is in seconds, otherwise rows are counted."""

    name: str
    sha256: str
    overview: ColumnStatistics
    timed: bool


def log_figure(log: ReportedLog, number: int) -> SvgFigure:
    """Return each angle over time with its histogram, and a strip of flagged rows below."""
    overview = log.overview
    count, (time, label) = len(overview.angles), _clock(log)

    def plot(figure: Figure) -> None:
        panels = figure.subplots(
            count + 1, 2, sharex="col", squeeze=False, width_ratios=[5, 1], height_ratios=[*([1.0] * count), 0.12]
        )
        for k, angle in enumerate(overview.angles):
            panel, beside = panels[k]
            low, high = overview.low[:, k], overview.high[:, k]
            panel.fill_between(time, low, high, color=BLUE)
            if len(time) <= FEW:
                panel.plot(time, low, ".", color=BLUE)
            panel.set_ylabel(f"{angle_words(angle)} [°]")
            edges, counts = overview.histogram(ANGLE_BINS)[k]
            if len(counts):
                beside.stairs(counts, edges, orientation="horizontal", fill=True, color=GREY)
            beside.set(xlim=(0.0, None), ylim=panel.get_ylim())
            beside.set_axis_off()
        strip = panels[-1, 0]
        for share, colour, height in zip(overview.flagged.T, (GREY, RED), (0.45, 1.0), strict=True):
            strip.vlines(time[share > 0.0], 0.0, height, color=colour)
        strip.set(ylim=(0.0, 1.0), xlabel=label)
        strip.set_yticks([0.5], ["flags"])
        panels[-1, 1].set_axis_off()

    least, most = np.nanmin(overview.low, axis=0), np.nanmax(overview.high, axis=0)
    said = "; ".join(
        f"{angle_words(angle)} from {at_place(low, 3)}° to {at_place(high, 3)}°"
        for angle, low, high in zip(overview.angles, least, most, strict=True)
    )
    return picture(
        f"log{number}",
        0.55 + 1.15 * count,
        plot,
        title=f"Tilt over time in {log.name}",
        description=f"{overview.rows} rows; {said}.",
        caption="Left: smallest and largest angle of groups of rows over time; below, red marks rows that fail or are "
        "missing, grey marks suspect rows. Right: histogram of the angle.",
    )


def _clock(log: ReportedLog) -> tuple[Array, str]:
    """Return the time of every group of rows since the first, and the label of the axis."""
    time = log.overview.time
    if not log.timed:
        return time, "row"
    known = time[np.isfinite(time)]
    begin, length = (float(known[0]), float(known[-1] - known[0])) if len(known) else (0.0, 0.0)
    name, seconds, _ = next(unit for unit in SECONDS if length <= unit[2])
    is_date = LEAST_SECONDS < begin < MOST_SECONDS
    start = f"{datetime.fromtimestamp(begin, UTC):%Y-%m-%d %H:%M:%S} UTC" if is_date else "the first row"
    return (time - begin) / seconds, f"time from {start} [{name}]"


def draw_noise(path: Path, noises: Mapping[str, ChannelNoise], scale: NoiseScale) -> None:
    """Write the Allan deviation of every channel with its kinds of noise, as SVG."""

    def plot(figure: Figure) -> None:
        panels = figure.subplots(len(noises), 1, squeeze=False)[:, 0]
        for panel, (channel, noise) in zip(panels, noises.items(), strict=True):
            _plot_noise(panel, channel, noise, scale)
        panels[-1].set_xlabel("averaging time [s]")

    write_figure(path, 1.0 + 3.6 * len(noises), plot)


def _plot_noise(panel: Axes, channel: str, noise: ChannelNoise, scale: NoiseScale) -> None:
    tau, deviation = noise.tau, noise.deviation
    described = np.geomspace(tau[noise.terms.first], tau[-1], 200)
    parts = noise.terms.parts(described)
    for name, part in parts.items() if len(parts) > 1 else ():
        panel.plot(described, part, color=GREY, linestyle=_DASHES[name], label=_NOISE[name])
    label = "sum" if len(parts) > 1 else _NOISE[next(iter(parts))]
    label += ", fitted" if noise.terms.follows else ", which does not follow it"
    panel.plot(described, np.sqrt(noise.terms.variance(described)), color=RED, label=label)
    within = [deviation - noise.low, noise.high - deviation]
    panel.errorbar(tau, deviation, within, fmt="o", color=BLUE, label="measured, 95 %")
    limits = float(noise.low.min()) / 1.6, float(noise.high.max()) * 1.6
    panel.set(xscale="log", yscale="log", ylim=limits, ylabel=f"Allan deviation of {channel} [{scale.unit}]")
    panel.grid()
    if channel in scale.per_g:
        factor = degrees(1.0 / scale.per_g[channel])
        beside = panel.twinx()
        beside.set(yscale="log", ylim=(limits[0] * factor, limits[1] * factor), ylabel="near level [°]")
        beside.spines["right"].set_visible(True)
    panel.legend(**LEGEND)


@dataclass(frozen=True)
class PairDrawing:
    """The spectra of a pair, and the course of its estimates.

    frequency, spin: in ``unit``, Hz or, where the record has no time, 1/row; the stage turns at ``spin``.
    densities: power spectral density, unit²/Hz, of one accelerometer, the sum after p, and the sum after p and q.
    course: p and q of the loops and of the recursive estimator after each turn; ``uncertainty`` is the larger of both.
    """

    frequency: Array
    densities: Mapping[str, Array]
    spin: float
    unit: str
    course: Sequence[tuple[float, float, float, float]] = ()
    uncertainty: float = 0.0


def draw_matching(path: Path, drawing: PairDrawing) -> None:
    """Write amplitude spectral densities as SVG (the source's figure 6), and below them the course of the estimates."""

    def plot(figure: Figure) -> None:
        panels = figure.subplots(2 if drawing.course else 1, 1, squeeze=False)[:, 0]
        _plot_spectra(panels[0], drawing)
        if drawing.course:
            _plot_course(panels[1], drawing)

    write_figure(path, 8.0 if drawing.course else 4.5, plot)


def _plot_spectra(panel: Axes, drawing: PairDrawing) -> None:
    """Plot amplitude densities at all frequencies above 0, with a line at the spin frequency."""
    panel.axvline(drawing.spin, color=INK, linestyle=":", label="spin frequency")
    for (name, density), colour in zip(drawing.densities.items(), _STAGES, strict=True):
        panel.loglog(drawing.frequency[1:], density[1:] ** 0.5, color=colour, label=name)
    panel.set_xlabel(f"frequency [{drawing.unit}]")
    panel.set_ylabel(f"amplitude density [reading/√({drawing.unit})]")
    panel.legend(**LEGEND)


def _plot_course(panel: Axes, drawing: PairDrawing) -> None:
    """Plot the distance of p and q of both estimators from the final recursive estimate."""
    course = np.array(drawing.course)
    least = max(drawing.uncertainty / 5.0, 1e-9)
    away = np.maximum(np.abs(course - np.tile(course[-1, 2:], 2)), least)
    for index, series in enumerate(("p, loops", "q, loops", "p, recursive", "q, recursive")):
        colour, style = _STAGES[1 + index // 2], "--" if index % 2 else "-"
        panel.semilogy(np.arange(1, len(away) + 1), away[:, index], style, color=colour, label=series)
    if drawing.uncertainty:
        panel.axhline(drawing.uncertainty, color=INK, linestyle=":", label="stated uncertainty")
        panel.set_ylim(bottom=least)
    panel.set_xlabel("turns")
    panel.set_ylabel("distance from the end")
    panel.legend(**LEGEND)


def spectra_figure(name: str, number: int, drawing: PairDrawing) -> SvgFigure:
    """Return the spectra of a log; matplotlib draws no more points than can be seen."""
    return picture(
        f"spectra{number}",
        3.1,
        lambda figure: _plot_spectra(figure.subplots(), drawing),
        title=f"Amplitude spectra of {name}",
        description=f"Amplitude densities over frequency of {', '.join(drawing.densities)}.",
        caption="Amplitude density of one accelerometer, and of the sum after p and after p and q.",
    )


def distribution_figure(fleet: ModelFleet, number: int) -> SvgFigure | None:
    """Return the distribution of each kind of coefficient, a row for each coefficient; None where nothing varies."""
    panels = {_KINDS[kind]: rows for kind in _KINDS if (rows := _of_kind(fleet, kind))}
    if not panels:
        return None
    heights = [0.55 + 0.32 * len(rows) for rows in panels.values()]

    def plot(figure: Figure) -> None:
        axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
        for panel, (kind, rows) in zip(axes, panels.items(), strict=True):
            for row, distribution in enumerate(rows):
                _plot_row(panel, row, distribution)
            panel.set_yticks(range(len(rows)), [label(one.name).words for one in rows])
            panel.set_ylim(len(rows) - 0.4, -0.6)
            units = {label(one.name, fleet.unit).unit for one in rows}
            panel.set_xlabel(f"{kind} [{units.pop()}]" if len(units) == 1 else kind)

    return picture(
        f"distribution-{number}",
        sum(heights),
        plot,
        title=f"Distribution of the coefficients of {len(fleet.histories)} {fleet.model}",
        description=f"One dot for each sensor and coefficient: {', '.join(panels)}.",
        caption="One dot for each sensor. Grey bar: median ± 2 spreads (from the quartiles). Outliers are named.",
    )


def _of_kind(fleet: ModelFleet, kind: str) -> list[CoefficientDistribution]:
    """Return the distributions of a kind that vary; of sensitivities those to the channel's own axis."""
    rows = [one for one in fleet.distributions if one.name.startswith(f"{kind}.") and len(set(one.values.values())) > 1]
    return [one for one in rows if " to " not in label(one.name).words]


def _plot_row(panel: Axes, row: int, distribution: CoefficientDistribution) -> None:
    values = np.array(list(distribution.values.values()))
    channel = next((part for part in distribution.name.split(".") if part in CHANNELS), "x")
    colour, mark, _ = CHANNELS[channel]
    middle, reach = distribution.median, 2.0 * distribution.spread
    panel.plot([middle - reach, middle + reach], [row, row], color=GREY, linewidth=4.0)
    panel.plot(middle, row, "|", color=INK, markersize=9.0)
    # Every other dot stands a little lower, so that neighbours do not hide one another.
    panel.plot(values, row + np.resize([-0.11, 0.0, 0.11], len(values)), mark, color=colour)
    for serial in distribution.outliers:
        place = distribution.values[serial], row
        panel.plot(*place, "o", markersize=7.0, markerfacecolor="none", markeredgecolor=RED)
        panel.annotate(serial, place, (0, -9), textcoords="offset points", ha="center", color=RED)


def change_figure(fleet: ModelFleet, number: int) -> SvgFigure | None:
    """Return the change of the offsets since the first calibration, mg; None where no sensor has two."""
    if not any(len(history.calibrations) > 1 for history in fleet.histories):
        return None

    def plot(figure: Figure) -> None:
        channels = fleet.histories[0].sensor.channels
        panels = figure.subplots(1, len(channels), squeeze=False)
        for panel, channel in zip(panels.flat, channels, strict=True):
            _plot_changes(panel, fleet, channel)
            panel.set_ylabel(f"change of the offset of {channel} [mg]")
        figure.autofmt_xdate()

    return picture(
        f"drift-{number}",
        2.3,
        plot,
        title=f"Change of the offsets of {len(fleet.histories)} {fleet.model}",
        description="Offset of each sensor and channel since its first calibration, in mg, over the date.",
        caption="Change of each offset since the sensor’s first calibration, with its standard uncertainty.",
    )


def _plot_changes(panel: Axes, fleet: ModelFleet, channel: str) -> None:
    colour, mark, _ = CHANNELS[channel]
    panel.axhline(0.0, color=INK)
    for history in fleet.histories:
        series, coefficients = history.series(f"offset.{channel}"), history.calibrations[-1].record.coefficients
        if series is not None and len(series[0]) > 1 and channel in coefficients.axes:
            milligravity = 1000.0 / coefficients.own_sensitivity(channel)
            values, u = series
            dates = [calibration.date for calibration in history.calibrations]
            change = milligravity * (values - values[0])
            panel.errorbar(dates, change, yerr=abs(milligravity) * u, color=colour, marker=mark)  # type: ignore[arg-type]
