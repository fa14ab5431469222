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

from tiltcal.core.detection import (
    Numbers,
    Span,
    lost_rows,
    repeated_rows,
    run_bounds,
    stillest,
    stuck_spans,
    window_scatter,
)
from tiltcal.core.estimation.free import UNKNOWNS, FreeFit, fit_free
from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.samples import BLOCKS
from tiltcal.errors import EstimateError
from tiltcal.files.tables import Segment

WINDOWS = (200, 100, 50, 25)
"""Rows of the windows that are tried."""

MULTIPLES = (1.4, 1.7, 2.0, 2.4, 2.8, 3.4, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Thresholds that are tried, in units of the noise of the stillest part."""

STUCK = 25
"""Rows that are identical in all channels, one after the other, where the noise would have changed them."""

SAME_DIRECTION_COSINE = cos(radians(0.5))
"""Still intervals one after the other, with less of a turn between them than this, are one attitude."""

_PIECE = 1 << 18
"""Rows that are summed up at once."""


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

    @property
    def segments(self) -> list[Segment]:
        """The still intervals as segments, named in their order; those of one attitude have one name."""
        digits = len(str(len(self.intervals)))
        return [
            Segment(f"still-{number:0{digits}}", start, end, None, None)
            for number, spans in enumerate(self.intervals, start=1)
            for start, end in spans
        ]


def find_still(
    columns: Sequence[Array], windows: Sequence[int] = WINDOWS
) -> tuple[StaticDetection, tuple[StaticDetection, ...]]:
    """Find the still intervals of columns x, y, z, unit, NaN where a value is missing, by the best threshold.

    It returns the choice, and all that were tried, the strictest of each window first. An EstimateError where no
    threshold finds more attitudes than there are unknowns.
    """
    lost = lost_rows(columns, stuck_spans(columns, STUCK))
    tried = _choices(columns, lost, windows)
    best = min(tried, key=lambda choice: choice.expanded, default=None)
    if best is None or best.fit is None or best.expanded == inf:
        raise EstimateError(_too_few(tried, int(lost.sum())))
    # What is left over shows the scatter no better than this. A choice that is better by less has but left out some
    # attitude that fits badly, and would be surer of itself than it is.
    tolerance = 1.0 + 1.0 / sqrt(2.0 * (len(best.intervals) - UNKNOWNS))
    good = [choice for choice in tried if choice.expanded <= tolerance * best.expanded]
    return max(good, key=lambda choice: (choice.distinct, -choice.expanded)), tried


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


def _choices(columns: Sequence[Array], lost: Mask, windows: Sequence[int]) -> tuple[StaticDetection, ...]:
    still = [(window, *found) for window in windows for found in _still(columns, lost, window)]
    if not still:
        return ()
    # A span in which nothing changes is stuck; its first row need not repeat the row before it.
    changes = np.cumsum(~repeated_rows(columns), dtype=np.int32)
    moving = [spans[changes[spans[:, 1] - 1] > changes[spans[:, 0]]] for *_, spans in still]
    sums = RowSums(columns, moving)
    attitudes = [_attitudes(sums, spans) for spans in moving]
    sums = RowSums(
        columns, [part for found in attitudes for spans in found for part in (spans, block_bounds(spans)[1])]
    )
    return tuple(
        StaticDetection(window, multiple, noise, tuple(map(_as_spans, found)), _fit(columns, sums, found))
        for (window, multiple, noise, _), found in zip(still, attitudes, strict=True)
    )


def _still(columns: Sequence[Array], lost: Mask, window: int) -> Iterator[tuple[float, float, Numbers]]:
    """Yield each threshold in units of the noise, the noise, and the spans that are still by it, shape (spans, 2)."""
    scatter = window_scatter(columns, lost, window)
    noise = stillest(scatter, varying=True)
    for multiple in MULTIPLES if noise else ():
        spans = np.stack(run_bounds(scatter <= multiple * (noise or 0.0)), axis=1)
        # Bounds that touch a window in motion are half a window inside; what is shorter than that is a turning point.
        yield multiple, noise or 0.0, spans[np.diff(spans)[:, 0] >= max(window // 2, 2)] + window // 2


class RowSums:
    """Sums of the rows of columns between any two of some bounds, from one pass over them.

    A value that is missing counts as zero.
    """

    def __init__(self, columns: Sequence[Array], bounds: Sequence[Numbers]) -> None:
        rows = len(columns[0])
        inside = np.unique(np.concatenate([np.arange(0, rows, _PIECE), *map(np.ravel, bounds)]))
        inside = inside[inside < rows]
        self._bounds, self._sums = np.append(inside, rows), np.zeros((len(inside) + 1, len(columns)))
        # Sums about values amid the others keep their digits.
        self._centres = np.array([np.nan_to_num(column[inside]).mean() for column in columns])
        for start in range(0, rows, _PIECE):
            first, last = np.searchsorted(inside, [start, start + _PIECE])
            for k, column in enumerate(columns):
                values = np.nan_to_num(column[start : start + _PIECE] - self._centres[k])
                self._sums[first + 1 : last + 1, k] = np.add.reduceat(values, inside[first:last] - start)
        np.cumsum(self._sums, axis=0, out=self._sums)

    def between(self, starts: Numbers, ends: Numbers) -> Array:
        """Return the sums of the rows from each start to before each end, shape (k, columns)."""
        first, last = np.searchsorted(self._bounds, starts), np.searchsorted(self._bounds, ends)
        return np.asarray(self._sums[last] - self._sums[first] + np.multiply.outer(ends - starts, self._centres))


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


def _fit(columns: Sequence[Array], sums: RowSums, attitudes: Sequence[Numbers]) -> FreeFit | None:
    if not attitudes:
        return None
    means, uncertainties = zip(*(mean_of(columns, sums, spans) for spans in attitudes), strict=True)
    try:
        return fit_free(np.array(means), np.array(uncertainties))
    except EstimateError:
        return None


def mean_of(columns: Sequence[Array], sums: RowSums, spans: Numbers) -> tuple[Array, Array]:
    """Return the mean of an attitude and its standard uncertainty, by :func:`tiltcal.core.samples.summarise`."""
    starts, ends = spans.T
    n = int((ends - starts).sum())
    each = sums.between(starts, ends)
    mean = each.sum(axis=0) / n
    size = n // BLOCKS
    if size < 2:
        rows = [np.concatenate([column[start:end] for start, end in _as_spans(spans)]) for column in columns]
        return mean, np.asarray(np.std(rows, axis=1, ddof=1) / sqrt(n))
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


def _too_few(tried: Sequence[StaticDetection], lost: int) -> str:
    most = max((len(choice.intervals) for choice in tried), default=0)
    windows = ", ".join(str(window) for window in dict.fromkeys(choice.window for choice in tried)) or "any number of"
    why = f" ({lost} rows are missing, or stuck at one value)" if lost else ""
    return (
        "no threshold finds enough attitudes to determine the sensor and check the result: at most "
        f"{most} static intervals in windows of {windows} rows{why}. Hold the sensor still for longer and in more "
        "attitudes, 12 to 18 or more; try a shorter --window; or give the intervals with --segments"
    )
