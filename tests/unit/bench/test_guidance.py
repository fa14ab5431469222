"""What guides an operator: the angle to set and the present one, by the data sheet and the positions before."""

from dataclasses import replace
from math import asin, cos, degrees, radians, sin

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import FIXTURES

from tiltcal.bench.guidance import calibrated_guidance, guidance, level_sides, note_on, too_high
from tiltcal.calibration.record import compensation_of
from tiltcal.core.attitude import STRAIGHT, gravity_from_tilt, orientation
from tiltcal.core.plausibility import ExpectedReadings
from tiltcal.drivers import find_model
from tiltcal.files.calibration import read_calibration
from tiltcal.files.twin import read_twin

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
    assert shown.tilts["x"] == pytest.approx((30.0, 29.0))
    assert shown.differences["x"].angle == pytest.approx(-1.0)
    assert shown.differences["y"].angle == pytest.approx(0.5)
    assert shown.ok
    # Two of sqrt(0.0023² + 0.03² + (0.0029 0.5)² + (0.03 0.87)² + 0.026²) g, 0.095 g, below 30°: asin(0.405) is 23.9°.
    assert shown.differences["x"].tolerance == pytest.approx(6.1, abs=0.1)
    assert shown.in_words()[0] == "x  +29.00° (-1.00) ok"
    wrong = guidance(SCA100T, STRAIGHT, counts(0.0, 30.0), UP_30, expected())
    assert [wrong.differences[channel].fits for channel in "xy"] == [False, False]
    assert wrong.in_words()[0].endswith("(-30.00)")


def test_one_tolerance_says_what_is_ok() -> None:
    """Near 90° an arcsine has more room on one side than on the other: 18° below 90° where 0.05 g are allowed."""
    model = find_model("sca100t-d02")
    for target in np.linspace(-90.0, 90.0, 37):
        for off in np.linspace(-30.0, 30.0, 61):
            up = gravity_from_tilt({"x": target})
            one = guidance(model, STRAIGHT, counts(target + off, 0.0), up, expected()).differences["x"]
            assert one.angle is not None
            assert one.fits == (abs(one.angle) <= one.tolerance + 1e-9), (target, off)


def test_positions_before_correct_the_present_angle() -> None:
    """A part whose offset is 0.03 g, 1.7° at level, shows it less after four positions."""
    learnt = expected()
    for tilt in ({"x": 30.0}, {"x": -30.0}, {"y": 30.0}, {"y": -30.0}):
        learnt.learn(gravity_from_tilt(tilt), np.array(counts(tilt.get("x", 0.0), tilt.get("y", 0.0), 0.03)))
    off = [
        guidance(SCA100T, STRAIGHT, counts(30.0, 0.0, 0.03), UP_30, one).differences["y"].angle
        for one in (expected(), learnt)
    ]
    assert off[0] == pytest.approx(1.72, abs=0.01)
    assert abs(off[1]) < 0.4


def test_nothing_is_ok_where_nothing_is_known() -> None:
    """The zero of an ADXL202 may be anywhere; in free positions nothing is asked for; an unknown scale has no angle."""
    adxl202 = find_model("adxl202")
    assert guidance(adxl202, STRAIGHT, [0.56, 0.5], UP_30, expected(adxl202)).ok is None
    free = guidance(SCA100T, STRAIGHT, counts(30.0, 0.0), UP_30, None)
    assert (free.tilts["x"].target, free.ok) == (None, None)
    assert free.in_words()[0] == "x  +30.00°"
    unscaled = guidance(replace(SCA100T, scaled=False), STRAIGHT, counts(30.0, 0.0), UP_30, expected())
    assert not unscaled.tilts


@pytest.mark.parametrize("axes", [("x", "y"), ("-y", "x"), ("z", "x")])
def test_the_present_attitude_is_in_the_frame_of_the_fixture(axes: tuple[str, str]) -> None:
    """A sensor that is exact reads what was set, however it sits; the axis that it lacks is as it was asked for."""
    sits, up = orientation(axes), (0.3, -0.4, 0.75**0.5)
    seen = sits.seen(up)
    shown = guidance(SCA100T, sits, [1024.0 + 819.0 * one for one in seen[:2]], up, expected())
    assert shown.up == pytest.approx(up)
    # Of one axis that is to point up, the others share what is left of gravity.
    alone = replace(SCA100T, channels=("x",))
    shown = guidance(alone, STRAIGHT, counts(degrees(asin(0.6)), 0.0)[:1], (1.0, 0.0, 0.0), expected(alone))
    assert shown.up == pytest.approx((0.6, 0.32**0.5, 0.32**0.5))
    shown = guidance(SCA100T, STRAIGHT, counts(60.0, 60.0), up, expected())
    assert shown.up == pytest.approx((0.5**0.5, 0.5**0.5, 0.0))


FACES = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
ADXL345 = find_model("adxl345")


def test_a_calibrated_angle_is_never_called_ok_and_says_where_it_is_far_away() -> None:
    calibrated = compensation_of(read_calibration(FIXTURES / "complete.yaml"))
    _, truth = read_twin(FIXTURES / "twins" / "sca100t-d02.yaml")
    read = [truth.reading(channel, UP_30, 24.0) for channel in "xy"]
    near, far, own = (
        calibrated_guidance(calibrated, STRAIGHT, read, 24.0, gravity_from_tilt({"x": asked}), tolerance)
        for asked, tolerance in ((31.0, 3.0), (20.0, 3.0), (31.0, None))
    )
    assert near.tilts["x"] == (pytest.approx(31.0), pytest.approx(30.0, abs=0.1))
    assert own.tilts["x"] == (None, far.tilts["x"].present) == (None, near.tilts["x"].present)
    assert near.differences["x"] == (pytest.approx(-1.0, abs=0.1), 3.0, True)
    assert [(one.fits, one.ok) for one in (near, far, own)] == [(True, None), (False, None), (None, None)]
    assert near.in_words()[0] == f"x  {near.tilts['x'].present:+.2f}° ({near.differences['x'].angle:+.2f})"
    note = "calibrated angles: set the table by its own scale, not by this number"
    away = f"more than 3° away, is this the position? {note}"
    assert [note_on([one]) for one in (near, far)] == [note, away]
    assert note_on([own]) == "calibrated angles, in the sensor's own frame"


def test_two_sides_are_level_across_each_other_and_nearest_to_level_in_any_attitude() -> None:
    drawn = np.random.default_rng(5).normal(size=(60, 3))
    for up in [*map(np.array, FACES), *(one / np.linalg.norm(one) for one in drawn)]:
        (first, one), (second, other) = level_sides(tuple(up.tolist()))
        axes = ["XYZ".index(name[1]) for name in (first, second)]
        assert np.array([one, other, up]) @ np.array([one, other, up]).T == pytest.approx(np.eye(3))
        assert axes == sorted(set(range(3)) - {2 - int(np.argmax(np.abs(up[::-1])))})
        assert one[axes[0]] > 0.0
        assert other[axes[1]] > 0.0
        # Turned about the first side by 1°, the second one is that much too high.
        turned = Rotation.from_rotvec(np.radians(1.0) * np.cross(up, other)).apply(up)
        assert too_high(tuple(up.tolist()), tuple(turned.tolist())) == pytest.approx(
            {first: 0.0, second: 1.0}, abs=1e-9
        )


def test_the_side_that_must_go_up_is_named_and_what_has_no_direction_yet_is_said() -> None:
    """A part at x-up whose +Y side is 20° low; one that reads 0.7 g; one whose zero is anywhere."""
    low = (cos(radians(20.0)), -sin(radians(20.0)), 0.0)
    values = [ADXL345.offset + ADXL345.sensitivity * one for one in low]
    shown = guidance(ADXL345, STRAIGHT, values, FACES[0], expected(ADXL345))
    assert shown.sides == pytest.approx({"+Y": -20.0, "+Z": 0.0}, abs=1e-9)
    assert shown.in_words() == ["20.00° off: +Y -20.00° raise, +Z +0.00°"]
    assert shown.tilts["x"] == pytest.approx((90.0, 70.0))
    weak = [ADXL345.offset + 0.7 * (value - ADXL345.offset) for value in values]
    assert guidance(ADXL345, STRAIGHT, weak, FACES[0], expected(ADXL345)).in_words() == ["direction not known yet"]
    anywhere = replace(ADXL345, offset_spread=1e4)
    assert guidance(anywhere, STRAIGHT, values, FACES[0], expected(anywhere)).in_words() == ["direction not known yet"]
