"""The mounting rotation against the document's nine terms and against scipy."""

from __future__ import annotations

from math import cos, degrees, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tiltcal.core.attitude import mounting_angles, mounting_matrix
from tiltcal.core.model import Mounting
from tiltcal.errors import EstimateError

turns = st.floats(-pi, pi)
pitches = st.floats(-pi / 2, pi / 2)


@given(r=turns, p=turns, y=turns)
def test_the_matrix_is_the_documents_term_by_term(r: float, p: float, y: float) -> None:
    """Correcting for SCA3000 Accelerometer Mounting Angle, the three formulas as printed."""
    printed = [
        [
            cos(y) * cos(p),
            sin(y) * cos(r) + cos(y) * sin(p) * sin(r),
            sin(y) * sin(r) - cos(y) * sin(p) * cos(r),
        ],
        [
            -sin(y) * cos(p),
            cos(y) * cos(r) - sin(y) * sin(p) * sin(r),
            cos(y) * sin(r) + sin(y) * sin(p) * cos(r),
        ],
        [sin(p), -cos(p) * sin(r), cos(p) * cos(r)],
    ]
    np.testing.assert_allclose(mounting_matrix(Mounting(r, p, y)), printed, rtol=0, atol=1e-15)


@given(r=turns, p=turns, y=turns)
def test_the_matrix_is_three_elementary_rotations_of_scipy(r: float, p: float, y: float) -> None:
    expected = (Rotation.from_euler("z", -y) * Rotation.from_euler("y", -p) * Rotation.from_euler("x", -r)).as_matrix()
    np.testing.assert_allclose(mounting_matrix(Mounting(r, p, y)), expected, rtol=0, atol=1e-14)


@given(r=turns, p=turns, y=turns)
def test_the_angles_give_the_matrix_back_whatever_the_mounting(r: float, p: float, y: float) -> None:
    matrix = mounting_matrix(Mounting(r, p, y))
    mounting, _ = mounting_angles(matrix)
    np.testing.assert_allclose(mounting_matrix(mounting), matrix, rtol=0, atol=3e-8)
    assert -pi < mounting.roll <= pi
    assert -pi / 2 <= mounting.pitch <= pi / 2
    assert -pi < mounting.yaw <= pi


@given(r=st.floats(-3.1, 3.1), p=st.floats(-1.5, 1.5), y=st.floats(-3.1, 3.1))
def test_the_angles_come_back_where_pitch_is_within_90_degrees(r: float, p: float, y: float) -> None:
    mounting, gimbal_lock = mounting_angles(mounting_matrix(Mounting(r, p, y)))
    assert not gimbal_lock
    assert (mounting.roll, mounting.pitch, mounting.yaw) == pytest.approx((r, p, y), abs=1e-12)


@pytest.mark.parametrize(("pitch", "roll_alone"), [(90.0, 50.0), (-90.0, 10.0)])
def test_gimbal_lock_is_stated_and_all_of_the_turn_is_roll(pitch: float, roll_alone: float) -> None:
    """At +90° only roll + yaw is determined (30° + 20°), at -90° only roll - yaw (30° - 20°)."""
    matrix = mounting_matrix(Mounting(radians(30), radians(pitch), radians(20)))
    mounting, gimbal_lock = mounting_angles(matrix)
    assert gimbal_lock
    assert degrees(mounting.pitch) == pytest.approx(pitch)
    assert degrees(mounting.roll) == pytest.approx(roll_alone)
    assert mounting.yaw == 0.0


@pytest.mark.parametrize("mounting", [Mounting(pi, 0, 0), Mounting(0, 0, pi), Mounting(pi, 0, pi)])
def test_half_a_turn_is_plus_180_degrees(mounting: Mounting) -> None:
    found, _ = mounting_angles(np.round(mounting_matrix(mounting)))
    assert found == mounting


def test_a_sensor_rolled_clockwise_about_its_x_axis_sees_up_on_minus_y() -> None:
    """Turned clockwise by 90° about x', seen from its positive side, the sensor's y axis points down at level."""
    up_in_sensor = mounting_matrix(Mounting(roll=pi / 2)).T @ (0.0, 0.0, 1.0)
    np.testing.assert_allclose(up_in_sensor, (0.0, -1.0, 0.0), atol=1e-15)


@pytest.mark.parametrize(
    "matrix", [np.eye(2), 2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.ones((3, 3)), np.full((3, 3), np.nan)]
)
def test_what_is_no_rotation_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(EstimateError, match="rotation"):
        mounting_angles(matrix)
