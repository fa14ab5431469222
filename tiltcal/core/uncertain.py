"""Uncertain quantities: values with their covariance, their 95 % intervals, and the sources of both.

What follows from uncertain quantities is uncertain by the law of propagation J C Jᵀ, and independent errors of the same
quantities add. Intervals follow by the same rule from ``wide``: the covariance of errors of known size that have the
same 95 % intervals. So few degrees of freedom widen what they are of, by Student's t, and nothing else; the squares of
intervals add as variances do, which is wider than by effective degrees of freedom.

Source: *Guide to the expression of uncertainty in measurement* (GUM), 4.2, 5.1, 6.2 and annex G.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array, Coefficients, referred, values, vector_of, with_vector

COVERAGE = 0.95  # probability that a stated interval contains the truth
NORMAL_FACTOR = 1.959963984540054  # coverage factor of a known variance: so many deviations hold 95 %
NEGLIGIBLE = 1e-3  # a coverage factor that exceeds the normal one by less than this share counts as the normal one
TURN = "mounting.turn."  # a small rotation error of the mounting about an axis of the application, radians
READING, ALIGNMENT = "single_reading.", "alignment"  # of a reading of a log, by channel; of how a sensor sits, radians
_FOLLOWS = 1e-12  # an error follows from others if no larger share of its variance is its own: rounding leaves so much
_STEP = 1e-4  # step of a coefficient for derivatives, in its uncertainty


@dataclass(frozen=True, eq=False)
class Uncertain:
    """k quantities with their joint uncertainty; a value is 0 where the errors alone count.

    ``wide``, shape (k, k), is the covariance of errors of known size that have the same 95 % intervals. ``sources``
    have the part of each variance that comes from a source, shape (k,), where that is known; their sum is the diagonal.
    """

    names: tuple[str, ...]
    value: Array
    covariance: Array
    wide: Array
    sources: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def errors(
        cls, names: Sequence[str], covariance: Array, dof: Array | float = np.inf, *, source: str = ""
    ) -> Uncertain:
        """Return errors from one source; its degrees of freedom are one number, or have the shape (k,)."""
        size = len(covariance)
        own = {source: np.diag(covariance)} if source else {}
        factors = coverage_factor(np.broadcast_to(np.asarray(dof, float), (size,)))
        return cls(tuple(names), np.zeros(size), covariance, widened(covariance, factors), own)

    @property
    def u(self) -> Array:
        """Standard uncertainties, shape (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def factors(self) -> Array:
        """What each standard uncertainty is multiplied with for an interval of 95 %, shape (k,)."""
        u = np.where(self.u > 0.0, self.u, 1.0)
        return np.asarray(np.where(self.u > 0.0, NORMAL_FACTOR * np.sqrt(np.diag(self.wide)) / u, NORMAL_FACTOR))

    @property
    def dof(self) -> Array:
        """Effective degrees of freedom, shape (k,): those that have the same coverage factor."""
        return degrees_of_freedom(self.factors)

    @property
    def shares(self) -> dict[str, Array]:
        """The share of each variance that comes from each source, shape (k,) each."""
        total = np.diag(self.covariance)
        safe = np.where(total > 0.0, total, 1.0)
        return {source: variance / safe for source, variance in self.sources.items()}

    def by_name(self, numbers: Array) -> dict[str, float]:
        """Return numbers, shape (k,), by the names of the quantities."""
        return dict(zip(self.names, numbers.tolist(), strict=True))

    def chosen(self, places: Sequence[int] | NDArray[np.intp]) -> Uncertain:
        """Return some of the quantities, by their places."""
        some = np.asarray(places, dtype=np.intp)
        return Uncertain(
            tuple(self.names[k] for k in some),
            self.value[some],
            self.covariance[np.ix_(some, some)],
            self.wide[np.ix_(some, some)],
            {source: variance[some] for source, variance in self.sources.items()},
        )

    def named(self, names: Collection[str]) -> Uncertain:
        """Return those of the quantities that have one of some names, in the order of these."""
        return self.chosen([self.names.index(name) for name in names if name in self.names])

    def without(self, *starts: str) -> Uncertain:
        """Return the quantities whose names do not start so."""
        return self.chosen([k for k, name in enumerate(self.names) if not name.startswith(starts)])

    def beside(self, other: Uncertain) -> Uncertain:
        """Return these and other quantities, whose errors are independent of these; without the sources of either."""
        across = np.zeros((len(self.names), len(other.names)))
        covariance, wide = (
            np.block([[one, across], [across.T, two]])
            for one, two in ((self.covariance, other.covariance), (self.wide, other.wide))
        )
        return Uncertain((*self.names, *other.names), np.concatenate([self.value, other.value]), covariance, wide)

    def through(self, jacobian: Array, names: Sequence[str], *, source: str = "") -> Uncertain:
        """Return m quantities that follow linearly, by derivatives (m, k): their errors alone, of value 0.

        They count as the ``source``, or as these do where these have one alone.
        """
        covariance, wide = (jacobian @ matrix @ jacobian.T for matrix in (self.covariance, self.wide))
        source = source or (next(iter(self.sources)) if len(self.sources) == 1 else "")
        sources = {source: np.diag(covariance)} if source else {}
        return Uncertain(tuple(names), np.zeros(len(covariance)), covariance, wide, sources)

    def through_function(self, names: Sequence[str], function: Callable[[Array], Array]) -> Uncertain:
        """Return quantities by a function of these, from shape (k,) to (m,), that may have corners.

        It is evaluated one standard deviation to either side along each column of the Cholesky factor: that stays
        finite at a corner, such as the angle between two directions that are nearly parallel. Sources are left out.

        Source: S. Julier and J. Uhlmann, *Unscented filtering and nonlinear estimation*, Proc. IEEE 92 (2004) 401.
        """
        covariance, wide = (_around(function, self.value, matrix) for matrix in (self.covariance, self.wide))
        return Uncertain(tuple(names), function(self.value), covariance, wide)

    def following(self, names: Sequence[str]) -> Array:
        """Return the slopes of all errors by those of some quantities, C[:, some] C[some, some]⁻¹, shape (k, m)."""
        some = self.named(names)
        size = np.where(some.u > 0.0, some.u, 1.0)
        correlations = some.covariance / np.outer(size, size)
        inverse = np.linalg.pinv(correlations, rcond=1e-9, hermitian=True) / np.outer(size, size)
        return np.asarray(self.covariance[:, [self.names.index(name) for name in some.names]] @ inverse)

    def __add__(self, other: Uncertain) -> Uncertain:
        """Return the sum of independent errors of the same quantities."""
        none = np.zeros(len(self.names))
        every = dict.fromkeys((*self.sources, *other.sources))
        sources = {source: self.sources.get(source, none) + other.sources.get(source, none) for source in every}
        covariance, wide = self.covariance + other.covariance, self.wide + other.wide
        return Uncertain(self.names, self.value + other.value, covariance, wide, sources)


def widened(covariance: Array, factors: Array) -> Array:
    """Return the covariance of errors of known size that have the 95 % intervals of coverage factors, shape (k,)."""
    wider = factors / NORMAL_FACTOR
    return np.asarray(covariance * np.outer(wider, wider))


def weighted_sum(
    first: Uncertain, second: Uncertain, weights: tuple[float, float], shared: Collection[str]
) -> Uncertain:
    """Return a weighted sum of the errors of two sets of quantities, in which the ``shared`` ones have one error.

    The errors of each set are slopes times those of the shared quantities, and a rest that is independent of all else:
    the slopes add with the weights, w1 F1 + w2 F2, and of the rests the variances do, w1² R1 + w2² R2.
    """
    names = tuple(dict.fromkeys((*first.names, *second.names)))
    common = second.named([name for name in names if name in shared])
    by_common, apart = np.zeros((len(names), len(common.names))), []
    for one, weight in zip((first, second), weights, strict=True):
        at = selection(names, one.names)
        slopes = at @ one.following(common.names)
        by_common += weight * slopes
        both = one.named(common.names).covariance
        rest = at @ one.covariance @ at.T - slopes @ both @ slopes.T
        kept = np.array([name not in common.names for name in names])
        rest = np.where(np.outer(kept, kept), rest, 0.0) * weight**2
        np.fill_diagonal(rest, np.maximum(np.diag(rest), 0.0))
        factors = one.by_name(one.factors)
        wide = widened(rest, np.array([factors.get(name, NORMAL_FACTOR) for name in names]))
        apart.append(Uncertain(names, np.zeros(len(names)), rest, wide))
    return common.through(by_common, names) + apart[0] + apart[1]


def selection(names: Sequence[str], among: Sequence[str]) -> Array:
    """Return the derivatives of named quantities by some, of which each is one of them or none, shape (m, k)."""
    return np.array([[float(name == other) for other in among] for name in names]).reshape(len(names), len(among))


def coverage_factor(dof: Array) -> Array:
    """Return coverage factors, shape (k,): Student's t, for infinite degrees of freedom 1.96; below 1 count as 1."""
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


def central_differences(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """Return the derivatives of a function by parameters, (m, k), 0 for those whose step, (k,), is 0."""
    moves = np.diag(steps)
    columns = [(function(at + move) - function(at - move)) / (2.0 * (move.sum() or 1.0)) for move in moves]
    return np.stack(columns, axis=1) if columns else np.zeros((len(function(at)), 0))


def _around(function: Callable[[Array], Array], at: Array, covariance: Array) -> Array:
    """Return the covariance of a function's values about the middle, one deviation to either side of it, (m, m)."""
    middle, rest = function(at), covariance.copy()
    found = np.zeros((len(middle), len(middle)))
    for k, variance in enumerate(np.diag(covariance)):
        if rest[k, k] > _FOLLOWS * variance:  # neither exact, nor following from those before
            step = rest[:, k] / np.sqrt(rest[k, k])
            step[:k] = 0.0
            rest -= np.outer(step, step)
            for change in (function(at + step) - middle, function(at - step) - middle):
                found += np.outer(change, change) / 2.0
    return found


def uncertain_at(coefficients: Coefficients, uncertain: Uncertain, reference: float | None) -> Uncertain:
    """Return the errors of coefficients at another reference temperature, °C, without those that became certain."""
    thermal = coefficients.thermal
    if thermal is None or reference is None or thermal.reference == reference:
        return uncertain
    own, turns = uncertain.without(TURN), [name for name in uncertain.names if name.startswith(TURN)]
    names = list(values(coefficients))

    def at(vector: Array) -> Array:
        return vector_of(referred(with_vector(coefficients, own.names, vector), reference), names)

    jacobian = np.zeros((len(names) + len(turns), len(uncertain.names)))
    places = [uncertain.names.index(name) for name in own.names]
    jacobian[: len(names), places] = central_differences(at, vector_of(coefficients, own.names), _STEP * own.u)
    for row, name in enumerate(turns, start=len(names)):
        jacobian[row, uncertain.names.index(name)] = 1.0
    moved = uncertain.through(jacobian, (*names, *turns))
    return moved.chosen(np.flatnonzero(moved.u > 0.0))
