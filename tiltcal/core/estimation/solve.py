"""Generalised least squares on the equations of a fixture, and the one variance that is not stated.

The normal matrix of all unknowns is solved at once, a few times: the equations are linear but for the sensitivities by
which the attitude angles act, and for products of coefficients.

Where the jig is not stated, its variance is estimated by restricted maximum likelihood (REML): in the space that the
coefficients leave, whitened by the noise, the directions that show the angles are independent with variances 1 + q d².
The same is done for a thermometer that is not stated, and for the noise of means of which nothing is stated.

Near the solution every coefficient is a linear function of the equations' errors, so every equation has its share of
every variance: the readings by noise and rounding, what is stated of an unknown by its source.

Source: H. D. Patterson, R. Thompson, *Recovery of inter-block information*, Biometrika 58 (1971) 545.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, radians, sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.estimation.equations import ADC, JIG, NOISE, PRIOR, TABLE, THERMOMETER, Bench, Equations, Linearised
from tiltcal.core.model import Array
from tiltcal.core.uncertain import NORMAL_FACTOR, Uncertain, coverage_factor
from tiltcal.errors import EstimateError

_ROUNDS = 50  # most of them; an estimate settles in about five
_SETTLED, _SETTLED_LATE, _LATE_ROUND = 1e-6, 1e-3, 11  # end where no coefficient moves by this share of its u
_ARITHMETIC = 1e-9  # or by this share of its size, which rounding leaves
LARGEST_JIG = radians(45.0)  # standard deviation of a set angle above which the positions are not those set, radians
_CLOSE = 1e-4  # estimate a variance again until it changes by this share
_POSITIVE = 0.9  # let a variance below 0 take away at most this share of the noise, where it takes away most
_INSENSITIVE = 1e-12  # a direction with less of the largest sensitivity to the errors of a source shows none
_HIDDEN = {JIG: radians(1.0), THERMOMETER: 5.0}  # directions that hide larger errors widen no interval: radians, °C
_SHOWN = 0.25  # a lean counts as shown by the readings if they leave less than this share of the variance of its bound
UNDETERMINED = 1e-9  # a singular value below this share of the largest, with columns scaled to one, counts as zero
_NAMED_PART = 0.1  # coefficients with at least this part in an undetermined combination are named


@dataclass(frozen=True)
class EstimatedVariance:
    """A variance that the residuals show: of an attitude angle, rad², of a temperature, °C², or of the noise, a factor.

    It is below 0 where the residuals are smaller than the noise by chance.
    """

    source: str
    value: float
    dof: float  # in how many directions the residuals show it
    whole: float  # the variance that they show there, with what the noise counts for in it
    rest: float = 0.0  # sum of squares of the residuals that no such error explains
    count: int = 0  # and in how many directions

    @property
    def excess(self) -> float:
        """By which share of the whole intervals are wider, because that is estimated."""
        return float(_excess(np.array(self.dof)))


@dataclass(frozen=True)
class Solution:
    """The unknowns that fit best, with their covariance, the equations there, and the sum of squares of all."""

    equations: Equations
    bench: Bench
    z: Array  # shape (unknowns,)
    near: Linearised
    covariance: Array  # shape (unknowns, unknowns)
    chi_square: float
    estimated: EstimatedVariance | None = None  # at most one variance, of what is not stated

    @cached_property
    def dof(self) -> int:
        """Degrees of freedom: equations less unknowns; the mere bound of a lean that shows is no equation."""
        equations, bench = self.equations, self.bench
        stated = np.count_nonzero(equations.weights(bench))
        dof = len(equations.u) + len(equations.stated_target) + stated - np.count_nonzero(equations.moving(bench))
        if not equations.table_stated:
            variance = np.diag(self.covariance)[equations.errors[TABLE]]
            dof -= np.count_nonzero(variance < _SHOWN * bench[TABLE] ** 2)
        return int(dof)


def start_as_set(equations: Equations) -> Array:
    """Return the coefficients with the attitudes as set and nothing stated of the bench, shape (unknowns,)."""
    z = np.zeros(equations.unknowns)
    z[: len(equations.names)] = equations.prior_value
    moving = equations.moving(equations.as_set)
    moving[: len(equations.names)] &= np.isinf(equations.prior_u)  # what is assumed stays as it is assumed
    # Gain, nonlinearity and lean have no effect before a sensitivity is known: they join in the second round.
    for _ in range(2):
        near = equations.at(z, equations.as_set)
        z = z + _covariance(near, moving) @ near.gradient
    return z


def solved_at(equations: Equations, z: Array) -> Solution:
    """Return the equations linearised at some unknowns: the solution of a plan, and where an estimate begins."""
    near = equations.at(z, equations.stated)
    return _solution(equations, equations.stated, z, near)[0]


def solved(equations: Equations, bench: Bench, start: Array) -> Solution:
    """Solve the equations of a fixture from some unknowns; an EstimateError where the coefficients do not settle."""
    z, n = start.copy(), len(equations.names)
    if not bench[JIG]:
        z[equations.errors[JIG]] = 0.0
    shortened = np.full(len(equations.looser), bench[JIG] ** 2)
    for number in range(_ROUNDS):
        settled = _SETTLED if number < _LATE_ROUND else _SETTLED_LATE
        solution, step = _solution(equations, bench, z, equations.at(z, bench, shortened))
        angles = np.diag(solution.covariance)[equations.errors[JIG]]
        before, shortened = shortened, np.asarray(angles.reshape(-1, 2).sum(axis=1) / 2.0)
        size, u = np.abs(z[:n]), np.sqrt(np.diag(solution.covariance))[:n]
        smallest = np.maximum(settled * u, _ARITHMETIC * (size + 1e-3 * size.max()))
        z = solution.z + step
        if np.all(np.abs(step[:n]) <= smallest) and np.max(np.abs(shortened - before)) <= _CLOSE * bench[JIG] ** 2:
            return replace(solution, z=z)
    raise EstimateError("the estimate does not settle: are the positions named right, and the readings plausible?")


def _solution(equations: Equations, bench: Bench, z: Array, near: Linearised) -> tuple[Solution, Array]:
    """Return the solution that is linearised at ``z``, and the step from there to the best fit."""
    covariance = _covariance(near, equations.moving(bench))
    step = covariance @ near.gradient
    chi_square = max(float(near.residual @ near.residual - near.gradient @ step), 0.0)
    return Solution(equations, bench, z, near, covariance, chi_square), step


def _covariance(near: Linearised, moving: NDArray[np.bool_]) -> Array:
    """Return the covariance, shape (unknowns, unknowns), 0 for unknowns that are held or have no effect."""
    covariance = np.zeros(near.normal.shape)
    some = np.flatnonzero(moving & (near.normal.diagonal() > 0.0))
    both = some[:, None], some
    covariance[both] = _inverse(near.normal[both])
    return covariance


def _inverse(normal: Array) -> Array:
    """Return the inverse of a normal matrix, its columns brought to one size."""
    scale = 1.0 / np.sqrt(np.maximum(normal.diagonal(), 1e-300))
    scales = scale[:, None] * scale
    scaled = normal * scales
    try:
        root = np.linalg.inv(np.linalg.cholesky(scaled))
        inverse = root.T @ root
    except np.linalg.LinAlgError:
        inverse = np.linalg.pinv(scaled, hermitian=True)
    return np.asarray(inverse * scales)


def with_estimated(solution: Solution, source: str) -> Solution:
    """Solve with the variance of JIG, THERMOMETER or NOISE that the residuals show; with too large a jig as before."""
    value = 0.0
    for _ in range(_ROUNDS):
        before, estimated = value, shown_variance(solution, source)
        value = estimated.value
        bench = {**solution.bench, source: value if source == NOISE else sqrt(max(value, 0.0))}
        if bench[JIG] > LARGEST_JIG:
            return replace(solution, bench=bench, estimated=estimated)
        solution = replace(solved(solution.equations, bench, solution.z), estimated=estimated)
        if abs(value - before) <= _CLOSE * abs(value):
            break
    return solution


def shown_variance(solution: Solution, source: str) -> EstimatedVariance:
    """Return the variance of one source by the residuals that the other unknowns leave, near a solution."""
    equations, bench, near = solution.equations, solution.bench, solution.near
    errors = equations.errors[JIG if source == NOISE else source]
    rows = np.ones(len(near.residual), dtype=bool)
    rows[equations.rows(JIG if source == NOISE else source)] = False
    own, back = np.arange(errors.start, errors.stop), np.zeros_like(solution.z)
    back[own] = solution.z[own]
    near = replace(near, residual=near.residual + near.times(back)).part(rows)  # with these errors put back
    normal, gradient = near.normal, near.gradient
    moving = equations.moving(bench)
    moving[own] = False
    others = np.flatnonzero(moving)
    inverse = _inverse(normal[np.ix_(others, others)])
    across = normal[np.ix_(own, others)] @ inverse
    direct = normal[np.ix_(own, own)]
    largest = float(np.linalg.eigvalsh(direct).max(initial=1e-300))
    d2, vectors = np.linalg.eigh(direct - across @ normal[np.ix_(others, own)])
    seen = d2 > _INSENSITIVE * largest
    d2, z2 = d2[seen], (vectors.T @ (gradient[own] - across @ gradient[others]))[seen] ** 2 / d2[seen]
    whole = float(near.residual @ near.residual - gradient[others] @ inverse @ gradient[others])
    rest, count = max(whole - float(z2.sum()), 0.0), max(solution.dof - len(d2), 0)
    if source != NOISE:
        shown = _most_likely(np.ones(len(d2)), d2, z2, -_POSITIVE / largest, _HIDDEN[source])
        return EstimatedVariance(source, *shown, rest, count)
    # No reading is better than its rounding, with which a factor of 1 counts.
    z2, stated = (np.append(part, np.full(count, each)) for part, each in ((z2, rest / max(count, 1)), (d2, 0.0)))
    value, dof, whole = _most_likely(bench[JIG] ** 2 * stated, np.ones(len(z2)), z2, 1.0 / bench[NOISE])
    return EstimatedVariance(source, value * bench[NOISE], dof, whole * bench[NOISE])


def _most_likely(
    stated: Array, each: Array, squares: Array, lowest: float, hidden: float = inf
) -> tuple[float, float, float]:
    """Return the most likely ``q`` from the lowest up, its degrees of freedom, and ``q`` with what is stated beside it.

    ``squares`` are those of independent normal numbers with the variances ``stated + q each``, shape (directions,).
    Directions count the less the more is stated, and not at all where that hides a ``q`` above ``hidden`` squared.
    """
    from scipy.optimize import brentq

    def slope(q: float) -> float:
        variance = stated + q * each
        return float(np.sum(each * (variance - squares) / variance**2))

    if not len(each):
        return 0.0, 0.0, 0.0
    highest = float(np.max(squares / each))
    q = lowest if slope(lowest) >= 0.0 else float(brentq(slope, lowest, highest, xtol=1e-300, rtol=1e-10))
    shows = (each / (stated + q * each))[stated < each * hidden**2]
    total, square = float(np.sum(shows)), float(np.sum(shows**2)) or 1.0
    return q, total**2 / square, total / square


def undetermined(jacobian: Array, names: Sequence[str]) -> list[str]:
    """Return the coefficients that a Jacobian, shape (rows, coefficients), leaves free: one, a combination, or none."""
    size = np.linalg.norm(jacobian, axis=0)
    unseen = [name for name, length in zip(names, size, strict=True) if length <= 1e-12 * size.max()]
    if unseen or not names:
        return unseen[:1]
    _, values, vectors = np.linalg.svd(jacobian / size, full_matrices=True)
    rank = int(np.sum(values > UNDETERMINED * values[0]))
    if rank == len(names):
        return []
    return [name for name, part in zip(names, vectors[rank], strict=True) if abs(part) > _NAMED_PART]


# The uncertainty of the coefficients, by its sources


def budgets(solution: Solution) -> list[Uncertain]:
    """Return the coefficients of each sensor with their uncertainty; an estimated NOISE counts rounding in."""
    shown, equations = solution.estimated, solution.equations
    bench, near, covariance = solution.bench, solution.near, solution.covariance
    readings = len(equations.u)
    measured = bench[NOISE] * (equations.u / near.sigma) ** 2  # the rest is the square of uncertain attitudes
    rounding = np.concatenate([channel.adc for channel in equations.channels]) / equations.u
    rounding = measured * np.minimum(rounding**2 / bench[NOISE], 1.0)
    dof = np.concatenate([channel.dof for channel in equations.channels])
    drawn = (measured - rounding) * _excess(dof)
    if shown is not None and shown.source == NOISE:
        drawn = measured * (shown.whole / bench[NOISE] * shown.excess)
    stated = {source: equations.rows(source) for source in equations.errors if bench[source]}
    if len(equations.stated_target):
        stated = {PRIOR: equations.rows(PRIOR), **stated}
    budgets = []
    for sensor, own in zip(equations.sensors, equations.sensor_coefficients(), strict=True):
        by = near.times(covariance[:, own])  # equations by coefficients
        squares, by_noise = np.square(by), by[:readings]
        variance = {NOISE: (measured - rounding) @ squares[:readings], ADC: rounding @ squares[:readings]}
        variance |= {source: squares[rows].sum(axis=0) for source, rows in stated.items() if rows.stop > rows.start}
        if bench[JIG]:
            variance[JIG] = variance[JIG] + (1.0 - measured) @ squares[:readings]
        total, more = covariance[own, own], by_noise.T @ (drawn[:, None] * by_noise)
        if shown is not None and shown.source != NOISE and shown.dof:
            by_readings = near.part(slice(0, readings)).normal[equations.errors[shown.source]]
            by_error = (by_readings @ covariance[:, own]).T
            by_variance = by_error @ by_error.T
            more = more + shown.whole * shown.excess * by_variance
            if shown.source == JIG and shown.value < 0.0:
                # The noise, by chance, was less than measured: so is what it does to the coefficients.
                total = total + shown.value * by_variance
                variance[NOISE] = variance[NOISE] + shown.value * np.diag(by_variance)
        budgets.append(Uncertain(sensor.design.names, solution.z[own], total, total + more, variance))
    return budgets


def _excess(dof: Array) -> Array:
    """Return by which share a variance with degrees of freedom grows for its 95 % interval, in the same shape."""
    return np.asarray((coverage_factor(dof) / NORMAL_FACTOR) ** 2 - 1.0)
