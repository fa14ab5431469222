"""A wrong position is caught before it counts."""

import numpy as np
import pytest

from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.core.plausibility import ExpectedReadings

PLANE = {
    "x-tilt1": gravity_from_tilt({"x": 30.0}),
    "x-tilt2": gravity_from_tilt({"x": -30.0}),
    "y-tilt1": gravity_from_tilt({"y": 30.0}),
    "y-tilt2": gravity_from_tilt({"y": -30.0}),
}


def sca100t() -> ExpectedReadings:
    return ExpectedReadings(("x", "y"), 1024.0, 819.0, 0.0023, 0.0029)


def adxl202() -> ExpectedReadings:
    """Zero-g duty cycle and sensitivity differ much from part to part."""
    return ExpectedReadings(("x", "y"), 0.5, 0.125, 0.5, 0.1)


def reading(g_x: float, g_y: float, offset: float = 1024.0, sensitivity: float = 819.0):
    return np.array([offset + sensitivity * g_x, offset + sensitivity * g_y])


def test_the_right_position_passes() -> None:
    assert sca100t().objection("x-tilt1", PLANE, reading(0.51, -0.01)) is None


def test_turned_round_is_named() -> None:
    assert "looks like x-tilt2" in str(sca100t().objection("x-tilt1", PLANE, reading(-0.49, 0.01)))


def test_a_position_that_is_met_twice_as_well_is_named() -> None:
    """Between -0.5 g and 0.5 g the distances are as one to two at -1/6 g."""
    assert "looks like x-tilt2" in str(sca100t().objection("x-tilt1", PLANE, reading(-0.18, 0.0)))
    assert "no position of this procedure" in str(sca100t().objection("x-tilt1", PLANE, reading(-0.15, 0.0)))


def test_nowhere_near_any_position_tells_what_was_expected() -> None:
    why = str(sca100t().objection("x-tilt1", PLANE, reading(0.0, 0.0)))
    assert "x reads 1024" in why
    assert "1433.5" in why


@pytest.mark.parametrize("offset", [0.38, 0.5, 0.62])
def test_a_part_of_unknown_offset_is_judged_by_its_own_positions(offset: float) -> None:
    """The first position of an ADXL202 can hardly be judged; once two are known, the third can."""
    known = adxl202()
    first = reading(0.5, 0.0, offset, 0.13)
    assert known.objection("x-tilt1", PLANE, first) is None
    known.learn(PLANE["x-tilt1"], first)
    known.learn(PLANE["y-tilt1"], reading(0.0, 0.5, offset, 0.13))
    assert "looks like x-tilt1" in str(known.objection("x-tilt2", PLANE, reading(0.5, 0.0, offset, 0.13)))
    assert known.objection("x-tilt2", PLANE, reading(-0.5, 0.0, offset, 0.13)) is None


def test_a_cold_offset_is_no_wrong_position() -> None:
    """0.1 g of drift at the freezing point of water, as the tilt meter paper quotes for the ADXL202."""
    level = {"level-warm": (0.0, 0.0, 1.0), "x-45": gravity_from_tilt({"x": 45.0})}
    known = adxl202()
    known.learn(level["level-warm"], reading(0.0, 0.0, 0.5, 0.125), 24.0)
    known.learn(level["x-45"], reading(0.7071, 0.0, 0.5, 0.125), 24.0)
    cold = {**level, "level-cold": (0.0, 0.0, 1.0)}
    assert known.objection("level-cold", cold, reading(0.1, -0.08, 0.5, 0.125), 5.5) is None
