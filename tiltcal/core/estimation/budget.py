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

from collections.abc import Iterator, Mapping
from math import isfinite

import numpy as np

from tiltcal.core.estimation.equations import ADC, JIG, NOISE, PRIOR, Indices
from tiltcal.core.estimation.solve import EstimatedVariance, Solution
from tiltcal.core.model import Array
from tiltcal.core.uncertain import Uncertain, welch_satterthwaite


def budgets(solution: Solution, estimated: Mapping[str, EstimatedVariance]) -> list[Uncertain]:
    """Return the coefficients of each sensor with their uncertainty.

    Parameters
    ----------
    estimated : mapping of str to EstimatedVariance
        The variance that the residuals showed, by its source: JIG, THERMOMETER, or ADC for noise and rounding together.
    """
    equations, errors, covariance = solution.equations, solution.errors, solution.covariance
    weights, n = equations.weights(errors), len(equations.names)
    measured = solution.near.measured
    rounding = np.concatenate([channel.adc for channel in equations.channels]) / equations.u
    rounding = measured * np.minimum(rounding**2 / errors.noise, 1.0)
    groups, dofs = _pooled_noise(solution)
    found = []
    for sensor, own in zip(equations.sensors, _by_sensor(solution), strict=True):
        by = solution.near.times(covariance[:, own])  # readings by coefficients
        squares = np.square(by)
        noise = squares * (measured - rounding)[:, None]
        variance = {NOISE: noise.sum(axis=0), ADC: rounding @ squares}
        if len(equations.prior_target):
            variance[PRIOR] = np.sum((covariance[own, :n] @ equations.prior_rows.T) ** 2, axis=1)
        for source, columns in equations.errors.items():
            if weights[columns].any():
                variance[source] = np.sum((covariance[own, columns] * weights[columns]) ** 2, axis=1)
        if errors.jig:
            variance[JIG] = variance[JIG] + (1.0 - measured) @ squares
        parts: list[tuple[Array, float]] = []
        if ADC in estimated:
            parts.append((variance[NOISE] + variance[ADC], estimated[ADC].dof))
        elif len(dofs):
            shares = np.stack([np.bincount(groups, column, len(dofs)) for column in noise.T], axis=1)
            parts += [(share, dof) for share, dof in zip(shares, dofs.tolist(), strict=True) if isfinite(dof)]
        for source, shown in estimated.items():
            if source != ADC and shown.information:
                parts.append((np.sum(_by_error(solution, source, own) ** 2, axis=1), shown.information))
        total = covariance[own, own]
        jig = estimated.get(JIG)
        if jig is not None and jig.value < 0.0:
            # The noise, by chance, was less than measured: so is what it does to the coefficients.
            by_angle = _by_error(solution, JIG, own)
            total = total + jig.value * by_angle @ by_angle.T
            variance[NOISE] = variance[NOISE] + jig.value * np.sum(by_angle**2, axis=1)
        dof = welch_satterthwaite(np.diag(total), parts)
        found.append(Uncertain(sensor.design.names, solution.z[own], total, dof, variance))
    return found


def _by_sensor(solution: Solution) -> Iterator[slice]:
    """Yield the coefficients of each sensor."""
    start = 0
    for sensor in solution.equations.sensors:
        yield slice(start, start + len(sensor.design.names))
        start += len(sensor.design.names)


def _pooled_noise(solution: Solution) -> tuple[Indices, Array]:
    """Number the estimates of noise that the readings share, shape (readings,), and return their degrees of freedom.

    Readings of one channel with the same uncertainty have it from one pooled estimate.
    """
    channels = solution.equations.channels
    if all(np.isinf(channel.dof).all() for channel in channels):
        return np.zeros(0, dtype=np.intp), np.zeros(0)
    keys = [np.stack([np.full(len(c.u), k), c.u, c.dof], axis=1) for k, c in enumerate(channels)]
    unique, groups = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    return np.asarray(groups.ravel(), dtype=np.intp), unique[:, 2]


def _by_error(solution: Solution, source: str, own: slice) -> Array:
    """Return how the coefficients follow the errors of a source, shape (coefficients, errors)."""
    columns, covariance = solution.equations.errors[source], solution.covariance
    u = getattr(solution.errors, source)
    if u > 0.0:
        return np.asarray(covariance[own, columns] / u**2)
    return np.asarray(covariance[own] @ solution.near.normal[:, columns])
