"""The coverage factor of a 95 % interval, from effective degrees of freedom.

Source: *Guide to the expression of uncertainty in measurement* (GUM), 6.2 and annex G.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np

from tiltcal.core.model import Array

COVERAGE = 0.95
"""Probability that a stated interval contains the truth."""

NORMAL_FACTOR = 1.959963984540054
"""The coverage factor of a variance that is known: the normal distribution is within so many deviations in 95 %."""

NEGLIGIBLE = 1e-3
"""The share of a variance below which a part of it changes no coverage factor visibly."""

_BISECTIONS = 40


def coverage_factor(dof: Array) -> Array:
    """Return the coverage factors of 95 % intervals: Student's t, 1.96 where the degrees of freedom are infinite.

    Parameters
    ----------
    dof : ndarray, shape (k,)
        Effective degrees of freedom; below 1 they count as 1.
    """
    factors, estimated = np.full(dof.shape, NORMAL_FACTOR), np.isfinite(dof)
    if estimated.any():
        from scipy.special import stdtrit

        factors[estimated] = stdtrit(np.maximum(dof[estimated], 1.0), 0.5 + COVERAGE / 2.0)
    return factors


def degrees_of_freedom(factors: Array) -> Array:
    """Return the degrees of freedom of coverage factors, shape (k,), by Student's t; infinite for the normal one."""
    dof, wider = np.full(factors.shape, np.inf), factors > NORMAL_FACTOR * (1.0 + NEGLIGIBLE)
    if wider.any():
        from scipy.special import stdtridf

        dof[wider] = stdtridf(0.5 + COVERAGE / 2.0, factors[wider])
    return dof


def half_width(spread: Array, weights: Array) -> Array:
    """Return half of the 95 % interval of mixtures of normal distributions about one centre, shape (k,).

    Parameters
    ----------
    spread : ndarray, shape (k, m)
        Standard deviations.
    weights : ndarray, shape (m,)
        Their sum is 1.
    """
    from scipy.special import erf

    low, high = np.zeros(len(spread)), 10.0 * np.max(spread, axis=1)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        short = np.sum(weights * erf(middle[:, None] / spread / sqrt(2.0)), axis=1) < COVERAGE
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.asarray(high)


def welch_satterthwaite(variance: Array, parts: Sequence[tuple[Array, float | Array]]) -> Array:
    """Return effective degrees of freedom of sums of variances (GUM, eq. G.2b); infinite where no part was estimated.

    Parameters
    ----------
    variance : ndarray, shape (k,)
        The sums.
    parts : sequence of (ndarray of shape (k,), float or ndarray of shape (k,))
        The parts, each with its degrees of freedom; infinite where it was not estimated.
    """
    weighted = np.zeros_like(variance)
    for part, dof in parts:
        weighted += part**2 / dof
    # A part so small that the quotient is no number is none.
    counts = weighted > variance**2 * np.finfo(float).tiny
    return np.divide(variance**2, weighted, out=np.full_like(weighted, np.inf), where=counts)
