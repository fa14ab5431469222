"""What guides an operator: the angle to set and the present one, by the data sheet and the positions before."""

from __future__ import annotations

from dataclasses import replace
from math import radians, sin

import numpy as np
import pytest

from tiltcal.bench.guidance import guidance, in_words, present_gravity
from tiltcal.core.attitude import STRAIGHT, gravity_from_tilt, orientation
from tiltcal.core.plausibility import ExpectedReadings
from tiltcal.drivers import find_model

SCA100T = find_model("sca100t-d02")  # 1024 counts at 0 g, 819 count/g
UP_30 = gravity_from_tilt({"x": 30.0})


def expected(model=SCA100T) -> ExpectedReadings:
    return ExpectedReadings(
        model.channels, model.offset, model.sensitivity, model.offset_spread, model.sensitivity_spread
    )


def counts(x: float, y: float, offset: float = 0.0) -> list[float]:
    """Readings at two tilts, degrees; the offset is in g."""
    return [1024.0 + 819.0 * (sin(radians(angle)) + offset) for angle in (x, y)]


def test_the_angle_to_set_and_the_present_one() -> None:
    shown = guidance(SCA100T, STRAIGHT, counts(29.0, 0.5), UP_30, expected())
    assert [shown["x"][key] for key in ("target", "present", "difference")] == pytest.approx([30.0, 29.0, -1.0])
    assert shown["x"]["ok"]
    assert shown["y"]["difference"] == pytest.approx(0.5)
    # Two of sqrt(0.0023² + 0.03² + (0.0029 0.5)² + (0.03 0.87)² + 0.026²) g.
    assert shown["x"]["tolerance"] == pytest.approx(6.5, abs=0.1)
    assert in_words("x", shown["x"]) == "x  +29.00° (-1.00) ok"
    wrong = guidance(SCA100T, STRAIGHT, counts(0.0, 30.0), UP_30, expected())
    assert [wrong[channel]["ok"] for channel in "xy"] == [False, False]
    assert in_words("x", wrong["x"]).endswith("(-30.00)")


def test_positions_before_correct_the_present_angle() -> None:
    """A part whose offset is 0.03 g, 1.7° at level, shows it less after four positions."""
    learnt = expected()
    for tilt in ({"x": 30.0}, {"x": -30.0}, {"y": 30.0}, {"y": -30.0}):
        learnt.learn(gravity_from_tilt(tilt), np.array(counts(tilt.get("x", 0.0), tilt.get("y", 0.0), 0.03)))
    differences = [
        guidance(SCA100T, STRAIGHT, counts(30.0, 0.0, 0.03), UP_30, one)["y"]["difference"]
        for one in (expected(), learnt)
    ]
    assert differences[0] == pytest.approx(1.72, abs=0.01)
    assert abs(differences[1]) < 0.4


def test_nothing_is_ok_where_nothing_is_known() -> None:
    """The zero of an ADXL202 may be anywhere; in free positions nothing is asked for; an unknown scale has no angle."""
    adxl202 = find_model("adxl202")
    assert guidance(adxl202, STRAIGHT, [0.56, 0.5], UP_30, expected(adxl202))["x"]["ok"] is None
    free = guidance(SCA100T, STRAIGHT, counts(30.0, 0.0), UP_30, None)
    assert (free["x"]["target"], free["x"]["ok"]) == (None, None)
    assert in_words("x", free["x"]) == "x  +30.00°"
    assert guidance(replace(SCA100T, scaled=False), STRAIGHT, counts(30.0, 0.0), UP_30, expected()) == {}


@pytest.mark.parametrize("axes", [("x", "y"), ("-y", "x"), ("z", "x")])
def test_the_present_attitude_is_in_the_frame_of_the_fixture(axes: tuple[str, str]) -> None:
    """A sensor that is exact reads what was set, however it sits; the axis that it lacks is as it was asked for."""
    sits, up = orientation(axes), (0.3, -0.4, 0.75**0.5)
    seen = sits.seen(up)
    shown = guidance(SCA100T, sits, [1024.0 + 819.0 * one for one in seen[:2]], up, expected())
    assert present_gravity(sits, shown, up) == pytest.approx(up)
