"""Disturbances of a record at rest: motion, and a reading that is stuck.

Means of short blocks differ from their neighbours by the noise, and by what it wanders from one to the next; in a block
that differs by far more, or scatters by far more within, the sensor was moved. How much is usual the median says, which
a knock or two does not shift.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import log, sqrt

import numpy as np

from tiltcal.core.detection import bursts, jumps
from tiltcal.core.model import Array
from tiltcal.core.rows import Span, run_bounds, runs

_BLOCK, _MOST_BLOCKS, _FEWEST_BLOCKS = 16, 1 << 16, 8
"""Rows of a block, twice as many and twice that where there are too many blocks; judge no record of fewer."""

_ODD_RUN = 3.0
"""A run of identical rows is stuck if it is so many times longer than the longest that chance makes."""


def moved_rows(columns: Sequence[Array], steps: Sequence[float]) -> list[Span]:
    """Return the rows in which the sensor was moved.

    Parameters
    ----------
    columns : sequence of ndarray, shape (n,)
        Readings; NaN where a value is missing.
    steps : sequence of float
        Of the readings, in their unit; 0 where they are continuous.
    """
    size = _BLOCK
    while len(columns[0]) > size * _MOST_BLOCKS:
        size *= 2
    blocks = len(columns[0]) // size
    if blocks < _FEWEST_BLOCKS:
        return []
    disturbed = np.zeros(blocks, dtype=bool)
    for column, step in zip(columns, steps, strict=True):
        samples = column[: blocks * size].reshape(blocks, size)
        counts = np.isfinite(samples).sum(axis=1).astype(np.float64)
        counts[counts < 2] = np.nan  # of one sample there is no scatter
        mean = np.nansum(samples, axis=1) / counts
        scatter = np.sqrt(np.nansum((samples - mean[:, None]) ** 2, axis=1) / counts)
        rounding = step / sqrt(12.0)
        disturbed |= (jumps(mean[:, None], rounding) | bursts(scatter[:, None], rounding))[:, 0]
    return [(start * size, end * size) for start, end in runs(disturbed)]


def stuck_rows(columns: Sequence[Array]) -> Span | None:
    """Return the longest run of rows that are identical in all columns, if it is longer than chance makes one."""
    same = np.logical_and.reduce([column[1:] == column[:-1] for column in columns])
    starts, ends = run_bounds(same)
    if not len(starts):
        return None
    longest = int(np.argmax(ends - starts))
    start, end = int(starts[longest]), int(ends[longest]) + 1  # a run begins with the row that the others repeat
    rows, length = len(same) + 1, end - start
    others = max(int(same.sum()) - length + 1, 1) / max(rows - length, 2)
    if others >= 0.9:
        return None  # a reading that hardly ever changes: rest looks like that
    likely = log(max(rows, 3)) / -log(others)
    return (start, end) if length > 10 + _ODD_RUN * likely else None
