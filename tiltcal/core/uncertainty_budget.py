"""The uncertainty budget: the sources of each quantity's uncertainty, and its propagation through a function.

Source: *Guide to the expression of uncertainty in measurement* (GUM), 4.2 and 5.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.coverage_factor import NORMAL_FACTOR, coverage_factor, degrees_of_freedom, welch_satterthwaite
from tiltcal.core.model import Array

_FOLLOWS = 1e-12
"""The share of a variance that rounding leaves where an error follows from others."""


@dataclass(frozen=True)
class Part:
    """The part that one source of uncertainty adds to some quantities: errors, and how the quantities follow them.

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
        wider = np.maximum(self.factors / NORMAL_FACTOR, 1.0)
        own, wide = (
            np.einsum("ik,kl,il->i", self.by, matrix, self.by)
            for matrix in (self.covariance, self.covariance * np.outer(wider, wider))
        )
        return degrees_of_freedom(NORMAL_FACTOR * np.sqrt(wide / np.where(own > 0.0, own, np.inf)))


@dataclass(frozen=True)
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
    The function is evaluated one standard deviation to either side along each column of the covariance's Cholesky
    factor, as the unscented transform does. That is the GUM's law of propagation (5.1) where the function is linear,
    and stays finite where it has a corner, such as the angle between two directions that are nearly parallel. Principal
    axes turn with the last digit of a covariance where two of them are equally long, and such a result with them.

    Source: S. Julier and J. Uhlmann, *Unscented filtering and nonlinear estimation*, Proc. IEEE 92 (2004) 401.
    """
    wider = factors / NORMAL_FACTOR
    u = _standard_uncertainty(function, parameters, covariance)
    if np.all(wider == 1.0):
        return u, np.full_like(u, NORMAL_FACTOR)
    wide = _standard_uncertainty(function, parameters, covariance * np.outer(wider, wider))
    return u, NORMAL_FACTOR * np.divide(wide, u, out=np.ones_like(u), where=u > 0.0)


def central_differences(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """Return the derivatives of a function by its parameters, from its values on both sides; shape (m, k).

    Parameters
    ----------
    function : callable
        From the parameters, shape (k,), to values, shape (m,).
    at : ndarray, shape (k,)
    steps : ndarray, shape (k,)
        How far to either side; a parameter whose step is 0 counts as certain, and its column is 0.
    """
    moves = np.diag(np.where(steps > 0.0, steps, 0.0))
    columns = [(function(at + move) - function(at - move)) / (2.0 * (move.sum() or 1.0)) for move in moves]
    return np.stack(columns, axis=1) if columns else np.zeros((len(function(at)), 0))


def _standard_uncertainty(function: Callable[[Array], Array], parameters: Array, covariance: Array) -> Array:
    middle = function(parameters)
    variance = np.zeros_like(middle)
    for step in _independent_steps(covariance):
        variance += ((function(parameters + step) - middle) ** 2 + (function(parameters - step) - middle) ** 2) / 2.0
    return np.asarray(np.sqrt(variance))


def _independent_steps(covariance: Array) -> Iterator[Array]:
    """Yield the columns of the Cholesky factor, shape (k,): independent errors that make up the covariance.

    An error that follows from those before it has none, nor has an exact parameter.
    """
    left = covariance.copy()
    for k, own in enumerate(np.diag(covariance)):
        if left[k, k] > _FOLLOWS * own:
            column = left[:, k] / np.sqrt(left[k, k])
            column[:k] = 0.0
            left -= np.outer(column, column)
            yield column
