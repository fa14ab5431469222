"""Disturbances of a record at rest: motion, and a reading that is stuck.

Means of short blocks differ from their neighbours by the noise, and by what it wanders from one to the next; in a block
that differs by far more, or scatters by far more within, the sensor was moved. How much is usual the median says, which
a knock or two does not shift.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, sqrt

import numpy as np

from tiltcal.core.detection import bursts, jumps
from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.rows import repeated, run_bounds, runs

BLOCK = 16
"""Rows of a block, in a short record."""

MOST_BLOCKS = 1 << 16
"""Blocks kept; in a longer record they are of twice the rows, and twice that, ..."""

_FEWEST_BLOCKS = 8

_ODD_RUN = 3.0  # a run of identical rows so many times longer than the longest that chance makes is none of chance


@dataclass(frozen=True)
class RowRange:
    """Some rows of a record, the end exclusive."""

    start: int
    end: int


class Disturbances:
    """Collects what shows motion and stuck readings along the samples of some channels."""

    def __init__(self, channels: int) -> None:
        empty = np.empty((0, channels))
        self._rows = 0
        self._size = BLOCK
        self._pending, self._pending_there = empty.T, empty.T.astype(bool)
        self._blocks = [_Blocks(empty, empty, empty)]
        self._held = 0
        self._last = np.full((1, channels), np.nan)
        self._repeats, self._run, self._longest = 0, 0, RowRange(0, 0)

    def add(self, samples: Array, present: Mask | None) -> None:
        """Take more samples, zero where they are missing, shape (n, channels); ``present`` is None if none is."""
        self._follow_runs(samples if present is None else np.where(present, samples, np.nan))
        self._rows += len(samples)
        there = np.ones((1, 1), bool) if present is None else present
        there = np.concatenate([self._pending_there, np.broadcast_to(there.T, samples.T.shape)], axis=1)
        values = np.concatenate([self._pending, samples.T], axis=1)
        whole = values.shape[1] // self._size * self._size
        self._pending, self._pending_there = values[:, whole:].copy(), there[:, whole:].copy()
        if whole:
            shape = (len(values), -1, self._size)
            cut, counted = values[:, :whole].reshape(shape), there[:, :whole].reshape(shape)
            sums, squares = np.einsum("cij->ic", cut), np.einsum("cij,cij->ic", cut, cut)
            self._blocks.append(_Blocks(sums, squares, np.count_nonzero(counted, axis=2).T))
            self._held += whole // self._size
        while self._held > MOST_BLOCKS:
            self._coarsen()

    def moved(self, step: Array) -> list[RowRange]:
        """Rows in which the sensor was moved; ``step``, shape (channels,), is 0 where a reading is continuous."""
        blocks = _joined(self._blocks)
        if len(blocks.counts) < _FEWEST_BLOCKS:
            return []
        rounding = step / sqrt(12.0)
        found = jumps(blocks.mean, rounding) | bursts(blocks.scatter, rounding)
        return [RowRange(start * self._size, end * self._size) for start, end in runs(np.any(found, axis=1))]

    def stuck(self) -> RowRange | None:
        """Return the longest run of rows that are identical in all channels, if it is longer than chance makes one."""
        length = self._longest.end - self._longest.start
        others = max(self._repeats - length + 1, 1) / max(self._rows - length, 2)
        if others >= 0.9:
            return None  # a reading that hardly ever changes: rest looks like that
        likely = log(max(self._rows, 3)) / -log(others)
        return self._longest if length > 10 + _ODD_RUN * likely else None

    def _follow_runs(self, samples: Array) -> None:
        if not len(samples):
            return
        same = np.asarray(repeated(samples, self._last).all(axis=1))
        self._last = samples[-1:]
        self._repeats += int(same.sum())
        starts, ends = run_bounds(same)
        starts -= 1  # a run begins with the row that the others repeat
        if same[0]:
            starts[0] = -self._run
        if len(starts):
            longest = int(np.argmax(ends - starts))
            if ends[longest] - starts[longest] > self._longest.end - self._longest.start:
                self._longest = RowRange(self._rows + int(starts[longest]), self._rows + int(ends[longest]))
        self._run = len(samples) - int(starts[-1]) if same[-1] else 1

    def _coarsen(self) -> None:
        """Join blocks by twos; an odd one stays as it is, half as long, which moves those behind it by as much."""
        blocks = _joined(self._blocks)
        even = len(blocks.counts) // 2 * 2
        odd = _Blocks(blocks.sums[even:], blocks.squares[even:], blocks.counts[even:])
        self._blocks = [blocks.halved(even), odd]
        self._held = even // 2 + len(odd.counts)
        self._size *= 2


@dataclass(frozen=True)
class _Blocks:
    """Sums, sums of squares and numbers of present samples, shape (blocks, channels)."""

    sums: Array
    squares: Array
    counts: Array

    def halved(self, even: int) -> _Blocks:
        parts = (self.sums, self.squares, self.counts)
        return _Blocks(*(part[0:even:2] + part[1:even:2] for part in parts))

    @property
    def mean(self) -> Array:
        return np.asarray(self.sums / np.where(self.counts > 1, self.counts, np.nan))

    @property
    def scatter(self) -> Array:
        """Standard deviation within each block."""
        variance = self.squares / np.where(self.counts > 1, self.counts, np.nan) - self.mean**2
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _joined(blocks: list[_Blocks]) -> _Blocks:
    return _Blocks(
        np.concatenate([block.sums for block in blocks]),
        np.concatenate([block.squares for block in blocks]),
        np.concatenate([block.counts for block in blocks]),
    )
