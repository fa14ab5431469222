"""All sensors of a fixture at once: what they share makes each of them better known."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from support.simulated_bench import LEVEL, POSITIONS, XYZ

from tiltcal.core.estimation.equations import Equations
from tiltcal.core.estimation.estimate import estimate
from tiltcal.core.estimation.positions import Design, Observation, Prior, SensorObservations

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


def test_a_position_that_is_held_on_keeps_its_attitude() -> None:
    """Warm and cold without touching: the jig's error leaves the temperature coefficient alone."""
    held = [
        Observation("warm", LEVEL, np.array([0.010]), np.array([1e-5]), 24.0),
        Observation("cold", LEVEL, np.array([0.047]), np.array([1e-5]), 5.5, held=True),
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


def test_the_residuals_of_a_reversal_say_how_good_its_jig_was() -> None:
    """Four headings tell the lean of a table from the offsets: the textbook's plane through eight readings."""
    rng, headings = np.random.default_rng(34), np.radians([0.0, 90.0, 180.0, 270.0])
    turned = [np.hstack([np.eye(2), [[np.cos(h), np.sin(h)], [-np.sin(h), np.cos(h)]]]) for h in headings]
    truth = np.array([1024.0, 1020.0, 3.0, -5.0])
    means = [columns @ truth + rng.normal(0.0, 0.7, 2) for columns in turned]
    priors = {f"sensitivity.{c}.{a}": Prior(800.0 * (a == c)) for c in "xy" for a in "xy"}
    observations = [
        Observation(f"{h:g}", LEVEL, mean, np.full(2, 0.1), heading=float(np.degrees(h)))
        for h, mean in zip(headings, means, strict=True)
    ]
    found = estimate(observations, Design(("x", "y"), ("x", "y"), priors=priors))
    plane, left, _, _ = np.linalg.lstsq(np.vstack(turned), np.concatenate(means))
    assert found.coefficients.offset == pytest.approx(plane[:2], abs=1e-3)
    # Eight readings, of which the lean and the offsets use up four; each offset is the mean of four.
    assert found.uncertain.u[[0, 3]] == pytest.approx(np.sqrt(left[0] / 4.0 / 4.0), rel=1e-3)
    assert found.uncertain.factors[[0, 3]] == pytest.approx(scipy.stats.t.ppf(0.975, 4), rel=1e-3)
