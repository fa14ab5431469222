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

from tiltcal.core.detection import LongRuns, Rows, Span, Stillest, lost_rows, stuck_spans, window_scatter
from tiltcal.core.estimation.ellipsoid import UNKNOWNS, Ellipsoid, fit_ellipsoid
from tiltcal.core.model import Array
from tiltcal.core.statistics import BLOCKS
from tiltcal.errors import EstimateError
from tiltcal.files.segments import Segment
from tiltcal.logs.stored_rows import StoredRows

WINDOWS = (200, 100, 50, 25)
"""Rows of the windows that are tried."""

MULTIPLES = (1.4, 1.7, 2.0, 2.4, 2.8, 3.4, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Thresholds that are tried, in units of the noise of the stillest part."""

STUCK = 25
"""Rows that are identical in all channels, one after the other, where the noise would have changed them."""

SAME_DIRECTION_COSINE = cos(radians(0.5))
"""Still intervals one after the other, with less of a turn between them than this, are one attitude."""

_PIECE = 1 << 10
"""Rows whose sums are kept, and of which longer intervals have theirs."""


@dataclass(frozen=True)
class StaticDetection:
    """One threshold between still and moving, and the fit that it leads to.

    Attributes
    ----------
    window : int
        Rows.
    multiple : float
        Threshold over noise.
    noise : float
        Standard deviation in the stillest part, all channels together (root of the sum of squares), unit.
    intervals : tuple of tuple of (start, end)
        The rows of each attitude, ends exclusive; an attitude may have several intervals.
    ellipsoid : Ellipsoid or None
        The unit-gravity fit of the attitudes; None where they cannot determine it.
    """

    window: int
    multiple: float
    noise: float
    intervals: tuple[tuple[Span, ...], ...]
    ellipsoid: Ellipsoid | None

    @property
    def threshold(self) -> float:
        """The standard deviation below which a window is still, unit."""
        return self.multiple * self.noise

    @property
    def distinct(self) -> int:
        """The number of different attitudes."""
        return 0 if self.ellipsoid is None else self.ellipsoid.distinct

    @property
    def expanded(self) -> float:
        """Expanded uncertainty (95 %) of the unknowns on average, g; infinite where nothing judges them."""
        return inf if self.ellipsoid is None else self.ellipsoid.expanded


def find_still(readings: Rows, windows: Sequence[int] = WINDOWS) -> tuple[StaticDetection, tuple[StaticDetection, ...]]:
    """Find the still intervals of a log by the threshold that calibrates best.

    Parameters
    ----------
    readings : Rows
        Of the channels x, y, z, in the sensor's unit; NaN where one is missing. They are read several times.
    windows : sequence of int
        Rows of the windows to try.

    Returns
    -------
    chosen : StaticDetection
    tried : tuple of StaticDetection
        All of them, the strictest of each window first.

    Raises
    ------
    EstimateError
        No threshold finds more attitudes than there are unknowns.
    """
    stuck = stuck_spans(readings, STUCK)
    tried = tuple(_choices(readings, stuck, windows))
    best = min(tried, key=lambda choice: choice.expanded, default=None)
    if best is None or best.ellipsoid is None or best.expanded == inf:
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
            fit = choice.ellipsoid
            row = f"{choice.threshold:>10.4g}{sum(map(len, choice.intervals)):>11}{len(choice.intervals):>11}"
            row += f"{fit.distinct:>10}{1e3 * fit.rms:>11.3f} mg" if fit else f"{'-':>10}{'-':>14}"
            row += "             -" if choice.expanded == inf else f"{1e3 * choice.expanded:>11.3f} mg"
            lines.append(f"{'*' if choice is chosen else ' '} {row}")
    return "\n".join(lines)


def still_intervals(
    readings: RowSums, scatter: StoredRows, window: int, thresholds: Sequence[float]
) -> Iterator[list[list[Span]]]:
    """Yield the still intervals of a log by each threshold, those of one attitude together.

    Parameters
    ----------
    scatter : StoredRows
        In every window; see :func:`tiltcal.core.detection.window_scatter`.
    window : int
        Rows.
    thresholds : sequence of float
        Standard deviations, all channels together, unit.

    Yields
    ------
    list of list of (start, end)
        Rows, ends exclusive, in order.
    """
    middle = window // 2
    # Bounds that touch a window in motion are half a window inside; what is shorter than that is a turning point.
    still = [LongRuns(max(middle, 2)) for _ in thresholds]
    for (piece,) in scatter.blocks():
        for found, threshold in zip(still, thresholds, strict=True):
            found.add(piece <= threshold)
    for found in still:
        spans = [(start + middle, end + middle) for start, end in found.result()]
        yield _merged(readings, [span for span in spans if readings.change(span)])


class RowSums:
    """The readings of a log, and the sums of any of its rows.

    Parameters
    ----------
    readings : Rows
    """

    def __init__(self, readings: Rows) -> None:
        self._readings = readings
        with np.errstate(invalid="ignore"):
            sums = [readings[start : start + _PIECE].sum(axis=0) for start in range(0, len(readings), _PIECE)]
        self._sums = np.array(sums)

    def rows(self, spans: Sequence[Span]) -> Array:
        """Return the rows of some intervals."""
        parts = [self._readings[start:end] for start, end in spans]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def mean(self, spans: Sequence[Span]) -> Array:
        """Return the mean of some intervals."""
        n = sum(end - start for start, end in spans)
        return np.asarray(sum(self._sum(start, end) for start, end in spans) / n)

    def uncertainty(self, spans: Sequence[Span]) -> Array:
        """Standard uncertainty of the mean, as :func:`tiltcal.core.statistics.summarise` has it, on arrays."""
        n = sum(end - start for start, end in spans)
        size = n // BLOCKS
        if size < 2:
            return np.asarray(self.rows(spans).std(axis=0, ddof=1) / sqrt(n))
        if n < _PIECE:
            means = self.rows(spans)[: BLOCKS * size].reshape(BLOCKS, size, -1).mean(axis=1)
        else:
            means = np.array([self.mean(_part(spans, size * block, size * (block + 1))) for block in range(BLOCKS)])
        return np.asarray(means.std(axis=0, ddof=1) / sqrt(BLOCKS))

    def change(self, span: Span) -> bool:
        """Return whether a reading changes in an interval."""
        start, end = span
        first = self._readings[start : start + 1]
        return any(np.any(self._readings[at : min(at + _PIECE, end)] != first) for at in range(start, end, _PIECE))

    def _sum(self, start: int, end: int) -> Array:
        first, last = -(-start // _PIECE), end // _PIECE
        if last - first < 2:
            return np.asarray(self._readings[start:end].sum(axis=0))
        before, behind = self._readings[start : first * _PIECE], self._readings[last * _PIECE : end]
        return np.asarray(before.sum(axis=0) + self._sums[first:last].sum(axis=0) + behind.sum(axis=0))


def _part(spans: Sequence[Span], first: int, last: int) -> list[Span]:
    """Return some rows of the rows of several intervals, counted along them."""
    found = []
    for start, end in spans:
        begin, stop = start + max(first, 0), min(start + last, end)
        if begin < stop:
            found.append((begin, stop))
        first, last = first - (end - start), last - (end - start)
    return found


def _choices(readings: Rows, stuck: Sequence[Span], windows: Sequence[int]) -> Iterator[StaticDetection]:
    sums = RowSums(readings)
    for window in windows:
        with StoredRows(1) as scatter:
            stillest = Stillest(len(readings))
            for piece in window_scatter(readings, stuck, window):
                scatter.append([piece])
                stillest.add(piece[np.isfinite(piece) & (piece > 0.0)])
            noise = stillest.result()
            if noise is None:
                continue
            found = still_intervals(sums, scatter, window, [multiple * noise for multiple in MULTIPLES])
            for multiple, intervals in zip(MULTIPLES, found, strict=True):
                yield StaticDetection(
                    window, multiple, noise, tuple(map(tuple, intervals)), _ellipsoid(sums, intervals)
                )


def _ellipsoid(readings: RowSums, intervals: Sequence[Sequence[Span]]) -> Ellipsoid | None:
    if not intervals:
        return None
    try:
        return fit_ellipsoid(
            np.array([readings.mean(spans) for spans in intervals]),
            np.array([readings.uncertainty(spans) for spans in intervals]),
        )
    except EstimateError:
        return None


def _merged(readings: RowSums, spans: Sequence[Span]) -> list[list[Span]]:
    """Intervals that follow each other in one attitude, together."""
    if not spans:
        return []
    means = np.array([readings.mean([span]) for span in spans])
    middle = (means.max(axis=0) + means.min(axis=0)) / 2
    directions = means - middle
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-300)
    intervals: list[list[Span]] = []
    first = directions[0]
    for span, direction in zip(spans, directions, strict=True):
        if intervals and direction @ first >= SAME_DIRECTION_COSINE:
            intervals[-1].append(span)
        else:
            intervals.append([span])
            first = direction
    return intervals


def _too_few(tried: Sequence[StaticDetection], readings: Rows, stuck: Sequence[Span]) -> str:
    most = max((len(choice.intervals) for choice in tried), default=0)
    windows = ", ".join(str(window) for window in dict.fromkeys(choice.window for choice in tried)) or "any number of"
    lost = sum(
        int(lost_rows(readings[start : start + _PIECE], start, stuck).sum())
        for start in range(0, len(readings), _PIECE)
    )
    why = f" ({lost} rows are missing, or stuck at one value)" if lost else ""
    return (
        "no threshold finds enough attitudes to determine the sensor and check the result: at most "
        f"{most} static intervals in windows of {windows} rows{why}. Hold the sensor still for longer and in more "
        "attitudes, 12 to 18 or more; try a shorter --window; or give the intervals with --segments"
    )
