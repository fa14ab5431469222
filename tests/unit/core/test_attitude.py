"""How a sensor sits on the board."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest

from tiltcal.core.attitude import STRAIGHT, orientation
from tiltcal.errors import InputError


def test_straight_changes_nothing() -> None:
    assert orientation(["x", "y", "z"]) == orientation(["x", "y"]) == STRAIGHT
    assert STRAIGHT.seen((0.1, 0.2, 0.3)) == (0.1, 0.2, 0.3)


def test_a_quarter_turn() -> None:
    """The sensor's x points along the fixture's -y: tilt the fixture's +y up, and the sensor's x reads down."""
    turned = orientation(["-y", "x"])
    assert turned.seen((0.0, 0.5, 0.866)) == (-0.5, 0.0, 0.866)


def test_upside_down() -> None:
    assert orientation(["x", "-y"]).seen((0.0, 0.0, 1.0)) == (0.0, 0.0, -1.0)


@pytest.mark.parametrize("signs", list(product("+-", repeat=3)))
@pytest.mark.parametrize("axes", list(permutations("xyz")))
def test_three_names_are_a_turn_or_refused(axes: tuple[str, ...], signs: tuple[str, ...]) -> None:
    """The matrix whose rows are the named directions is a rotation where its determinant is +1 (numpy)."""
    names = [sign.replace("+", "") + axis for sign, axis in zip(signs, axes, strict=True)]
    matrix = np.array([(-1 if s == "-" else 1) * np.eye(3)["xyz".index(a)] for s, a in zip(signs, axes, strict=True)])
    if np.linalg.det(matrix) > 0:
        np.testing.assert_array_equal(orientation(names).seen((0.1, 0.2, 0.3)), matrix @ [0.1, 0.2, 0.3])
    else:
        with pytest.raises(InputError, match="left-handed"):
            orientation(names)


@pytest.mark.parametrize("names", [["x"], ["x", "x"], ["x", "-x", "y"], ["x", "q"], ["x", "y", "z", "x"], []])
def test_nonsense_is_refused(names: list[str]) -> None:
    with pytest.raises(InputError, match="two or three"):
        orientation(names)
