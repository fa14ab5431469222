"""Digits of an uncertainty, against decimal arithmetic."""

from __future__ import annotations

from decimal import ROUND_CEILING, Decimal

import numpy as np
import pytest

from tiltcal.core.angle_uncertainty import round_up


@pytest.mark.parametrize(
    "numbers",
    [
        [0.1301, 0.14010001, 0.2222222],  # one power of ten
        [0.0911111, 0.1300001, 17.23456, 1.23456e-5],  # several
        [0.0, 0.130001, np.nan, 0.222222],
        [np.nan, np.nan, 0.0333333],
    ],
)
def test_four_digits_or_five_and_never_less(numbers: list[float]) -> None:
    room = np.array([numbers, numbers])
    round_up(room)
    for rounded, number in zip(room[1], numbers, strict=True):
        if not number > 0.0:
            assert np.array_equal(rounded, number, equal_nan=True)
            continue
        steps = {Decimal(10) ** (Decimal(number).adjusted() - digits) for digits in (3, 4)}
        assert rounded in {float(Decimal(number).quantize(step, ROUND_CEILING)) for step in steps}


def test_neighbours_do_not_change_the_digits() -> None:
    alone, beside = np.array([0.0911111]), np.array([0.0911111, 17.0])
    round_up(alone)
    round_up(beside)
    assert alone[0] == beside[0]
