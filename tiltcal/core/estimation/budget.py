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

from collections.abc import Mapping
from math import isfinite

import numpy as np

from tiltcal.core.estimation.equations import ADC, JIG, NOISE, PRIOR, Indices
from tiltcal.core.estimation.solve import EstimatedVariance, Solution
from tiltcal.core.model import Array
from tiltcal.core.uncertain import Uncertain, welch_satterthwaite


def budgets(solution: Solution, estimated: Mapping[str, EstimatedVariance]) -> list[Uncertain]:
    """Return the coefficients of each sensor with their uncertainty.

    ``estimated`` are the variances that the residuals showed; that of NOISE is of noise and rounding together.
    """
    equations, bench, near, covariance = solution.equations, solution.bench, solution.near, solution.covariance
    readings = len(equations.u)
    measured = bench[NOISE] * (equations.u / near.sigma) ** 2  # the rest is the square of uncertain attitudes
    rounding = np.concatenate([channel.adc for channel in equations.channels]) / equations.u
    rounding = measured * np.minimum(rounding**2 / bench[NOISE], 1.0)
    groups, dofs = _pooled_noise(solution)
    stated = {source: equations.rows(source) for source in equations.errors if bench[source]}
    if len(equations.stated_target):
        stated = {PRIOR: equations.rows(PRIOR), **stated}
    by_readings = near.part(slice(0, readings)).normal if estimated else np.zeros((0, 0))
    budgets = []
    for sensor, own in zip(equations.sensors, equations.sensor_coefficients(), strict=True):
        by = near.times(covariance[:, own])  # equations by coefficients
        squares = np.square(by)
        noise = squares[:readings] * (measured - rounding)[:, None]
        variance = {NOISE: noise.sum(axis=0), ADC: rounding @ squares[:readings]}
        variance |= {source: squares[rows].sum(axis=0) for source, rows in stated.items() if rows.stop > rows.start}
        if bench[JIG]:
            variance[JIG] = variance[JIG] + (1.0 - measured) @ squares[:readings]
        parts: list[tuple[Array, float]] = []
        if NOISE in estimated:
            parts.append((variance[NOISE] + variance[ADC], estimated[NOISE].dof))
        elif len(dofs):
            shares = np.stack([np.bincount(groups, column, len(dofs)) for column in noise.T], axis=1)
            parts += [(share, dof) for share, dof in zip(shares, dofs.tolist(), strict=True) if isfinite(dof)]
        total = covariance[own, own]
        for source, shown in estimated.items():
            if source == NOISE or not shown.information:
                continue
            by_error = (by_readings[equations.errors[source]] @ covariance[:, own]).T
            parts.append((np.sum(by_error**2, axis=1), shown.information))
            if source == JIG and shown.value < 0.0:
                # The noise, by chance, was less than measured: so is what it does to the coefficients.
                total = total + shown.value * by_error @ by_error.T
                variance[NOISE] = variance[NOISE] + shown.value * np.sum(by_error**2, axis=1)
        dof = welch_satterthwaite(np.diag(total), parts)
        budgets.append(Uncertain(sensor.design.names, solution.z[own], total, dof, variance))
    return budgets


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
