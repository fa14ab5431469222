"""The estimator against exact readings, and scipy's own optimiser."""

from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tiltcal.core.estimation.estimate import estimate
from tiltcal.core.estimation.positions import Design, Observation
from tiltcal.errors import EstimateError


def observe(name: str, gravity: tuple[float, float, float], *mean: float, u: float = 0.1, t: float | None = None):
    return Observation(name, np.array(gravity), np.array(mean), np.full(len(mean), u), t)


directions = st.tuples(st.floats(-180, 180), st.floats(-90, 90)).map(
    lambda angles: (
        cos(radians(angles[1])) * cos(radians(angles[0])),
        cos(radians(angles[1])) * sin(radians(angles[0])),
        sin(radians(angles[1])),
    )
)


@settings(max_examples=60, deadline=None)
@given(
    extra=st.lists(directions, max_size=8),
    offset=st.floats(-3000, 3000),
    row=st.tuples(st.floats(200, 2000), st.floats(-60, 60), st.floats(-60, 60)),
    drift=st.floats(-5, 5),
    gain=st.floats(-2e-3, 2e-3),
    bend=st.tuples(st.floats(-0.03, 0.03), st.floats(-0.03, 0.03)),
)
def test_recovers_any_coefficients_from_exact_readings(extra, offset, row, drift, gain, bend) -> None:
    """Without noise the truth is the only minimum, whatever the positions beyond the necessary ones."""
    faces = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    slanted = [(sin(angle), 0.0, cos(angle)) for angle in (0.4, -0.4, 0.8, -0.8)]
    conditions = [(g, 20.0) for g in [*faces, *slanted, *extra]] + [((1, 0, 0), 45.0), ((-1, 0, 0), 45.0)]
    observations = []
    for number, (g, t) in enumerate(conditions):
        dt = t - 25.0
        a = np.dot(row, g) / row[0]
        reading = offset + drift * dt + (1 + gain * dt) * row[0] * (a + bend[0] * a**2 + bend[1] * a**3)
        observations.append(observe(str(number), g, reading, t=t))
    found = estimate(observations, Design(("x",), ("x", "y", "z"), 1, 1, reference=25.0, jig=0.0, nonlinearity=2))
    assert found.coefficients.thermal is not None
    assert found.coefficients.offset[0] == pytest.approx(offset, rel=1e-9, abs=1e-8)
    assert found.coefficients.sensitivity[0] == pytest.approx(row, rel=1e-9, abs=1e-8)
    assert found.coefficients.thermal.drift[0, 0] == pytest.approx(drift, abs=1e-8)
    assert found.coefficients.thermal.gain[0, 0] == pytest.approx(gain, abs=1e-11)
    assert found.coefficients.nonlinearity[0] == pytest.approx(bend, abs=1e-9)


FACES = {
    "x-up": (1, 0, 0),
    "x-down": (-1, 0, 0),
    "y-up": (0, 1, 0),
    "y-down": (0, -1, 0),
    "z-up": (0, 0, 1),
    "z-down": (0, 0, -1),
}


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
