"""The uncertainty of an estimate by its sources.

Near the solution every coefficient is a linear function of the equations' errors, so every equation has its share of
every variance: the readings by noise and rounding, what is stated of an unknown by its source.

**By hand.** One channel of known offset in one position reads ``S sin(t + a)`` with the uncertainty u, of which
rounding gives r; S is stated to v before, and the jig to s. What it reads differs from S sin t with the variance V, and
S changes by G for a unit of it::

    V = u² + (v sin t)² + (s S cos t)²,   G = v² sin t / V
    noise = G² (u² - r²),   adc = G² r²,   assumed = (1 - G sin t)² v²,   jig = (G s S cos t)²

The four add up to v² (1 - G sin t).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

import numpy as np

from tiltcal.core.coverage_factor import welch_satterthwaite
from tiltcal.core.estimation.equations import ADC, NOISE, PRIOR
from tiltcal.core.estimation.solve import EstimatedVariance, Solution
from tiltcal.core.model import Array
from tiltcal.core.uncertainty_budget import Budget


def budgets(solution: Solution, estimated: dict[str, EstimatedVariance]) -> list[Budget]:
    """Return the uncertainty of each sensor's coefficients.

    Parameters
    ----------
    estimated : mapping of str to EstimatedVariance
        The variance that the residuals showed, by its source: JIG, THERMOMETER, or ADC for noise and rounding together.
    """
    equations, errors, covariance = solution.equations, solution.errors, solution.covariance
    weights, n = equations.weights(errors), len(equations.names)
    rounding = np.concatenate([channel.adc for channel in equations.channels]) / equations.u
    rounding = np.clip(rounding**2 / errors.noise, 0.0, 1.0)
    groups, dofs = _pooled_noise(solution)
    found = []
    for own in _by_sensor(solution):
        by = solution.near.jacobian @ covariance[:, own]  # readings by coefficients
        squares = np.square(by)
        noise = squares * (1.0 - rounding)[:, None]
        variance = {NOISE: noise.sum(axis=0), ADC: squares.sum(axis=0) - noise.sum(axis=0)}
        if weights[:n].any():
            variance[PRIOR] = np.sum((covariance[own, :n] * weights[:n]) ** 2, axis=1)
        for source, columns in equations.errors.items():
            if weights[columns].any():
                variance[source] = np.sum((covariance[own, columns] * weights[columns]) ** 2, axis=1)
        parts: list[tuple[Array, float]] = []
        if ADC in estimated:
            parts.append((variance[NOISE] + variance[ADC], estimated[ADC].dof))
        elif len(dofs):
            shares = np.stack([np.bincount(groups, column, len(dofs)) for column in noise.T], axis=1)
            parts += [(share, dof) for share, dof in zip(shares, dofs.tolist(), strict=True) if isfinite(dof)]
        for source, shown in estimated.items():
            if source != ADC and shown.information:
                parts.append((_by_variance(solution, source, own), shown.information))
        total = np.diag(covariance)[own]
        found.append(Budget(covariance[own, own], variance, welch_satterthwaite(total, parts)))
    return found


def _by_sensor(solution: Solution) -> Iterator[slice]:
    """Yield the coefficients of each sensor."""
    start = 0
    for sensor in solution.equations.sensors:
        yield slice(start, start + len(sensor.design.names))
        start += len(sensor.design.names)


def _pooled_noise(solution: Solution) -> tuple[Array, Array]:
    """Number the estimates of noise that the readings share, shape (readings,), and return their degrees of freedom.

    Readings of one channel with the same uncertainty have it from one pooled estimate.
    """
    channels = solution.equations.channels
    if all(np.isinf(channel.dof).all() for channel in channels):
        return np.zeros(0), np.zeros(0)
    keys = [np.stack([np.full(len(c.u), k), c.u, c.dof], axis=1) for k, c in enumerate(channels)]
    unique, groups = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    return groups.ravel(), unique[:, 2]


def _by_variance(solution: Solution, source: str, own: slice) -> Array:
    """Return by how much the variance of each coefficient grows with that of the errors of a source."""
    columns, covariance = solution.equations.errors[source], solution.covariance
    u = getattr(solution.errors, source)
    if u > 0.0:
        return np.asarray(np.sum(covariance[own, columns] ** 2, axis=1) / u**4)
    follows = covariance[own] @ (solution.near.jacobian.T @ solution.near.jacobian[:, columns]).toarray()
    return np.asarray(np.sum(follows**2, axis=1))
