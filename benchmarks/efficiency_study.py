"""Simulated calibrations, and how near their errors are to the Cramér-Rao bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan

import numpy as np
from numpy.typing import NDArray
from support.simulated_bench import FACES, Part, Plan, design, fixture, measured, part, plan_of

from tiltcal.core.estimation.equations import Equations
from tiltcal.core.estimation.estimate import Estimate, estimate_jointly
from tiltcal.core.estimation.free import fit_free
from tiltcal.core.estimation.positions import Observation
from tiltcal.core.estimation.solve import budgets, solved_at

Array = NDArray[np.float64]

OFFSET, OWN, CROSS = [0, 4, 8], [1, 6, 11], [2, 3, 5, 7, 9, 10]
"""Places of the coefficients in their vector of twelve."""

CLASSES = {"offset": OFFSET, "own": OWN, "cross": CROSS}

METHODS = ("joint", "jig not stated", "least squares", "six faces", "unit gravity")

BOUNDS = 40
"""Most sessions over which the bound is averaged: it differs by a per cent from part to part."""

REACH = 0.05
"""The share of the bound's variance that second powers may add where the bound counts as attainable."""


@dataclass(frozen=True)
class EfficiencyRegime:
    """One bench."""

    jig: float
    count: int
    sensors: int
    noise: float


@dataclass(frozen=True)
class Result:
    """Bound over mean square error by method and class, its Monte Carlo error for the estimator, and the attainable."""

    ratio: Mapping[str, Mapping[str, float]]
    error: Mapping[str, float]
    attainable: Mapping[str, float]


def simulate(
    regime: EfficiencyRegime, calibrations: int, seed: int, methods: Sequence[str] = METHODS, bounds_of: int = BOUNDS
) -> Result:
    """Many calibrations of one bench; the bound is the mean of the first ``bounds_of`` sessions."""
    rng = np.random.default_rng([seed, round(100 * regime.jig), regime.count, regime.sensors])
    plan = plan_of(regime.count, noise=regime.noise, jig=regime.jig)
    squares: dict[str, list[Array]] = {}
    bounds, beyond = [], []
    for session in range(max(calibrations // regime.sensors, 2)):
        parts = [part(rng) for _ in range(regime.sensors)]
        observations = measured(rng, plan, parts)
        if session < bounds_of:
            bounds.append(bound_of(plan, parts))
            beyond.append(beyond_bound(plan, parts, seed=session))
        for method, errors in _errors(plan, parts, observations, methods).items():
            squares.setdefault(method, []).append(errors**2)
    bound, second = np.mean(bounds, axis=(0, 1)), np.mean(beyond, axis=(0, 1))
    ratio = {
        method: {name: float(_ratio(bound, np.mean(found, axis=(0, 1)), rows)) for name, rows in CLASSES.items()}
        for method, found in squares.items()
    }
    return Result(
        ratio, _error(squares["joint"], bound), {n: _ratio(bound, bound + second, r) for n, r in CLASSES.items()}
    )


def bound_of(plan: Plan, parts: list[Part]) -> Array:
    """The bound's variances at the truth, shape (sensors, 12)."""
    exact = measured(np.random.default_rng(0), replace(plan, jig=0.0, noise=0.0), parts)
    stated = [[replace(one, u=np.full(3, plan.noise)) for one in sensor] for sensor in exact]
    equations = Equations(fixture(stated, design(plan, jig=plan.jig)))
    z = np.zeros(equations.unknowns)
    z[: len(equations.names)] = np.concatenate([one.truth for one in parts])
    return np.array([np.diag(budget.covariance) for budget in budgets(solved_at(equations, z))])


def beyond_bound(plan: Plan, parts: list[Part], seed: int) -> Array:
    """Squares of what even powers of the attitudes do to the estimate: the mean of some attitudes and their opposites.

    No noise is in it, and no odd power, which is what the bound counts.
    """
    found = []
    for sign in (1.0, -1.0):
        rng = np.random.default_rng(seed)
        exact = measured(rng, replace(plan, jig=sign * plan.jig, noise=0.0), parts)
        stated = [[replace(one, u=np.full(3, plan.noise)) for one in sensor] for sensor in exact]
        found.append(_vectors(estimate_jointly(fixture(stated, design(plan, jig=plan.jig)))))
    return np.asarray((np.mean(found, axis=0) - [one.truth for one in parts]) ** 2)


def _errors(
    plan: Plan, parts: list[Part], observations: list[list[Observation]], methods: Sequence[str]
) -> dict[str, Array]:
    """Errors of each method, shape (sensors, 12); NaN where it says nothing."""
    truth = np.array([one.truth for one in parts])
    errors = {}
    if "joint" in methods:
        errors["joint"] = _vectors(estimate_jointly(fixture(observations, design(plan, jig=plan.jig)))) - truth
    if "jig not stated" in methods:
        errors["jig not stated"] = _vectors(estimate_jointly(fixture(observations, design(plan, jig=None)))) - truth
    if "least squares" in methods:
        # All readings have one uncertainty here: a perfect jig weighs them alike.
        errors["least squares"] = _vectors(estimate_jointly(fixture(observations, design(plan, jig=0.0)))) - truth
    if "six faces" in methods:
        errors["six faces"] = np.array([_six_faces(one) for one in observations]) - truth
    if "unit gravity" in methods:
        errors["unit gravity"] = _unit_gravity(plan, observations, truth)
    return errors


def _unit_gravity(plan: Plan, observations: list[list[Observation]], truth: Array) -> Array:
    errors = np.full_like(truth, nan)
    if len(plan.gravity) > 9:
        fits = [
            fit_free(np.array([one.mean for one in sensor]), np.array([one.u for one in sensor]))
            for sensor in observations
        ]
        found = np.array([np.hstack([one.offset[:, None], one.sensitivity]).ravel() for one in fits])
        errors[:, OFFSET] = found[:, OFFSET] - truth[:, OFFSET]
        # Without a frame of its own only the length of a row is comparable.
        errors[:, OWN] = _lengths(found) - _lengths(truth)
    return errors


def _vectors(found: tuple[Estimate, ...]) -> Array:
    return np.array(
        [np.hstack([one.coefficients.offset[:, None], one.coefficients.sensitivity]).ravel() for one in found]
    )


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors.reshape(-1, 3, 4)[:, :, 1:], axis=2))


def _six_faces(observations: list[Observation]) -> Array:
    """Half sums and half differences of opposite faces."""
    by_face = {tuple(one.gravity): one.mean for one in observations}
    if not all(tuple(face) in by_face for face in FACES):
        return np.full(12, nan)
    up, down = (np.array([by_face[tuple(face)] for face in FACES[start::2]]) for start in (0, 1))
    return np.hstack([np.diag((up + down) / 2)[:, None], (up - down).T / 2]).ravel()


def _ratio(bound: Array, squares: Array, rows: list[int]) -> float:
    return float(np.sum(bound[rows]) / np.sum(squares[rows]))


def _error(squares: list[Array], bound: Array) -> dict[str, float]:
    """Standard deviation of the estimator's ratio, from the scatter over sessions."""
    table = np.mean(squares, axis=1)
    found = {}
    for name, rows in CLASSES.items():
        sums = table[:, rows].sum(axis=1)
        found[name] = float(np.sum(bound[rows]) / sums.mean() * sums.std(ddof=1) / sums.mean() / np.sqrt(len(sums)))
    return found
