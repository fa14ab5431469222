"""The step of readings that are rounded, found from the readings themselves."""

from __future__ import annotations

import numpy as np

from tiltcal.core.model import Array

MOST_VALUES = 4096
"""Different values beyond which a reading counts as continuous."""

_REPEATED = 4.0
"""How often a rounded reading takes each value, on average, at the least."""

_EVEN = 0.02
"""How far the distances of values may be off whole steps, in steps: readings are written with so many digits."""


class Quantisation:
    """Collects the different values of one channel.

    Attributes
    ----------
    values : ndarray or None
        Those seen so far, rising; None where there are too many.
    """

    def __init__(self) -> None:
        self.values: Array | None = np.empty(0)
        self._samples = 0

    def add(self, samples: Array) -> None:
        """Take more samples, none of them missing, shape (n,)."""
        self._samples += len(samples)
        if self.values is None:
            return
        self.values = np.union1d(self.values, samples)
        if len(self.values) > MOST_VALUES:
            self.values = None

    def result(self) -> float:
        """Return the step; 0 where the reading is continuous, as far as the readings show."""
        values = self.values
        if values is None or len(values) < 2 or self._samples < _REPEATED * len(values):
            return 0.0
        distances = np.diff(values)
        smallest = float(distances.min())
        whole = np.round(distances / smallest)
        if np.any(np.abs(distances / smallest - whole) > _EVEN * whole):
            return 0.0
        return float(distances.sum() / whole.sum())
