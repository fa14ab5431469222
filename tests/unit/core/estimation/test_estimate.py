"""The estimator against exact readings, and scipy's own optimiser."""

from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tiltcal.core.estimation.estimate import estimate
from tiltcal.core.estimation.positions import Design, Observation
from tiltcal.errors import EstimateError


def observe(name: str, gravity: tuple[float, float, float], *mean: float, u: float = 0.1, t: float | None = None):
    return Observation(name, np.array(gravity), np.array(mean), np.full(len(mean), u), t)


FACES = {
    "x-up": (1, 0, 0),
    "x-down": (-1, 0, 0),
    "y-up": (0, 1, 0),
    "y-down": (0, -1, 0),
    "z-up": (0, 0, 1),
    "z-down": (0, 0, -1),
}


@pytest.mark.parametrize("seed", range(6))
def test_recovers_any_coefficients_from_exact_readings(seed: int) -> None:
    """Without noise the truth is the only minimum, bent and warm as it may be."""
    rng = np.random.default_rng(seed)
    row, bend = rng.uniform((200.0, -60.0, -60.0), (2000.0, 60.0, 60.0)), rng.uniform(-0.03, 0.03, 2)
    offset, drift, gain = rng.uniform(-1.0, 1.0, 3) * (3000.0, 5.0, 2e-3)
    slanted = [(sin(angle), 0.0, cos(angle)) for angle in (0.4, -0.4, 0.8, -0.8)]
    up, dt = np.array([*FACES.values(), *slanted, (1, 0, 0), (-1, 0, 0)]), np.repeat([-5.0, 20.0], [10, 2])
    a = up @ row / row[0]
    mean = offset + drift * dt + (1.0 + gain * dt) * row[0] * (a + bend[0] * a**2 + bend[1] * a**3)
    seen = [observe(f"{k}", up[k], mean[k], t=25.0 + dt[k]) for k in range(12)]
    found = estimate(seen, Design(("x",), ("x", "y", "z"), 1, 1, reference=25.0, jig=0.0, nonlinearity=2))
    np.testing.assert_allclose(found.coefficients.vectors[0], [offset, *row, drift, gain, *bend], rtol=1e-9, atol=1e-9)


def test_the_joint_minimum_is_scipys() -> None:
    """Attitudes, coefficients and temperatures together: the same least sum of squares by a general optimiser."""
    rng = np.random.default_rng(8)
    gravity = np.array([*FACES.values(), (0.6, 0.8, 0), (0, 0.6, 0.8)], dtype=float)
    temperature = np.array([5.0, 5.5, 34.0, 35.0, 20.0, 20.5, 5.0, 34.0])
    jig, thermometer, noise = radians(0.4), 0.3, 2e-3
    turned = Rotation.from_rotvec(rng.normal(0.0, jig, (8, 3))).apply(gravity)
    truth = np.array([[0.1, 1.0, 0.02, -0.01, 2e-3], [-0.2, 0.01, 0.98, 0.03, -1e-3]])

    def model(theta, g, t):
        return theta[:, 0] + g @ theta[:, 1:4].T + np.outer(t - 20.0, theta[:, 4])

    mean = model(truth, turned, temperature) + noise * rng.standard_normal((8, 2))

    def residual(p):
        turns, warmth = p[10:34].reshape(8, 3), p[34:]
        g = Rotation.from_rotvec(turns).apply(gravity)
        # A turn about gravity moves nothing; its prior keeps it at zero.
        misfit = (mean - model(p[:10].reshape(2, 5), g, temperature + warmth)) / noise
        return np.concatenate([misfit.ravel(), p[10:34] / jig, warmth / thermometer])

    peer = least_squares(residual, np.concatenate([truth.ravel(), np.zeros(32)]), xtol=1e-15, ftol=1e-15, gtol=1e-12)
    observations = [observe(str(k), tuple(g), *mean[k], u=noise, t=temperature[k]) for k, g in enumerate(gravity)]
    wanted = Design(("x", "y"), ("x", "y", "z"), drift=1, reference=20.0, jig=0.4, thermometer=thermometer)
    found = estimate(observations, wanted)
    # The peer has no mean of the squares of the attitudes: 0.4° squared is 5e-5 g, of noise of 2e-3.
    assert found.chi_square == pytest.approx(2 * peer.cost, rel=1e-3)
    assert (found.dof, found.p) == (16 - 10, pytest.approx(chi2.sf(found.chi_square, 6)))
    known = found.coefficients
    theta = np.column_stack([known.offset, known.sensitivity, known.thermal.drift])
    # What is taken off for the squares of the attitudes is of their size, 0.4° squared.
    np.testing.assert_allclose(theta, peer.x[:10].reshape(2, 5), atol=jig**2)
    peer_u = np.sqrt(np.diag(np.linalg.inv(peer.jac.T @ peer.jac)))[:10]
    np.testing.assert_allclose(found.uncertain.u, peer_u, rtol=0.01)


def test_noise_of_which_nothing_is_stated_is_that_of_the_plane_through_all_readings() -> None:
    """Held by hand, off by more than 10°, but no more than attitudes explain: linear least squares of 18 readings."""
    up = np.array([*FACES.values()], dtype=float)
    turns = Rotation.from_rotvec(np.random.default_rng(3).normal(0.0, radians(9.0), (6, 3)))
    mean, (u, xyz) = 2.0 + 5.0 * turns.apply(up), (1e-3, ("x", "y", "z"))
    seen = [replace(observe(name, up[k], *mean[k], u=u), noise_unknown=True) for k, name in enumerate(FACES)]
    found = estimate(seen, Design(xyz, xyz))
    table, left, _, _ = np.linalg.lstsq(np.column_stack([np.ones(6), up]), mean)
    known = np.column_stack([found.coefficients.offset, found.coefficients.sensitivity])
    np.testing.assert_allclose(known, table.T, atol=1e-3)
    assert found.estimated_noise == pytest.approx(np.sqrt(left.sum() / 6.0), rel=1e-3)
    assert np.degrees(np.abs(mean - np.column_stack([np.ones(6), up]) @ table).max() / 5.0) > 10.0


@pytest.mark.parametrize("unknown", [False, True], ids=["noise stated", "nothing stated"])
def test_readings_that_have_nothing_to_do_with_the_positions_are_refused(unknown: bool) -> None:
    rng = np.random.default_rng(1)
    observations = [
        replace(observe(str(k), up, *rng.normal(size=3), u=1e-6), noise_unknown=unknown)
        for k, up in enumerate(Rotation.random(12, rng).apply((0, 0, 1)))
    ]
    with pytest.raises(EstimateError, match="larger than any error of the set angles explains"):
        estimate(observations, Design(("x", "y", "z"), ("x", "y", "z")))
