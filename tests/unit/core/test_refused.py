"""What the core refuses, each with its reason."""

from collections.abc import Callable
from math import inf, nan

import numpy as np
import pytest
from support import accelerometer_disk as disk

from tiltcal.core import closed_forms as forms
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.attitude import gravity_from_tilt, mounting_rotation, normalised
from tiltcal.core.compensation import Compensated, Compensation
from tiltcal.core.derived import intrinsic, separated
from tiltcal.core.earth_frame import EarthFrameCompensation
from tiltcal.core.estimation.estimate import estimate, estimate_jointly
from tiltcal.core.estimation.free import fit_free, planned_uncertain
from tiltcal.core.estimation.positions import Design, Observation, SensorObservations
from tiltcal.core.model import AXES, Array, Coefficients, Mounting, vector_of
from tiltcal.core.noise import characterise, kinds_of_noise
from tiltcal.core.pair.demodulate import demodulate
from tiltcal.core.pair.matching import MatchedRotation, rotation_of, solve
from tiltcal.core.pair.model import Pair
from tiltcal.core.pair.online import Online
from tiltcal.core.pair.stage import estimate_spin, estimated_angle, follow, stage_record
from tiltcal.core.ramp.fit import fit_ramp
from tiltcal.core.ramp.record import RampRecord, legs_of, ramp_record
from tiltcal.core.uncertain import Uncertain
from tiltcal.errors import EstimateError, InputError

FLAT = Coefficients(("x", "y"), ("x", "y"), np.zeros(2), np.eye(2))
THREE = Coefficients(AXES, AXES, np.zeros(3), np.eye(3))
NONE = Uncertain.errors((), np.zeros((0, 0)))
UP = np.eye(3)
CIRCLE = np.stack([np.cos(np.arange(20)), *np.tile(np.sin(np.arange(20)) / 2**0.5, (2, 1))], axis=1)


def of(*rows: tuple[float, ...], mounting: Mounting | None = None) -> Coefficients:
    channels, axes = AXES[: len(rows)], AXES[: len(rows[0])]
    return Coefficients(channels, axes, np.zeros(len(rows)), np.array(rows), mounting=mounting)


def seen(name: str, temperature: float | None = None) -> Observation:
    return Observation(name, UP[0], np.zeros(1), np.ones(1), temperature)


def of_one(name: str, up: Array) -> SensorObservations:
    return SensorObservations(Design(("x",), ("x",)), [Observation(name, up, np.zeros(1), np.ones(1))])


def asked(*met: tuple[float, float]) -> None:
    """Positions in which x has some sine and the sensor some temperature."""
    ups = [np.array([x, 0.0, np.sqrt(1.0 - x * x)]) for x, _ in met]
    seen = [Observation(f"{k}", up, np.full(1, k), np.ones(1), met[k][1]) for k, up in enumerate(ups)]
    estimate(seen, Design(("x",), ("x",), 1, jig=0.0))


def doubted(name: str) -> CompensationWithUncertainty:
    return CompensationWithUncertainty(Compensation(of((1,))), of((1,)), Uncertain.errors((name,), np.eye(1)))


def spin(seconds: float, gap: float = 0.0) -> None:
    taken = disk.record(seconds=seconds)
    estimate_spin(taken.time + gap * (taken.time > seconds / 2.0), taken.readings)


def matched(first: str, second: str, orthogonal: str, a4: float = 3.39) -> None:
    taken = disk.record(seconds=40.0, scale=(3.383, 3.415, 3.402, a4))
    record = demodulate(disk.NAMES, follow(taken.theta + 40.0), taken.readings.T, np.ones(len(taken.theta), bool))
    solve(record, Pair(first, second, orthogonal))


def turning() -> MatchedRotation:
    taken = disk.record(seconds=40.0, rate=5)
    return rotation_of(disk.NAMES, np.column_stack([taken.time, taken.theta, taken.readings]))


def online(seconds: float, lost: int = 0, channel: int = 1) -> None:
    """Online, of which a channel reads nothing in the last rows."""
    taken = disk.record(seconds=seconds, rate=10)
    taken.readings[len(taken.time) - lost :, channel] = 0.0
    estimators = Online(Pair("a1", "a2", "a4"), disk.NAMES)
    estimators.push(taken.theta, taken.readings.T)
    estimators.coefficients(loops=True)


def ramp(time: list[float], temperature: list[float], step: float = 0.0) -> RampRecord:
    rows = len(time)
    return RampRecord(np.array(time), np.array(temperature), np.zeros((rows, 1)), np.zeros(1), rows, "", step)


REFUSED: dict[type[Exception], list[tuple[Callable[[], object], str]]] = {
    EstimateError: [
        (lambda: forms.cross_axis_sensitivity(0.0, 1.0, 1.0), "measuring direction has no cross-axis ratio"),
        (lambda: forms.scale_from_tilt(2.0, 1.0, 0.0), "two level positions cannot determine a scale"),
        (lambda: forms.tempco_from_two_temperatures(1, 2, 9, 9), r"same temperature \(9 °C\)"),
        (lambda: forms.sensitivity_from_pair(3.5, 1.5, 0.0, 0.0), "tilt the axis up, then down"),
        (lambda: forms.sensitivity_from_pair(3.5, 1.5, -0.5, 0.5), "magnitudes of the two tilts"),
        (lambda: forms.sensitivity_from_pair(3.5, 1.5, 0.5, 1.6), "magnitudes of the two tilts"),
        (lambda: mounting_rotation(UP[:1], UP[:1], None), "same line in every position"),
        (lambda: mounting_rotation(UP[[0, 0]], UP[[0, 0]] * [[1], [-1]], None), "same line in every"),
        (lambda: Compensation(of((1, 2), (2, 4))), "singular"),
        (lambda: Compensation(of((1, nan), (2, 4))), "singular"),
        (lambda: Compensation(of((1, 0), (0, 1), (1, 1))), "3 channels .x, y, z. cannot .* 2 axes .x, y."),
        (lambda: Compensation(of((1,), mounting=Mounting(0.1))), "a mounting rotation takes a sensor"),
        (lambda: Compensation(THREE, first_order=True), "for two channels; this sensor has 3"),
        (lambda: Compensation(of((0, 1), (1, 1)), first_order=True), "own axis: one is 0"),
        (lambda: doubted("offset.q"), "the calibration has no coefficient 'offset.q'"),
        (lambda: doubted("mounting.turn.z"), "a mounting that is uncertain takes a sensor .* x and y"),
        (lambda: EarthFrameCompensation(Compensation(of((1,))), magnetometer=True, velocity=False), "at least x and y"),
        (lambda: separated(np.ones((3, 3))), "two channels measure the same axis"),
        (lambda: separated(np.diag([1.0, 1.0, -1.0])), "left-handed frame"),
        (lambda: intrinsic(FLAT, NONE), "three channels over three axes"),
        (lambda: vector_of(FLAT, ["offset.z"]), "no coefficient 'offset.z'"),
        (lambda: estimate([], Design(("x",), ("x",))), "no position was measured"),
        (lambda: estimate([seen("a"), seen("a")], Design(("x",), ("x",))), "position a is there twice"),
        (lambda: estimate([seen("a", 1.0), seen("b")], Design(("x",), (), 1)), "position b: a temperature"),
        (lambda: estimate_jointly([of_one("a", UP[0]), of_one("a", UP[1])]), "a: two sensors of the fixture"),
        (lambda: asked((0.6, 20), (0.6, 40)), r"separate offset.x and sensitivity.x.x: add the position level \("),
        (lambda: asked((0.6, 20), (-0.6, 20)), r"gravity \[-0.6, 0, 0.8\] at another, lower temperature$"),
        # A circle lies on many ellipsoids, and so does one attitude.
        (lambda: fit_free(CIRCLE, 0 * CIRCLE), "20 free positions do not determine .*: add positions"),
        (lambda: fit_free(0 * CIRCLE, 0 * CIRCLE), "the readings lie on no ellipsoid: add positions"),
        (lambda: planned_uncertain(UP, 1.0, 1.0), "3 free positions for 9 unknowns: .* nine positions, and"),
        (lambda: characterise(np.tile([1.0, nan, nan, nan], 16), 1.0), "so much is missing"),
        (lambda: kinds_of_noise(np.ones(1), np.array([inf]), np.ones(1, int), 64), "another unit"),
        (lambda: demodulate("a", np.zeros(2), [np.zeros(2)], np.zeros(2, bool)), "no row of the record has"),
        (lambda: stage_record("a", np.full(3, nan), [UP[0]]).turns, "the record has 0.00 turns"),
        (lambda: estimated_angle(UP[0], [np.full(3, nan)]), "no row of the record has all readings"),
        (lambda: turning().matched([Pair("a1", "a4", "a2")] * 2), "^a1 and a4: a2 .*; a1 and a4: a2 is not"),
        (lambda: matched("a1", "a4", "a2"), "a2 is not orthogonal to a1: their phases are less than 6°"),
        (lambda: matched("a1", "a3", "a4"), r"a3 answers with -?0.0\d* of what a1 .* see that it is connected"),
        (lambda: matched("a1", "a1", "a4"), r"p is 2.0000.* it sits opposite a1 with the same polarity"),
        (lambda: matched("a1", "a2", "a4", a4=0.33), "a4 has 0.3.* it cannot correct a misalignment"),
        (lambda: online(15.0), "had 1 whole turns and need 2: the record is too short"),
        (lambda: online(45.0), "the loops have not settled in 5 turns: let the stage turn for longer"),
        (lambda: online(81.0, lost=90), r"p runs to \d.\d\d: a2 cannot be matched to a1"),
        (lambda: online(81.0, lost=90, channel=3), "a4 has no signal in quadrature to a1"),
        (lambda: spin(10.0), r"turns 1.\d\d times in it: .* less than 2 turns"),
        (lambda: spin(0.2), "too short"),
        (lambda: spin(40.0, gap=3600.0), "the gaps of the record are more than 7 times"),
        (lambda: ramp_record(np.arange(31.0), np.zeros(31), [np.zeros(31)]), "has 31 rows .* too few"),
        (lambda: legs_of(ramp([0, 15, 45, 60], [5, 15, 35, 45])), "share 0 °C of 40 °C.* all the way back, at 64 "),
        (lambda: legs_of(ramp([0, 1, 2, 3], [5, 44, 45, 33])), "the ways up and down share 11 °C of 40 °C"),
        (lambda: fit_ramp(ramp([*range(60)], [*range(57), 0, 56, 0]), reference=9.0, highest=1), "must span the full"),
        (lambda: legs_of(ramp([0, 2, 2], [0, 9, 0])), "goes back or stands still"),
        (lambda: legs_of(ramp([0, 1, 2], [0, 1.9, 0])), "by 1.9 °C in the record: a drift takes at least 2 "),
        (lambda: legs_of(ramp([0, 1], [0, 3.9], 0.5)), "3.9 °C in steps of 0.5 °C .* at least 4 °C"),
    ],
    InputError: [
        (lambda: gravity_from_tilt({"x": 1.0, "z": 1.0}), "tilt names axis 'z'"),
        (lambda: gravity_from_tilt({"x": -90.5}), "a tilt of -90.5° is not between"),
        (lambda: gravity_from_tilt({"y": nan}), "a tilt of nan° is not between"),
        (lambda: normalised([0.0, 1.0]), "three finite numbers"),
        (lambda: normalised([0.0, 1.0, inf]), "three finite numbers"),
    ],
    ValueError: [
        (lambda: Compensation(FLAT)([[1.0]]), r"shape \(1, 1\); the calibration takes \(n, 2\)"),
        (lambda: Compensation(FLAT)([[1.0, 2.0]], [1.0, 2.0]), r"shape \(2,\); the readings need \(1,\)"),
        (lambda: Compensation(FLAT)([[1.0, 2.0]], out=Compensated.empty(1, 3)), r"has shape \(1, 3\)"),
    ],
}


@pytest.mark.parametrize(("kind", "call", "said"), [(kind, *one) for kind, some in REFUSED.items() for one in some])
def test_refused(kind: type[Exception], call: Callable[[], object], said: str) -> None:
    with pytest.raises(kind, match=said):
        call()
