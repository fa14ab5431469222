"""How a sensor sits on the board and in its application: against the document's nine terms, numpy and scipy."""

from itertools import permutations, product
from math import cos, degrees, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tiltcal.core import attitude
from tiltcal.core.model import Array, Mounting
from tiltcal.errors import EstimateError, InputError

turns = st.floats(-pi, pi)


@given(r=turns, p=turns, y=turns)
def test_the_matrix_is_the_documents_term_by_term_and_its_angles_give_it_back(r: float, p: float, y: float) -> None:
    """Correcting for SCA3000 Accelerometer Mounting Angle, the three formulas as printed."""
    printed = [
        [cos(y) * cos(p), sin(y) * cos(r) + cos(y) * sin(p) * sin(r), sin(y) * sin(r) - cos(y) * sin(p) * cos(r)],
        [-sin(y) * cos(p), cos(y) * cos(r) - sin(y) * sin(p) * sin(r), cos(y) * sin(r) + sin(y) * sin(p) * cos(r)],
        [sin(p), -cos(p) * sin(r), cos(p) * cos(r)],
    ]
    matrix = attitude.mounting_matrix(Mounting(r, p, y))
    np.testing.assert_allclose(matrix, printed, rtol=0, atol=1e-15)
    mounting, _ = attitude.mounting_angles(matrix)
    np.testing.assert_allclose(attitude.mounting_matrix(mounting), matrix, rtol=0, atol=3e-8)
    assert -pi < mounting.roll <= pi
    assert -pi / 2 <= mounting.pitch <= pi / 2
    assert -pi < mounting.yaw <= pi


@pytest.mark.parametrize(("pitch", "roll_alone"), [(90.0, 50.0), (-90.0, 10.0)])
def test_gimbal_lock_is_stated_and_all_of_the_turn_is_roll(pitch: float, roll_alone: float) -> None:
    """At +90° only roll + yaw is determined (30° + 20°), at -90° only roll - yaw (30° - 20°)."""
    matrix = attitude.mounting_matrix(Mounting(radians(30), radians(pitch), radians(20)))
    mounting, gimbal_lock = attitude.mounting_angles(matrix)
    assert gimbal_lock
    assert degrees(mounting.pitch) == pytest.approx(pitch)
    assert degrees(mounting.roll) == pytest.approx(roll_alone)
    assert mounting.yaw == 0.0


@pytest.mark.parametrize("stated", [True, False])
def test_a_mounting_is_the_weighted_fit_of_scipy(stated: bool) -> None:
    """With its covariance, misses and chi-square; its angles turn as small turns about the application's axes do."""
    rng, sigma = np.random.default_rng(10), np.radians([0.1, 0.2, 0.4, 0.2, 0.1])
    known = Rotation.random(5, rng).apply([0.0, 0.0, 1.0])
    truth = attitude.mounting_matrix(Mounting(0.3, -0.9, 2.0))
    read = Rotation.from_rotvec(sigma[:, None] * rng.standard_normal((5, 3))).apply(known) @ truth
    each = sigma if stated else np.ones(5)

    def missed(turn: Array) -> Array:
        return np.asarray((Rotation.from_rotvec(turn).apply(read @ truth.T) - known) / each[:, None]).ravel()

    peer = least_squares(missed, np.zeros(3), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    found, square = attitude.solve_mounting(read, known, sigma if stated else None), 2.0 * peer.cost
    turned = Rotation.from_rotvec(peer.x).as_matrix() @ truth
    np.testing.assert_allclose(found.matrix, turned, atol=1e-6)
    covariance = np.linalg.inv(peer.jac.T @ peer.jac) * (1.0 if stated else square / 7.0)
    np.testing.assert_allclose(found.covariance, covariance, rtol=0.02, atol=1e-8)
    angles = np.arccos(np.clip(np.sum(read @ turned.T * known, axis=1), -1.0, 1.0))
    np.testing.assert_allclose(found.residuals, angles, rtol=1e-4)
    assert (found.chi_square, found.dof, found.stated) == (pytest.approx(square, rel=1e-4), 7, stated)
    for axis, slope in zip(np.eye(3), attitude.angle_derivatives(turned).T, strict=True):
        turns = (Rotation.from_rotvec(h * axis).as_matrix() @ turned for h in (1e-4, -1e-4))
        moved = [attitude.mounting_angles(turn)[0] for turn in turns]
        ahead, behind = (np.array([one.roll, one.pitch, one.yaw]) for one in moved)
        assert slope == pytest.approx((ahead - behind) / 2e-4, abs=1e-5)


@pytest.mark.parametrize("pitch", [pi / 2, -pi / 2])
def test_roll_and_yaw_are_not_separated_within_three_uncertainties_of_the_vertical(pitch: float) -> None:
    """Errors in two directions leave 1 % beyond three standard uncertainties; 15 % are beyond 1.96."""
    for off, locked in ((2.99, True), (3.01, False)):
        assert attitude.is_locked(pitch + off * 0.01, 0.01) is attitude.is_locked(pitch - off * 0.01, 0.01) is locked


def test_tilts_are_the_sines_of_up_and_no_direction_moves_without_them() -> None:
    for x, y in ((0.0, 0.0), (30.0, -45.0), (-90.0, 0.0), (60.0, 30.0)):
        up = attitude.gravity_from_tilt({"x": x, "y": y})
        expected = (sin(radians(x)), sin(radians(y)))
        assert up == pytest.approx((*expected, np.sqrt(max(1.0 - expected[0] ** 2 - expected[1] ** 2, 0.0))), abs=1e-7)
        assert attitude.tilt_from_gravity([3.0 * one for one in up]) == pytest.approx({"x": x, "y": y})
    assert [attitude.gravity_from_tilt({axis: 30.0})[:2] for axis in "xy"] == [(0.5, 0.0), (0.0, 0.5)]


@pytest.mark.parametrize(
    "matrix", [np.eye(2), 2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.ones((3, 3)), np.full((3, 3), np.nan)]
)
def test_what_is_no_rotation_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(EstimateError, match="rotation"):
        attitude.mounting_angles(matrix)


def test_three_names_are_a_turn_or_refused() -> None:
    """The matrix whose rows are the named directions is a rotation where its determinant is +1 (numpy)."""
    for axes, signs in product(permutations("xyz"), product("+-", repeat=3)):
        names = [sign.replace("+", "") + axis for sign, axis in zip(signs, axes, strict=True)]
        rows = [(-1 if sign == "-" else 1) * np.eye(3)["xyz".index(a)] for sign, a in zip(signs, axes, strict=True)]
        if np.linalg.det(rows) > 0:
            seen = attitude.orientation(names).seen((0.1, 0.2, 0.3))
            np.testing.assert_array_equal(seen, np.array(rows) @ [0.1, 0.2, 0.3])
        else:
            with pytest.raises(InputError, match="left-handed"):
                attitude.orientation(names)


@pytest.mark.parametrize("names", [["x"], ["x", "x"], ["x", "-x", "y"], ["x", "q"], ["x", "y", "z", "x"], []])
def test_nonsense_is_refused(names: list[str]) -> None:
    with pytest.raises(InputError, match="two or three"):
        attitude.orientation(names)
