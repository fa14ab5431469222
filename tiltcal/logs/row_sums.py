"""Sums of the rows of a long record between many bounds, from one pass over it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.rows import Rows, repeated

_BLOCK = 1 << 14
"""Rows that are read at once."""

Numbers = NDArray[np.intp]
"""Numbers of rows."""


class RowSums:
    """Sums of the rows between bounds, and whether they change.

    Parameters
    ----------
    readings : Rows
        NaN where a value is missing; it counts as zero, and as a change.
    bounds : ndarray of int, shape (k,)
        All first rows, and rows behind the last, that will be asked for; in any order.
    """

    def __init__(self, readings: Rows, bounds: Numbers) -> None:
        self._bounds = np.unique(bounds)
        channels = readings[:1].shape[1]
        # Sums of the block of a bound, up to it, and of the blocks before: one sum would lose digits.
        self._sums, self._blocks = (np.zeros((len(self._bounds), channels + 1)) for _ in range(2))
        self._changed = np.zeros(len(self._bounds))
        before, total = np.full(channels, np.nan), np.zeros(channels + 1)
        for start in range(0, len(readings) + 1, _BLOCK):
            block = readings[start : start + _BLOCK]
            first, last = np.searchsorted(self._bounds, [start, start + _BLOCK])
            self._blocks[first:last] = total
            if not len(block):
                break
            values = np.empty((channels + 1, len(block)))
            values[:-1], values[-1] = block.T, ~repeated(block, before).all(axis=1)
            values[np.isnan(values)] = 0.0
            places = self._bounds[first:last] - start
            inside = places[places < len(block)]
            self._changed[first : first + len(inside)] = values[-1, inside]
            cuts = np.unique(np.append(0, inside))
            up_to = np.cumsum(np.add.reduceat(values, cuts, axis=1), axis=1)
            total, before = total + up_to[:, -1], block[-1]
            behind = np.searchsorted(cuts, places)
            self._sums[first:last] = np.where(behind > 0, up_to[:, behind - 1], 0.0).T

    def between(self, starts: Numbers, ends: Numbers) -> Array:
        """Return the sums of the rows from each start to before each end, shape (k, channels)."""
        first, last = np.searchsorted(self._bounds, starts), np.searchsorted(self._bounds, ends)
        return self._between(first, last)[:, :-1]

    def change(self, starts: Numbers, ends: Numbers) -> Mask:
        """Return whether a reading changes from each start to before each end, shape (k,)."""
        first, last = np.searchsorted(self._bounds, starts), np.searchsorted(self._bounds, ends)
        # The first row need not repeat the row before it.
        return np.asarray(self._between(first, last)[:, -1] > self._changed[first])

    def _between(self, first: Numbers, last: Numbers) -> Array:
        return np.asarray((self._blocks[last] - self._blocks[first]) + (self._sums[last] - self._sums[first]))
