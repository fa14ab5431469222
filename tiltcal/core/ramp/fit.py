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

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.loops import Loops, error_of_hysteresis, loops
from tiltcal.core.ramp.means import BLOCKS, FIT_SMOOTHING, FittedMeans
from tiltcal.core.ramp.noise import noise_covariance
from tiltcal.core.ramp.record import Leg, RampRecord, legs_of
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.errors import EstimateError

LEG_LAGS = 4.0
"""A leg must last so many lags: else the element does not follow."""

LAG_RESOLUTION = 0.1
"""A lag has to be known better than the time in which the temperature crosses this part of its range."""

RESOLVED = 2.0
"""Standard uncertainties that a lag is away from 0 where it is used."""

WORSE = 0.02
"""Part by which the mean square error of a channel may grow on a leg without anyone seeing it."""

_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5)
_LAGS, _STEPS, _CONVERGED = 14, 8, 0.01


@dataclass(frozen=True)
class HeldOutLeg:
    """How well a leg is predicted from the others.

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
    loop_variance : ndarray, shape (channels,)
        What that adds to the variance of the reading, unit².
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
    loop_variance: Array
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
        The legs cannot tell lag from drift; the message has the pace to take.
    """
    legs = legs_of(record)
    means = FittedMeans(record, legs, reference)
    scale = _scale(means, highest)
    lags, no_lag = _trial_lags(legs), np.zeros(1)
    plain = _cross_validated(means, highest, no_lag, scale)
    lagged = _cross_validated(means, highest, lags, scale)
    everything = np.ones(len(means), dtype=bool)
    solution = _solve(means, everything, lagged.order, lags, scale)
    found_lag, _, covariance = _estimate(means, solution.lag, lagged.order, with_lag=True)
    u_lag = sqrt(covariance[-1, -1])
    _require_lag_resolved(legs, found_lag, u_lag)
    used = (
        _legs_confirm(lagged, plain, scale)
        and abs(found_lag) > RESOLVED * u_lag
        and solution.error < error_of_hysteresis(means, lagged.order, scale)
    )
    chosen = lagged if used else plain
    lag, coefficients, covariance = _estimate(means, found_lag if used else 0.0, chosen.order, with_lag=used)
    if used:
        covariance = covariance + _of_a_second_lag(record, legs, solution, scale, reference)
    left = loops(means, lag, coefficients.T)
    if not used and left.variance.any():
        coefficients, covariance = _midway(means, chosen.order)
        left = loops(means, lag, coefficients.T)
    without = _solve(means, everything, lagged.order, no_lag, scale)
    explained = loops(means, 0.0, without.coefficients).explained_by(loops(means, solution.lag, solution.coefficients))
    return RampFit(
        reference,
        coefficients,
        lag,
        covariance,
        lag if used else found_lag,
        sqrt(covariance[-1, -1]) if used else u_lag,
        explained,
        left,
        _loop_variance(left, covariance, coefficients.shape),
        tuple(
            HeldOutLeg(leg, np.sqrt(b), np.sqrt(a)) for leg, b, a in zip(legs, plain.error, lagged.error, strict=True)
        ),
        {order: float(np.mean(error / scale**2)) for order, error in chosen.errors.items()},
        means,
    )


def _trial_lags(legs: list[Leg]) -> Array:
    """Return the lags that are tried first, of both signs, from a thousandth to half of the longest leg, s."""
    longest = max(leg.seconds for leg in legs)
    grid = np.geomspace(longest / 1000.0, longest / 2.0, _LAGS)
    return np.concatenate([-grid[::-1], [0.0], grid])


def _legs_confirm(lagged: _CrossValidated, plain: _CrossValidated, scale: Array) -> bool:
    """Return whether a lag predicts every left-out leg better, and no channel of it visibly worse."""
    gained = np.mean((plain.error - lagged.error) / scale**2, axis=1) > 0.0
    return bool(gained.all() and np.all(lagged.error <= (1.0 + WORSE) * plain.error))


def _loop_variance(left: Loops, covariance: Array, shape: tuple[int, ...]) -> Array:
    """Return what the loops that are left add to the variance of a reading, shape (channels,).

    The ways of two legs alone differ by what wanders too, which is in the variance of the offset already.
    """
    if left.repeated:
        return left.variance
    offsets = np.diag(covariance)[:-1].reshape(shape)[:, 0]
    return np.maximum(left.variance - offsets, 0.0)


def _least_squares(x: Array, y: Array) -> Array:
    return np.asarray(np.linalg.lstsq(x, y, rcond=None)[0], dtype=np.float64)


def _scale(means: FittedMeans, order: int) -> Array:
    """Return the scatter about a polynomial, shape (channels,): what errors of several channels are compared by."""
    x = means.powers(0.0, order)
    left = means.readings - x @ _least_squares(x, means.readings)
    smallest = 1e-12 * np.max(np.abs(means.readings), axis=0) + np.finfo(float).tiny
    return np.asarray(np.maximum(np.std(left, axis=0), smallest))


def _cross_validated(means: FittedMeans, highest: int, lags: Array, scale: Array) -> _CrossValidated:
    """Predict each leg from the others, by polynomials of every order with one of some lags."""
    errors = {}
    for order in range(1, highest + 1):
        rows = []
        for number in range(len(means.legs)):
            out = means.leg == number
            found = _solve(means, ~out, order, lags, scale)
            left = means.readings[out] - means.powers(found.lag, order)[out] @ found.coefficients
            rows.append(np.mean(left**2, axis=0))
        errors[order] = np.array(rows)
    return _CrossValidated(min(errors, key=lambda order: float(np.mean(errors[order] / scale**2))), errors)


def _solve(means: FittedMeans, kept: NDArray[np.bool_], order: int, lags: Array, scale: Array) -> _Solution:
    """Fit polynomial and lag to some means: the best of some lags, then Gauss-Newton steps."""
    y = means.readings[kept]

    def at(lag: float) -> _Solution:
        x = means.powers(lag, order)[kept]
        coefficients = _least_squares(x, y)
        return _Solution(lag, coefficients, float(np.sum(((y - x @ coefficients) / scale) ** 2)))

    best = min((at(lag) for lag in lags.tolist()), key=lambda one: one.error)
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
        one = at(round(best.lag + float(np.clip(change, lags[0] / 2.0, lags[-1] / 2.0)), 6))
        if not one.error < best.error:
            break
        best = one
    return best


def _estimate(means: FittedMeans, lag: float, order: int, *, with_lag: bool) -> tuple[float, Array, Array]:
    """Return lag, coefficients and their covariance, by generalised least squares under the noise of the record."""
    y = means.readings
    channels, p = y.shape[1], order + 1
    size = channels * p + with_lag
    factors: list[Array] = []
    covariance = np.zeros((channels * p + 1, channels * p + 1))
    coefficients = _least_squares(means.powers(lag, order), y)
    for _ in range(_STEPS):
        x = means.powers(lag, order)
        slope = means.by_lag(lag, coefficients)
        designs = [np.column_stack([x, slope[:, c]]) if with_lag else x for c in range(channels)]
        if not factors:
            factors = [
                np.asarray(np.linalg.cholesky(noise_covariance(means, one, y[:, c])), dtype=np.float64)
                for c, one in enumerate(designs)
            ]
        normal, right = np.zeros((size, size)), np.zeros(size)
        for c, (factor, design) in enumerate(zip(factors, designs, strict=True)):
            places = [*range(c * p, (c + 1) * p), *([channels * p] if with_lag else [])]
            white = np.linalg.solve(factor, np.column_stack([design, y[:, c] - x @ coefficients[:, c]]))
            normal[np.ix_(places, places)] += white[:, :-1].T @ white[:, :-1]
            right[places] += white[:, :-1].T @ white[:, -1]
        scale = 1.0 / np.sqrt(np.diag(normal))
        covariance[:size, :size] = np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
        change = covariance[:size, :size] @ right
        coefficients = coefficients + change[: channels * p].reshape(channels, p).T
        if not with_lag:
            break
        lag += float(change[-1])
        if abs(change[-1]) < _CONVERGED * sqrt(covariance[-1, -1]):
            break
    return lag, np.asarray(coefficients.T), covariance


def _midway(means: FittedMeans, order: int) -> tuple[Array, Array]:
    """Return coefficients between the ways and their covariance: both ways weigh alike, and so do all temperatures.

    Weights by the noise would take the loop for noise that wanders, and follow one way here and the other there.
    """
    x, y = means.powers(0.0, order), means.readings
    rising = np.array([leg.rising for leg in means.legs])[means.leg]
    weights = np.where(rising, 1.0 / np.sum(rising), 1.0 / np.sum(~rising))
    solve = np.linalg.solve(x.T @ (weights[:, None] * x), x.T * weights)
    channels, p = y.shape[1], order + 1
    covariance = np.zeros((channels * p + 1, channels * p + 1))
    for c in range(channels):
        own = slice(c * p, (c + 1) * p)
        covariance[own, own] = solve @ noise_covariance(means, x, y[:, c]) @ solve.T
    return np.asarray((solve @ y).T), covariance


def _of_a_second_lag(record: RampRecord, legs: list[Leg], found: _Solution, scale: Array, reference: float) -> Array:
    """Return what the covariance gains because the lag may be two in series, of which the second has a part of it.

    One lag follows the turns of two badly, and the polynomial takes on what it leaves. So each part counts as far as it
    moves the coefficients, with the weight that its likelihood gives it; one lag alone has half of the prior weight.
    """
    size = len(found.coefficients) * found.coefficients.shape[1]
    solutions = []
    for share in _SHARES:
        filtered = ThermalLag(share * found.lag, FIT_SMOOTHING)(record.time, record.temperature)
        means = FittedMeans(replace(record, temperature=filtered), legs, reference)
        lags = found.lag * (np.linspace(0.7, 1.3, 7) - share)
        solutions.append(_solve(means, np.ones(len(means), dtype=bool), len(found.coefficients) - 1, lags, scale))
    errors = np.array([found.error, *(one.error for one in solutions)])
    variance = errors.min() / (BLOCKS * found.coefficients.shape[1])
    weights = np.array([1.0, *(1.0 / len(_SHARES) for _ in _SHARES)]) * np.exp(
        (errors.min() - errors) / (2.0 * variance)
    )
    gained = np.zeros((size + 1, size + 1))
    for weight, one in zip(weights[1:] / weights.sum(), solutions, strict=True):
        apart = np.array([*(one.coefficients - found.coefficients).T.ravel(), 0.0])
        gained += weight * np.outer(apart, apart)
    return gained


def _require_lag_resolved(legs: list[Leg], lag: float, u: float) -> None:
    """Refuse a lag that the legs cannot tell from drift."""
    shortest = min(leg.seconds for leg in legs)
    widest = max(leg.high - leg.low for leg in legs)
    pace = float(np.mean([leg.pace for leg in legs]))
    if abs(lag) * LEG_LAGS > shortest and abs(lag) > RESOLVED * u:
        slower = widest / (2.0 * LEG_LAGS * abs(lag)) * 60.0
        raise EstimateError(
            f"at {pace:.2g} °C/min a leg lasts {shortest:.0f} s, and the lag is about {abs(lag):.0f} s: so short a leg "
            f"cannot tell it from drift; change the temperature by {slower:.2g} °C/min or slower"
        )
    if not 2.0 * u * pace / 60.0 < LAG_RESOLUTION * widest:
        raise EstimateError(
            f"at {pace:.2g} °C/min the lag is known to ±{2.0 * u:.2g} s, which does not tell it from drift: the zero "
            f"wanders, or the noise is too large; take more legs, at {4.0 * pace:.2g} °C/min"
        )
