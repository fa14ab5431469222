"""Still intervals of a recorded log: when the sensor was held still, found in the readings themselves.

A row is still where the standard deviation in the window around it stays below a threshold, a multiple of the noise in
the stillest part of the log (the static detector of Tedaldi, Pretto and Menegatti, 2014). What multiple and what window
is for the calibration to say. Too loose lets motion in, and the fit leaves a large scatter; too strict leaves few
attitudes, and nine of them fit nine unknowns perfectly and wrongly. So every choice is fitted and judged by the
expanded uncertainty of the coefficients, in which noise, scatter, number and spread of the attitudes and Student's t
for the degrees of freedom that are left all have their say, and nine attitudes have no say at all. Of those that are as
good as the best, within what its degrees of freedom show, the one with the most attitudes is taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import cos, inf, radians, sqrt

import numpy as np

from tiltcal.core.estimation.free import UNKNOWNS, FreeFit, fit_free
from tiltcal.core.model import Array
from tiltcal.core.rows import LongRuns, Rows, Span, Stillest, lost_rows, stuck_spans, window_scatter
from tiltcal.core.samples import BLOCKS
from tiltcal.errors import EstimateError
from tiltcal.files.tables import Segment
from tiltcal.logs.row_sums import Numbers, RowSums
from tiltcal.logs.streams import read_ahead

WINDOWS = (200, 100, 50, 25)
"""Rows of the windows that are tried."""

MULTIPLES = (1.4, 1.7, 2.0, 2.4, 2.8, 3.4, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Thresholds that are tried, in units of the noise of the stillest part."""

STUCK = 25
"""Rows that are identical in all channels, one after the other, where the noise would have changed them."""

SAME_DIRECTION_COSINE = cos(radians(0.5))
"""Still intervals one after the other, with less of a turn between them than this, are one attitude."""

_BLOCK = 1 << 14
"""Rows that are read at once."""


@dataclass(frozen=True)
class StaticDetection:
    """One threshold between still and moving, and the fit that it leads to; None where attitudes determine none.

    ``noise`` is the standard deviation in the stillest part, all channels together (root of the sum of squares), unit,
    and ``multiple`` is threshold over noise; each attitude has one or several intervals of rows, ends exclusive.
    """

    window: int
    multiple: float
    noise: float
    intervals: tuple[tuple[Span, ...], ...]
    fit: FreeFit | None

    @property
    def threshold(self) -> float:
        """The standard deviation below which a window is still, unit."""
        return self.multiple * self.noise

    @property
    def distinct(self) -> int:
        """The number of different attitudes."""
        return 0 if self.fit is None else self.fit.distinct

    @property
    def expanded(self) -> float:
        """Expanded uncertainty (95 %) of the unknowns on average, g; infinite where nothing judges them."""
        return inf if self.fit is None else self.fit.expanded


def find_still(readings: Rows, windows: Sequence[int] = WINDOWS) -> tuple[StaticDetection, tuple[StaticDetection, ...]]:
    """Find the still intervals of readings of x, y, z, unit, NaN where one is missing, by the best threshold.

    It returns the choice, and all that were tried, the strictest of each window first. An EstimateError where no
    threshold finds more attitudes than there are unknowns. The readings are read several times.
    """
    stuck = stuck_spans(readings, STUCK)
    tried = tuple(_choices(readings, stuck, windows))
    best = min(tried, key=lambda choice: choice.expanded, default=None)
    if best is None or best.fit is None or best.expanded == inf:
        raise EstimateError(_too_few(tried, readings, stuck))
    # What is left over shows the scatter no better than this. A choice that is better by less has but left out some
    # attitude that fits badly, and would be surer of itself than it is.
    tolerance = 1.0 + 1.0 / sqrt(2.0 * (len(best.intervals) - UNKNOWNS))
    good = [choice for choice in tried if choice.expanded <= tolerance * best.expanded]
    return max(good, key=lambda choice: (choice.distinct, -choice.expanded)), tried


def still_segments(choice: StaticDetection) -> list[Segment]:
    """Return the still intervals as segments, named in their order; those of one attitude have one name."""
    digits = len(str(len(choice.intervals)))
    return [
        Segment(f"still-{number:0{digits}}", start, end, None, None)
        for number, spans in enumerate(choice.intervals, start=1)
        for start, end in spans
    ]


def choice_table(chosen: StaticDetection, tried: Sequence[StaticDetection], unit: str) -> str:
    """Return what was tried with the chosen window, and what was chosen, as a table in the unit of the readings."""
    windows = ", ".join(str(window) for window in dict.fromkeys(choice.window for choice in tried))
    lines = [
        f"still: standard deviation over {chosen.window} rows up to {chosen.threshold:.4g} {unit}, "
        f"{chosen.multiple:g} times the noise of the stillest part (windows tried: {windows} rows)",
        f"  {'threshold':>10}{'intervals':>11}{'attitudes':>11}{'distinct':>10}{'misfit rms':>14}{'expanded u':>14}",
    ]
    for choice in tried:
        if choice.window == chosen.window:
            fit = choice.fit
            row = f"{choice.threshold:>10.4g}{sum(map(len, choice.intervals)):>11}{len(choice.intervals):>11}"
            row += f"{fit.distinct:>10}{1e3 * fit.rms:>11.3f} mg" if fit else f"{'-':>10}{'-':>14}"
            row += "             -" if choice.expanded == inf else f"{1e3 * choice.expanded:>11.3f} mg"
            lines.append(f"{'*' if choice is chosen else ' '} {row}")
    return "\n".join(lines)


class StillSpans:
    """Collects the rows in which a log is still over a window, by standard deviations of all channels, unit."""

    def __init__(self, window: int, thresholds: Sequence[float]) -> None:
        self._middle, self._thresholds = window // 2, thresholds
        # Bounds that touch a window in motion are half a window inside; what is shorter than that is a turning point.
        self._still = [LongRuns(max(self._middle, 2)) for _ in thresholds]

    def add(self, scatter: Array) -> None:
        """Take the scatter in the next windows, shape (n,); see :func:`tiltcal.core.rows.window_scatter`."""
        low, high = float(np.min(scatter, initial=inf)), float(np.max(scatter, initial=0.0))
        for found, threshold in zip(self._still, self._thresholds, strict=True):
            if low <= threshold < high:
                found.add(scatter <= threshold)
            else:
                found.add_alike(len(scatter), high <= threshold)

    def result(self) -> list[Numbers]:
        """Return the first rows and the rows behind the last by each threshold, shape (spans, 2), in order."""
        return [np.array(found.result(), dtype=np.intp).reshape(-1, 2) + self._middle for found in self._still]


def _choices(readings: Rows, stuck: Sequence[Span], windows: Sequence[int]) -> list[StaticDetection]:
    still = list(_still(readings, stuck, windows))
    sums = RowSums(readings, np.concatenate([np.empty(0, np.intp), *(spans.ravel() for *_, spans in still)]))
    attitudes = [_attitudes(sums, spans[sums.change(*spans.T)]) for *_, spans in still]
    bounds = [part for found in attitudes for spans in found for part in (spans.ravel(), block_bounds(spans)[1])]
    sums = RowSums(readings, np.concatenate([np.empty(0, np.intp), *bounds]))
    return [
        StaticDetection(window, multiple, noise, tuple(map(_as_spans, found)), _fit(readings, sums, found))
        for (window, multiple, noise, _), found in zip(still, attitudes, strict=True)
    ]


def _still(
    readings: Rows, stuck: Sequence[Span], windows: Sequence[int]
) -> Iterator[tuple[int, float, float, Numbers]]:
    """Yield each window, threshold in units of the noise, noise, and the spans that are still by it.

    The scatter is worked out twice, once for the noise: it takes no longer than keeping it in a file.
    """
    stillest = [Stillest(len(readings)) for _ in windows]
    for scatter in read_ahead(window_scatter(readings, stuck, windows)):
        for least, piece in zip(stillest, scatter, strict=True):
            least.add(piece[np.isfinite(piece) & (piece > 0.0)])
    noise = [least.result() or 0.0 for least in stillest]  # 0 where there is no window
    still = [
        StillSpans(window, [multiple * each for multiple in MULTIPLES])
        for window, each in zip(windows, noise, strict=True)
    ]
    for scatter in read_ahead(window_scatter(readings, stuck, windows)):
        for found, piece in zip(still, scatter, strict=True):
            found.add(piece)
    for window, each, found in zip(windows, noise, still, strict=True):
        if each:
            yield from (
                (window, multiple, each, spans) for multiple, spans in zip(MULTIPLES, found.result(), strict=True)
            )


def _attitudes(sums: RowSums, spans: Numbers) -> list[Numbers]:
    """Return the spans of each attitude, shape (m, 2): those that follow each other without a turn between them."""
    if not len(spans):
        return []
    means = sums.between(*spans.T) / np.diff(spans)
    directions = means - (means.max(axis=0) + means.min(axis=0)) / 2
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-300)
    first, cuts = directions[0], []
    for number, direction in enumerate(directions[1:], start=1):
        if direction @ first < SAME_DIRECTION_COSINE:
            cuts.append(number)
            first = direction
    return np.split(spans, cuts)


def _fit(readings: Rows, sums: RowSums, attitudes: Sequence[Numbers]) -> FreeFit | None:
    if not attitudes:
        return None
    means, uncertainties = zip(*(mean_of(readings, sums, spans) for spans in attitudes), strict=True)
    try:
        return fit_free(np.array(means), np.array(uncertainties))
    except EstimateError:
        return None


def mean_of(readings: Rows, sums: RowSums, spans: Numbers) -> tuple[Array, Array]:
    """Return the mean of an attitude and its standard uncertainty, by :func:`tiltcal.core.samples.summarise`."""
    starts, ends = spans.T
    n = int((ends - starts).sum())
    each = sums.between(starts, ends)
    mean = each.sum(axis=0) / n
    size = n // BLOCKS
    if size < 2:
        rows = np.concatenate([readings[start:end] for start, end in _as_spans(spans)])
        return mean, np.asarray(rows.std(axis=0, ddof=1) / sqrt(n))
    which, bounds = block_bounds(spans)
    up_to = (np.cumsum(each, axis=0) - each)[which] + sums.between(starts[which], bounds)
    return mean, np.asarray((np.diff(up_to, axis=0) / size).std(axis=0, ddof=1) / sqrt(BLOCKS))


def block_bounds(spans: Numbers) -> tuple[Numbers, Numbers]:
    """Return the bounds of the ten blocks of an attitude along its spans: the span of each, and the row."""
    starts, ends = spans.T
    lengths = ends - starts
    before = np.cumsum(lengths) - lengths
    places = int(lengths.sum()) // BLOCKS * np.arange(BLOCKS + 1)
    which = np.searchsorted(before, places, side="right") - 1
    return which, starts[which] + places - before[which]


def _as_spans(spans: Numbers) -> tuple[Span, ...]:
    return tuple(zip(*spans.T.tolist(), strict=True))


def _too_few(tried: Sequence[StaticDetection], readings: Rows, stuck: Sequence[Span]) -> str:
    most = max((len(choice.intervals) for choice in tried), default=0)
    windows = ", ".join(str(window) for window in dict.fromkeys(choice.window for choice in tried)) or "any number of"
    lost = sum(
        int(lost_rows(readings[start : start + _BLOCK], start, stuck).sum())
        for start in range(0, len(readings), _BLOCK)
    )
    why = f" ({lost} rows are missing, or stuck at one value)" if lost else ""
    return (
        "no threshold finds enough attitudes to determine the sensor and check the result: at most "
        f"{most} static intervals in windows of {windows} rows{why}. Hold the sensor still for longer and in more "
        "attitudes, 12 to 18 or more; try a shorter --window; or give the intervals with --segments"
    )
