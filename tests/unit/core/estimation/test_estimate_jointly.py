"""All sensors of a fixture at once: what they share makes each of them better known."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.simulated_bench import POSITIONS, XYZ, design, fixture, measured, part, plan_of

from tiltcal.core.estimation.equations import Equations
from tiltcal.core.estimation.estimate import estimate, estimate_jointly
from tiltcal.core.estimation.positions import Design, Observation, Prior, SensorObservations
from tiltcal.core.estimation.solve import budgets, solved_at
from tiltcal.core.model import vector_of
from tiltcal.errors import EstimateError

OFFSETS = [0, 4, 8]

Array = NDArray[np.float64]


@pytest.mark.parametrize(
    ("jig", "count", "sensors", "sessions"), [(0.0, 6, 1, 40), (0.02, 12, 1, 40), (0.2, 12, 1, 40), (0.2, 6, 6, 12)]
)
def test_the_mean_square_error_is_the_cramer_rao_bounds(jig, count, sensors, sessions) -> None:
    """Bound over mean square error at least 0.95 within 2.5 Monte Carlo standard deviations, in units of the bound."""
    rng, plan = np.random.default_rng(5), plan_of(count, noise=5e-4, jig=jig)
    squares = []
    for _ in range(sessions):
        parts = [part(rng) for _ in range(sensors)]
        truth = np.array([one.truth for one in parts])
        equations = Equations(fixture(measured(rng, plan, parts), design(plan, jig=jig)))
        z = np.concatenate([truth.ravel(), np.zeros(equations.unknowns - truth.size)])
        bound = [np.diag(one.covariance) for one in budgets(solved_at(equations, z))]
        found = estimate_jointly(equations.sensors)
        off = np.array([vector_of(one.coefficients, one.uncertain.names) for one in found]) - truth
        squares.append(np.mean(off**2 / bound))
    assert 1.0 / np.mean(squares) > 0.95 - 2.5 * np.std(squares) / np.mean(squares) ** 2 / np.sqrt(sessions)


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
