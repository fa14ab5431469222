"""A product of a small matrix with many rows of a log, and quadratic forms of them.

A quadratic form is a product of its coefficients with the products of two values each.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

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


def pairs_of(count: int) -> list[tuple[int, int]]:
    """Return all pairs of a number of things, each once, a thing with itself too."""
    return list(combinations_with_replacement(range(count), 2))


def products_of(table: Array) -> Array:
    """Return the products of two rows each, in the order of :func:`pairs_of`, shape (pairs, n)."""
    count = len(table)
    found = np.empty((count * (count + 1) // 2, table.shape[1]))
    start = 0
    for k, row in enumerate(table):
        end = start + count - k
        np.multiply(row, table[k:], out=found[start:end])
        start = end
    return found


def form(matrix: Array) -> Array:
    """Return the coefficients of a quadratic form by these products, shape (pairs,), from its matrix."""
    whole = matrix + matrix.T
    np.fill_diagonal(whole, matrix.diagonal())
    return np.asarray(whole[_upper_triangle(len(whole))])


@cache
def _upper_triangle(size: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.triu_indices(size)
