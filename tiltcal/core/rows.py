"""Rows of a record of any length: runs, repeated and stuck rows, and the scatter in windows.

A record is read piece by piece, so that a long one takes no more memory than a short one.

Sources: Tedaldi, Pretto and Menegatti (2014) for the scatter in windows; QARTOD's flat line test for stuck readings.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterator, Sequence
from math import inf
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array

Span = tuple[int, int]
"""First row and the row behind the last."""


class Rows(Protocol):
    """The rows of a record, shape (n, channels), of which slices are taken: an array, or a long log in a file."""

    def __len__(self) -> int: ...
    def __getitem__(self, rows: slice, /) -> Array: ...


STILLEST = 0.01
"""The share of the windows of a record that counts as its stillest part."""

_CHUNK = 1 << 14


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
