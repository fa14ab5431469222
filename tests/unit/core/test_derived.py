"""What follows from the sensitivity matrix: against formulas by hand."""

from dataclasses import replace
from math import degrees, radians, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.derived import cross_axis, intrinsic, misalignment, rotation, separated
from tiltcal.core.model import AXES, Coefficients, Mounting
from tiltcal.core.uncertain import Uncertain, degrees_of_freedom

TRIANGULAR = np.array([[1.02, 0.03, -0.02], [0.0, 0.97, 0.05], [0.0, 0.0, 1.01]])
NAMES = tuple(f"{name}" for c in AXES for name in (f"offset.{c}", *(f"sensitivity.{c}.{a}" for a in AXES)))
STRAIGHT = Coefficients(AXES, AXES, np.array([0.1, -0.2, 0.3]), TRIANGULAR)


def uncertain(names: tuple[str, ...], covariance: np.ndarray, factor: float = 1.96) -> Uncertain:
    return Uncertain.errors(names, covariance, degrees_of_freedom(np.full(len(names), factor)))


@settings(max_examples=50, deadline=None)
@given(st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1)))
def test_any_mounting_is_told_from_the_sensor(angles) -> None:
    turned = mounting_matrix(Mounting(*angles))
    triangular, found = separated(TRIANGULAR @ turned)
    np.testing.assert_allclose(triangular, TRIANGULAR, atol=1e-12)
    np.testing.assert_allclose(found, turned, atol=1e-12)


def test_the_nine_that_no_mounting_changes_by_hand() -> None:
    own = intrinsic(STRAIGHT, uncertain(NAMES, 1e-12 * np.eye(12)))
    x, y, z = TRIANGULAR
    expected = {"offset.x": 0.1, "offset.y": -0.2, "offset.z": 0.3}
    expected |= {f"sensitivity.{name}": sqrt(row @ row) for name, row in zip(AXES, TRIANGULAR, strict=True)}
    for pair, one, other in (("xy", x, y), ("xz", x, z), ("yz", y, z)):
        expected[f"angle_degrees.{pair}"] = degrees(np.arccos(one @ other / sqrt(one @ one * (other @ other))))
    assert own.by_name(own.value) == pytest.approx(expected)


def test_a_common_turn_is_uncertain_in_the_mounting_alone() -> None:
    """An error that turns all rows alike, by 0.1° about z, is the yaw's and nobody else's."""
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    shift = np.hstack([np.zeros((3, 1)), TRIANGULAR @ turn]).ravel() * radians(0.1)
    known = uncertain(NAMES, np.outer(shift, shift))
    turned, locked = rotation(STRAIGHT, known)
    assert not locked
    assert turned.by_name(turned.u)["rotation_degrees.yaw"] == pytest.approx(0.1, rel=1e-3)
    assert turned.by_name(turned.u)["rotation_degrees.roll"] < 1e-3
    assert np.all(intrinsic(STRAIGHT, known).u < 1e-3)
    # Along ±90° of pitch roll and yaw are one turn, each of them anything: 180°/√3.
    upright = TRIANGULAR @ mounting_matrix(Mounting(0.3, radians(89.9), 0.2))
    turned, locked = rotation(replace(STRAIGHT, sensitivity=upright), uncertain(NAMES, np.diag(np.full(12, 1e-6))))
    assert locked
    assert turned.value[1] == pytest.approx(89.9)
    assert turned.u[[0, 2]] == pytest.approx([180.0 / sqrt(3.0)] * 2)
    assert turned.u[1] == pytest.approx(degrees(1e-3), rel=0.05)


def test_cross_axis_and_misalignment_with_their_uncertainty() -> None:
    """S_X = 2, S_Y = 0.06, S_Z = 0.08: 5 %; du = (0.6 du_Y + 0.8 du_Z) / 2, for both of 0.01: 0.5 %."""
    coefficients = Coefficients(("x",), AXES, np.zeros(1), np.array([[2.0, 0.06, 0.08]]))
    known = uncertain(("sensitivity.x.y", "sensitivity.x.z"), 1e-4 * np.eye(2))
    share, angle = cross_axis(coefficients, known), misalignment(coefficients, known)
    assert (share.value[0], share.u[0]) == pytest.approx((5.0, 0.5), rel=0.01)
    assert angle.value[0] == pytest.approx(degrees(np.arctan(0.05)))
    assert angle.u[0] == pytest.approx(degrees(0.005 / (1 + 0.05**2)), rel=0.01)
