"""The coverage factor of a 95 % interval, from effective degrees of freedom.

Source: *Guide to the expression of uncertainty in measurement* (GUM), 6.2 and annex G.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import sqrt

import numpy as np

from tiltcal.core.model import Array

COVERAGE = 0.95
"""Probability that a stated interval contains the truth."""

NORMAL_FACTOR = 1.959963984540054
"""The coverage factor of a variance that is known: the normal distribution is within so many deviations in 95 %."""

FACTOR_STEPS = 1 << 14
"""Of the table of coverage factors: four digits of a factor."""

NEGLIGIBLE = 1e-3
"""The share of a variance below which a part of it changes no coverage factor visibly."""

_BISECTIONS = 40

_NARROW = 1.0 / (1.0 + NEGLIGIBLE) ** 2  # an estimated part over the widened one, from which it counts as narrowed


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


class CoverageFactors:
    """Coverage factors of sums of an estimated and a known variance, for millions of values at a time.

    The estimated part of a variance has Student's t as its factor; the other part is known. Their sum has effective
    degrees of freedom (GUM, eq. G.2b), which give the factor. Both functions have one argument and are smooth, so they
    are looked up in tables.
    """

    def __init__(self) -> None:
        from scipy.special import stdtrit

        upper = 0.5 + COVERAGE / 2.0
        at = (np.arange(FACTOR_STEPS) + 0.5) / FACTOR_STEPS
        self._factors = np.asarray(stdtrit(1.0 / at, upper))
        """By one over the degrees of freedom, from 0 to 1."""
        whole = np.concatenate([[NORMAL_FACTOR], self._factors, [float(stdtrit(1.0, upper))]])
        self._inverse_dof = np.interp(NORMAL_FACTOR / np.sqrt(at), whole, np.concatenate([[0.0], at, [1.0]]))
        """One over the degrees of freedom, by the square of the normal factor over Student's."""

    def whole(self, estimated: Array, widened: Array | float, known: Array) -> tuple[Array, Array]:
        """Return a variance of two parts, and what its root is multiplied with for an interval of 95 %.

        Parameters
        ----------
        estimated : ndarray, shape (n,)
            The part of the variance that was estimated.
        widened : ndarray, shape (n,), or float
            The same part with what Student's t stretches it by: its square of half an interval over that of 1.96.
            A number is that stretch, where it is the same everywhere.
        known : ndarray, shape (n,)
            The other part.

        Returns
        -------
        tuple of ndarray, shape (n,)
            The factor is NaN where an argument is, or where nothing is uncertain.

        Notes
        -----
        The estimated part may have a factor below 1.96, where large errors also make the residuals large from which
        their size is estimated. Then no degrees of freedom are sought: the interval is the root of the sum of
        squares of both parts' intervals.
        """
        total = estimated + known
        with np.errstate(invalid="ignore", divide="ignore"):
            inverse_dof = estimated / total
            inverse_dof *= inverse_dof
            stretched = isinstance(widened, float)
            own = np.asarray(1.0 / widened) if stretched else estimated / widened
            inverse_dof *= _looked_up(self._inverse_dof, own)
            factor = _looked_up(self._factors, inverse_dof)
            if not np.max(own) < _NARROW:
                narrow = np.broadcast_to(~(own < _NARROW), total.shape)
                whole = known + (estimated * widened if stretched else widened)
                factor[narrow] = NORMAL_FACTOR * np.sqrt(whole[narrow] / total[narrow])
        return total, factor


@cache
def coverage_factors() -> CoverageFactors:
    """Return the tables, which are made once."""
    return CoverageFactors()


def _looked_up(table: Array, argument: Array) -> Array:
    """Return the table's values at arguments from 0 to 1, and the first one where there is no number."""
    with np.errstate(invalid="ignore"):
        place = (argument * len(table)).astype(np.intp)
    return np.take(table, place, mode="clip")
