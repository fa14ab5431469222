"""The check that the length of a magnetic field stays what it usually is."""

from __future__ import annotations

from bisect import insort
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import MAGNETIC, SUSPECT, mark_columns
from tiltcal.core.model import Array

FIELD_TOLERANCE = 0.05
"""The share of its usual length by which the field may differ."""

_USUAL = 1000
"""Rows of which the median length of the field is the usual one."""


class FieldLength:
    """Rows whose field is longer or shorter than usual.

    The usual length is the median of the first thousand rows, or of those up to the row itself; so it does not depend
    on where blocks end.
    """

    def __init__(self) -> None:
        self._first: list[float] = []

    def flagged(self, table: Mapping[str, NDArray[Any]], field: Array) -> dict[str, NDArray[Any]]:
        """Return the columns of some rows, flagged 3 with reason 128 where the field has another length than usual.

        Parameters
        ----------
        table : mapping of str to ndarray
            As :func:`tiltcal.core.flags.mark_columns` takes it.
        field : ndarray, shape (n, 3)
            Of the next rows, in order.
        """
        wandering = self.wanders(np.sqrt(np.einsum("ni,ni->n", field, field)))
        return mark_columns(table, wandering, SUSPECT, MAGNETIC)

    def wanders(self, lengths: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return the rows whose length differs by more than :data:`FIELD_TOLERANCE`; NaN does not.

        Parameters
        ----------
        lengths : ndarray, shape (n,)
            Of the next rows, in order.
        """
        usual = np.full(len(lengths), np.nan)
        row = 0
        while row < len(lengths) and len(self._first) < _USUAL:
            if np.isfinite(lengths[row]):
                insort(self._first, float(lengths[row]))
            usual[row] = self._median()
            row += 1
        usual[row:] = self._median()
        return np.asarray(np.abs(lengths - usual) > FIELD_TOLERANCE * usual)

    def _median(self) -> float:
        count = len(self._first)
        return (self._first[(count - 1) // 2] + self._first[count // 2]) / 2.0 if count else np.nan
