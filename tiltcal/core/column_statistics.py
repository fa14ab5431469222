"""Statistics of a log of any length in bounded memory: envelopes of its angles over time, histograms, flags."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import FAIL, SUSPECT, count_flags
from tiltcal.core.model import Array

STRETCHES = 600  # fewest stretches of a long log, one for each dot across a page; there are up to twice as many
STEP = 0.005  # width of a histogram's bins, degrees

_REACH = 180.0


class ColumnStatistics:
    """Named angles and flags of a log, summed up row after row, and how many rows have each flag and bit of the reason.

    The rows are parted into stretches of one length; when there are twice as many as are needed, neighbours are joined.
    """

    def __init__(self, angles: Sequence[str]) -> None:
        self.angles = tuple(angles)
        self.rows = 0
        self.flags: Counter[int] = Counter()
        self.reasons: Counter[int] = Counter()
        self._length = 1
        self._least = np.full(
            (2 * STRETCHES, 1 + 2 * len(self.angles)), np.nan
        )  # of the time, the angles, and these with the other sign
        self._bad = np.zeros((2 * STRETCHES, 2), np.int64)
        self._counts = np.zeros((len(self.angles), round(2 * _REACH / STEP) + 1), np.int64)
        self._sums = np.zeros(len(self.angles))

    def add(self, time: Array, angles: Array, flag: NDArray[Any], reason: NDArray[Any]) -> None:
        """Take some rows: time, s, shape (n,); angles, degrees, shape (n, angles), NaN where there is none; flags."""
        count_flags(self.flags, self.reasons, flag, reason)
        for k, column in enumerate(angles.T):
            known = column[np.isfinite(column)]
            place = np.rint((np.clip(known, -_REACH, _REACH) + _REACH) / STEP).astype(np.intp)
            self._counts[k] += np.bincount(place, minlength=self._counts.shape[1])
            self._sums[k] += known.sum()
        if not len(flag):
            return
        while (self.rows + len(flag) - 1) // self._length >= 2 * STRETCHES:
            self._least[:STRETCHES], self._least[STRETCHES:] = np.fmin(self._least[::2], self._least[1::2]), np.nan
            self._bad[:STRETCHES], self._bad[STRETCHES:] = self._bad[::2] + self._bad[1::2], 0
            self._length *= 2
        where = np.arange(self.rows // self._length, (self.rows + len(flag) - 1) // self._length + 1)
        starts = np.maximum(where * self._length - self.rows, 0)
        values = np.concatenate([time[None], angles.T, -angles.T])
        self._least[where] = np.fmin(self._least[where], np.fmin.reduceat(values, starts, axis=1).T)
        for k, bad in enumerate((flag == SUSPECT, flag >= FAIL)):
            self._bad[where, k] += np.add.reduceat(bad, starts, dtype=np.int64)
        self.rows += len(flag)

    @property
    def time(self) -> Array:
        """When each stretch begins, shape (stretches,)."""
        return self._least[: self._used, 0]

    @property
    def low(self) -> Array:
        """Smallest angles of each stretch, shape (stretches, angles), degrees."""
        return self._least[: self._used, 1 : 1 + len(self.angles)]

    @property
    def high(self) -> Array:
        """Largest angles of each stretch, shape (stretches, angles), degrees."""
        return -self._least[: self._used, 1 + len(self.angles) :]

    @property
    def flagged(self) -> Array:
        """Shares of the rows of each stretch that are suspect, and that fail or are missing, shape (stretches, 2)."""
        rows = np.minimum(self._length, self.rows - self._length * np.arange(self._used))
        return np.asarray(self._bad[: self._used] / rows[:, None])

    @property
    def mean(self) -> Array:
        """Mean of each angle, degrees; NaN where it never was a number."""
        count = self._counts.sum(axis=1)
        return np.asarray(np.where(count > 0, self._sums / np.maximum(count, 1), np.nan))

    def histogram(self, bins: int) -> list[tuple[Array, Array]]:
        """Return for each angle the edges of so many bins or fewer, degrees, and the number of rows in each."""
        found = []
        for counts in self._counts:
            (met,) = np.nonzero(counts)
            if not len(met):
                found.append((np.zeros(1), np.zeros(0)))
                continue
            first, last = int(met[0]), int(met[-1]) + 1
            width = -(-(last - first) // bins)
            starts = np.arange(first, last, width)
            edges = np.append(starts, starts[-1] + width) * STEP - _REACH - STEP / 2
            found.append((edges, np.add.reduceat(counts[:last], starts).astype(float)))
        return found

    @property
    def _used(self) -> int:
        return -(-self.rows // self._length)
