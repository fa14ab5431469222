"""The hull of calibrated directions, against their convex combinations and angles."""

import numpy as np
import pytest

from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.core.directions import ALL, Cone, common, covered, tilts
from tiltcal.core.model import Array

X, Y = gravity_from_tilt({"x": 30.0}), gravity_from_tilt({"y": 20.0})


def along(x: float, y: float, side: float = 1.0) -> Array:
    """Directions of a slope on x and on y, of 2 g."""
    return 2.0 * np.array([[x], [y], [side]]) / np.sqrt(x * x + y * y + 1.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_direction_is_inside_the_hull_and_within_5_degrees_of_what_was_met(side: float) -> None:
    x, y = (np.array(one) * (1.0, 1.0, side) for one in (X, Y))
    flat, whole = Cone([tuple(x), (0.0, 0.0, side)]), Cone([tuple(x), tuple(y)])
    t_x, t_y = np.tan(np.radians([30.0, 20.0]))
    near, far = np.tan(np.radians([34.9, 35.1]))
    for cone, slopes in (
        (flat, ((0.0, True), (near, True), (far, False), (0.5 * t_x, False))),
        (whole, ((near, True),)),
    ):
        assert [cone.inside(along(s, 0.0, side))[0] for s, _ in slopes] == [found for _, found in slopes]
        assert [cone.inside(along(-s, 0.0, side))[0] for s, _ in slopes] == [found for _, found in slopes]
    # A polygon with the corners (±t_x, 0) and (0, ±t_y) in the plane z = 1, and nothing of the other side.
    for share, inside in ((0.99, True), (1.01, False)):
        assert whole.inside(along(0.6 * share * t_x, -0.4 * share * t_y, side))[0] == inside
    assert not whole.inside(along(0.1, 0.1, -side))[0]
    assert (flat.side, whole.side, Cone([tuple(x)]).side) == (side, side, side)


def test_what_is_covered_and_common() -> None:
    assert covered([X, Y, X]) == (tuple(round(c, 4) for c in X), tuple(round(c, 4) for c in Y))
    assert covered([X, Y, (0.0, 0.0, -1.0)]) == ALL
    assert common([ALL, (X, Y), ALL]) == (X, Y)
    assert common([(X, Y), (Y,)]) == common([(Y,), (X, Y)]) == (Y,)
    low, level = ((X[0], X[1], -X[2]), (Y[0], Y[1], -Y[2])), (0.0, 0.0, 1.0)
    assert (common([(X, Y), low]), set(common([(X, level), (Y, level)]))) == ((), {level})
    narrow = gravity_from_tilt({"x": 20.0}), gravity_from_tilt({"y": 30.0})
    corners, met = np.abs(common([(X, Y), narrow]))[:, :2].max(axis=0), tilts((X, Y))
    assert corners == pytest.approx(np.sin(np.radians([20.0, 20.0])), abs=1e-3)
    assert met["x"] == pytest.approx((-np.pi / 6, np.pi / 6))
    assert met["z"] == pytest.approx(np.radians((60.0, 70.0)))
    assert tilts(ALL)["y"] == (-np.pi / 2, np.pi / 2)
