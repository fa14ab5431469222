"""All sensors of a fixture at once: what they share makes each of them better known."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.efficiency_study import CLASSES, EfficiencyRegime, bound_of, simulate
from support.simulated_bench import FACES, POSITIONS, XYZ, design, fixture, measured, part, plan_of

from tiltcal.core.estimation.estimate import estimate, estimate_jointly
from tiltcal.core.estimation.positions import Design, Observation, Prior, SensorObservations
from tiltcal.errors import EstimateError

OFFSETS = [0, 4, 8]

Array = NDArray[np.float64]


def vector(found) -> np.ndarray:
    return np.hstack([found.coefficients.offset[:, None], found.coefficients.sensitivity]).ravel()


@pytest.mark.parametrize(
    ("jig", "count", "sensors", "calibrations"),
    [(0.0, 6, 1, 40), (0.02, 12, 1, 40), (0.5, 12, 1, 40), (0.5, 6, 6, 60)],
)
def test_the_mean_square_error_is_the_cramer_rao_bounds(jig, count, sensors, calibrations) -> None:
    """Bound over mean square error at least 0.95 within 2.5 Monte Carlo standard deviations, for every class."""
    result = simulate(EfficiencyRegime(jig, count, sensors, noise=5e-4), calibrations, 5, ("joint",), bounds_of=6)
    for name in CLASSES:
        if result.attainable[name] > 0.95:
            assert result.ratio["joint"][name] > 0.95 - 2.5 * result.error[name], name


def test_the_simpler_ways_are_far_from_it() -> None:
    """With hand-placed faces and edges, least squares wastes nine tenths of what the readings say of the offsets."""
    ratio = simulate(
        EfficiencyRegime(0.5, 18, 1, noise=5e-4),
        24,
        6,
        ("joint", "jig not stated", "least squares", "six faces"),
        bounds_of=6,
    ).ratio
    assert ratio["least squares"]["offset"] < 0.1
    assert ratio["six faces"]["offset"] < 0.6
    assert ratio["joint"]["offset"] > 0.6
    assert ratio["jig not stated"]["offset"] > 0.6


def test_six_sensors_with_one_jig_beat_six_separate_fits_by_what_the_bound_predicts() -> None:
    """Six faces, a 0.3° jig: what six sensors feel of an attitude is better known than what one does."""
    rng = np.random.default_rng(30)
    plan = plan_of(6, noise=5e-4, jig=0.3)
    together, apart, bound_together, bound_apart = [], [], [], []
    for _ in range(12):
        parts = [part(rng) for _ in range(6)]
        observations = measured(rng, plan, parts)
        truth = np.array([one.truth for one in parts])
        joint = estimate_jointly(fixture(observations, design(plan, jig=0.3)))
        single = [estimate(one, design(plan, jig=0.3)) for one in observations]
        together.append(np.array([vector(one) for one in joint]) - truth)
        apart.append(np.array([vector(one) for one in single]) - truth)
        if len(bound_apart) < 5:
            bound_together.append(bound_of(plan, parts))
            bound_apart.append(np.array([bound_of(plan, [one])[0] for one in parts]))
    gain = np.mean(np.square(apart)[:, :, OFFSETS]) / np.mean(np.square(together)[:, :, OFFSETS])
    predicted = np.mean(np.array(bound_apart)[:, :, OFFSETS]) / np.mean(np.array(bound_together)[:, :, OFFSETS])
    print(f"offsets of six sensors: mean square error {gain:.2f} times smaller, predicted {predicted:.2f}")
    assert predicted > 1.5
    # 216 squares on either side, in part the same ones: 10 % of Monte Carlo error, and no gain would be off by 40 %.
    assert gain == pytest.approx(predicted, rel=0.25)


def test_a_sensor_that_sits_turned_feels_the_same_attitude() -> None:
    """One sensor lies on its side: its readings, in its own frame, still tell of the fixture's attitude."""
    rng = np.random.default_rng(32)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    errors = np.radians(0.5) * rng.standard_normal((18, 3))
    gravity = Rotation.from_rotvec(errors).apply(POSITIONS[18])
    sensors = []
    for orientation in (np.eye(3), turn):
        mean = gravity @ orientation.T + 1e-6 * rng.standard_normal(gravity.shape)
        observations = [
            Observation(f"p{k}", orientation @ g, mean[k], np.full(3, 1e-6)) for k, g in enumerate(POSITIONS[18])
        ]
        sensors.append(SensorObservations(Design(XYZ, XYZ, jig=0.5), observations, orientation.tolist()))
    straight, turned = estimate_jointly(sensors)
    for one, other in zip(straight.attitudes, turned.attitudes, strict=True):
        np.testing.assert_array_equal(one.turn, other.turn)
    # What the two mean of the fixture is one: the part of the errors that no sensor can tell is common to both.
    np.testing.assert_allclose(
        turn.T @ turned.coefficients.sensitivity @ turn, straight.coefficients.sensitivity, atol=1e-5
    )
    with pytest.raises(EstimateError, match="axes"):
        estimate_jointly([sensors[0], replace(sensors[1], orientation=np.eye(3).tolist())])


def test_a_position_that_is_held_on_keeps_its_attitude() -> None:
    """Warm and cold without touching: the jig's error leaves the temperature coefficient alone."""
    held = [
        Observation("warm", np.array([0.0, 0.0, 1.0]), np.array([0.010]), np.array([1e-5]), 24.0),
        Observation("cold", np.array([0.0, 0.0, 1.0]), np.array([0.047]), np.array([1e-5]), 5.5, held=True),
    ]
    tilted = [
        Observation(f"{x}", np.array([x, 0.0, np.sqrt(1 - x * x)]), np.array([0.010 + x]), np.array([1e-5]), 24.0)
        for x in (0.5, -0.5)
    ]
    wanted = Design(("x",), ("x",), drift=1, reference=24.0, jig=0.5)
    found = estimate([*tilted, *held], wanted)
    name = "temperature.offset.x.1"
    assert found.uncertainty()[name] == pytest.approx(np.sqrt(2) * 1e-5 / 18.5, rel=1e-3)
    touched = estimate([*tilted, held[0], replace(held[1], held=False)], wanted)
    assert touched.uncertainty()[name] > 100 * found.uncertainty()[name]


class TestTable:
    """A table that leans: a position and the same one turned round by 180° tell it from the offset."""

    LEAN = (radians(0.4), radians(-0.25))

    def observations(self, headings: tuple[float, ...]) -> list[Observation]:
        """Level, and ±30° of x and y, on a leaning table; exact but for 1e-6 g."""
        rng = np.random.default_rng(33)
        observations = []
        for heading in headings:
            for name, set_to in {"level": (0.0, 0.0), "x": (30.0, 0.0), "-x": (-30.0, 0.0), "y": (0.0, 30.0)}.items():
                # The fixture is turned about the vertical, then tilts by its own angles.
                table = Rotation.from_rotvec([-self.LEAN[1], self.LEAN[0], 0.0])
                spin = Rotation.from_euler("z", heading, degrees=True)
                tilt = Rotation.from_euler("yx", [set_to[0], -set_to[1]], degrees=True)
                up = tilt.apply(spin.inv().apply(table.apply([0.0, 0.0, 1.0])))
                nominal = tilt.apply([0.0, 0.0, 1.0])
                mean = np.array([0.02, -0.01]) + up[:2] + 1e-6 * rng.standard_normal(2)
                observations.append(
                    Observation(f"{name} at {heading:g}", nominal, mean, np.full(2, 1e-6), heading=heading)
                )
        return observations

    @pytest.mark.parametrize("jig", [0.0, 0.001, None])
    def test_headings_cancel_it(self, jig) -> None:
        found = estimate(self.observations((0.0, 180.0)), Design(("x", "y"), ("x", "y"), jig=jig))
        # The square of the lean is left, 4e-5 g at most where z lends it a lever.
        np.testing.assert_allclose(found.coefficients.offset, [0.02, -0.01], atol=5e-5)

    def test_one_heading_takes_it_for_offset(self) -> None:
        found = estimate(self.observations((0.0,)), Design(("x", "y"), ("x", "y"), jig=0.0))
        shift = found.coefficients.offset - [0.02, -0.01]
        assert np.all(shift / self.LEAN > 0.8)

    def reversals(self, jig: float, sessions: int) -> tuple[Array, list[list[Observation]]]:
        """Sessions of four level positions at four headings on tables that lean; offsets 2 count, 800 count/g."""
        rng = np.random.default_rng(34)
        offset, taken = np.array([1024.0, 1020.0]), []
        for _ in range(sessions):
            lean = Rotation.from_rotvec([*np.radians(rng.normal(0.0, 0.3, 2)), 0.0])
            observations = []
            for heading in (0.0, 90.0, 180.0, 270.0):
                missed = Rotation.from_rotvec([*np.radians(rng.normal(0.0, jig, 2)), 0.0])
                spin = Rotation.from_euler("z", -heading, degrees=True)
                up = (spin * lean * missed).apply([0.0, 0.0, 1.0])
                mean = offset + 800.0 * up[:2] + rng.normal(0.0, 0.1, 2)
                name = f"{heading:g}"
                observations.append(Observation(name, np.array([0, 0, 1.0]), mean, np.full(2, 0.1), heading=heading))
            taken.append(observations)
        return offset, taken

    def design(self, jig: float | None) -> Design:
        """The sensitivities are the model's, within a per cent."""
        own = {f"sensitivity.{c}.{a}": Prior(800.0, 8.0) if a == c else Prior(0.0) for c in "xy" for a in "xy"}
        return Design(("x", "y"), ("x", "y"), jig=jig, priors=own)

    def test_a_lean_of_which_nothing_is_known_costs_its_degrees_of_freedom(self) -> None:
        """Eight readings, two offsets and the two angles of the lean: a chi-square of four."""
        _, sessions = self.reversals(0.05, 80)
        found = [estimate(one, self.design(0.05)) for one in sessions]
        assert {one.dof for one in found} == {4}
        assert scipy.stats.kstest([one.p for one in found], "uniform").pvalue > 0.01

    def test_a_bench_far_worse_than_it_was_stated_to_be_gives_a_result_and_a_verdict(self) -> None:
        """0.3° where the jig was stated to be perfect: the way to the minimum is long, and chi-square says why."""
        _, sessions = self.reversals(0.3, 20)
        assert max(estimate(one, self.design(0.0)).p for one in sessions) < 1e-6

    def test_what_is_assumed_of_a_sensitivity_is_hardly_corrected(self) -> None:
        """A reversal holds next to nothing of it: it stays within a seventh of its uncertainty, which stays too."""
        _, sessions = self.reversals(0.3, 3)
        for one in sessions:
            found = estimate(one, self.design(None))
            np.testing.assert_allclose(found.coefficients.sensitivity, np.diag([800.0, 800.0]), atol=8.0 / 7.0)
            assert found.uncertainty()["sensitivity.x.x"] == pytest.approx(8.0, rel=0.02)

    def test_the_residuals_of_a_reversal_say_how_good_its_jig_was(self) -> None:
        """Where it is not stated: the offsets are in 95 % of the intervals, which are not much wider than needed."""
        offset, sessions = self.reversals(0.05, 80)
        found = [estimate(one, self.design(None)) for one in sessions]
        own = [0, 3]
        errors = np.array([one.coefficients.offset - offset for one in found])
        half = np.array([(one.uncertain.factors * one.uncertain.u)[own] for one in found])
        assert np.mean(np.abs(errors) <= half) == pytest.approx(0.95, abs=0.03)
        # Eight readings, of which the lean and the offsets use up four.
        student = scipy.stats.t.ppf(0.975, 4)
        assert np.median([one.uncertain.factors[own] for one in found]) == pytest.approx(student, rel=0.02)
        assert all(share >= 0.0 for one in found for column in one.uncertain.shares.values() for share in column[own])


def test_sensors_of_different_benches_are_refused() -> None:
    observations = [Observation("z", FACES[4], np.ones(1), np.ones(1))]
    sensors = [SensorObservations(Design(("z",), (), jig=jig), observations) for jig in (0.1, 0.2)]
    with pytest.raises(EstimateError, match="share"):
        estimate_jointly(sensors)
