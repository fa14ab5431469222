"""How a sensor sits on the board and in its application: against the document's nine terms, numpy and scipy."""

from itertools import permutations, product
from math import cos, degrees, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.core.attitude import mounting_angles, mounting_matrix, orientation
from tiltcal.core.model import Mounting
from tiltcal.errors import EstimateError, InputError

turns = st.floats(-pi, pi)


@given(r=turns, p=turns, y=turns)
def test_the_matrix_is_the_documents_term_by_term(r: float, p: float, y: float) -> None:
    """Correcting for SCA3000 Accelerometer Mounting Angle, the three formulas as printed."""
    printed = [
        [cos(y) * cos(p), sin(y) * cos(r) + cos(y) * sin(p) * sin(r), sin(y) * sin(r) - cos(y) * sin(p) * cos(r)],
        [-sin(y) * cos(p), cos(y) * cos(r) - sin(y) * sin(p) * sin(r), cos(y) * sin(r) + sin(y) * sin(p) * cos(r)],
        [sin(p), -cos(p) * sin(r), cos(p) * cos(r)],
    ]
    np.testing.assert_allclose(mounting_matrix(Mounting(r, p, y)), printed, rtol=0, atol=1e-15)


@given(r=turns, p=turns, y=turns)
def test_the_angles_give_the_matrix_back_whatever_the_mounting(r: float, p: float, y: float) -> None:
    matrix = mounting_matrix(Mounting(r, p, y))
    mounting, _ = mounting_angles(matrix)
    np.testing.assert_allclose(mounting_matrix(mounting), matrix, rtol=0, atol=3e-8)
    assert -pi < mounting.roll <= pi
    assert -pi / 2 <= mounting.pitch <= pi / 2
    assert -pi < mounting.yaw <= pi


@pytest.mark.parametrize(("pitch", "roll_alone"), [(90.0, 50.0), (-90.0, 10.0)])
def test_gimbal_lock_is_stated_and_all_of_the_turn_is_roll(pitch: float, roll_alone: float) -> None:
    """At +90° only roll + yaw is determined (30° + 20°), at -90° only roll - yaw (30° - 20°)."""
    matrix = mounting_matrix(Mounting(radians(30), radians(pitch), radians(20)))
    mounting, gimbal_lock = mounting_angles(matrix)
    assert gimbal_lock
    assert degrees(mounting.pitch) == pytest.approx(pitch)
    assert degrees(mounting.roll) == pytest.approx(roll_alone)
    assert mounting.yaw == 0.0


@pytest.mark.parametrize(
    "matrix", [np.eye(2), 2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.ones((3, 3)), np.full((3, 3), np.nan)]
)
def test_what_is_no_rotation_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(EstimateError, match="rotation"):
        mounting_angles(matrix)


def test_three_names_are_a_turn_or_refused() -> None:
    """The matrix whose rows are the named directions is a rotation where its determinant is +1 (numpy)."""
    for axes, signs in product(permutations("xyz"), product("+-", repeat=3)):
        names = [sign.replace("+", "") + axis for sign, axis in zip(signs, axes, strict=True)]
        rows = [(-1 if sign == "-" else 1) * np.eye(3)["xyz".index(a)] for sign, a in zip(signs, axes, strict=True)]
        if np.linalg.det(rows) > 0:
            np.testing.assert_array_equal(orientation(names).seen((0.1, 0.2, 0.3)), np.array(rows) @ [0.1, 0.2, 0.3])
        else:
            with pytest.raises(InputError, match="left-handed"):
                orientation(names)


@pytest.mark.parametrize("names", [["x"], ["x", "x"], ["x", "-x", "y"], ["x", "q"], ["x", "y", "z", "x"], []])
def test_nonsense_is_refused(names: list[str]) -> None:
    with pytest.raises(InputError, match="two or three"):
        orientation(names)
