"""The summary of a log: shares of flags and reasons, angles over time, and their histograms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.column_statistics import ColumnStatistics
from tiltcal.core.flags import FLAGS, REASONS
from tiltcal.core.model import Array
from tiltcal.files.moments import LEAST_SECONDS, MOST_SECONDS
from tiltcal.report.figure import BLUE, GREY, RED, SvgFigure, picture
from tiltcal.report.number_format import AlignedNumber, at_place, column, grouped

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BINS = 48
SECONDS = (("s", 1.0, 300.0), ("min", 60.0, 4 * 3600.0), ("h", 3600.0, 4 * 86400.0), ("d", 86400.0, float("inf")))
"""Units of a time axis: name, seconds, and the longest log for it."""

ROUND = "roll"
"""An angle that wraps from 180° to -180°, so that its mean has no meaning."""

FEW = 100
"""Largest number of rows that are drawn one by one."""

GAP = 5.0
"""Distance of two groups of rows, in usual distances, that counts as a gap."""


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


@dataclass(frozen=True)
class Share:
    """The number of rows with a flag or a reason."""

    code: int
    words: str
    rows: str
    percent: str


@dataclass(frozen=True)
class AngleRow:
    """The statistics of one angle over the log, degrees."""

    name: str
    least: AlignedNumber
    mean: AlignedNumber
    most: AlignedNumber


@dataclass(frozen=True)
class LogSection:
    """A log on the page."""

    name: str
    sha256: str
    rows: str
    how: str
    flags: Sequence[Share]
    reasons: Sequence[Share]
    angles: Sequence[AngleRow]
    figure: SvgFigure | None


def log_section(log: ReportedLog, number: int) -> LogSection:
    """Return the section of a log with its number on the page."""
    overview = log.overview
    angles = bool(np.isfinite(overview.low).any())
    return LogSection(
        log.name,
        log.sha256,
        "1 row" if overview.rows == 1 else f"{grouped(overview.rows)} rows",
        "The tilt is that of the log." if log.compensated else "The calibration was applied to its readings.",
        _shares(overview.flags, FLAGS, overview.rows),
        _shares(overview.reasons, REASONS, overview.rows),
        _angle_rows(overview) if angles else [],
        _figure(log, number) if angles else None,
    )


def _shares(counts: dict[int, int], names: dict[int, str], rows: int) -> list[Share]:
    met = [code for code in names if counts.get(code)]
    return [Share(code, names[code], grouped(counts[code]), _percent(counts[code], rows)) for code in met]


def _percent(count: int, rows: int) -> str:
    """Return a share in per cent that is never rounded to 0 or 100."""
    return "100.000" if count == rows else f"{min(max(100.0 * count / rows, 0.001), 99.999):.3f}"


def _angle_rows(overview: ColumnStatistics) -> list[AngleRow]:
    least = column(_told(min(low[np.isfinite(low)], default=np.nan)) for low in overview.low.T)
    most = column(_told(max(high[np.isfinite(high)], default=np.nan)) for high in overview.high.T)
    means = zip(overview.angles, overview.mean.tolist(), strict=True)
    mean = column(_told(np.nan if name == ROUND else value) for name, value in means)
    return [AngleRow(words_of(name), *row) for name, *row in zip(overview.angles, least, mean, most, strict=True)]


def _told(angle: float) -> str:
    return at_place(angle, 3) if np.isfinite(angle) else ""


def words_of(angle: str) -> str:
    """Return the name of a column of angles as text: ``tilt_x`` is the tilt of x."""
    return f"tilt of {angle.removeprefix('tilt_')}" if angle.startswith("tilt_") else angle


def _figure(log: ReportedLog, number: int) -> SvgFigure:
    overview = log.overview
    said = "; ".join(f"{row.name} from {row.least}° to {row.most}°" for row in _angle_rows(overview))
    return picture(
        f"log{number}",
        0.55 + 1.15 * len(overview.angles),
        partial(_plot, log=log),
        title=f"Tilt over time in {log.name}",
        description=f"{overview.rows} rows; {said}.",
        caption="Left: smallest and largest angle of groups of rows over time; below, red marks rows that fail or are "
        "missing, grey marks suspect rows. Right: histogram of the angle.",
    )


def _plot(figure: Figure, log: ReportedLog) -> None:
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
        panel.set_ylabel(f"{words_of(angle)} [°]")
        panel.margins(x=0.0)
        _histogram(beside, overview, k)
        beside.set_ylim(panel.get_ylim())
        beside.tick_params(left=False, labelleft=False, bottom=False, labelbottom=False)
    _flag_strip(panels[-1, 0], time, overview)
    panels[-1, 0].set_xlabel(label)
    panels[-1, 1].set_axis_off()


def _histogram(panel: Axes, overview: ColumnStatistics, k: int) -> None:
    edges, counts = overview.histogram(BINS)[k]
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
