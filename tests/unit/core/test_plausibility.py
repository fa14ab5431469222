"""A wrong position is caught before it counts."""

from math import asin, cos, degrees, hypot, radians, sin, tan

import numpy as np
import pytest

from tiltcal.core.angle_readings import AngleReadings
from tiltcal.core.attitude import Vector, gravity_from_tilt
from tiltcal.core.model import Array
from tiltcal.core.plausibility import ExpectedReadings

PLANE = {f"{axis}-tilt{k}": gravity_from_tilt({axis: angle}) for axis in "xy" for k, angle in ((1, 30.0), (2, -30.0))}


def sca100t() -> ExpectedReadings:
    return ExpectedReadings(("x", "y"), 1024.0, 819.0, 0.0023, 0.0029)


def reading(g_x: float, g_y: float, offset: float = 1024.0, sensitivity: float = 819.0) -> Array:
    return np.array([offset + sensitivity * g_x, offset + sensitivity * g_y])


def test_what_accepted_positions_teach_is_bayesian_least_squares() -> None:
    """All at once by the normal equations: the part's spread, 1.5° of attitude, and 5 mg of drift a degree."""
    taken: list[tuple[Vector, Array, float | None]] = [
        (PLANE["x-tilt1"], reading(0.52, 0.01), 24.0),
        (PLANE["y-tilt2"], reading(0.0, -0.49), 5.5),
        ((0.0, 0.0, -1.0), reading(0.03, 0.02), None),
    ]
    known = sca100t()
    for position in taken:
        known.learn(*position)
    for k, channel in enumerate("xy"):
        own = np.eye(4)[1 + k]
        information = np.diag(1.0 / np.where(own, 0.0029, [hypot(0.0023, 0.03), 0.03, 0.03, 0.03]) ** 2)
        against = information @ own
        for gravity, one, at in taken:
            row, u = np.array([1.0, *gravity]), hypot(sin(radians(1.5)), 0.005 * (24.0 if at is None else at) - 0.12)
            information = information + np.outer(row, row) / u**2
            against = against + row * (one[k] - 1024.0) / 819.0 / u**2
        row, covariance = np.array([1.0, *PLANE["x-tilt2"]]), np.linalg.inv(information)
        mean, u = row @ covariance @ against, hypot(sin(radians(1.5)), 0.005 * 10.0)
        means, deviations = known.in_g(PLANE["x-tilt2"], 34.0)
        assert (means[k], deviations[k]) == pytest.approx((mean, np.sqrt(row @ covariance @ row + u**2)), rel=1e-9)
        assert known.expected(PLANE["x-tilt2"])[channel] == pytest.approx(1024.0 + 819.0 * mean)
        off = reading(*np.where(np.arange(2) == k, mean - 7.0 * deviations[k], means))
        assert known.distance(PLANE["x-tilt2"], off, 34.0) == pytest.approx(7.0)


@pytest.mark.parametrize(
    ("g_x", "said"),
    [(0.51, None), (-0.49, "tilt2"), (-0.18, "tilt2"), (-0.15, ""), (0.0, ""), (0.87, None), (0.89, "")],
)
def test_another_position_is_named_where_it_fits_twice_as_well(g_x: float, said: str | None) -> None:
    """Between -0.5 g and 0.5 g the distances are as one to two at -1/6 g; eight deviations of 47 mg are too far."""
    why = sca100t().objection("x-tilt1", PLANE, reading(g_x, -0.01))
    expected = f"this looks like x-{said}: is the sensor turned round?"
    if said == "":
        expected = (
            f"no position of this procedure reads like this (x reads {1024 + 819 * g_x:.6g} where about 1433.5 is "
            "expected, y reads 1015.81 where about 1024 is expected): is the sensor at the angle, and are its axes "
            "named right?"
        )
    assert why == (None if said is None else expected)


@pytest.mark.parametrize("offset", [0.38, 0.5, 0.62])
def test_a_part_of_unknown_offset_is_judged_by_its_own_positions(offset: float) -> None:
    """The first position of an ADXL202 can hardly be judged; once two are known, the third can."""
    known = ExpectedReadings(("x", "y"), 0.5, 0.125, 1.1, 0.1)
    first = reading(0.5, 0.0, offset, 0.13)
    assert known.objection("x-tilt1", PLANE, first) is None
    known.learn(PLANE["x-tilt1"], first)
    known.learn(PLANE["y-tilt1"], reading(0.0, 0.5, offset, 0.13))
    assert str(known.objection("x-tilt2", PLANE, reading(0.5, 0.0, offset, 0.13))).endswith(
        "looks like x-tilt1: is the sensor turned round, or was a position before it wrong (go back)?"
    )
    assert known.objection("x-tilt2", PLANE, reading(-0.5, 0.0, offset, 0.13)) is None


def test_an_attitude_that_comes_again_is_named() -> None:
    known = ExpectedReadings(("x", "y", "z"), 10.0, 2.0, 0.01, 0.01)
    before = {"p1": np.array([12.0, 10.0, 10.0]), "p2": np.array([10.0, 10.0, 12.4])}
    for angle, name in ((4.9, "p2"), (-4.9, "p2"), (5.1, None), (180.0, None), (86.0, "p1")):
        again = known.repeated(before, 10.0 + 2.0 * np.array([sin(radians(angle)), 0.0, cos(radians(angle))]))
        expected = f"this is the attitude of {name} again: hold the sensor in a different attitude"
        assert again == (None if name is None else expected)


@pytest.mark.parametrize("slope", [0.0, 1000.0])
@pytest.mark.parametrize("euler", [False, True])
def test_what_prints_angles_is_judged_in_g(slope: float, euler: bool) -> None:
    """1° or, of slopes, 1000 mm/m of a tangent of 1; roll is asin(g_y / cos pitch)."""
    unit = slope or degrees(1.0)
    known = ExpectedReadings(("x", "y"), 0.0, unit, 0.001, 0.001, AngleReadings(slope, euler))
    up = gravity_from_tilt({"x": 20.0, "y": 30.0})
    x, y = asin(up[0]), asin(up[1] / (cos(asin(up[0])) if euler else 1.0))
    near = [unit * (tan(angle) if slope else angle) for angle in (x, y)]
    assert known.distance(up, np.array(near), None) == pytest.approx(0.0, abs=1e-9)
    if not slope and not euler:  # beyond 90° it is 90°
        for side in (1.0, -1.0):
            assert known.distance((side, 0.0, 0.0), np.array([side * 2.5 * unit, 0.0]), None) == pytest.approx(0.0)
    alone = [unit * (tan(asin(one)) if slope else asin(one)) for one in up[:2]]
    assert list(known.expected(up).values()) == pytest.approx(alone)
