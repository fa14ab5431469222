"""All sensors of a fixture at once: what they share makes each of them better known."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.simulated_bench import POSITIONS, XYZ

from tiltcal.core.estimation.equations import Equations
from tiltcal.core.estimation.estimate import estimate, estimate_jointly
from tiltcal.core.estimation.positions import Design, Observation, Prior, SensorObservations
from tiltcal.errors import EstimateError

Array = NDArray[np.float64]


def test_the_equations_are_linearised_as_differences_have_it() -> None:
    rng, turn = np.random.default_rng(6), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    bench = {"jig": 0.3, "table_lean": 0.2, "heading": 1.0, "thermometer": 0.5}
    wanted = Design(("x", "y"), XYZ, drift=2, gain=1, nonlinearity=2, reference=20.0, **bench)
    sensors = [
        SensorObservations(
            wanted,
            [
                Observation(f"p{k}", np.array(turned) @ g, np.zeros(2), np.full(2, 1e-3), 15.0 + k, heading=40.0 * k)
                for k, g in enumerate(POSITIONS[18])
            ],
            turned,
        )
        for turned in (np.eye(3).tolist(), turn)
    ]
    equations = Equations(sensors)
    z = 0.05 * rng.normal(size=equations.unknowns)
    z[: len(equations.names)] += [name in ("sensitivity.x.x", "sensitivity.y.y") for name in equations.names]

    def residual(moved: Array) -> Array:
        return equations.at(moved, equations.stated).residual

    found = equations.at(z, equations.stated).times(np.eye(len(z)))
    by_differences = [(residual(z - move) - residual(z + move)) / 2e-6 for move in 1e-6 * np.eye(len(z))]
    np.testing.assert_allclose(found, np.transpose(by_differences), rtol=1e-5, atol=1e-4)


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
    """A table that leans: positions at several headings tell it from the offset."""

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
