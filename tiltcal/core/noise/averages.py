"""Averages of so many samples: their standard deviation and range.

Source: *A Solid State Tilt Meter for Current Meter Attitude Determination*, table I.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.noise.allan import PRESENT

RANGE_OF_100 = 5.0152
"""Mean range of 100 independent values of a normal distribution, in standard deviations (Tippett, 1925)."""


@dataclass(frozen=True)
class Average:
    """The scatter of the averages of so many samples, of one channel.

    Attributes
    ----------
    samples : int
        In each average.
    count : int
        Averages, one behind the other.
    mean, std, range : float
        Unit; NaN where there are too few.
    """

    samples: int
    count: int
    mean: float
    std: float
    range: float


class Averager:
    """Collects averages of so many samples each along some channels."""

    def __init__(self, samples: int, channels: int) -> None:
        self._samples = samples
        self._filled = 0
        self._sum, self._present = np.zeros(channels), np.zeros(channels)
        self._count = np.zeros(channels)
        self._mean, self._squares = np.zeros(channels), np.zeros(channels)
        self._low, self._high = np.full(channels, np.inf), np.full(channels, -np.inf)

    def add(self, samples: Array, present: Mask | None) -> None:
        """Take more samples, zero where they are missing, shape (n, channels); ``present`` is None if none is."""
        if not len(samples):
            return
        if self._samples == 1:
            self._merge(samples, present)
            return
        cuts = np.r_[0, np.arange(self._samples - self._filled, len(samples), self._samples)]
        # Channel by channel in memory, as the samples are.
        sums = np.add.reduceat(samples.T, cuts, axis=1).T
        if present is None:
            counts = np.repeat(np.diff(np.r_[cuts, len(samples)])[None].astype(np.float64), samples.shape[1], axis=0).T
        else:
            counts = np.add.reduceat(present.T.astype(np.float64), cuts, axis=1).T
        sums[0] += self._sum
        counts[0] += self._present
        self._filled = (self._filled + len(samples)) % self._samples
        if self._filled:
            self._sum, self._present = sums[-1], counts[-1]
            sums, counts = sums[:-1], counts[:-1]
        else:
            self._sum, self._present = np.zeros_like(self._sum), np.zeros_like(self._present)
        if len(sums):
            whole = counts >= PRESENT * self._samples
            means = np.divide(sums, counts, out=np.zeros_like(sums), where=whole)
            self._merge(means, None if whole.all() else whole)

    def result(self, channel: int) -> Average:
        """Return what came out of one channel so far."""
        count = int(self._count[channel])
        mean = float(self._mean[channel]) if count else nan
        std = sqrt(self._squares[channel] / (count - 1)) if count > 1 else nan
        spread = float(self._high[channel] - self._low[channel]) if count > 1 else nan
        return Average(self._samples, count, mean, std, spread)

    def _merge(self, means: Array, whole: Mask | None) -> None:
        """Add means; where some are of too few samples, ``whole`` says which count."""
        where = True if whole is None else whole
        more = len(means) if whole is None else whole.sum(axis=0)
        mean = means.sum(axis=0, where=where) / np.maximum(more, 1)
        squares = np.square(means - mean).sum(axis=0, where=where)
        total = self._count + more
        step = mean - self._mean
        # Chan, Golub and LeVeque: two groups' sums of squares about their common mean.
        self._squares += squares + step**2 * self._count * more / np.maximum(total, 1)
        self._mean += step * more / np.maximum(total, 1)
        self._count = total
        self._low = np.minimum(self._low, means.min(axis=0, where=where, initial=np.inf))
        self._high = np.maximum(self._high, means.max(axis=0, where=where, initial=-np.inf))


def decades(rows: int, fewest: int) -> Sequence[int]:
    """1, 10, 100, ... as long as at least ``fewest`` averages of so many fit into the rows."""
    sizes = [1]
    while sizes[-1] * 10 * fewest <= rows:
        sizes.append(sizes[-1] * 10)
    return sizes
