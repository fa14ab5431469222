"""Generalised least squares on the equations of a fixture, and the one variance that is not stated.

The normal matrix of all unknowns is solved at once, a few times: the equations are linear but for the sensitivities by
which the attitude angles act, and for products of coefficients.

Where the jig is not stated, its variance is estimated by restricted maximum likelihood (REML): in the space that the
coefficients leave, whitened by the noise, the directions that show the angles are independent with variances 1 + q d².
The same is done for a thermometer that is not stated, and for the noise of means of which nothing is stated.

Source: H. D. Patterson, R. Thompson, *Recovery of inter-block information*, Biometrika 58 (1971) 545.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import radians, sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.estimation.equations import ADC, JIG, TABLE, BenchErrors, Equations, Linearised
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

_ROUNDS, _SETTLED, _ARITHMETIC = 50, (1e-6, 1e-3), 1e-9
"""Solve again until no coefficient moves by this share of its standard uncertainty, which grows behind ten rounds
because readings without noise leave no better equations, or by what rounding leaves."""

LARGEST_JIG = radians(45.0)
"""Standard deviation of a set angle above which the positions are not those that were set, radians."""

_CLOSE = 1e-4
"""Estimate a variance again until it changes by this share."""

_POSITIVE = 0.9
"""Let a variance below 0 take away at most this share of the noise, where it takes away most."""

_INSENSITIVE = 1e-12
"""A direction with less than this share of the largest sensitivity to the angles shows none."""

_SHOWN = 0.25
"""A lean counts as shown by the readings if they leave less than this share of the variance of its bound."""


@dataclass(frozen=True)
class Solution:
    """The unknowns that fit best, shape (unknowns,), and the equations there.

    Attributes
    ----------
    z : ndarray, shape (unknowns,)
    covariance : ndarray, shape (unknowns, unknowns)
    chi_square : float
        Sum of squares of all equations.
    """

    equations: Equations
    errors: BenchErrors
    z: Array
    near: Linearised
    covariance: Array
    chi_square: float

    @cached_property
    def dof(self) -> int:
        """Degrees of freedom: equations less unknowns; the mere bound of a lean that shows is no equation."""
        equations, errors = self.equations, self.errors
        moving = equations.moving(errors)
        stated = int(np.count_nonzero(equations.weights(errors)[moving]))
        dof = len(equations.u) + len(equations.prior_target) + stated - int(np.count_nonzero(moving))
        if not equations.table_stated:
            variance = np.diag(self.covariance)[equations.errors[TABLE]]
            dof -= int(np.count_nonzero(variance < _SHOWN * errors.table**2))
        return dof


@dataclass(frozen=True)
class EstimatedVariance:
    """A variance that the residuals show: of an attitude angle, rad², of a temperature, °C², or of the noise, a factor.

    Attributes
    ----------
    information : float
        Half of it is the Fisher information of ``value``; 0 where the residuals show nothing of it.
    rest, count : float and int
        Sum of squares of the residuals that no such error explains, and in how many directions.
    """

    value: float
    information: float
    rest: float = 0.0
    count: int = 0

    @property
    def dof(self) -> float:
        """Degrees of freedom of the variance."""
        return self.value**2 * self.information


@dataclass(frozen=True)
class ProjectedResiduals:
    """Squares of the residuals that the coefficients leave, by direction of some errors of the bench.

    Attributes
    ----------
    d2, z2 : ndarray, shape (directions,)
        Variance that errors of variance 1 give to each direction that shows them, and its square.
    rest, count : float and int
        Sum of squares of the residuals beside them, and in how many directions.
    largest : float
        The largest variance that errors of variance 1 give to the readings, over that of the noise.
    """

    d2: Array
    z2: Array
    rest: float
    count: int
    largest: float


def solved(equations: Equations, errors: BenchErrors, start: Array | None = None) -> Solution:
    """Solve the equations of a fixture.

    Parameters
    ----------
    start : ndarray, shape (unknowns,), optional
        From :func:`start_as_set`, or an earlier solution.

    Raises
    ------
    EstimateError
        The coefficients do not settle.
    """
    z = start_as_set(equations) if start is None else start.copy()
    if not errors.jig:
        z[equations.errors[JIG]] = 0.0
    moving = equations.moving(errors)
    shortened = _shortened(equations, np.eye(equations.unknowns) * errors.jig**2)
    n = len(equations.names)
    for number in range(_ROUNDS):
        before = shortened
        near, step, covariance, chi_square = _round(equations, errors, z, moving, before)
        shortened = _shortened(equations, covariance)
        size = np.abs(z[:n])
        smallest = np.maximum(
            _SETTLED[number > 10] * np.sqrt(np.diag(covariance))[:n], _ARITHMETIC * (size + 1e-3 * size.max())
        )
        steps = np.abs(step[:n]) / np.maximum(smallest, 1e-300)
        if steps.max() <= 1.0 and np.max(np.abs(shortened - before)) <= _CLOSE * errors.jig**2:
            return Solution(equations, errors, z + step, near, covariance, chi_square)
        z = z + step
    raise EstimateError("the estimate does not settle: are the positions named right, and the readings plausible?")


def _shortened(equations: Equations, covariance: Array) -> Array:
    """Return by how much uncertain attitude angles shorten gravity on average, shape (settings,)."""
    return np.asarray(np.diag(covariance)[equations.errors[JIG]].reshape(-1, 2).sum(axis=1) / 2.0)


def solved_at(equations: Equations, z: Array) -> Solution:
    """Return the equations linearised at some unknowns: the solution of a plan, and where an estimate begins."""
    errors = equations.stated
    exact = np.zeros(int(equations.settings.max()) + 1)
    near, _, covariance, chi_square = _round(equations, errors, z, equations.moving(errors), exact)
    return Solution(equations, errors, z, near, covariance, chi_square)


def start_as_set(equations: Equations) -> Array:
    """Return the coefficients with the attitudes as set and nothing stated of the bench, shape (unknowns,)."""
    perfect = BenchErrors(0.0, equations.stated.table, 0.0, 0.0)
    z = equations.start()
    # Gain, nonlinearity and lean have no effect before a sensitivity is known: they join in the second round.
    moving = equations.moving(perfect)
    moving[: len(equations.names)] &= np.isinf(equations.prior_u)  # what is assumed stays as it is assumed
    exact = np.zeros(int(equations.settings.max()) + 1)
    insensitive = np.zeros(equations.unknowns, dtype=bool)
    for channel in equations.channels:
        own = channel.coefficients
        up = equations.gravity[channel.places] @ channel.orientation.T
        insensitive[own] = ~np.any(channel.model.read(z[own], up, channel.dt).by_coefficient, axis=0)
    for mask in (moving & ~insensitive, moving):
        z = z + _round(equations, perfect, z, mask, exact)[1]
    return z


def _round(
    equations: Equations, errors: BenchErrors, z: Array, moving: NDArray[np.bool_], shortened: Array
) -> tuple[Linearised, Array, Array, float]:
    """Return the equations about ``z``, the step of the unknowns, their covariance, and chi-square behind the step."""
    near = equations.at(z, errors, shortened)
    normal, gradient, squares = _normal(equations, near, equations.weights(errors), z)
    some = np.flatnonzero(moving)
    covariance = np.zeros_like(normal)
    covariance[np.ix_(some, some)] = _inverse(normal[np.ix_(some, some)])
    step = covariance @ gradient
    return near, step, covariance, max(float(squares - gradient @ step), 0.0)


def _normal(equations: Equations, near: Linearised, weights: Array, z: Array) -> tuple[Array, Array, float]:
    """Return normal matrix, gradient and sum of squares of readings and of what is stated of the unknowns."""
    rows, n = equations.prior_rows, len(equations.names)
    missing = equations.prior_target - rows @ z[:n]
    normal = near.normal + np.diag(weights**2)
    normal[:n, :n] += rows.T @ rows
    gradient = near.gradient - weights**2 * z
    gradient[:n] += rows.T @ missing
    return normal, gradient, float(near.residual @ near.residual + missing @ missing + np.sum((weights * z) ** 2))


def _inverse(normal: Array) -> Array:
    """Return the inverse of a normal matrix, its columns brought to one size."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * np.outer(scale, scale)
    try:
        root = np.linalg.inv(np.linalg.cholesky(scaled))
        inverse = root.T @ root
    except np.linalg.LinAlgError:
        inverse = np.linalg.pinv(scaled, hermitian=True)
    return np.asarray(inverse * np.outer(scale, scale))


def projected(solution: Solution, source: str) -> ProjectedResiduals:
    """Return the residuals that the other unknowns leave, by direction of the errors of one source."""
    equations, errors = solution.equations, solution.errors
    weights, z = equations.weights(errors), solution.z
    own = np.arange(equations.errors[source].start, equations.errors[source].stop)
    moving = equations.moving(errors)
    moving[own] = False
    others = np.flatnonzero(moving)
    weights[own] = 0.0
    near = solution.near
    back = np.zeros_like(z)
    back[own] = z[own]
    near = replace(near, residual=near.residual + near.times(back))  # with these errors put back
    normal, gradient, squares = _normal(equations, near, weights, z)
    inverse = _inverse(normal[np.ix_(others, others)])
    across = normal[np.ix_(own, others)] @ inverse
    direct = normal[np.ix_(own, own)]
    largest = float(np.linalg.eigvalsh(direct).max(initial=1e-300))
    values, vectors = np.linalg.eigh(direct - across @ normal[np.ix_(others, own)])
    seen = values > _INSENSITIVE * largest
    z2 = (vectors.T @ (gradient[own] - across @ gradient[others]))[seen] ** 2 / values[seen]
    whole = squares - gradient[others] @ inverse @ gradient[others]
    count = solution.dof - int(np.count_nonzero(seen))
    return ProjectedResiduals(values[seen], z2, max(float(whole - z2.sum()), 0.0), count, largest)


def estimated_variance(residuals: ProjectedResiduals) -> EstimatedVariance:
    """Return the variance of the errors by restricted maximum likelihood.

    It is below 0 where the residuals are smaller than the noise by chance.
    """
    d2, z2 = residuals.d2, residuals.z2
    beside = residuals.rest, residuals.count
    if not len(d2):
        return EstimatedVariance(0.0, 0.0, *beside)
    lowest = -_POSITIVE / residuals.largest
    value = _root(
        lambda q: float(np.sum(d2 * (1.0 + q * d2 - z2) / (1.0 + q * d2) ** 2)), lowest, float(np.max(z2 / d2))
    )
    return EstimatedVariance(value, float(np.sum((d2 / (1.0 + value * d2)) ** 2)), *beside)


def estimated_noise(residuals: ProjectedResiduals, jig: float, lowest: float) -> EstimatedVariance:
    """Return the factor of the noise's variance by restricted maximum likelihood, beside a stated jig, radians.

    No reading is better than its rounding: the factor is ``lowest`` at least.
    """
    s2, z2, rest, count = jig**2 * residuals.d2, residuals.z2, residuals.rest, residuals.count

    def slope(f: float) -> float:
        return float(np.sum((f + s2 - z2) / (f + s2) ** 2)) + count / f - rest / f**2

    value = _root(slope, lowest, max(float(np.max(z2, initial=rest)), 2.0 * lowest))
    return EstimatedVariance(value, float(np.sum(1.0 / (value + s2) ** 2)) + count / value**2)


def _root(slope: Callable[[float], float], low: float, high: float) -> float:
    """Return where a slope changes from below 0 to above it, from ``low`` up; that where it is above 0 there."""
    from scipy.optimize import brentq

    if slope(low) >= 0.0:
        return low
    while slope(high) < 0.0:
        high *= 4.0
    return float(brentq(slope, low, high, xtol=1e-300, rtol=1e-10))


def with_estimated(solution: Solution, source: str) -> tuple[Solution, EstimatedVariance]:
    """Solve with the variance of one source as the residuals show it.

    Parameters
    ----------
    solution : Solution
        With that source as it is stated, or at 0.
    source : str
        JIG, THERMOMETER, or ADC for the noise of readings of which rounding alone is stated. A jig above
        :data:`LARGEST_JIG` is returned as it is, with the solution before.
    """
    found = EstimatedVariance(0.0, 0.0)
    for _ in range(_ROUNDS):
        before = found.value
        residuals = projected(solution, JIG if source == ADC else source)
        if source == ADC:
            noise = estimated_noise(residuals, solution.errors.jig, 1.0 / solution.errors.noise)
            found = EstimatedVariance(noise.value * solution.errors.noise, noise.information / solution.errors.noise**2)
            errors = replace(solution.errors, noise=found.value)
        else:
            found = estimated_variance(residuals)
            errors = replace(solution.errors, **{source: sqrt(max(found.value, 0.0))})
        if errors.jig > LARGEST_JIG:
            return replace(solution, errors=errors), found
        solution = solved(solution.equations, errors, solution.z)
        if abs(found.value - before) <= _CLOSE * abs(found.value):
            break
    return solution, found
