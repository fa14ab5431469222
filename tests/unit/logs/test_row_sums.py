"""Sums of the rows of a record between bounds."""

from __future__ import annotations

import numpy as np
import pytest

from tiltcal.logs.row_sums import RowSums

BLOCK = 1 << 14
"""Rows that are read at once."""


def test_sums_between_any_rows_are_those_of_numpy() -> None:
    rows = np.random.default_rng(3).normal(1e3, 1.0, (2 * BLOCK, 2))
    bounds = np.array([0, 1, 7, 4000, BLOCK - 1, BLOCK, BLOCK + 1, 30_000, 2 * BLOCK])
    sums = RowSums(rows, bounds[::-1])
    for number, start in enumerate(bounds):
        ends = bounds[number:]
        expected = [rows[start:end].sum(axis=0) for end in ends]
        assert sums.between(np.full(len(ends), start), ends) == pytest.approx(np.array(expected), rel=1e-12)


def test_a_missing_value_does_not_touch_the_sums_behind_it() -> None:
    rows = np.ones((100, 2))
    rows[3] = np.nan
    assert RowSums(rows, np.array([4, 100])).between(np.array([4]), np.array([100])).tolist() == [[96.0, 96.0]]


@pytest.mark.parametrize("changed", [8, 4321, BLOCK - 1, BLOCK, BLOCK + 1])
def test_a_change_is_within_its_rows(changed: int) -> None:
    rows = np.ones((BLOCK + 500, 3))
    rows[changed:, 1] = 2.0
    bounds = np.array([7, changed, changed + 1, len(rows)])
    change = RowSums(rows, bounds).change
    assert change(np.array([7, 7, changed]), np.array([changed, changed + 1, len(rows)])).tolist() == [
        False,
        True,
        False,
    ]
