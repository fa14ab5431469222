"""The median and the largest of millions of positive numbers, in a memory that does not grow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array

_CODES = 1 << 15
"""Sign, exponent and the seven leading bits of the mantissa: neighbours are a per cent apart."""


class ColumnWidths:
    """Half widths of intervals, counted by size; NaN is none."""

    def __init__(self) -> None:
        self._counts = np.zeros(_CODES, np.int64)
        self._largest = 0.0

    def add(self, widths: Array) -> None:
        """Count some more."""
        known = widths[np.isfinite(widths)]
        if len(known):
            self._largest = max(self._largest, float(known.max()))
            self._counts += np.bincount(_codes(known), minlength=_CODES)

    @property
    def median(self) -> float | None:
        """To half a per cent; None where there is none."""
        total = int(self._counts.sum())
        if not total:
            return None
        code = int(np.searchsorted(np.cumsum(self._counts), (total + 1) // 2))
        ends = np.array([code << 16, (code + 1) << 16], np.int32).view(np.float32)
        return min(float(ends.mean()), self._largest)

    @property
    def largest(self) -> float | None:
        """None where there is none."""
        return self._largest if self._counts.any() else None


def _codes(numbers: Array) -> NDArray[np.int32]:
    return np.asarray(numbers.astype(np.float32).view(np.int32) >> 16)
