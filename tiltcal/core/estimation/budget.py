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

import numpy as np

from tiltcal.core.estimation.equations import ADC, JIG, NOISE, PRIOR
from tiltcal.core.estimation.solve import EstimatedVariance, Solution
from tiltcal.core.model import Array
from tiltcal.core.uncertain import NORMAL_FACTOR, Uncertain, coverage_factor


def budgets(solution: Solution, estimated: Mapping[str, EstimatedVariance]) -> list[Uncertain]:
    """Return the coefficients of each sensor with their uncertainty.

    ``estimated`` are the variances that the residuals showed; that of NOISE is of noise and rounding together.
    """
    equations, bench, near, covariance = solution.equations, solution.bench, solution.near, solution.covariance
    readings = len(equations.u)
    measured = bench[NOISE] * (equations.u / near.sigma) ** 2  # the rest is the square of uncertain attitudes
    rounding = np.concatenate([channel.adc for channel in equations.channels]) / equations.u
    rounding = measured * np.minimum(rounding**2 / bench[NOISE], 1.0)
    dof = np.concatenate([channel.dof for channel in equations.channels])
    drawn = measured if NOISE in estimated else measured - rounding
    drawn = drawn * _excess(np.full(readings, estimated[NOISE].dof) if NOISE in estimated else dof)
    stated = {source: equations.rows(source) for source in equations.errors if bench[source]}
    if len(equations.stated_target):
        stated = {PRIOR: equations.rows(PRIOR), **stated}
    by_readings = near.part(slice(0, readings)).normal if estimated else np.zeros((0, 0))
    budgets = []
    for sensor, own in zip(equations.sensors, equations.sensor_coefficients(), strict=True):
        by = near.times(covariance[:, own])  # equations by coefficients
        squares, by_noise = np.square(by), by[:readings]
        variance = {NOISE: (measured - rounding) @ squares[:readings], ADC: rounding @ squares[:readings]}
        variance |= {source: squares[rows].sum(axis=0) for source, rows in stated.items() if rows.stop > rows.start}
        if bench[JIG]:
            variance[JIG] = variance[JIG] + (1.0 - measured) @ squares[:readings]
        total, more = covariance[own, own], by_noise.T @ (drawn[:, None] * by_noise)
        for source, shown in estimated.items():
            if source == NOISE or not shown.dof:
                continue
            by_error = (by_readings[equations.errors[source]] @ covariance[:, own]).T
            by_variance = by_error @ by_error.T
            more = more + shown.whole * float(_excess(np.array([shown.dof]))[0]) * by_variance
            if source == JIG and shown.value < 0.0:
                # The noise, by chance, was less than measured: so is what it does to the coefficients.
                total = total + shown.value * by_variance
                variance[NOISE] = variance[NOISE] + shown.value * np.diag(by_variance)
        budgets.append(Uncertain(sensor.design.names, solution.z[own], total, total + more, variance))
    return budgets


def _excess(dof: Array) -> Array:
    """Return by which share a variance with degrees of freedom grows for its 95 % interval, shape (k,)."""
    return np.asarray((coverage_factor(dof) / NORMAL_FACTOR) ** 2 - 1.0)
