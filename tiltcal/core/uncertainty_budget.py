"""The uncertainty budget: the sources of each coefficient's uncertainty, and its coverage factor for 95 %.

Source: *Guide to the expression of uncertainty in measurement* (GUM), 4.2, 5.1 and annex G (Welch-Satterthwaite).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

from tiltcal.core.model import Array
from tiltcal.frozen import frozen

COVERAGE = 0.95
"""Probability that a stated interval contains the truth."""

NORMAL_FACTOR = 1.959963984540054
"""The coverage factor of a variance that is known: the normal distribution is within so many deviations in 95 %."""

FACTOR_STEPS = 1 << 14
"""Of the table of coverage factors: four digits of a factor."""

NEGLIGIBLE = 1e-3
"""A part of a variance below this changes no factor that anyone would see."""


@frozen
class Part:
    """What one source of uncertainty adds to some quantities: errors, and how the quantities follow them.

    Attributes
    ----------
    by : ndarray, shape (k, m)
        Derivatives of the quantities by the errors.
    covariance : ndarray, shape (m, m)
    factors : ndarray, shape (m,)
        What each error's standard uncertainty is multiplied with for an interval of 95 %.
    """

    source: str
    by: Array
    covariance: Array
    factors: Array

    @classmethod
    def known(cls, source: str, by: Array, covariance: Array) -> Part:
        """Return the part of errors whose uncertainty is known and not estimated from a scatter."""
        return cls(source, by, covariance, np.full(len(covariance), NORMAL_FACTOR))

    @property
    def dof(self) -> Array:
        """Degrees of freedom of its part of each quantity's variance, shape (k,), from its 95 % intervals."""
        from scipy.special import stdtridf

        normal = coverage_factor(np.array([np.inf]))[0]
        wider = np.maximum(self.factors / normal, 1.0)
        own, wide = (
            np.einsum("ik,kl,il->i", self.by, matrix, self.by)
            for matrix in (self.covariance, self.covariance * np.outer(wider, wider))
        )
        ratio = np.sqrt(wide / np.where(own > 0.0, own, 1.0))
        told = (own > 0.0) & (ratio > 1.0 + NEGLIGIBLE)
        return np.where(told, stdtridf(0.5 + COVERAGE / 2.0, np.where(told, normal * ratio, 3.0)), np.inf)


@frozen
class Budget:
    """Covariance of quantities, and its sources.

    Attributes
    ----------
    covariance : ndarray, shape (k, k)
    variance : mapping of str to ndarray, shape (k,)
        By source; their sum is the diagonal of the covariance.
    dof : ndarray, shape (k,)
        Effective degrees of freedom; infinite where nothing was estimated from a scatter.
    """

    covariance: Array
    variance: Mapping[str, Array]
    dof: Array

    @classmethod
    def of(cls, parts: Sequence[Part]) -> Budget:
        """Return the budget of quantities whose errors come from independent sources."""
        shares = [part.by @ part.covariance @ part.by.T for part in parts]
        variance: dict[str, Array] = {}
        for part, share in zip(parts, shares, strict=True):
            variance[part.source] = variance.get(part.source, 0.0) + np.diag(share)
        covariance = np.sum(shares, axis=0)
        estimated = [(np.diag(share), part.dof) for part, share in zip(parts, shares, strict=True)]
        return cls(covariance, variance, welch_satterthwaite(np.diag(covariance), estimated))

    @property
    def factors(self) -> Array:
        """What each standard uncertainty is multiplied with for an interval of 95 %, shape (k,)."""
        return coverage_factor(self.dof)

    @property
    def u(self) -> Array:
        """Standard uncertainties, shape (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def shares(self) -> dict[str, Array]:
        """The part of each variance that comes from each source, shape (k,) each."""
        total = np.diag(self.covariance)
        safe = np.where(total > 0.0, total, 1.0)
        return {source: variance / safe for source, variance in self.variance.items()}

    def with_known(self, added: Array, source: str) -> Budget:
        """Return the budget with a known covariance added from another source, shape (k, k)."""
        total, more = np.diag(self.covariance), np.diag(added)
        grown = np.where(total > 0.0, (total + more) / np.where(total > 0.0, total, 1.0), np.inf)
        return Budget(self.covariance + added, {**self.variance, source: more}, self.dof * grown**2)

    def part(self, chosen: Sequence[int]) -> Budget:
        """Return the budget of some of the quantities."""
        rows = np.asarray(chosen, dtype=np.intp)
        return Budget(
            self.covariance[np.ix_(rows, rows)],
            {source: variance[rows] for source, variance in self.variance.items()},
            self.dof[rows],
        )


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


def welch_satterthwaite(variance: Array, parts: Sequence[tuple[Array, float | Array]]) -> Array:
    """Effective degrees of freedom of a sum of variances (GUM, eq. G.2b).

    Parameters
    ----------
    variance : ndarray, shape (k,)
        The sums.
    parts : sequence of (ndarray of shape (k,), float or ndarray of shape (k,))
        The parts, each with its degrees of freedom; infinite where it was not estimated.

    Returns
    -------
    ndarray, shape (k,)
        Infinite where no part was estimated.
    """
    weighted = np.zeros_like(variance)
    for part, dof in parts:
        weighted += part**2 / dof
    # A part so small that the quotient is no number is none.
    counts = weighted > variance**2 * np.finfo(float).tiny
    return np.divide(variance**2, weighted, out=np.full_like(weighted, np.inf), where=counts)


def propagated(
    function: Callable[[Array], Array], parameters: Array, covariance: Array, factors: Array
) -> tuple[Array, Array]:
    """Compute the standard uncertainty of a function of uncertain parameters, and its coverage factor.

    Parameters
    ----------
    function : callable
        From the parameters, shape (k,), to any number of values, shape (m,).
    parameters : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
    factors : ndarray, shape (k,)
        What each parameter's standard uncertainty is multiplied with for an interval of 95 %.

    Returns
    -------
    u : ndarray, shape (m,)
        NaN where the function is NaN near the parameters.
    factors : ndarray, shape (m,)
        From parameters whose uncertainties are wider by what each factor exceeds that of a normal distribution.

    Notes
    -----
    The function is evaluated one standard deviation to either side along each principal axis of the covariance. That is
    the GUM's law of propagation (5.1) where the function is linear, and stays finite where it has a corner, such as the
    angle between two directions that are nearly parallel.
    """
    wider = factors / NORMAL_FACTOR
    u = _standard_uncertainty(function, parameters, covariance)
    wide = _standard_uncertainty(function, parameters, covariance * np.outer(wider, wider))
    return u, NORMAL_FACTOR * np.divide(wide, u, out=np.ones_like(u), where=u > 0.0)


def _standard_uncertainty(function: Callable[[Array], Array], parameters: Array, covariance: Array) -> Array:
    values, axes = np.linalg.eigh(covariance)
    middle = function(parameters)
    variance = np.zeros_like(middle)
    for value, axis in zip(values, axes.T, strict=True):
        if value <= 0.0:
            continue
        step = np.sqrt(value) * axis
        variance += ((function(parameters + step) - middle) ** 2 + (function(parameters - step) - middle) ** 2) / 2.0
    return np.asarray(np.sqrt(variance))


class CoverageFactors:
    """Coverage factors of sums of an estimated and a known variance, for millions of values at a time.

    The estimated part of a variance has Student's t as its factor; the other part is known. Their sum has effective
    degrees of freedom (GUM, eq. G.2b), which give the factor. Both functions have one argument and are smooth, so they
    are looked up in tables.
    """

    def __init__(self) -> None:
        from scipy.special import stdtrit

        upper = 0.5 + COVERAGE / 2.0
        self.normal = NORMAL_FACTOR
        at = (np.arange(FACTOR_STEPS) + 0.5) / FACTOR_STEPS
        self._factors = np.asarray(stdtrit(1.0 / at, upper))
        """By one over the degrees of freedom, from 0 to 1."""
        whole = np.concatenate([[self.normal], self._factors, [float(stdtrit(1.0, upper))]])
        self._inverse_dof = np.interp(self.normal / np.sqrt(at), whole, np.concatenate([[0.0], at, [1.0]]))
        """One over the degrees of freedom, by the square of the normal factor over Student's."""

    def factor(self, estimated: Array, widened: Array, known: Array) -> Array:
        """Return what the standard uncertainty is multiplied with for an interval of 95 %.

        Parameters
        ----------
        estimated : ndarray, shape (n,)
            The part of the variance that was estimated.
        widened : ndarray, shape (n,)
            The same part with what Student's t stretches it by: its square of half an interval over that of 1.96.
        known : ndarray, shape (n,)
            The other part.

        Returns
        -------
        ndarray, shape (n,)
            NaN where an argument is, or where nothing is uncertain.

        Notes
        -----
        A part that its factor narrows, because errors come with the residuals that show their size, is narrowed by
        itself.
        """
        total = estimated + known
        with np.errstate(invalid="ignore", divide="ignore"):
            inverse_dof = _looked_up(self._inverse_dof, estimated / widened)
            inverse_dof *= (estimated / total) ** 2
        factor = _looked_up(self._factors, inverse_dof)
        narrow = widened <= estimated * (1.0 + NEGLIGIBLE) ** 2
        if narrow.any():
            factor[narrow] = self.normal * np.sqrt((widened + known)[narrow] / total[narrow])
        return factor


@cache
def coverage_factors() -> CoverageFactors:
    """Return the tables, which are made once."""
    return CoverageFactors()


def _looked_up(table: Array, argument: Array) -> Array:
    """Return the table's values at arguments from 0 to 1, and the first one where there is no number."""
    with np.errstate(invalid="ignore"):
        place = (argument * len(table)).astype(np.int32)
    return np.take(table, place, mode="clip")
