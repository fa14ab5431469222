"""Still intervals of a recorded log: when the sensor was held still, found in the readings themselves.

A row is still where the standard deviation in the window around it stays below a threshold, a multiple of the noise in
the stillest part of the log (the static detector of Tedaldi, Pretto and Menegatti, 2014). Too loose lets motion in; too
strict leaves few attitudes, and nine of them fit nine unknowns perfectly and wrongly. So every window and multiple is
fitted and judged by the expanded uncertainty of the coefficients. Of those that are as good as the best, within what
its degrees of freedom show, the one with the most attitudes is taken. Where a procedure states the positions, the
attitudes are named by them, and the fit is a linear one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import chain, combinations, product
from math import cos, inf, radians, sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.attitude import Vector
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
from tiltcal.core.estimation.free import DIFFERENT_ATTITUDE, UNKNOWNS, FreeFit, fit_free
from tiltcal.core.flags import Mask
from tiltcal.core.model import AXES, Array
from tiltcal.core.samples import BLOCKS
from tiltcal.core.uncertain import coverage_factor
from tiltcal.errors import Argument, EstimateError, Parts
from tiltcal.files.tables import Segment

WINDOWS = (200, 100, 50, 25)  # rows of the windows that are tried
MULTIPLES = (1.4, 1.7, 2.0, 2.4, 2.8, 3.4, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Thresholds that are tried, in units of the noise of the stillest part."""

NEARLY = 0.15  # rows whose lengths differ by less may all be gravity, and may be means, relative
AT_REST = 10.0  # standard deviations of a sample by which the means of one attitude may differ
SAME_DIRECTION_COSINE = cos(radians(0.5))
"""Still intervals one after the other, with less of a turn between them than this, are one attitude."""

NEAR, CLOSEST = 0.35, 0.15
"""An attitude this near to a position, g, and within a third of the way to the next one, is in it; positions that are
closer to each other than the second number are not told apart."""


@dataclass(frozen=True)
class PositionFit:
    """The attitudes of a log in the positions of a procedure, and the linear fit of their readings.

    ``names`` are the positions by attitude, empty where it is none; ``absent`` are those that no attitude is in.
    ``expanded`` is the expanded uncertainty (95 %) of the coefficients on average, g; infinite where some are absent.
    """

    names: tuple[str, ...]
    absent: tuple[str, ...]
    dof: int
    expanded: float

    @property
    def distinct(self) -> int:
        """The number of attitudes that are in a position."""
        return sum(map(bool, self.names))


Attitudes = tuple[tuple[Span, ...], ...]
"""The intervals of each attitude, ends exclusive."""

Fit = Callable[[Attitudes], FreeFit | PositionFit | None]
Judge = Callable[[Array, Array], FreeFit | PositionFit]
"""Fits the means of attitudes and their standard uncertainties, unit, both of shape (n, channels)."""


@dataclass(frozen=True)
class StaticDetection:
    """One threshold between still and moving, and the fit that it leads to; None where attitudes determine none.

    ``noise`` is the standard deviation in the stillest part, all channels together (root of the sum of squares), unit,
    and ``multiple`` is threshold over noise; each attitude has one or several intervals of rows.
    """

    window: int
    multiple: float
    noise: float
    intervals: Attitudes
    fit: FreeFit | PositionFit | None

    @property
    def threshold(self) -> float:
        """The standard deviation below which a window is still, unit."""
        return self.multiple * self.noise

    @property
    def expanded(self) -> float:
        """Expanded uncertainty (95 %) of the unknowns on average, g; infinite where nothing judges them."""
        return inf if self.fit is None else self.fit.expanded

    @property
    def segments(self) -> list[Segment]:
        """The still intervals as segments; those of one attitude have one name, its position's or its number."""
        digits = len(str(len(self.intervals)))
        names = [f"still-{number:0{digits}}" for number in range(1, len(self.intervals) + 1)]
        if isinstance(self.fit, PositionFit):
            names = [*self.fit.names]
        return [
            Segment(name, start, end, None, None)
            for name, spans in zip(names, self.intervals, strict=True)
            for start, end in spans
            if name
        ]

    def in_words(self, unit: str) -> str:
        """Return what was found, and at which threshold, in the unit of the readings, with a blank before it."""
        return (
            f"{sum(map(len, self.intervals))} static intervals in {len(self.intervals)} attitudes: standard deviation "
            f"over {self.window} rows up to {self.threshold:.4g}{unit}, {self.multiple:g} times the noise of the "
            "stillest part"
        )


def find_still(columns: Sequence[Array], judge: Judge = fit_free) -> StaticDetection:
    """Find the still intervals of columns of readings, unit, NaN where a value is missing, by the best threshold.

    An EstimateError where no threshold finds attitudes that determine the sensor and are judged.
    """
    tried, lost = _tried(columns, judge)
    best = min(tried, key=lambda choice: choice.expanded, default=None)
    if best is None or best.fit is None or best.expanded == inf:
        raise EstimateError(_too_few(tried, columns, lost))
    # What is left over shows the scatter no better than this. A choice that is better by less has but left out some
    # attitude that fits badly, and would be surer of itself than it is.
    limit = best.expanded * (1.0 + 1.0 / sqrt(2.0 * best.fit.dof))
    good = [
        (choice.fit.distinct, -choice.expanded, choice) for choice in tried if choice.fit and choice.expanded <= limit
    ]
    return max(good, key=lambda each: each[:2])[2]


def _tried(columns: Sequence[Array], judge: Judge | None) -> tuple[tuple[StaticDetection, ...], int]:
    """Return the detection by each window and threshold, and how many rows are lost to all."""
    lost = lost_rows(columns, stuck_spans(columns))
    changes = np.cumsum(~repeated_rows(columns), dtype=np.int32)
    fit = cache(lambda attitudes: _fit(columns, attitudes, judge))  # windows and thresholds find the same ones again
    tried = (choice for window in WINDOWS for choice in _choices(columns, lost, changes, window, fit))
    return tuple(tried), int(lost.sum())


def still_attitudes(columns: Sequence[Array]) -> Sequence[Sequence[Span]]:
    """Return the rows of the still attitudes of readings: those that a fit by gravity takes, else the most.

    Means that differ by no more than noise are of one attitude.
    """
    found: StaticDetection | None = None
    if len(columns) == len(AXES):
        with suppress(EstimateError):
            found = find_still(columns)
    found = found or max(_tried(columns, None)[0], key=lambda choice: len(choice.intervals), default=None)
    if found is None or not found.intervals:
        return ()
    means = np.array([mean_of(columns, spans)[0] for spans in found.intervals])
    at_rest = np.ptp(means, axis=0).max() < AT_REST * found.noise
    return (tuple(chain(*found.intervals)),) if at_rest else found.intervals


def judge_of(positions: Mapping[str, Vector], channels: Sequence[str]) -> Judge | None:
    """Return what names and fits the attitudes of a log in positions, g by name; None where readings cannot tell them.

    The extreme readings of each channel are taken to be those of the positions that are extreme along its axis.
    """
    axes = [AXES.index(channel) for channel in channels]
    gravity = np.array([*positions.values()])[:, axes]
    apart = [float(np.linalg.norm(one - other)) for one, other in combinations(gravity, 2)]
    design = np.column_stack([np.ones(len(gravity)), gravity])
    if not np.linalg.matrix_rank(design) == design.shape[1] < len(design) or min(apart) < CLOSEST:
        return None
    limit = min(NEAR, min(apart) / 3.0)
    middle, half = (gravity.max(axis=0) + gravity.min(axis=0)) / 2.0, np.ptp(gravity, axis=0) / 2.0

    def judge(means: Array, u: Array) -> PositionFit:
        reach = np.maximum(np.ptp(means, axis=0) / 2.0, 1e-300)
        up = middle + half * (means - (means.max(axis=0) + means.min(axis=0)) / 2.0) / reach
        distance = np.linalg.norm(up[:, None] - gravity, axis=2)
        nearest, near = distance.argmin(axis=1), distance.min(axis=1) < limit
        names = tuple(name if there else "" for name, there in zip(np.array([*positions])[nearest], near, strict=True))
        absent = tuple(name for name in positions if name not in names)
        rows, dof = design[nearest[near]], int(near.sum()) - design.shape[1]
        if absent or dof < 1:
            return PositionFit(names, absent, dof, inf)
        readings = means[near] * half / reach  # g
        misfit = readings - rows @ np.linalg.lstsq(rows, readings, rcond=None)[0]
        squares = max(float(np.sum(misfit**2)) / (dof * len(axes)), float(np.mean((u[near] * half / reach) ** 2)))
        student = float(coverage_factor(np.array([float(dof * len(axes))]))[0])
        expanded = student * sqrt(squares * float(np.mean(np.diag(np.linalg.inv(rows.T @ rows)))))
        return PositionFit(names, absent, dof, expanded)

    return judge


def _choices(
    columns: Sequence[Array], lost: Mask, changes: NDArray[np.int32], window: int, fit: Fit
) -> Iterator[StaticDetection]:
    """Yield the detection by each threshold; ``changes`` counts the rows that do not repeat the one before, (n,)."""
    scatter = window_scatter(columns, lost, window)
    noise = stillest(scatter, varying=True)
    if not noise:
        return
    for multiple in MULTIPLES:
        spans = np.stack(run_bounds(scatter <= multiple * noise), axis=1)
        # Bounds that touch a window in motion are half a window inside; what is shorter than that is a turning point.
        spans = spans[np.ptp(spans, axis=1) >= window // 2] + window // 2
        # A span in which nothing changes is stuck; its first row need not repeat the row before it.
        spans = spans[changes[spans[:, 1] - 1] > changes[spans[:, 0]]]
        attitudes = tuple(
            tuple((start, end) for start, end in of_one.tolist()) for of_one in _attitudes(columns, spans)
        )
        yield StaticDetection(window, multiple, noise, attitudes, fit(attitudes))


def _attitudes(columns: Sequence[Array], spans: Numbers) -> list[Numbers]:
    """Return the spans of each attitude, shape (m, 2): those that follow each other without a turn between them."""
    if not len(spans):
        return []
    means = np.stack([np.add.reduceat(column, spans.ravel())[::2] for column in columns], axis=1) / np.diff(spans)
    directions = means - (means.max(axis=0) + means.min(axis=0)) / 2
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-300)
    first, cuts = directions[0], []
    for number, direction in enumerate(directions[1:], start=1):
        if direction @ first < SAME_DIRECTION_COSINE:
            cuts.append(number)
            first = direction
    return np.split(spans, cuts)


def _fit(columns: Sequence[Array], attitudes: Attitudes, judge: Judge | None) -> FreeFit | PositionFit | None:
    if not attitudes or judge is None:
        return None
    means, uncertainties = zip(*(mean_of(columns, spans) for spans in attitudes), strict=True)
    try:
        return judge(np.array(means), np.array(uncertainties))
    except EstimateError:
        return None


def mean_of(columns: Sequence[Array], spans: Sequence[Span]) -> tuple[Array, Array]:
    """Return the mean of an attitude and its standard uncertainty, as :func:`tiltcal.core.samples.summarise` has it."""
    rows = np.stack([np.concatenate([column[start:end] for start, end in spans]) for column in columns])
    n = rows.shape[1]
    blocks = rows[:, : n // BLOCKS * BLOCKS].reshape(len(rows), BLOCKS, -1).mean(axis=2) if n >= 2 * BLOCKS else rows
    return rows.mean(axis=1), np.asarray(blocks.std(axis=1, ddof=1) / sqrt(blocks.shape[1]))


def _too_few(tried: Sequence[StaticDetection], columns: Sequence[Array], lost: int) -> Parts:
    """Return why no choice will do, and what to add; ``lost`` rows are missing, or stuck at one value."""
    absent = min((choice.fit.absent for choice in tried if isinstance(choice.fit, PositionFit)), key=len, default=None)
    most = max(tried, key=lambda choice: len(choice.intervals), default=None)
    longer = "Hold the sensor still in more attitudes, and for longer in each"
    if absent is not None:
        found = f"the sensor still in every position: {', '.join(absent) or 'a further one'} is missing"
    else:
        count = 0 if most is None else len(most.intervals)
        found = f"enough attitudes to determine the sensor and check the result (10, better 12 to 18): at most {count}"
        if most is not None and count > UNKNOWNS:
            kinds = different(np.array([mean_of(columns, spans)[0] for spans in most.intervals]))
            if len(kinds) <= UNKNOWNS:
                found = f"{found}, of which {len(kinds)} are different"
                longer = f"Add other attitudes, such as the one with {farthest(kinds)} up"
    lost_too = f"; {lost} rows are missing, or stuck at one value" if lost else ""
    why = f"no threshold finds {found} in windows of {WINDOWS[-1]} rows or more{lost_too}. {longer}"
    few = most is None or len(most.intervals) < 2
    means = (
        ("; if each row is the mean of one position, say ", Argument("table")) if few and may_be_means(columns) else ()
    )
    return f"{why}; or give the intervals with ", Argument("segments"), *means


def may_be_means(columns: Sequence[Array]) -> bool:
    """Return whether rows of three channels are about as long as each other, and point apart: means of positions."""
    if len(columns) != len(AXES):
        return False
    rows = np.stack(columns, axis=1)
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) < UNKNOWNS:
        return False
    lengths = np.linalg.norm(rows, axis=1)
    near = np.abs(lengths / max(float(np.median(lengths)), 1e-300) - 1.0) < NEARLY
    return bool(near.mean() > 1.0 - NEARLY and np.ptp(rows, axis=0).max() > float(np.median(lengths)))


def different(means: Array) -> Array:
    """Return a direction of each group of attitudes that count as one, unit vectors, of mean readings (n, 3)."""
    half = np.maximum(np.ptp(means, axis=0) / 2.0, 1e-300)
    up = (means - (means.max(axis=0) + means.min(axis=0)) / 2.0) / half
    kept = list[Array]()
    for one in up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-300):
        if all(float(one @ other) < cos(radians(DIFFERENT_ATTITUDE)) for other in kept):
            kept.append(one)
    return np.array(kept)


def farthest(directions: Array) -> str:
    """Return the face, edge or corner of a box that is farthest from all directions, in words."""
    corners = np.array([corner for corner in product((-1, 0, 1), repeat=3) if any(corner)], float)
    near = (corners / np.linalg.norm(corners, axis=1, keepdims=True) @ directions.T).max(axis=1)
    signs = {1: "+", -1: "-"}
    return " and ".join(
        f"{signs[int(sign)]}{axis}" for sign, axis in zip(corners[int(near.argmin())], AXES, strict=True) if sign
    )
