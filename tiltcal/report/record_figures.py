"""The figures of logs, noise, pairs and fleets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiltcal.calibration.fleet import CoefficientDistribution, ModelFleet
from tiltcal.calibration.wording import unit_of, words
from tiltcal.core.column_statistics import ColumnStatistics
from tiltcal.core.model import Array
from tiltcal.core.noise import ChannelNoise, NoiseScale
from tiltcal.files.moments import LEAST_SECONDS, MOST_SECONDS
from tiltcal.report.figure import BLUE, CHANNELS, GREY, INK, RED, SvgFigure, picture, write_figure
from tiltcal.report.numbers import at_place
from tiltcal.report.tables import angle_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


ANGLE_BINS = 48
"""Intervals of the histogram of an angle."""

SPECTRUM_BINS = 400
"""Intervals of a spectrum on a logarithmic scale, in each of which its peaks and troughs are drawn."""

SECONDS = (("s", 1.0, 300.0), ("min", 60.0, 4 * 3600.0), ("h", 3600.0, 4 * 86400.0), ("d", 86400.0, float("inf")))
"""Units of a time axis: name, seconds, and the longest log for it."""

FEW = 100
"""Largest number of rows that are drawn one by one."""

GAP = 5.0
"""Distance of two groups of rows, in usual distances, that counts as a gap."""

_KINDS = {
    "offset": "offset",
    "sensitivity": "sensitivity",
    "temperature.offset": "temperature coefficient of the offset",
    "temperature.sensitivity": "temperature coefficient of the sensitivity",
}

_BINS = 12  # of a coefficient, within which the dots of sensors are moved aside
_NOISE = {"N": "white noise", "B": "flicker noise", "K": "random walk", "R": "drift"}

_DASHES = {"N": "--", "B": ":", "K": "-.", "R": (0, (8, 3))}

_STAGES = (GREY, RED, BLUE)  # the colours of one accelerometer, the sum after p, the sum after p and q


@dataclass(frozen=True)
class ReportedLog:
    """A log file and its summary.

    compensated: whether the log brought its tilt along; otherwise the calibration of the page was applied to it.
    timed: whether its time is in seconds; otherwise rows are counted.
    """

    name: str
    sha256: str
    overview: ColumnStatistics
    compensated: bool
    timed: bool


def log_figure(log: ReportedLog, number: int) -> SvgFigure:
    overview = log.overview
    least, most = np.nanmin(overview.low, axis=0), np.nanmax(overview.high, axis=0)
    angles = zip(map(angle_words, overview.angles), least, most, strict=True)
    said = "; ".join(f"{words} from {at_place(low, 3)}° to {at_place(high, 3)}°" for words, low, high in angles)
    return picture(
        f"log{number}",
        0.55 + 1.15 * len(overview.angles),
        partial(_plot_log, log=log),
        title=f"Tilt over time in {log.name}",
        description=f"{overview.rows} rows; {said}.",
        caption="Left: smallest and largest angle of groups of rows over time; below, red marks rows that fail or are "
        "missing, grey marks suspect rows. Right: histogram of the angle.",
    )


def _plot_log(figure: Figure, log: ReportedLog) -> None:
    overview = log.overview
    count = len(overview.angles)
    panels = figure.subplots(
        count + 1, 2, sharex="col", squeeze=False, width_ratios=[5, 1], height_ratios=[*([1.0] * count), 0.12]
    )
    time, label = _clock(log)
    breaks = _breaks(time)
    for k, angle in enumerate(overview.angles):
        panel, beside = panels[k]
        low, high = (np.insert(values[:, k], breaks, np.nan) for values in (overview.low, overview.high))
        at = np.insert(time, breaks, np.nan)
        panel.fill_between(at, low, high, color=BLUE, linewidth=0.5, edgecolor=BLUE)
        if len(time) <= FEW:
            panel.plot(at, low, ".", color=BLUE, markersize=4.0)
        panel.set_ylabel(f"{angle_words(angle)} [°]")
        panel.margins(x=0.0)
        _histogram(beside, overview, k)
        beside.set_ylim(panel.get_ylim())
        beside.tick_params(left=False, labelleft=False, bottom=False, labelbottom=False)
    _flag_strip(panels[-1, 0], time, overview)
    panels[-1, 0].set_xlabel(label)
    panels[-1, 1].set_axis_off()


def _histogram(panel: Axes, overview: ColumnStatistics, k: int) -> None:
    edges, counts = overview.histogram(ANGLE_BINS)[k]
    if len(counts):
        panel.stairs(counts, edges, orientation="horizontal", fill=True, color=GREY)
    panel.spines["bottom"].set_visible(False)
    panel.set_xlim(left=0.0)


def _flag_strip(panel: Axes, time: Array, overview: ColumnStatistics) -> None:
    """Draw a strip of flagged rows below the angles."""
    suspect, bad = overview.flagged.T
    for share, colour, height in ((suspect, GREY, 0.45), (bad, RED, 1.0)):
        panel.vlines(time[share > 0.0], 0.0, height, color=colour, linewidth=max(0.6, FEW / (4.0 * len(time))))
    panel.set_ylim(0.0, 1.0)
    panel.set_yticks([0.5], ["flags"])
    panel.tick_params(axis="y", length=0)
    for side in ("left", "bottom"):
        panel.spines[side].set_visible(False)


def _clock(log: ReportedLog) -> tuple[Array, str]:
    """Return the time of every group of rows since the first, and the label of the axis."""
    time = log.overview.time
    if not log.timed:
        return time, "row"
    known = time[np.isfinite(time)]
    begin, length = (float(known[0]), float(known[-1] - known[0])) if len(known) else (0.0, 0.0)
    name, seconds, _ = next(unit for unit in SECONDS if length <= unit[2])
    return (time - begin) / seconds, f"time from {_moment(begin)} [{name}]"


def _moment(seconds: float) -> str:
    """Return the start of a log, if its seconds can only be those since 1970."""
    if not LEAST_SECONDS < seconds < MOST_SECONDS:
        return "the first row"
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _breaks(time: Array) -> NDArray[np.intp]:
    """Return the groups of rows that follow a gap."""
    steps = np.diff(time)
    usual = float(np.nanmedian(steps)) if np.isfinite(steps).any() else 0.0
    return np.asarray(np.flatnonzero(steps > GAP * usual) + 1 if usual > 0.0 else [], dtype=np.intp)


def draw_noise(path: Path, noises: Mapping[str, ChannelNoise], scale: NoiseScale) -> None:
    """Write the Allan deviation of every channel with its kinds of noise, as SVG."""
    write_figure(path, (8.0, 1.0 + 3.6 * len(noises)), partial(_draw_noise, noises=noises, scale=scale))


def _draw_noise(figure: Figure, noises: Mapping[str, ChannelNoise], scale: NoiseScale) -> None:
    panels = figure.subplots(len(noises), 1, squeeze=False)[:, 0]
    for panel, (channel, noise) in zip(panels, noises.items(), strict=True):
        _draw_noise_of(panel, channel, noise, scale)
    panels[-1].set_xlabel("averaging time [s]")


def _draw_noise_of(panel: Axes, channel: str, noise: ChannelNoise, scale: NoiseScale) -> None:
    tau, deviation = noise.tau, noise.deviation
    described = np.geomspace(tau[noise.terms.first], tau[-1], 200)
    parts = noise.terms.parts(described)
    for name, part in parts.items() if len(parts) > 1 else ():
        panel.plot(described, part, color=GREY, linewidth=0.9, linestyle=_DASHES[name], label=_NOISE[name])
    label = ("sum, " if len(parts) > 1 else f"{_NOISE[next(iter(parts))]}, ") + (
        "fitted" if noise.terms.follows else "which does not follow it"
    )
    panel.plot(described, np.sqrt(noise.terms.variance(described)), color=RED, linewidth=1.2, label=label)
    within = [deviation - noise.low, noise.high - deviation]
    panel.errorbar(tau, deviation, within, fmt="o", markersize=3.5, elinewidth=0.9, color=BLUE, label="measured, 95 %")
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_ylim(float(noise.low.min()) / 1.6, float(noise.high.max()) * 1.6)
    panel.set_ylabel(f"Allan deviation of {channel} [{scale.unit}]")
    panel.grid(which="major", color="#dddddd", linewidth=0.6)
    panel.set_axisbelow(True)
    if channel in scale.per_g:
        factor = degrees(1.0 / scale.per_g[channel])
        beside = panel.twinx()
        beside.set_yscale("log")
        beside.set_ylim(*(limit * factor for limit in panel.get_ylim()))
        beside.set_ylabel("near level [°]")
        beside.spines["right"].set_visible(True)
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderaxespad=0.1, columnspacing=1.2)


@dataclass(frozen=True)
class PairDrawing:
    """The data of the figure.

    Attributes
    ----------
    frequency : ndarray, shape (n,)
        Hz, or 1/row where the record has no time.
    densities : mapping of str to ndarray, shape (n,)
        Power spectral density by what it is of: one accelerometer, the sum after p, the sum after p and q; unit²/Hz.
    spin : float
        Where the stage turns, same unit as ``frequency``.
    unit : str
        Of ``frequency``.
    course : sequence of (float, float, float, float)
        p and q of the loops and of the recursive estimator after each turn; empty for none.
    uncertainty : float
        Stated for p and q, the larger of the two; below it no course says anything.
    """

    frequency: Array
    densities: Mapping[str, Array]
    spin: float
    unit: str
    course: Sequence[tuple[float, float, float, float]] = ()
    uncertainty: float = 0.0


def draw_matching(path: Path, drawing: PairDrawing) -> None:
    """Write amplitude spectral densities as SVG (the source's figure 6), and beside them the course of the estimates.

    UsageError: the file cannot be written there.
    """
    write_figure(path, (8.0, 8.0 if drawing.course else 4.5), partial(_draw_matching, drawing=drawing))


def _draw_matching(figure: Figure, drawing: PairDrawing) -> None:
    panels = figure.subplots(2 if drawing.course else 1, 1, squeeze=False)[:, 0]
    _draw_spectra(panels[0], drawing)
    if drawing.course:
        _draw_course(panels[1], drawing)
    for panel in panels:
        panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderaxespad=0.1, columnspacing=1.2)
        panel.margins(x=0.01)


def _draw_spectra(panel: Axes, drawing: PairDrawing) -> None:
    """Draw amplitude densities over frequency, with a line at the spin frequency."""
    panel.axvline(drawing.spin, color="black", linewidth=0.8, linestyle=":", label="spin frequency")
    for (name, density), colour in zip(drawing.densities.items(), _STAGES, strict=False):
        panel.loglog(drawing.frequency[1:], density[1:] ** 0.5, color=colour, linewidth=0.9, label=name)
    panel.set_xlabel(f"frequency [{drawing.unit}]")
    panel.set_ylabel(f"amplitude density [reading/√({drawing.unit})]")


def _draw_course(panel: Axes, drawing: PairDrawing) -> None:
    """Draw the distance of p and q of both estimators from the final recursive estimate."""
    course = np.array(drawing.course)
    least = max(drawing.uncertainty / 5.0, 1e-9)
    away = np.maximum(np.abs(course - np.tile(course[-1, 2:], 2)), least)
    for index, label in enumerate(("p, loops", "q, loops", "p, recursive", "q, recursive")):
        colour, style = _STAGES[1 + index // 2], "--" if index % 2 else "-"
        panel.semilogy(np.arange(1, len(away) + 1), away[:, index], style, color=colour, linewidth=0.9, label=label)
    if drawing.uncertainty:
        panel.axhline(drawing.uncertainty, color="black", linewidth=0.8, linestyle=":", label="stated uncertainty")
        panel.set_ylim(bottom=least)
    panel.set_xlabel("turns")
    panel.set_ylabel("distance from the end")


def spectra_figure(name: str, number: int, drawing: PairDrawing) -> SvgFigure:
    """Return the spectra of a log, drawn with few points that keep all peaks and troughs."""
    shown = _outstanding(drawing.frequency, list(drawing.densities.values()))
    densities = {said: density[shown] for said, density in drawing.densities.items()}
    thinned = replace(drawing, frequency=drawing.frequency[shown], densities=densities)

    def plot(figure: Figure) -> None:
        panel = figure.subplots()
        _draw_spectra(panel, thinned)
        panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.1)
        panel.margins(x=0.01)

    return picture(
        f"spectra{number}",
        3.1,
        plot,
        title=f"Amplitude spectra of {name}",
        description=f"Amplitude densities over frequency of {', '.join(densities)}.",
        caption="Amplitude density of one accelerometer, and of the sum after p and after p and q.",
    )


def _outstanding(frequency: Array, densities: Sequence[Array]) -> NDArray[np.intp]:
    """Return the places where a density is largest or smallest within its interval."""
    if len(frequency) <= 2 * SPECTRUM_BINS:
        return np.arange(len(frequency))
    edges = np.unique(np.geomspace(1, len(frequency), SPECTRUM_BINS + 1).astype(np.intp))
    chosen = {0}
    for low, high in pairwise(edges.tolist()):
        for density in densities:
            chosen |= {low + int(np.argmax(density[low:high])), low + int(np.argmin(density[low:high]))}
    return np.array(sorted(chosen), dtype=np.intp)


def distribution_figure(fleet: ModelFleet, number: int) -> SvgFigure | None:
    """Return the distribution of each kind of coefficient, a row for each coefficient; None where nothing varies."""
    panels = [(kind, _of_kind(fleet, kind)) for kind in _KINDS]
    panels = [(kind, found) for kind, found in panels if found]
    if not panels:
        return None
    names = ", ".join(_KINDS[kind] for kind, _ in panels)
    return picture(
        f"distribution-{number}",
        sum(0.55 + 0.32 * len(found) for _, found in panels),
        partial(_plot_distributions, fleet=fleet, panels=panels),
        title=f"Distribution of the coefficients of {len(fleet.histories)} {fleet.model}",
        description=f"One dot for each sensor and coefficient: {names}.",
        caption="One dot for each sensor. Grey bar: median ± 2 spreads (from the quartiles). Outliers are named.",
    )


def change_figure(fleet: ModelFleet, number: int) -> SvgFigure | None:
    """Return the change of the offsets since the first calibration; None where no sensor has two."""
    if not any(len(history.calibrations) > 1 for history in fleet.histories):
        return None
    return picture(
        f"drift-{number}",
        2.3,
        partial(_plot_changes, fleet=fleet),
        title=f"Change of the offsets of {len(fleet.histories)} {fleet.model}",
        description="Offset of each sensor and channel since its first calibration, in mg, over the date.",
        caption="Change of each offset since the sensor’s first calibration, with its standard uncertainty.",
    )


def _of_kind(fleet: ModelFleet, kind: str) -> list[CoefficientDistribution]:
    """Return the distributions of a kind that vary; of sensitivities those to the channel's own axis."""
    found = []
    for distribution in fleet.distributions:
        parts = distribution.name.split(".")
        cross = parts[0] == "sensitivity" and parts[1] != parts[2]
        if distribution.name.startswith(f"{kind}.") and not cross and len(set(distribution.values.values())) > 1:
            found.append(distribution)
    return found


def _plot_distributions(
    figure: Figure, fleet: ModelFleet, panels: Sequence[tuple[str, Sequence[CoefficientDistribution]]]
) -> None:
    heights = [0.55 + 0.32 * len(found) for _, found in panels]
    axes = figure.subplots(len(panels), 1, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    for panel, (kind, found) in zip(axes, panels, strict=True):
        for row, distribution in enumerate(found):
            _plot_row(panel, row, distribution)
        panel.set_yticks(range(len(found)), [words(distribution.name) for distribution in found])
        panel.set_ylim(len(found) - 0.4, -0.6)
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        unit = unit_of(found[0].name, fleet.unit)
        panel.set_xlabel(f"{_KINDS[kind]} [{unit}]" if len({unit_of(o.name, fleet.unit) for o in found}) == 1 else kind)


def _plot_row(panel: Axes, row: int, distribution: CoefficientDistribution) -> None:
    numbers = np.array(list(distribution.values.values()))
    channel = next((part for part in distribution.name.split(".") if part in CHANNELS), "x")
    colour, mark, _ = CHANNELS[channel]
    reach = 2.0 * distribution.spread
    panel.plot(
        [distribution.median - reach, distribution.median + reach], [row, row], color=GREY, linewidth=4.0, alpha=0.35
    )
    panel.plot([distribution.median, distribution.median], [row - 0.28, row + 0.28], color=INK, linewidth=0.8)
    panel.plot(numbers, row + _apart(numbers), mark, color=colour, markersize=3.0, markeredgewidth=0.0, alpha=0.75)
    for serial in distribution.outliers:
        panel.plot(distribution.values[serial], row, "o", markersize=7.0, markerfacecolor="none", markeredgecolor=RED)
        panel.annotate(
            serial,
            (distribution.values[serial], row),
            (0, -9),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            color=RED,
        )


def _apart(numbers: Array) -> Array:
    """Return how far each dot is moved aside, so that neighbours do not hide one another."""
    width = float(np.ptp(numbers)) / _BINS or 1.0
    bins = np.floor((numbers - numbers.min()) / width).astype(int)
    aside = np.zeros(len(numbers))
    for value in np.unique(bins):
        places = np.flatnonzero(bins == value)
        aside[places] = 0.11 * (np.arange(len(places)) - (len(places) - 1) / 2.0)
    return np.clip(aside, -0.3, 0.3)


def _plot_changes(figure: Figure, fleet: ModelFleet) -> None:

    channels = fleet.histories[0].sensor.channels
    panels = figure.subplots(1, len(channels), sharey=True, squeeze=False)[0]
    for panel, channel in zip(panels, channels, strict=True):
        colour, mark, _ = CHANNELS[channel]
        panel.axhline(0.0, color=INK, linewidth=0.6)
        for history in fleet.histories:
            series = history.series(f"offset.{channel}")
            coefficients = history.calibrations[-1].record.coefficients
            if series is None or len(series[0]) < 2 or channel not in coefficients.axes:
                continue
            own = coefficients.own_sensitivity(channel)
            values, u = series
            dates: list[datetime] = [calibration.date for calibration in history.calibrations]
            panel.errorbar(
                dates,
                1000.0 * (values - values[0]) / own,
                yerr=1000.0 * u / abs(own),
                color=colour,
                marker=mark,
                markersize=2.5,
                linewidth=0.6,
                elinewidth=0.4,
                alpha=0.7,
            )
        panel.tick_params(axis="x", labelrotation=30)
        panel.set_title(channel, fontsize=8)
    panels[0].set_ylabel("change of the offset [mg]")
