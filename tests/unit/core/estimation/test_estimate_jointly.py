"""All sensors of a fixture at once: what they share makes each of them better known."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
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
    """Four level positions at four headings tell the lean of a table from the offset, in 95 % of the intervals."""
    rng, offset, off, factors = np.random.default_rng(34), np.array([1024.0, 1020.0]), [], []
    own = {f"sensitivity.{c}.{a}": Prior(800.0, 8.0) if a == c else Prior(0.0) for c in "xy" for a in "xy"}
    for _ in range(80):
        lean, observations = Rotation.from_rotvec([*np.radians(rng.normal(0.0, 0.3, 2)), 0.0]), []
        for heading in (0.0, 90.0, 180.0, 270.0):
            missed = Rotation.from_rotvec([*np.radians(rng.normal(0.0, 0.05, 2)), 0.0])
            spin = Rotation.from_euler("z", -heading, degrees=True)
            mean = offset + 800.0 * (spin * lean * missed).apply([0.0, 0.0, 1.0])[:2] + rng.normal(0.0, 0.1, 2)
            observations.append(Observation(f"{heading:g}", LEVEL, mean, np.full(2, 0.1), heading=heading))
        found = estimate(observations, Design(("x", "y"), ("x", "y"), priors=own))
        off.append(np.abs(found.coefficients.offset - offset) / found.uncertain.u[[0, 3]])
        factors.append(found.uncertain.factors[[0, 3]])
        assert all(share >= 0.0 for column in found.uncertain.shares.values() for share in column[[0, 3]])
    assert np.mean(np.array(off) <= factors) == pytest.approx(0.95, abs=0.03)
    # Eight readings, of which the lean and the offsets use up four.
    assert np.median(factors) == pytest.approx(scipy.stats.t.ppf(0.975, 4), rel=0.02)
