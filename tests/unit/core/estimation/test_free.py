"""The fit of a three-axis sensor at rest from the length of gravity alone, with the attitudes eliminated."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tiltcal.core.estimation.free import fit_free

OFFSET = np.array([0.3, -0.2, 0.1])
SENSITIVITY = np.array([[9.9, 0.05, -0.08], [0.0, 9.7, 0.12], [0.0, 0.0, 10.1]])


def attitudes(n: int, seed: int = 1) -> NDArray[np.float64]:
    """Directions all over the sphere."""
    return np.asarray(Rotation.random(n, random_state=seed).as_matrix()[:, :, 2])


def readings(up: NDArray[np.float64], noise: float = 0.0, seed: int = 2) -> NDArray[np.float64]:
    return up @ SENSITIVITY.T + OFFSET + noise * np.random.default_rng(seed).normal(size=up.shape)


def test_it_is_the_minimum_that_scipy_finds() -> None:
    mean = readings(attitudes(18), noise=0.02)

    def lengths_less_one(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        inverse = np.array([[theta[0], theta[1], theta[2]], [0, theta[3], theta[4]], [0, 0, theta[5]]])
        return np.asarray(np.linalg.norm((mean - theta[6:]) @ inverse.T, axis=1) - 1.0)

    start = [0.1, 0, 0, 0.1, 0, 0.1, 0, 0, 0]
    peer = least_squares(lengths_less_one, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
    found = fit_free(mean, np.full((18, 3), 1e-3))
    assert found.misfit == pytest.approx(peer.fun, abs=1e-7)
    assert found.offset == pytest.approx(peer.x[6:], abs=1e-6)
    inverse = np.zeros((3, 3))
    inverse[np.triu_indices(3)] = peer.x[:6]
    assert found.sensitivity == pytest.approx(np.linalg.inv(inverse), abs=1e-5)
    gravity = (mean - peer.x[6:]) @ inverse.T
    assert found.attitudes == pytest.approx(gravity / np.linalg.norm(gravity, axis=1, keepdims=True), abs=1e-6)
    # The uncertainty of the offsets, from the peer's Jacobian and the scatter of its residuals.
    u = np.sqrt(np.diag(np.linalg.inv(peer.jac.T @ peer.jac))[6:] * 2 * peer.cost / 9)
    assert found.uncertain(np.inf).u[[0, 4, 8]] == pytest.approx(u, rel=1e-4)


def test_misfits_below_the_noise_are_chance_or_sway() -> None:
    """The noise counts where such small misfits happen by chance; far below it shows that it is no noise of length."""
    up = attitudes(12)
    by_chance = fit_free(readings(up, noise=0.05), np.full((12, 3), 0.1))
    assert by_chance.below_noise
    # 0.1 of about 9.9 per g
    assert by_chance.noise == pytest.approx(0.0101, rel=0.05)
    sway = fit_free(readings(up, noise=0.001), np.full((12, 3), 0.1))
    assert not sway.below_noise
    assert sway.uncertain(np.inf).u[0] == pytest.approx(
        by_chance.uncertain(np.inf).u[0] * sway.scatter / 0.0101, rel=0.05
    )
