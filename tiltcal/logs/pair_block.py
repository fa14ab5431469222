"""Some rows of a log of accelerometer pairs, in order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array


@dataclass(frozen=True)
class PairBlock:
    """Some rows of a log, in order.

    Attributes
    ----------
    theta : ndarray, shape (n,)
        Stage angle, degrees; NaN where it is missing.
    readings : ndarray, shape (n, channels)
        NaN where a value is missing.
    time : ndarray, shape (n,), or None
        Seconds; None where the log has no such column.
    first : int
        Number of the first row, counted from 0.
    """

    theta: Array
    readings: Array
    time: Array | None
    first: int

    def complete(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """Angle, readings and number of the rows in which no value is missing."""
        rows = self.first + np.arange(len(self.theta), dtype=np.int64)
        good = np.isfinite(self.theta) & np.isfinite(self.readings).all(axis=1)
        if good.all():
            return self.theta, self.readings, rows
        return self.theta[good], self.readings[good], rows[good]

    def rows(self, where: slice) -> PairBlock:
        """Some of the rows."""
        time = None if self.time is None else self.time[where]
        first = self.first + where.indices(len(self.theta))[0]
        return PairBlock(self.theta[where], self.readings[where], time, first)

    def followed_by(self, other: PairBlock) -> PairBlock:
        """One stretch of this one and the next."""
        time = None if self.time is None or other.time is None else np.concatenate([self.time, other.time])
        return PairBlock(
            np.concatenate([self.theta, other.theta]),
            np.concatenate([self.readings, other.readings]),
            time,
            self.first,
        )
