"""A product of a small matrix with many rows of a log."""

from __future__ import annotations

import numpy as np

from tiltcal.core.model import Array

_ONE_THREAD = 1 << 18
"""Multiplications for which the linear algebra starts no threads: they cost more here than they bring."""


def product(matrix: Array, columns: Array, out: Array | None = None) -> Array:
    """Return ``matrix @ columns``, shapes (k, m) and (m, n), in one thread however many columns there are."""
    found = np.empty((len(matrix), columns.shape[1])) if out is None else out
    step = columns_of_one_thread(matrix)
    for start in range(0, columns.shape[1], step):
        part = slice(start, start + step)
        np.matmul(matrix, columns[:, part], out=found[:, part])
    return found


def columns_of_one_thread(matrix: Array) -> int:
    """Return by how many columns a matrix is multiplied without threads."""
    return max(1, _ONE_THREAD // max(1, matrix.size))
