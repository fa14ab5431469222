"""Detectors of a sensor that is still, moves, is knocked, or is stuck at one value.

They work on arrays; the bench, recorded logs and the characterisation of noise use them with limits of their own. The
detectors that need positions are in :mod:`tiltcal.bench.sample_checks` and :mod:`tiltcal.logs.static_intervals`, that
of a turning stage in :mod:`tiltcal.logs.pair_rows`.

Samples that are all alike are not still: a sensor at rest has noise, and one whose reading does not change although its
noise is larger than half a step of the reading is stuck.

Sources: Tedaldi, Pretto and Menegatti (2014) for the static detector; QARTOD's flat line test for stuck readings.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterator, Sequence
from math import erf, inf, log, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.quantisation import noise_under_rounding
from tiltcal.core.statistics import SampleSummary

Span = tuple[int, int]
"""First row and the row behind the last."""


class Rows(Protocol):
    """The rows of a record, shape (n, channels), of which slices are taken: an array, or a long log in a file."""

    def __len__(self) -> int: ...
    def __getitem__(self, rows: slice, /) -> Array: ...


CHANCE = 1e-6
"""Probability of identical samples below which they are no chance."""

STILLEST = 0.01
"""The share of the windows of a record that counts as its stillest part."""

JUMP = 8.0
"""A difference of block means beyond so many standard deviations is motion."""

BURST = 5.0
"""So is a scatter within a block beyond so many times the usual one."""

FEWEST_SAMPLES = 8
"""Readings among which one can be called far off."""

OUTLYING = 6.0
"""Standard deviations beyond which a sample is far off."""

LEFT_OUT = 0.05
"""The largest share of samples that is left out as far off; more is a fault that must not be hidden."""

TEMPERATURES = (-60.0, 150.0)
"""The range of temperatures at a bench, °C: a DS18B20 that fails reads -127."""

TEMPERATURE_JUMP = 5.0
"""A temperature this far from those around it is a failed conversion, °C."""

FLICKER = 0.5
"""Standard deviation of a reading that takes two neighbouring values, at most, in steps."""

TILTED = 0.1
"""How far a channel's axis has to move before its reading must change, g."""

_SIGMA_OF_MEDIAN = 1.4826  # standard deviation of normal numbers over the median of their distance from the median
_SIGMA_OF_NEAREST = 1.267  # and over the root mean square of the nearest 90 % of them
_CHUNK = 1 << 14
_EXACT = 1.0 + 1e-9  # arithmetic may leave the last digits of a scatter that is the largest of a flicker
_MANY, _SAMPLE = 1 << 13, 1 << 11  # values of which a sample is taken first, and those of the sample


def run_bounds(mask: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first rows of the runs of True, and the rows behind their last."""
    framed = np.zeros(len(mask) + 2, dtype=bool)
    framed[1:-1] = mask
    edges = np.flatnonzero(framed[1:] != framed[:-1])
    return edges[::2], edges[1::2]


def runs(mask: Mask) -> list[Span]:
    """Return the runs of True."""
    starts, ends = run_bounds(mask)
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


class LongRuns:
    """Collects the runs of True of at least so many rows in masks that follow each other.

    Parameters
    ----------
    shortest : int
        Rows.
    """

    def __init__(self, shortest: int) -> None:
        self._shortest, self._rows = shortest, 0
        self._bounds = [np.empty((2, 0), np.intp)]

    def add(self, mask: Mask) -> None:
        """Take the next rows, shape (n,)."""
        starts, ends = run_bounds(mask)
        kept = (ends - starts >= self._shortest) | (starts == 0) | (ends == len(mask))
        self._bounds.append(self._rows + np.stack([starts[kept], ends[kept]]))
        self._rows += len(mask)

    def add_alike(self, rows: int, value: bool) -> None:
        """Take so many next rows that all have one value."""
        if value:
            self._bounds.append(np.array([[self._rows], [self._rows + rows]], np.intp))
        self._rows += rows

    def result(self) -> list[Span]:
        """Return the runs in the rows so far."""
        starts, ends = np.concatenate(self._bounds, axis=1)
        apart = starts[1:] != ends[:-1]
        starts, ends = starts[np.append(True, apart)[: len(starts)]], ends[np.append(apart, True)[: len(ends)]]
        long = ends - starts >= self._shortest
        return list(zip(starts[long].tolist(), ends[long].tolist(), strict=True))


# ---------------------------------------------------------------------------------------------------------------- stuck


def repeated(samples: Array, before: ArrayLike = np.nan) -> Mask:
    """Return where a sample is the same as the one before it, shape (n, channels).

    Parameters
    ----------
    samples : ndarray, shape (n, channels)
        NaN where a value is missing; it repeats nothing.
    before : array_like, shape (channels,)
        The row before the first.
    """
    same = np.empty_like(samples, dtype=bool)
    same[:1] = samples[:1] == before
    np.equal(samples[1:], samples[:-1], out=same[1:])
    return same


def stuck_runs(samples: Rows, shortest: int) -> list[Span]:
    """Return the runs of at least ``shortest`` rows in which no channel changes.

    Parameters
    ----------
    samples : Rows
        NaN where a value is missing.
    shortest : int
        Rows, at least 2.
    """
    found = LongRuns(shortest - 1)
    for before, piece in _pieces(samples):
        found.add(np.all(repeated(piece, before), axis=1))
    return [(start - 1, end) for start, end in found.result()]


def stuck_spans(samples: Rows, shortest: int) -> list[Span]:
    """Return the long runs of identical samples, where the noise of the rest makes such runs no chance.

    Parameters
    ----------
    samples : Rows
        NaN where a value is missing.
    shortest : int
        Rows of a run that is judged.
    """
    stuck = stuck_runs(samples, shortest)
    if not stuck:
        return stuck
    steps = np.full(samples[:1].shape[1], inf)
    elsewhere = [Stillest(len(samples)) for _ in steps]
    for variances in window_variances(samples, stuck, shortest):
        usable = variances[:, np.isfinite(variances).all(axis=0)]
        for found, channel in zip(elsewhere, usable, strict=True):
            found.add(channel)
    noise = [found.result() for found in elsewhere]
    if None in noise:
        return stuck
    for before, piece in _pieces(samples):
        change = np.abs(np.diff(piece, axis=0, prepend=before[None]))
        steps = np.minimum(steps, np.min(change, axis=0, initial=inf, where=change > 0.0))
    # Noise of half a step changes every other reading: a run of identical ones is then no chance.
    return stuck if np.any(np.sqrt(np.array(noise, dtype=float)) >= steps / 2) else []


def lost_rows(piece: Array, first: int, stuck: Sequence[Span]) -> Mask:
    """Return the rows of a piece of a record in which a value is missing or stuck.

    Parameters
    ----------
    piece : ndarray, shape (n, channels)
    first : int
        Number of its first row.
    stuck : sequence of (start, end)
        Rows of the record, rising.
    """
    lost = np.asarray(~np.isfinite(piece).all(axis=1))
    for start, end in stuck[max(bisect(stuck, (first, first)) - 1, 0) : bisect(stuck, (first + len(piece), 0))]:
        lost[max(start - first, 0) : max(end - first, 0)] = True
    return lost


def _pieces(samples: Rows) -> Iterator[tuple[Array, Array]]:
    """Yield the rows piece by piece, each with the row before it."""
    before = np.full(samples[:1].shape[1], np.nan)
    for start in range(0, len(samples), _CHUNK):
        piece = samples[start : start + _CHUNK]
        yield before, piece
        before = piece[-1]


def noise_of_positions(summaries: Sequence[SampleSummary], step: float) -> float:
    """Return the noise that a channel has in several positions, before rounding.

    Parameters
    ----------
    summaries : sequence of SampleSummary
        Of its samples in each position.
    step : float
        Of the reading, unit; 0 where it is continuous.

    Returns
    -------
    float
        Unit; 0 where none is shown. A reading that flickers between two values scatters by up to half a step however
        small its noise is: it tells nothing of a position in which the reading stands still.
    """
    scatters = [summary.std**2 * (summary.n - 1) / summary.n for summary in summaries]
    if step and np.median(scatters) <= (FLICKER * step) ** 2 * _EXACT:
        return 0.0
    scatter = float(np.mean(scatters))
    return noise_under_rounding(scatter, step) if step else sqrt(scatter)


def identical_by_chance(count: int, noise: float, step: float) -> bool:
    """Return whether noise can leave so many samples in one step of the reading.

    Parameters
    ----------
    count : int
        Of the samples that are identical.
    noise : float
        Standard deviation of the samples, in their unit.
    step : float
        Of the reading, same unit.
    """
    if noise == 0.0:
        return True
    # Of normal noise no step holds more than the one in the middle.
    most = erf(step / noise / sqrt(8.0))
    return most > 0.0 and count * log(most) >= log(CHANCE)


# ---------------------------------------------------------------------------------------------------------------- still


def is_still(
    change: float, uncertainty: float, limit: float, *, sigmas: float = 4.0, shown: bool = False, coverage: float = 2.0
) -> bool:
    """Return whether a change along a line through some samples is none.

    Parameters
    ----------
    change, uncertainty : float
        Of :func:`tiltcal.core.statistics.drift`.
    limit : float
        The largest change that counts as none, same unit.
    sigmas : float
        A change below this many of its standard uncertainties is noise.
    shown : bool
        The change must be shown to be within the limit: noise that might hide a larger one is no excuse.
    coverage : float
        Standard uncertainties within which it is shown.
    """
    return abs(change) <= (limit - coverage * uncertainty if shown else max(limit, sigmas * uncertainty))


def window_scatter(samples: Rows, stuck: Sequence[Span], windows: Sequence[int]) -> Iterator[list[Array]]:
    """Yield the standard deviation in every window, all channels together (root of the sum of squares), in pieces.

    Parameters
    ----------
    samples : Rows
        NaN where a value is missing.
    stuck : sequence of (start, end)
        Rows that cannot be used either, rising.
    windows : sequence of int
        Rows of a window; there may be windows of several lengths.

    Yields
    ------
    list of ndarray, shape (n,)
        Of windows that follow each other, for each length; infinite where a window holds a row that cannot be used.
        There is none where there are fewer rows than a window has.
    """
    for piece, gone in _pieces_of_windows(samples, stuck, max(windows)):
        sums, squares = _WindowSums(piece), _WindowSums(np.einsum("ci,ci->i", piece, piece)[None])
        found = []
        for window in windows:
            variances = np.einsum("ci,ci->i", sums.over(window), sums.over(window))
            variances /= -window
            variances += squares.over(window)[0]
            found.append(np.sqrt(_usable(variances[:_CHUNK], gone, window)))
        yield found


def window_variances(samples: Rows, stuck: Sequence[Span], window: int) -> Iterator[Array]:
    """Yield the sample variance of every channel in every window, shape (channels, n), as :func:`window_scatter`."""
    for piece, gone in _pieces_of_windows(samples, stuck, window):
        variances = _WindowSums(np.square(piece)).over(window) - np.square(_WindowSums(piece).over(window)) / window
        yield _usable(variances[:, :_CHUNK], gone, window)


def _pieces_of_windows(samples: Rows, stuck: Sequence[Span], longest: int) -> Iterator[tuple[Array, Mask]]:
    """Yield the rows of some windows about their mean, shape (channels, n), and which of them cannot be used."""
    for start in range(0, len(samples), _CHUNK):
        piece = samples[start : start + _CHUNK + longest - 1]
        gone = lost_rows(piece, start, stuck)
        # Squares of what is far from zero would lose the noise in their last digits.
        piece = piece - (piece if gone.all() else piece[~gone] if gone.any() else piece).mean(axis=0)
        piece[gone] = 0.0
        yield np.ascontiguousarray(piece.T), gone


def _usable(variances: Array, gone: Mask, window: int) -> Array:
    """Finish the sums of squared differences in windows, shape (..., n); infinite where a row cannot be used."""
    np.maximum(variances, 0.0, out=variances)
    variances /= window - 1
    if gone.any():
        variances[..., _WindowSums(gone[None].astype(float)).over(window)[0, : variances.shape[-1]] > 0.5] = inf
    return variances


class _WindowSums:
    """Sums of the values in every window of any length, shape (channels, n): a window is made of two of half of it."""

    def __init__(self, values: Array) -> None:
        self._known = {1: values}

    def over(self, window: int) -> Array:
        """Return the sums over windows of so many values; there is none where there are fewer values."""
        if window not in self._known:
            half = window // 2
            sums = self.over(half)
            sums = sums[:, : max(sums.shape[1] - half, 0)] + sums[:, half:]
            if window % 2:
                sums = sums[:, :-1] + self._known[1][:, window - 1 :]
            self._known[window] = sums
        return self._known[window]


class Stillest:
    """Collects the scatter in the windows of a record, and keeps the smallest of them.

    Parameters
    ----------
    most : int
        Windows of the record, at the most.
    """

    def __init__(self, most: int) -> None:
        self._most = int(STILLEST * most) + 2
        self._kept = [np.empty(0)]
        self._held, self._count, self._limit = 0, 0, inf

    def add(self, scatter: Array) -> None:
        """Take the scatter in the next windows, shape (n,)."""
        self._count += len(scatter)
        self._kept.append(scatter[scatter <= self._limit])
        self._held += len(self._kept[-1])
        if self._held > 2 * self._most + _CHUNK:
            smallest = np.partition(np.concatenate(self._kept), self._most - 1)[: self._most]
            self._kept, self._held, self._limit = [smallest], self._most, float(smallest[-1])

    def result(self) -> float | None:
        """Return the scatter in the stillest part, the :data:`STILLEST` quantile; None where there is no window."""
        if not self._count:
            return None
        place = STILLEST * (self._count - 1)
        low = int(place)
        return float(np.quantile(np.sort(np.concatenate(self._kept))[low : low + 2], place - low))


# ---------------------------------------------------------------------------------------------------------------- moved


def jumps(means: Array, rounding: ArrayLike = 0.0) -> Mask:
    """Return the blocks before and behind a difference of block means that stands out: a step, a turn.

    Parameters
    ----------
    means : ndarray, shape (blocks, channels)
        NaN where a block has none.
    rounding : array_like, shape (channels,)
        Standard deviation that rounding gives, below which no difference stands out.
    """
    changes = np.diff(means, axis=0)
    difference = np.abs(changes - np.nanmedian(changes, axis=0))
    usual = np.maximum(_SIGMA_OF_MEDIAN * np.nanmedian(difference, axis=0), rounding)
    far = difference > JUMP * usual
    none = np.zeros((1, far.shape[1]), dtype=np.bool_)
    return np.asarray(np.concatenate([far, none]) | np.concatenate([none, far]))


def bursts(scatter: Array, rounding: ArrayLike = 0.0) -> Mask:
    """Return the blocks whose standard deviation stands out: a knock, a vibration; see :func:`jumps`."""
    usual = np.maximum(np.nanmedian(scatter, axis=0), rounding)
    return np.asarray(scatter > BURST * usual)


def outliers(samples: Sequence[float] | Array, step: float = 0.0) -> NDArray[np.intp]:
    """Return the samples of one channel that stand far out of the others; none of fewer than eight.

    Parameters
    ----------
    samples : sequence of float
        Of a sensor at rest.
    step : float
        Of the reading, in the unit of the samples: a distance of two steps is no outlier.
    """
    distance, limit, _ = distances(np.asarray(samples, dtype=float))
    return np.flatnonzero(distance > max(limit, 2.0 * step)) if distance is not None else np.empty(0, np.intp)


def distances(values: Array) -> tuple[Array | None, float, float]:
    """Return how far each sample is from the median, beyond what distance it is far off, and the median.

    Where none is far off, the distances are None, and the limit is a lower bound of it, which many samples show sooner.

    Parameters
    ----------
    values : ndarray, shape (n,)
        At least one; of fewer than eight none is an outlier.
    """
    centre = _median(values)
    if len(values) < FEWEST_SAMPLES:
        return None, inf, centre
    farthest = max(float(values.max()) - centre, centre - float(values.min()))
    bound = OUTLYING * _SIGMA_OF_MEDIAN * _least_median_distance(values, centre)
    if farthest <= bound:
        return None, bound, centre
    distance = np.abs(values - centre)
    limit = OUTLYING * _SIGMA_OF_MEDIAN * _median(distance)
    if farthest > limit:
        # Where more than half of the samples are in one step, that median is 0; the nearest 90 % are not.
        count = max(1, round(0.9 * len(values)))
        nearest = np.partition(distance, count - 1)[:count]
        limit = max(limit, OUTLYING * _SIGMA_OF_NEAREST * float(np.sqrt(np.mean(nearest**2))))
    return (distance if farthest > limit else None), limit, centre


def _least_median_distance(values: Array, centre: float) -> float:
    """Return a number that the median distance from the centre reaches; 0 where a few of the samples show none."""
    if len(values) < _MANY:
        return 0.0
    count = int(0.47 * _SAMPLE)
    near = float(np.partition(np.abs(values[:: len(values) // _SAMPLE] - centre), count)[count])
    # It does where not more than half of the samples are nearer.
    nearer = np.count_nonzero(values < centre + near) - np.count_nonzero(values <= centre - near)
    return near / _EXACT if nearer <= (len(values) - 1) // 2 else 0.0


def _median(values: Array) -> float:
    """Return the median of numbers without a missing one; of many, it is sought among those near that of a sample."""
    middle = len(values) // 2
    if len(values) >= _MANY:
        few = np.sort(values[:: len(values) // _SAMPLE])
        lower, upper = few[[int(share * len(few)) for share in (0.46, 0.54)]]
        below = int(np.count_nonzero(values < lower))
        near = np.compress((values >= lower) & (values <= upper), values)
        if below < middle < below + len(near):
            return _middle(near, middle - below, even=len(values) % 2 == 0)
    return _middle(values, middle, even=len(values) % 2 == 0)


def _middle(values: Array, place: int, *, even: bool) -> float:
    """Return the value of a place by size; of an even number, the mean of it and the one before."""
    parted = np.partition(values, place)
    upper = float(parted[place])
    return (float(parted[:place].max()) + upper) / 2.0 if even else upper
