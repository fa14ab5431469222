"""Quadratic forms of many rows of a log, as a product of coefficients with the products of two derivatives each."""

from __future__ import annotations

from functools import cache
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array


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
