"""Detectors of a sensor that is stuck at one value, is still, is moved or knocked, and of samples that are far off.

The bench, recorded logs and the characterisation of noise use them with limits of their own. Samples that are all alike
are not still: a sensor at rest has noise, and one whose reading does not change although its noise is larger than half
a step of the reading is stuck. Those that need positions are in :mod:`tiltcal.bench.checks` and
:mod:`tiltcal.logs.positions`, that of a turning stage in :mod:`tiltcal.core.pair.stage`.

Sources: QARTOD's flat line test for stuck readings; Tedaldi, Pretto and Menegatti (2014) for the scatter in windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import erf, inf, log, sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.samples import SampleSummary, noise_under_rounding

Span = tuple[int, int]  # first row and the row behind the last
Numbers = NDArray[np.intp]  # numbers of rows
CHANCE = 1e-6  # probability of identical samples below which they are no chance
JUMP = 8.0  # a difference of block means beyond so many standard deviations is motion
BURST = 5.0  # so is a scatter within a block beyond so many times the usual one
FEWEST_SAMPLES = 8  # readings among which one can be called far off
OUTLYING = 6.0  # standard deviations beyond which a sample is far off
LEFT_OUT = 0.05  # the largest share of samples that is left out as far off; more is a fault that must not be hidden
TEMPERATURES = (-60.0, 150.0)  # the range of temperatures at a bench, °C: a DS18B20 that fails reads -127
TEMPERATURE_JUMP = 5.0  # a temperature this far from those around it is a failed conversion, °C
FLICKER = 0.5  # standard deviation of a reading that takes two neighbouring values, at most, in steps
TILTED = 0.1  # how far a channel's axis has to move before its reading must change, g
STUCK = 25  # rows of a log that are identical in all channels where the noise would have changed them
STILLEST = 0.01  # the share of the windows of a record that counts as its stillest part
_SIGMA_OF_MEDIAN = 1.4826  # standard deviation of normal numbers over the median of their distance from the median
_SIGMA_OF_NEAREST = 1.267  # ratio of sigma to the root mean square of the nearest 90 %
_EXACT = 1.0 + 1e-9  # arithmetic may leave the last digits of a scatter that is the largest of a flicker
_PIECE = 1 << 14  # rows whose sums are formed at once: a sum of more would lose the noise in its last digits
_BLOCK, _MOST_BLOCKS, _FEWEST_BLOCKS = 16, 1 << 16, 8  # rows of a block, doubled where there are too many blocks


def run_bounds(mask: Mask) -> tuple[Numbers, Numbers]:
    """Return the first rows of the runs of True, and the rows behind their last."""
    framed = np.zeros(len(mask) + 2, dtype=bool)
    framed[1:-1] = mask
    edges = np.flatnonzero(framed[1:] != framed[:-1])
    return edges[::2], edges[1::2]


# Stuck


def noise_of_positions(summaries: Sequence[SampleSummary], step: float) -> float:
    """Return the noise of a channel in several positions before rounding to a step, unit; 0 if none shows."""
    scatters = [summary.std**2 * (summary.n - 1) / summary.n for summary in summaries]
    if step and np.median(scatters) <= (FLICKER * step) ** 2 * _EXACT:
        return 0.0
    scatter = float(np.mean(scatters))
    return noise_under_rounding(scatter, step) if step else sqrt(scatter)


def identical_by_chance(count: int, noise: float, step: float) -> bool:
    """Return whether noise (a standard deviation) can leave so many samples in one step of the reading, same unit."""
    if noise == 0.0:
        return True
    # Of normal noise no step holds more than the one in the middle.
    most = erf(step / noise / sqrt(8.0))
    return most > 0.0 and count * log(most) >= log(CHANCE)


def repeated_rows(columns: Sequence[Array]) -> Mask:
    """Return which rows are the same in all columns as the row before, shape (n,); NaN repeats nothing."""
    same = np.zeros(len(columns[0]), dtype=bool)
    same[1:] = True
    for column in columns:
        same[1:] &= column[1:] == column[:-1]
    return same


def stuck_spans(columns: Sequence[Array], shortest: int = STUCK) -> list[Span]:
    """Return runs of so many identical rows or more, where the noise of the rest makes such runs no chance."""
    starts, ends = run_bounds(repeated_rows(columns))
    long = ends - starts >= shortest - 1
    stuck = list(zip((starts[long] - 1).tolist(), ends[long].tolist(), strict=True))
    if not stuck:
        return stuck
    lost = lost_rows(columns, stuck)
    for column in columns:
        noise = stillest(window_scatter([column], lost, shortest))
        if noise is None:
            return stuck
        changes = np.abs(np.diff(column))
        # Noise of half a step changes every other reading: a run of identical ones is then no chance.
        if noise >= float(np.min(changes, initial=inf, where=changes > 0.0)) / 2:
            return stuck
    return []


# Still


def lost_rows(columns: Sequence[Array], stuck: Sequence[Span]) -> Mask:
    """Return the rows in which a value is missing or stuck, shape (n,)."""
    lost: Mask = np.logical_or.reduce([~np.isfinite(column) for column in columns])
    for start, end in stuck:
        lost[start:end] = True
    return lost


def window_scatter(columns: Sequence[Array], lost: Mask, window: int) -> Array:
    """Return the standard deviation of all columns together in every window of rows, infinite if one is lost."""
    scatter = np.empty(max(len(lost) - window + 1, 0))
    for start in range(0, len(scatter), _PIECE):
        rows = slice(start, min(start + _PIECE, len(scatter)) + window - 1)
        gone = lost[rows]
        squares = np.zeros(len(gone) - window + 1)
        for column in columns:
            # Squares of what is far from zero would lose the noise in their last digits.
            part = column[rows]
            part = np.where(gone, 0.0, part - (0.0 if gone.all() else part[~gone].mean()))
            squares += _window_sums(part * part, window) - _window_sums(part, window) ** 2 / window
        squares[_window_sums(gone.astype(float), window) > 0.5] = inf
        scatter[start : start + _PIECE] = np.sqrt(np.maximum(squares, 0.0) / (window - 1))
    return scatter


def _window_sums(values: Array, window: int) -> Array:
    """Return the sums over windows of so many values."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(sums[window:] - sums[:-window])


def stillest(scatter: Array, *, varying: bool = False) -> float | None:
    """Return the :data:`STILLEST` quantile of scatters, 0 left out if ``varying``; None without any."""
    some = scatter[np.isfinite(scatter) & (scatter > 0.0 if varying else True)]
    return float(np.quantile(some, STILLEST)) if len(some) else None


# Moved


def moved_rows(columns: Sequence[Array], steps: Sequence[float]) -> list[Span]:
    """Return the rows in which the sensor was moved, of columns whose readings have ``steps``, 0 where continuous.

    There the mean of a short block differs by far more than usual from its neighbours, or scatters by far more within.
    """
    size = _BLOCK
    while len(columns[0]) > size * _MOST_BLOCKS:
        size *= 2
    blocks = len(columns[0]) // size
    if blocks < _FEWEST_BLOCKS:
        return []
    disturbed = np.zeros(blocks, dtype=bool)
    for column, step in zip(columns, steps, strict=True):
        samples = column[: blocks * size].reshape(blocks, size)
        counts = np.isfinite(samples).sum(axis=1).astype(np.float64)
        counts[counts < 2] = np.nan  # of one sample there is no scatter
        mean = np.nansum(samples, axis=1) / counts
        scatter = np.sqrt(np.nansum((samples - mean[:, None]) ** 2, axis=1) / counts)
        changes, rounding = np.diff(mean), step / sqrt(12.0)  # nothing stands out below what rounding gives
        difference = np.abs(changes - np.nanmedian(changes))
        turned = difference > JUMP * np.maximum(_SIGMA_OF_MEDIAN * np.nanmedian(difference), rounding)
        knocked = scatter > BURST * np.maximum(np.nanmedian(scatter), rounding)
        disturbed |= np.append(turned, False) | np.append(False, turned) | knocked
    starts, ends = run_bounds(disturbed)
    return list(zip((starts * size).tolist(), (ends * size).tolist(), strict=True))


# Outlying


def outliers(samples: Sequence[float] | Array, step: float = 0.0) -> Numbers:
    """Return the samples of a channel at rest that stand far out of the others, by more than two steps; none of few."""
    values = np.asarray(samples, dtype=float)
    if len(values) < FEWEST_SAMPLES:
        return np.empty(0, np.intp)
    distance = np.abs(values - np.median(values))
    limit = max(OUTLYING * _SIGMA_OF_MEDIAN * float(np.median(distance)), 2.0 * step)
    if float(distance.max()) <= limit:
        return np.empty(0, np.intp)
    # Where more than half of the samples are in one step, that median is 0; the nearest 90 % are not.
    count = max(1, round(0.9 * len(values)))
    nearest = np.partition(distance, count - 1)[:count]
    limit = max(limit, OUTLYING * _SIGMA_OF_NEAREST * float(np.sqrt(np.mean(nearest**2))))
    return np.flatnonzero(distance > limit)
