"""The drift of a sensor at rest whose temperature goes up and down: polynomial, thermal lag, and what loop is left.

A reading of channel i, in one attitude, at the thermometer's temperature T(t)::

    u_i(t) = c_i0 + c_i1 dT + c_i2 dT² + ... + noise,    dT = F(T; lag)(t) - T_ref

F being the filter of :mod:`tiltcal.core.thermal_lag`. For a given lag this is linear; the lag is found by variable
projection (Golub and Pereyra, 1973). A lag separates the way up from the way down by a loop as wide as the lag times
the pace, and so does hysteresis; a zero that wanders separates any two legs. What distinguishes them is whether a lag
that is fitted to some legs predicts another one. So every leg is left out once, and the lag is used only where it
predicts each of them better, and where hysteresis without time does not explain the record as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import sqrt
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.loops import HalfLoop, Loops, error_of_hysteresis, loop_terms, loops
from tiltcal.core.ramp.means import FittedMeans
from tiltcal.core.ramp.noise import joint_least_squares, noise_covariance, noise_of_temperature, whitener
from tiltcal.core.ramp.record import Leg, RampRecord, legs_of
from tiltcal.core.ramp.second_lag import likeliest_pair, over_lags
from tiltcal.errors import EstimateError

LEG_LAGS = 4.0
"""A leg must last so many lags: else the element does not follow."""

LAG_RESOLUTION = 0.1
"""A lag has to be known better than the time in which the temperature crosses this part of its range."""

RESOLVED = 2.0
"""Standard uncertainties that a lag is away from 0 where it is used."""

WORSE = 0.02
"""Part by which the mean square error of a channel may grow on a leg and not count as worse."""

TURNS = 3.0
"""Mean square of the residuals behind the turns, over that of the others, from which on a loop turns there."""

_LAGS, _STEPS, _CONVERGED = 14, 8, 0.01


@dataclass(frozen=True)
class HeldOutLeg:
    """The error with which a leg is predicted from the others.

    Attributes
    ----------
    polynomial, lagged : ndarray, shape (channels,)
        Root mean square error of the polynomial alone, and of the one with a lag, unit.
    """

    leg: Leg
    polynomial: Array
    lagged: Array


@dataclass(frozen=True)
class RampFit:
    """The drift that a record shows.

    Attributes
    ----------
    reference : float
        °C.
    coefficients : ndarray, shape (channels, order + 1)
        Reading at the reference temperature, unit, and its polynomial, unit/°C, ...
    lag : float
        s; 0 where none is used.
    covariance : ndarray, shape (channels (order + 1) + 1,) twice
        Of the coefficients, channel by channel, and of the lag.
    found_lag, u_lag : float
        The lag that was found, used or not, and its standard uncertainty, s.
    explained : ndarray, shape (channels,)
        Part of the loop's square that it explains.
    loops : Loops
        What is left.
    loop_covariance : ndarray, shape (channels (order + 1),) twice
        What that adds to the covariance of the coefficients.
    u_element : float
        Standard uncertainty of the element's temperature in a log, behind turns, °C: a second lag may follow them as
        well, and the filter of a log smooths those of a thermometer that is later.
    error_by_order : mapping of int to float
        Mean square error of predicting a leg that was left out, over the variance of the residuals.
    """

    reference: float
    coefficients: Array
    lag: float
    covariance: Array
    found_lag: float
    u_lag: float
    explained: Array
    loops: Loops
    loop_covariance: Array
    u_element: float
    held_out: tuple[HeldOutLeg, ...]
    error_by_order: Mapping[int, float]
    means: FittedMeans

    @property
    def uses_lag(self) -> bool:
        """Whether the lag is part of the result."""
        return self.lag != 0.0

    @property
    def order(self) -> int:
        """The order of the polynomial."""
        return int(self.coefficients.shape[1]) - 1


@dataclass(frozen=True)
class _CrossValidated:
    """The order that predicts left-out legs best, and the mean square errors by order, shape (legs, channels)."""

    order: int
    errors: Mapping[int, Array]

    @property
    def error(self) -> Array:
        """Mean square errors of the best order, shape (legs, channels)."""
        return self.errors[self.order]


@dataclass(frozen=True)
class _Solution:
    """Polynomials of shape (order + 1, channels) for a lag, and their sum of squares over the scale."""

    lag: float
    coefficients: Array
    error: float


def fit_ramp(record: RampRecord, *, reference: float, highest: int = 3) -> RampFit:
    """Find the drift of a record, its order, and its lag.

    Parameters
    ----------
    reference : float
        °C.
    highest : int
        The highest order that is tried.

    Raises
    ------
    EstimateError
        The legs do not separate lag and drift; the message has the pace to take.
    """
    legs = legs_of(record)
    lags, no_lag = _trial_lags(legs), np.zeros(1)
    means, first, scale = _from_start(record, legs, reference, highest)
    means = means.grouped(first.lag, first.coefficients)
    plain = _cross_validated(means, highest, scale, partial(_with_some_lag, means, no_lag, scale))
    lagged = _cross_validated(means, highest, scale, partial(_with_some_lag, means, lags, scale))
    everything = np.ones(len(means), dtype=bool)
    solution = _solve(means, everything, lagged.order, lags, scale)
    found_lag, _, covariance = _one_lag(means, solution.lag, lagged.order)
    u_lag = sqrt(covariance[-1, -1])
    _require_lag_resolved(legs, found_lag, u_lag)
    used = (
        _legs_confirm(lagged, plain, scale)
        and abs(found_lag) > RESOLVED * u_lag
        and solution.error < error_of_hysteresis(means, lagged.order, scale)
    )
    if used:
        # One lag leaves more at the turns than a coefficient explains, where the element has two.
        pair = likeliest_pair(means, found_lag, _least_squares(means.powers(found_lag, highest), means.readings).T)
        chosen = _cross_validated(means, highest, scale, partial(_with_element, means, pair.element))
        estimate = _with_lag(means, *_one_lag(means, found_lag, chosen.order))
    else:
        chosen = plain
        estimate = _without_lag(means, plain.order)
    lag, coefficients = estimate.lag, estimate.coefficients
    without = _solve(means, everything, lagged.order, no_lag, scale)
    whole_loop = loops(means, 0.0, without.coefficients)
    return RampFit(
        reference=reference,
        coefficients=coefficients,
        lag=lag,
        covariance=estimate.covariance,
        found_lag=lag if used else found_lag,
        u_lag=sqrt(estimate.covariance[-1, -1]) if used else u_lag,
        explained=whole_loop.explained_by(loops(means, solution.lag, solution.coefficients)),
        loops=loops(means, lag, coefficients.T),
        loop_covariance=estimate.loop_covariance,
        u_element=estimate.u_element,
        held_out=tuple(
            HeldOutLeg(leg, np.sqrt(b), np.sqrt(a)) for leg, b, a in zip(legs, plain.error, lagged.error, strict=True)
        ),
        error_by_order={order: float(np.mean(error / scale**2)) for order, error in chosen.errors.items()},
        means=means,
    )


def _from_start(
    record: RampRecord, legs: list[Leg], reference: float, highest: int
) -> tuple[FittedMeans, _Solution, Array]:
    """Return means, fit and scale of a record that starts at rest, or on the way: whichever explains the record better.

    One lag alone would take a second one for a start on the way.
    """
    starts = [FittedMeans(record, legs, reference, running=running) for running in (False, True)]
    scale, everything = _scale(starts[0], highest), np.ones(len(starts[0]), dtype=bool)
    at_rest, running = (_solve(start, everything, highest, _trial_lags(legs), scale) for start in starts)
    found = list(zip(starts, (at_rest, running), strict=True))
    if running.lag > 0.0 and running.error < at_rest.error:
        found.sort(key=lambda one: likeliest_pair(one[0], one[1].lag, one[1].coefficients.T).error(one[0], scale))
    return *found[0], scale


def _trial_lags(legs: list[Leg]) -> Array:
    """Return the lags that are tried first, of both signs, from a thousandth to half of the longest leg, s."""
    longest = max(leg.seconds for leg in legs)
    grid = np.geomspace(longest / 1000.0, longest / 2.0, _LAGS)
    return np.concatenate([-grid[::-1], [0.0], grid])


def _legs_confirm(lagged: _CrossValidated, plain: _CrossValidated, scale: Array) -> bool:
    """Return whether a lag predicts every left-out leg better, and no channel of it visibly worse."""
    gained = np.mean((plain.error - lagged.error) / scale**2, axis=1) > 0.0
    return bool(gained.all() and np.all(lagged.error <= (1.0 + WORSE) * plain.error))


def _least_squares(x: Array, y: Array) -> Array:
    return np.asarray(np.linalg.lstsq(x, y, rcond=None)[0], dtype=np.float64)


def _scale(means: FittedMeans, order: int) -> Array:
    """Return the scatter about a polynomial, shape (channels,): what errors of several channels are compared by."""
    x = means.powers(0.0, order)
    left = means.readings - x @ _least_squares(x, means.readings)
    smallest = 1e-12 * np.max(np.abs(means.readings), axis=0) + np.finfo(float).tiny
    return np.asarray(np.maximum(np.std(left, axis=0), smallest))


def _cross_validated(
    means: FittedMeans, highest: int, scale: Array, predicted: Callable[[int, NDArray[np.bool_]], Array]
) -> _CrossValidated:
    """Compare each leg with what an order predicts of it from the others."""
    legs = [means.leg == number for number in range(len(means.legs))]
    errors = {
        order: np.array([np.mean((means.readings[out] - predicted(order, out)) ** 2, axis=0) for out in legs])
        for order in range(1, highest + 1)
    }
    return _CrossValidated(min(errors, key=lambda order: float(np.mean(errors[order] / scale**2))), errors)


def _with_some_lag(means: FittedMeans, lags: Array, scale: Array, order: int, out: NDArray[np.bool_]) -> Array:
    """Predict a leg by a polynomial with one of some lags."""
    found = _solve(means, ~out, order, lags, scale)
    return np.asarray(means.powers(found.lag, order)[out] @ found.coefficients)


def _with_element(means: FittedMeans, element: Array, order: int, out: NDArray[np.bool_]) -> Array:
    """Predict a leg by a polynomial of a temperature."""
    x = means.powers_of(element, order)
    return np.asarray(x[out] @ _least_squares(x[~out], means.readings[~out]))


def _solve(means: FittedMeans, kept: NDArray[np.bool_], order: int, lags: Array, scale: Array) -> _Solution:
    """Fit polynomial and lag to some means: the best of some lags, then Gauss-Newton steps."""
    y = means.readings[kept]

    def at(lag: float) -> _Solution:
        x = means.powers(lag, order)[kept]
        coefficients = _least_squares(x, y)
        return _Solution(lag, coefficients, float(np.sum(((y - x @ coefficients) / scale) ** 2)))

    best = min((at(lag) for lag in lags.tolist()), key=attrgetter("error"))
    if len(lags) == 1:
        return best
    for _ in range(_STEPS):
        x = means.powers(best.lag, order)[kept]
        slope = means.by_lag(best.lag, best.coefficients)[kept]
        slope = slope - x @ _least_squares(x, slope)
        steepness = float(np.sum((slope / scale) ** 2))
        if not steepness > 0.0:
            break
        change = float(np.sum(slope * (y - x @ best.coefficients) / scale**2)) / steepness
        refined = at(round(best.lag + float(np.clip(change, lags[0] / 2.0, lags[-1] / 2.0)), 6))
        if not refined.error < best.error:
            break
        best = refined
    return best


@dataclass(frozen=True)
class _Estimate:
    """Lag, coefficients of shape (channels, order + 1), and their covariances as in :class:`RampFit`."""

    lag: float
    u_element: float
    coefficients: Array
    covariance: Array
    loop_covariance: Array


def _one_lag(means: FittedMeans, lag: float, order: int) -> tuple[float, Array, Array]:
    """Return lag, coefficients of shape (channels, order + 1), and their covariance."""
    y = means.readings
    whiteners: list[Array] = []
    coefficients = _least_squares(means.powers(lag, order), y).T
    for _ in range(_STEPS):
        x = means.powers(lag, order)
        designs = [np.column_stack([x, slope]) for slope in means.by_lag(lag, coefficients.T).T]
        whiteners = whiteners or [whitener(means, design, y[:, c]) for c, design in enumerate(designs)]
        solution, covariance, _ = joint_least_squares(whiteners, designs, y)
        coefficients = solution[:-1].reshape(coefficients.shape)
        lag += float(solution[-1])
        if abs(solution[-1]) < _CONVERGED * sqrt(covariance[-1, -1]):
            break
    return lag, coefficients, covariance


def _with_lag(means: FittedMeans, lag: float, polynomials: Array, covariance: Array) -> _Estimate:
    """Estimate with a lag; the loop that even a second one leaves is fitted to the residuals."""
    mean, p = over_lags(means, lag, polynomials, covariance[:-1, :-1]), polynomials.shape[1]
    powers = means.powers_of(mean.element, p - 1)
    left = means.readings - powers @ mean.coefficients.T
    ways = means.ways(powers, loop_terms(p - 1))
    found = []
    for c, whiten in enumerate(mean.whiteners):
        solution, of_loop, _ = joint_least_squares([whiten], [ways], left[:, c : c + 1])
        found.append(HalfLoop(solution, of_loop))
    covariance = covariance.copy()
    covariance[:-1, :-1] = mean.covariance + noise_of_temperature(mean.element, mean.coefficients, means)
    lag = means.element.closest_lag(mean.element, lag)
    u_element = mean.distance(means.element.in_log(lag))
    return _Estimate(lag, u_element, mean.coefficients, covariance, _widened(found, powers, covariance))


def _without_lag(means: FittedMeans, order: int) -> _Estimate:
    """Estimate without a lag, each channel with a loop beside its polynomial where its ways differ.

    The polynomial then lies between the ways, and the noise is what both leave. Weights by the noise alone would take
    the loop for a zero that wanders, and follow one way here and the other there.
    """
    p, channels = order + 1, means.readings.shape[1]
    x = means.powers(0.0, order)
    ways = means.ways(x, loop_terms(order))
    end = p + ways.shape[1]
    coefficients, covariance = np.zeros((channels, p)), np.zeros((channels * p + 1, channels * p + 1))
    found = []
    for c, values in enumerate(means.readings.T):
        own = slice(c * p, (c + 1) * p)
        both = _with_turns(means, np.column_stack([x, ways]), values)
        solve = np.linalg.pinv(both)
        solution, of_solution = solve @ values, solve @ noise_covariance(means, both, values) @ solve.T
        loop = HalfLoop(solution[p:end], of_solution[p:end, p:end])
        found.append(loop)
        if not loop.certain:
            solution, of_solution, _ = joint_least_squares([whitener(means, x, values)], [x], values[:, None])
        coefficients[c], covariance[own, own] = solution[:p], of_solution[:p, :p]
    covariance[:-1, :-1] += noise_of_temperature(means.element.at(0.0), coefficients, means)
    return _Estimate(0.0, 0.0, coefficients, covariance, _widened(found, x, covariance))


def _with_turns(means: FittedMeans, design: Array, values: Array) -> Array:
    """Return a design with unknowns for the means behind the turns, where they are no part of its ways.

    There hysteresis such as a play is on its way from one side to the other.
    """
    behind = means.behind_turns
    square = (values - design @ _least_squares(design, values)) ** 2
    if not behind.any() or np.mean(square[behind]) < TURNS * np.mean(square[~behind]):
        return design
    return np.column_stack([design, np.eye(len(design))[:, behind]])


def _widened(found: list[HalfLoop], powers: Array, covariance: Array) -> Array:
    """Return what the loops that are certain add to the covariance of the coefficients."""
    p = powers.shape[1]
    added = np.zeros((len(found) * p, len(found) * p))
    for c, loop in enumerate(found):
        own = slice(c * p, (c + 1) * p)
        if loop.certain:
            added[own, own] = loop.widening(powers, covariance[own, own])
    return added


def _require_lag_resolved(legs: list[Leg], lag: float, u: float) -> None:
    """Refuse a lag that the legs do not separate from drift."""
    shortest = min(leg.seconds for leg in legs)
    widest = max(leg.high - leg.low for leg in legs)
    pace = float(np.mean([leg.pace for leg in legs]))
    if abs(lag) * LEG_LAGS > shortest > u * LEG_LAGS and abs(lag) > RESOLVED * u:
        slower = widest / (2.0 * LEG_LAGS * abs(lag)) * 60.0
        raise EstimateError(
            f"at {pace:.2g} °C/min a leg lasts {shortest:.0f} s, and the lag is about {abs(lag):.0f} s: so short a leg "
            f"does not separate it from drift; change the temperature at {slower:.2g} °C/min or slower"
        )
    if not 2.0 * u * pace / 60.0 < LAG_RESOLUTION * widest:
        raise EstimateError(
            f"at {pace:.2g} °C/min the lag is known to ±{2.0 * u:.2g} s, which does not separate it from drift: the "
            f"zero wanders, or the noise is too large; take more legs, at {4.0 * pace:.2g} °C/min"
        )
