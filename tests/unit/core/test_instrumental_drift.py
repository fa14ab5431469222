"""How far a coefficient wanders between its calibrations, against its distribution and simulated histories."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import stdtrit

from tiltcal.core.instrumental_drift import WalkContrasts, estimate_walk, walk_contrasts
from tiltcal.core.model import Array


def test_without_noise_the_rate_is_the_mean_square_with_as_many_degrees_of_freedom() -> None:
    """The posterior of a variance under Jeffreys' prior: n times the mean square over chi-square of n."""
    values = np.array([1.0, -2.0, 0.5, 3.0, -1.0, 0.2, 1.5, -0.7])
    walk = estimate_walk(WalkContrasts(values, np.full(8, 1e-9)))
    assert walk is not None
    assert walk.dof == pytest.approx(8.0, rel=0.02)
    assert walk.rate == pytest.approx(np.mean(values**2), rel=0.02)


def test_two_calibrations_give_the_square_of_their_difference_over_the_time() -> None:
    """6 units in 9 days: 4 unit²/d, and a noise of 0.3² + 0.4² over 9 days."""
    contrasts = walk_contrasts(np.array([1.0, 10.0]), np.array([2.0, 8.0]), np.array([0.3, 0.4]), steady=False)
    assert np.abs(contrasts.value) == pytest.approx([2.0])
    assert contrasts.noise == pytest.approx([0.25 / 9.0])
    assert not len(walk_contrasts(np.array([1.0, 10.0]), np.array([2.0, 8.0]), np.zeros(2), steady=True))
    assert estimate_walk(WalkContrasts.joined([])) is None


def test_a_steady_change_is_no_walk() -> None:
    days = np.array([0.0, 30.0, 200.0, 365.0])
    contrasts = walk_contrasts(days, 5.0 + 0.01 * days, np.full(4, 0.1), steady=True)
    assert len(contrasts) == 2
    assert contrasts.value == pytest.approx([0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("truth", ["walk", "line"])
def test_an_interpolated_coefficient_is_within_its_interval(truth: str) -> None:
    """Twenty units with four calibrations each, u = 0.5 of what a year adds: 95 % at 9 times in the last year."""
    draw = np.random.default_rng(5)
    inside = [interpolated(truth, draw) for _ in range(40)]
    assert 0.94 < np.mean(inside) < 0.965


def interpolated(truth: str, draw: np.random.Generator, u: float = 0.5, units: int = 20) -> Array:
    days = np.array([0.0, 400.0, 700.0, 1100.0])
    at = np.linspace(700.0, 1100.0, 11)[1:-1]
    every = np.sort(np.concatenate([days, at]))
    steps = draw.normal(size=(units, len(every) - 1)) * np.sqrt(np.diff(every) / 365.0)
    walk = np.concatenate([np.zeros((units, 1)), np.cumsum(steps, axis=1)], axis=1)
    true = walk if truth == "walk" else draw.normal(size=(units, 1)) * every / 365.0
    measured = true[:, np.searchsorted(every, days)] + draw.normal(0.0, u, (units, 4))
    parts = [walk_contrasts(days, row, np.full(4, u), steady=True) for row in measured]
    found = estimate_walk(WalkContrasts.joined(parts))
    assert found is not None
    share = (at - 700.0) / 400.0
    error = measured[:, 2:3] * (1.0 - share) + measured[:, 3:] * share - true[:, np.searchsorted(every, at)]
    known, bridge = u**2 * ((1.0 - share) ** 2 + share**2), found.rate * share * (1.0 - share) * 400.0
    factor = stdtrit((known + bridge) ** 2 / (bridge**2 / found.dof), 0.975)
    return np.asarray(np.abs(error) < factor * np.sqrt(known + bridge))
