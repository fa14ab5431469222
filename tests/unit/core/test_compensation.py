"""The compensation kernel against the model that it inverts, and the flags of its rows."""

from dataclasses import replace
from math import acos, asin, cos, degrees, inf, isfinite, nan, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.closed_forms import first_order_compensation, tilt_from_channel
from tiltcal.core.compensation import Compensated, Compensation
from tiltcal.core.model import Array, Coefficients, Limits, Mounting, Thermal

OFFSET = (1024.6, 1021.9)
TWO = ((818.2, 9.1), (-6.4, 820.7))
TWO_OF_THREE = ((818.2, 9.1, -14.0), (-6.4, 820.7, 22.5))
THREE = ((1333.0, 12.0, -7.0), (-9.0, 1341.0, 15.0), (4.0, -11.0, 1320.0))


def coefficients(
    sensitivity: tuple[tuple[float, ...], ...],
    *,
    offset: tuple[float, ...] | None = None,
    thermal: Thermal | None = None,
    mounting: Mounting | None = None,
) -> Coefficients:
    channels, axes = ("x", "y", "z")[: len(sensitivity)], ("x", "y", "z")[: len(sensitivity[0])]
    zero = offset or (*OFFSET, -30.0)[: len(channels)]
    return Coefficients(channels, axes, np.array(zero), np.array(sensitivity), thermal, mounting)


def second_order(channels: int) -> Thermal:
    drift = np.array([[0.21, -0.004], [-0.05, 0.002], [0.4, 0.003]])[:channels]
    gain = np.array([[2e-4, -3e-6], [-1e-4, 1e-6], [5e-5, 2e-6]])[:channels]
    return Thermal(24.0, (-40.0, 85.0), drift, gain)


def directions(count: int, seed: int) -> Array:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    unit: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def test_one_channel_takes_the_other_axes_to_be_level() -> None:
    """A sensor of one axis from `plane`, which determines what y adds to it as well."""
    known = Coefficients(("x",), ("x", "y"), np.array([3.0]), np.array([[6554.0, 120.0]]))
    result = Compensation(known)(np.array([[3.0], [3.0 + 6554.0 * 0.17], [3.0 - 6554.0 * 0.1]]))
    assert result.tilt[:, 0] == pytest.approx([0.0, degrees(asin(0.17)), degrees(asin(-0.1))])


def test_first_order_is_eq_6_on_each_channel() -> None:
    (xx, xy), (yx, yy) = TWO
    readings = coefficients(TWO).predict(directions(500, 4) * 0.9)
    expected = []
    for u_x, u_y in readings.tolist():
        x = first_order_compensation(u_x, u_y, OFFSET[1], xy, yy)
        y = first_order_compensation(u_y, u_x, OFFSET[0], yx, xx)
        expected.append(np.degrees([tilt_from_channel(x, OFFSET[0], xx), tilt_from_channel(y, OFFSET[1], yy)]))
    result = Compensation(coefficients(TWO), first_order=True)(readings)
    np.testing.assert_allclose(result.tilt, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("matrix", [TWO, TWO_OF_THREE, THREE], ids=["two", "two over three", "three"])
@pytest.mark.parametrize(
    "mounting", [None, Mounting(-0.5, 0.3, 0.3), Mounting(0.2, -0.6, 2.0), Mounting(-3.0, 0.3, 1.7)]
)
def test_the_kernel_undoes_the_model(matrix: tuple[tuple[float, ...], ...], mounting: Mounting | None) -> None:
    """Bent, with temperature terms of second order; g_z of two channels has the sign of the side that is up."""
    bend = np.array([[0.02, -0.01], [-0.015, 0.03], [0.01, 0.02]])[: len(matrix)]
    known = replace(coefficients(matrix, thermal=second_order(len(matrix)), mounting=mounting), nonlinearity=bend)
    turn = np.eye(3) if mounting is None else mounting_matrix(mounting)
    up, two = directions(2000, 7), len(matrix) == 2
    if two:
        up[:, 2] = np.copysign(up[:, 2], turn[2, 2])
        up = up[np.abs(up[:, 2]) > 0.1]  # nearer to the horizon two attitudes read alike
    t = np.random.default_rng(7).uniform(-40.0, 85.0, len(up))
    result, gravity = Compensation(known)(known.predict(up, t), t), up @ turn.T
    x, y, z = gravity.T
    if two:
        np.testing.assert_allclose(result.gravity, gravity[:, :2], rtol=0, atol=2e-8)
        np.testing.assert_allclose(result.angles, np.degrees(np.arcsin([x, y])).T, rtol=0, atol=1e-3)
    else:
        np.testing.assert_allclose(result.gravity, gravity, rtol=0, atol=1e-11)
        tilts = [np.arctan2(a, np.hypot(b, c)) for a, b, c in ((x, y, z), (y, x, z), (z, x, y), (x, y, z))]
        expected = np.degrees([*tilts, np.arctan2(y, z), np.arctan2(np.hypot(x, y), z)])
        np.testing.assert_allclose(result.angles, expected.T, rtol=0, atol=1e-6)
    assert set(verdicts(result)) == {(1, 0)}


THOUSAND = coefficients(((1000.0, 0.0, 0.0), (0.0, 1000.0, 0.0), (0.0, 0.0, 1000.0)), offset=(0.0, 0.0, 0.0))
PLAIN = coefficients(((1000.0, 0.0), (0.0, 1000.0)), offset=(0.0, 0.0))


def verdicts(result: Compensated) -> list[tuple[int, int]]:
    return list(zip(result.flag.tolist(), result.reason.tolist(), strict=True))


def test_the_length_of_gravity_is_judged_in_every_row() -> None:
    up = np.array([0.6, 0.0, -0.8])
    angles = [degrees(asin(0.6)), 0.0, -degrees(asin(0.8)), degrees(asin(0.6)), 180.0, degrees(acos(-0.8))]
    for verdict, lengths in {
        (1, 0): (1.0, 1.02, 0.98),
        (3, 256): (1.0201, 0.9799, 0.5, 2.0),
        (4, 256): (0.4999, 2.0001, 9.81, 1e200),
    }.items():
        out = Compensation(THOUSAND)(np.outer(lengths, 1000.0 * up))
        assert verdicts(out) == [verdict] * len(lengths)
        np.testing.assert_allclose(out.angles, [angles if verdict[0] < 4 else 6 * [nan]] * len(lengths), atol=1e-12)
        np.testing.assert_allclose(out.gravity, np.outer(lengths, up), rtol=1e-12)
    rows = [[0.0, 0.0, 1049.0], [0.0, 0.0, 1051.0], [0.0, 0.0, 499.0]]
    assert Compensation(THOUSAND, Limits(length=0.05))(rows).flag.tolist() == [1, 3, 4]
    assert Compensation(THOUSAND, Limits(length=0.7))(rows).flag.tolist() == [1, 1, 4]


@pytest.mark.parametrize("roll", [90.0, -60.0, 92.0, -120.0])
def test_on_edge_rows_without_a_sign_have_no_number(roll: float) -> None:
    """Nothing shows the sign of the third axis where the sensor itself is not near level."""
    up = directions(5000, 4)
    own = up @ mounting_matrix(Mounting(radians(roll), 0.0, 0.0))
    mounted = replace(coefficients(((800.0, 0.0), (0.0, 800.0))), mounting=Mounting(roll=radians(roll)))
    out = Compensation(mounted)(mounted.predict(own))
    unknown = np.abs(own[:, 2]) < cos(radians(45.0))
    assert set(out.flag[unknown].tolist()) == {4}
    assert (out.reason[unknown] & 128 > 0).all()
    assert np.isnan([out.gravity[unknown, 1], out.tilt[unknown, 1]]).all()
    np.testing.assert_allclose(out.gravity[:, 0], up[:, 0], atol=1e-9)  # x lies along the line of the roll
    side = -1.0 if abs(roll) > 95.0 else 1.0
    stands = ~unknown & (side * own[:, 2] > 0.0)
    np.testing.assert_allclose(out.gravity[stands], up[stands, :2], atol=1e-9)
    assert set(out.flag[stands].tolist()) == {1}


class TestFlags:
    """SPEC 10, one rule after the other. The sensor reads 1000 per g around 0."""

    def test_the_arcsine_is_trapped(self) -> None:
        readings = [500.0, 1000.0, -1000.0, 1000.001, -1010.0, 1020.0, 1020.001, -5000.0]
        result = Compensation(PLAIN)([[reading, 0.0] for reading in readings])
        assert result.tilt[:, 0] == pytest.approx([30.0, 90.0, -90.0, 90.0, -90.0, 90.0, nan, nan], nan_ok=True)
        assert result.tilt[:, 1].tolist() == [0.0] * 8
        assert verdicts(result) == [(1, 0)] * 3 + [(3, 1)] * 3 + [(4, 1)] * 2
        for y, verdict in ((0.59, (1, 0)), (0.61, (3, 1))):  # 0.8 and 0.6 leave nothing for a z that both see
            beyond = np.array(OFFSET) + np.array(TWO_OF_THREE)[:, :2] @ (0.8, y)
            assert verdicts(Compensation(coefficients(TWO_OF_THREE))(beyond[None])) == [verdict]

    @pytest.mark.parametrize("mounting", [None, Mounting(roll=0.3, pitch=-0.2)])
    def test_three_axes_that_read_0_g_have_no_direction(self, mounting: Mounting | None) -> None:
        out = Compensation(coefficients(THREE, mounting=mounting))([[*OFFSET, -30.0], [*OFFSET, 1290.0]])
        assert verdicts(out) == [(4, 128 + 256), (1, 0)]
        assert np.isfinite(out.angles).all(axis=1).tolist() == np.isfinite(out.angles).any(axis=1).tolist()
        assert np.isfinite(out.angles[:, 0]).tolist() == [False, True]
        assert out.gravity[0].tolist() == [0.0, 0.0, 0.0]

    @pytest.mark.parametrize("odd", [nan, inf, -inf])
    def test_a_reading_that_is_no_number_makes_the_row_missing_and_nothing_else(self, odd: float) -> None:
        limits = Limits(reading={"x": (-900.0, 900.0)}, temperature=(0.0, 10.0))
        result = Compensation(PLAIN, limits)([[odd, 0.0], [0.0, odd], [0.0, 0.0]], [50.0, 5.0, 5.0])
        assert verdicts(result) == [(9, 32), (9, 32), (1, 0)]
        assert np.isnan([result.tilt[:2], result.gravity[:2]]).all()

    def test_rails_and_tilts_outside_the_calibrated_range(self) -> None:
        """At the rail the row fails, and its tilt is still there."""
        limits = Limits(tilt={"x": (radians(-30), radians(45)), "y": (-pi / 2, pi / 2)}, reading={"x": (-800.0, 800.0)})
        edge = 1000.0 * sin(radians(45))
        readings = [[edge, 0.0], [edge + 0.001, 0.0], [-500.001, 0.0], [0.0, 1010.0], [-800.0, 0.0], [800.0, 0.0]]
        result = Compensation(PLAIN, limits)(readings)
        assert verdicts(result) == [(1, 0), (3, 8), (3, 8), (3, 1), (4, 4 + 8), (4, 4 + 8)]
        assert result.tilt[4, 0] == pytest.approx(degrees(asin(-0.8)))

    def test_reasons_add_up_and_the_worst_flag_stays(self) -> None:
        known = replace(PLAIN, thermal=Thermal(24.0, (5.5, 24.0), np.zeros((2, 1)), np.zeros((2, 1))))
        limits = Limits(tilt={"x": (-1.0, 1.0)}, reading={"y": (-500.0, 500.0)})
        result = Compensation(known, limits)([[1010.0, 600.0], [1010.0, 0.0], [0.0, 500.0]], [30.0, 30.0, nan])
        assert verdicts(result) == [(4, 1 + 2 + 4 + 8), (3, 1 + 2 + 8), (4, 4 + 16)]


@given(st.lists(st.lists(st.floats(width=64), min_size=2, max_size=2), min_size=1, max_size=20), st.floats())
def test_any_reading_gives_a_flag_and_a_pass_gives_numbers(rows: list[list[float]], temperature: float) -> None:
    known = coefficients(TWO_OF_THREE, thermal=second_order(2), mounting=Mounting(0.1, 0.2, 0.3))
    result = Compensation(known)(np.array(rows), np.full(len(rows), temperature))
    assert set(result.flag.tolist()) <= {1, 3, 4, 9}
    assert ((result.flag == 1) == (result.reason == 0)).all()
    passed = result.flag <= 3
    assert np.isfinite(result.tilt[passed]).all()
    assert [flag == 9 for flag in result.flag.tolist()] == [not all(map(isfinite, row)) for row in rows]
