"""Flags and reasons of rows, marked as QARTOD orders them."""

import numpy as np

from tiltcal.core.flags import FAIL, MISSING, NO_DIRECTION, NOT_A_NUMBER, PASS, RAIL, SUSPECT, mark_columns


def test_a_mark_raises_the_flag_adds_the_reason_and_leaves_missing_rows() -> None:
    table = {
        "a_flag": np.array([PASS, FAIL, MISSING, PASS], np.uint8),
        "a_reason": np.array([0, RAIL, NOT_A_NUMBER, 0], np.uint8),
        "flagpole": np.zeros(4),
    }
    marked = mark_columns(table, np.array([True, True, True, False]), SUSPECT, NO_DIRECTION)
    assert marked["a_flag"].tolist() == [3, 4, 9, 1]
    assert marked["a_reason"].tolist() == [128, 132, 32, 0]
    assert marked["flagpole"] is table["flagpole"]
