"""The drift of a sensor at rest whose temperature goes up and down: polynomial, thermal lag, and what loop is left.

A reading of channel i, in one attitude, at the thermometer's temperature T(t)::

    u_i(t) = c_i0 + c_i1 dT + c_i2 dT² + ... + noise,    dT = F(T; lag)(t) - T_ref

F being the filter of :mod:`tiltcal.core.thermal_lag`. For a given lag this is linear; the lag is found by variable
projection (Golub and Pereyra, 1973). A lag separates the way up from the way down by a loop as wide as the lag times
the pace, and so does hysteresis; a zero that wanders separates any two legs. What distinguishes them is whether a lag
that is fitted to some legs predicts another one. So every leg is left out once, and the lag is used only where it
predicts each of them better, and where hysteresis without time does not explain the record as well.

One lag is all: a record whose residuals turn with the temperature, by a second lag or because it starts on the way, is
refused with the pace at which one lag describes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.means import LAGS, TINY, RampMeans, least_squares, lowest
from tiltcal.core.ramp.record import Leg, RampRecord, legs_of
from tiltcal.errors import EstimateError

RESOLVED = 2.0  # standard uncertainties that a lag is away from 0 where it is used
PLACES = 8  # temperatures at which the ways are compared
_LAG_RESOLUTION = 0.1  # of the range: a lag must be known better than the time in which the temperature crosses it
_LEG_LAGS = 4.0  # lags that a leg lasts at least: else the element does not follow
_WORSE = 0.02  # by which the mean square error of a channel may grow on a leg and not count as worse
_LOOP, _TURNING = 0.01, 1e-4  # probability with which noise alone makes a loop, and residuals that turn
_TURNS = 3.0  # mean square of the residuals behind the turns over that of the others where hysteresis crosses there
_BEHIND_TURN = 0.1  # of a leg's range, in which hysteresis gets from one side to the other
_LOOP_TERMS = 3  # of the polynomial of a loop: a play of a cubic, and Rayleigh's loop, have three
_ONE_SIDED, _TWO_SIDED = 1.645, 1.96  # deviations that hold 95 % of a normal variable, to one side and to both


@dataclass(frozen=True)
class RampFit:
    """The drift that a record shows, and the means that it is fitted to."""

    coefficients: Array  # (channels, order + 1): reading at the reference temperature, unit, unit/°C, ...
    lag: float  # s, of the temperature that they are polynomials of; 0 where none is used
    covariance: Array  # of the coefficients, channel by channel
    loop_covariance: Array  # what the loop adds to it
    found_lag: float  # s; describes the record best, used or not
    u_lag: float  # its standard uncertainty, s
    explained: Array  # (channels,): part of the loop's square that it explains
    places: Array  # (places,): temperatures from the reference, °C
    loops: Array  # (places, channels): the way up less the way down that is left there, unit
    u_element: float  # °C, of the element in a log, whose filter smooths the turns of a thermometer that is later
    polynomial: Array  # (legs, channels): root mean square error of a leg, predicted from the others, unit
    lagged: Array  # the same with a lag
    error_by_order: Mapping[int, float]  # mean square of these errors over the variance of the residuals
    means: RampMeans

    @property
    def uses_lag(self) -> bool:
        """Whether the lag is part of the result."""
        return self.lag != 0.0

    @property
    def order(self) -> int:
        """The order of the polynomial."""
        return int(self.coefficients.shape[1]) - 1


def fit_ramp(record: RampRecord, *, reference: float, highest: int = 3) -> RampFit:
    """Find the drift of a record from a reference temperature in °C, its order, at most the ``highest``, and its lag.

    An EstimateError, with the pace to take, where the legs do not separate lag and drift, or one lag does not describe
    the turns.
    """
    means = RampMeans(record, legs_of(record), reference, highest)
    if means.lag(highest) < 0.0:
        means = RampMeans(record, means.legs, reference, highest, late=True)
    orders = range(1, highest + 1)
    plain = {order: _left_out(means, order, lambda *_: 0.0) for order in orders}
    lagged = {order: _left_out(means, order, means.lag) for order in orders}
    order_alone, order = (min(errors, key=lambda one: float(np.mean(errors[one]))) for errors in (plain, lagged))
    found_lag, u_lag, *by_lag = _with_lag(means, order)
    _require_lag_resolved(means.legs, found_lag, u_lag)
    gained = np.mean(plain[order_alone] - lagged[order], axis=1) > 0.0
    used = bool(
        gained.all()
        and np.all(lagged[order] <= (1.0 + _WORSE) * plain[order_alone])
        and abs(found_lag) > RESOLVED * u_lag
        and means.cost(means.powers(means.lag(order), order)) < _cost_of_hysteresis(means, order)
    )
    element, up = means.temperature(0.0), means.rising > 0.0
    low, high = max(element[up].min(), element[~up].min()), min(element[up].max(), element[~up].max())
    places = low + (high - low) * (np.arange(PLACES) + 0.5) / PLACES
    loops = [_loops(means, places, lag, order) for lag in (0.0, found_lag)]
    u_element, lag = 0.0, found_lag if used else 0.0
    coefficients, covariance, loop_covariance = _beside_loop(means, lag, order if used else order_alone)
    if used:
        coefficients, covariance = by_lag
        _require_one_lag(means, found_lag, order, record.step)
        if lag < 0.0:
            u_element = float(np.sqrt(np.mean((means.temperature_in_log(lag) - means.temperature(lag)) ** 2)))
    # Rounding of the thermometer does not average out at the turns.
    slopes = np.pad(coefficients[:, 1:] * np.arange(1, coefficients.shape[1]), ((0, 0), (0, 1)))
    for block, slope in zip(_blocks(slopes), slopes, strict=True):
        covariance[block, block] += np.outer(slope, slope) * means.shift**2
    return RampFit(
        coefficients=coefficients,
        lag=lag,
        covariance=covariance,
        found_lag=found_lag,
        u_lag=u_lag,
        explained=1.0 - np.mean(loops[1] ** 2, axis=0) / np.maximum(np.mean(loops[0] ** 2, axis=0), TINY),
        places=places,
        loops=loops[1] if used else loops[0],
        loop_covariance=loop_covariance,
        u_element=u_element,
        polynomial=np.sqrt(plain[order_alone]) * means.scale,
        lagged=np.sqrt(lagged[order]) * means.scale,
        error_by_order={order: float(np.mean(error)) for order, error in (lagged if used else plain).items()},
        means=means,
    )


def _with_lag(means: RampMeans, order: int) -> tuple[float, float, Array, Array]:
    """Return the lag that all channels share, s, its u, polynomials (channels, order + 1), and their covariance."""
    lag, noises = means.lag(order), list[Array]()
    for _ in range(2):
        designs = _lag_designs(means, lag, order)
        noises = noises or list(map(means.noise_covariance, designs, means.readings.T))
        solution, covariance = _generalised_least_squares(designs, 1, means.readings, noises)
        lag += float(solution[-1])
    return lag, sqrt(covariance[-1, -1]), solution[:-1].reshape(-1, order + 1), covariance[:-1, :-1]


def _lag_designs(means: RampMeans, lag: float, order: int) -> list[Array]:
    """Return the powers of the temperature and the derivative by the lag, for each channel."""
    x = means.powers(lag, order)
    slopes = means.by_lag(lag, order) @ least_squares(x, means.readings)
    return [np.column_stack([x, slope]) for slope in slopes.T]


def _beside_loop(means: RampMeans, lag: float, order: int) -> tuple[Array, Array, Array]:
    """Return polynomials for a given lag that lie between the ways, their covariance, and what the loop adds to it.

    A reading is on one way or the other, half of their difference from the middle.
    """
    from scipy.special import chdtri

    x, p, channels = means.powers(lag, order), order + 1, means.readings.shape[1]
    ways = x[:, :_LOOP_TERMS] * means.rising[:, None]
    of_ways = slice(p, p + ways.shape[1])
    coefficients, (covariance, added) = np.zeros((channels, p)), np.zeros((2, channels * p, channels * p))
    for c, (block, values) in enumerate(zip(_blocks(coefficients), means.readings.T, strict=True)):
        design = np.column_stack([x, ways])
        if lag == 0.0:
            design = _with_turns(means, design, values)
        # Not weighted by the noise that lasts: it would follow one way of a loop here and the other there.
        solve = np.linalg.pinv(design)
        solution, of_solution = solve @ values, solve @ means.noise_covariance(design, values) @ solve.T
        half, of_half = solution[of_ways], of_solution[of_ways, of_ways]
        if half @ np.linalg.solve(of_half, half) > chdtri(len(half), _LOOP):
            loop = slice(block.start, block.start + len(half))
            noise_on_ways = _mean_square(x, of_solution[:p, :p]) + _mean_square(x[:, : len(half)], of_half)
            loop_square = _mean_square(x[:, : len(half)], np.outer(half, half))
            added[loop, loop] = of_half + loop_weight(sqrt(loop_square / noise_on_ways)) * np.outer(half, half)
        else:
            noise = means.noise_covariance(x, values)
            solution, of_solution = _generalised_least_squares([x], 0, values[:, None], [noise])
        coefficients[c], covariance[block, block] = solution[:p], of_solution[:p, :p]
    return coefficients, covariance, added


def _mean_square(x: Array, covariance: Array) -> float:
    return float(np.mean(np.einsum("ij,jk,ik->i", x, covariance, x)))


def loop_weight(ratio: float) -> float:
    """Return what half a loop's square counts, so that 1.96 standard uncertainties hold 95 % of readings on both ways.

    Of a half loop of so many standard uncertainties they must reach its end and 1.645 of these beyond.
    """
    return min((((ratio + _ONE_SIDED) / _TWO_SIDED) ** 2 - 1.0) / ratio**2, 1.0)


def _blocks(polynomials: Array) -> list[slice]:
    """Return where the coefficients of each channel are, for polynomials of shape (channels, p)."""
    channels, p = polynomials.shape
    return [slice(c * p, (c + 1) * p) for c in range(channels)]


def _with_turns(means: RampMeans, design: Array, values: Array) -> Array:
    """Return a design with unknowns for the means behind the turns, where they are no part of its ways.

    There hysteresis such as a play is on its way from one side to the other.
    """
    temperature = means.temperature(0.0)
    turns = temperature[np.searchsorted(means.leg, means.leg)]
    near = np.array([_BEHIND_TURN * (leg.high - leg.low) for leg in means.legs])
    behind = np.abs(temperature - turns) < near[means.leg]
    square = (values - design @ least_squares(design, values)) ** 2
    if not behind.any() or np.mean(square[behind]) < _TURNS * np.mean(square[~behind]):
        return design
    return np.column_stack([design, np.eye(len(design))[:, behind]])


def _loops(means: RampMeans, places: Array, lag: float, order: int) -> Array:
    """Return the way up less the way down at some temperatures from the reference, unit, shape (places, channels)."""
    x = means.powers(lag, order)
    ways = x[:, :_LOOP_TERMS] * means.rising[:, None]
    half = least_squares(np.column_stack([x, ways]), means.readings)[order + 1 :]
    return np.asarray(2.0 * np.vander(places, len(half), increasing=True) @ half)


def _cost_of_hysteresis(means: RampMeans, order: int) -> float:
    """Return the sum of squares that the best hysteresis without time leaves, over the scale squared.

    Two forms are tried. A play of the temperature makes, at one pace, the loop that a lag makes; only the turns differ.
    Rayleigh's loop (1887) grows from both turns: its two ways are parabolas between them.
    """
    element = means.temperature(0.0)
    legs = [element[means.leg == k] for k in range(len(means.legs))]
    low, high = (np.array([bound(leg) for leg in legs])[means.leg] for bound in (np.min, np.max))
    grown = means.rising * (element - low) * (high - element)
    widest = max(leg.high - leg.low for leg in means.legs) / 2.0
    widths = np.geomspace(widest / 1000.0, widest, LAGS)
    return min(
        means.cost(np.column_stack([means.powers(0.0, order), grown])),
        lowest(lambda width: means.cost(means.played(width)[:, : order + 1]), widths)[1],
    )


def _left_out(means: RampMeans, order: int, lag_of: Callable[[int, NDArray[np.bool_]], float]) -> Array:
    """Return the mean square errors, over the scale squared, of each leg from the others, shape (legs, channels)."""
    errors = []
    for number in range(len(means.legs)):
        kept = means.leg != number
        x = means.powers(lag_of(order, kept), order)
        left = means.readings[~kept] - x[~kept] @ least_squares(x[kept], means.readings[kept])
        errors.append(np.mean((left / means.scale) ** 2, axis=0))
    return np.array(errors)


def _require_lag_resolved(legs: Sequence[Leg], lag: float, u: float) -> None:
    """Refuse a lag that the legs do not separate from drift."""
    shortest = min(leg.seconds for leg in legs)
    widest = max(leg.high - leg.low for leg in legs)
    pace = float(np.mean([leg.pace for leg in legs]))
    if abs(lag) * _LEG_LAGS > shortest > u * _LEG_LAGS and abs(lag) > RESOLVED * u:
        slower = widest / (2.0 * _LEG_LAGS * abs(lag)) * 60.0
        raise EstimateError(
            f"at {pace:.2g} °C/min a leg lasts {shortest:.0f} s, and the lag is about {abs(lag):.0f} s: so short a leg "
            f"does not separate it from drift; change the temperature at {slower:.2g} °C/min or slower"
        )
    if not 2.0 * u * pace / 60.0 < _LAG_RESOLUTION * widest:
        raise EstimateError(
            f"at {pace:.2g} °C/min the lag is known to ±{2.0 * u:.2g} s, which does not separate it from drift: the "
            f"zero wanders, or the noise is too large; take more legs, at {4.0 * pace:.2g} °C/min"
        )


def _require_one_lag(means: RampMeans, lag: float, order: int, step: float) -> None:
    """Refuse a record whose residuals turn with the temperature, by more than rounding of the thermometer explains.

    A second lag changes the temperature of the element by what is like the second derivative by the lag, and a start on
    the way by what decays from there; all channels share both. What is left of them grows with the pace.
    """
    from scipy.special import chdtri

    apart = abs(lag) / 2.0
    # Behind a thermometer that is later, the inverse filter has the noise that the residuals have.
    centre = lag if lag > 0.0 else apart
    turns = [means.temperature(centre + apart) + means.temperature(centre - apart) - 2.0 * means.temperature(centre)]
    if lag > 0.0:
        turns.append(np.exp((means.time[0] - means.time) / lag))
    shared, x, y = np.stack(turns, axis=1), means.powers(lag, order), means.readings
    slopes = x[:, :-1] @ (np.arange(1, order + 1)[:, None] * least_squares(x, y)[1:])
    designs = [
        np.column_stack([design, slope[:, None] * shared])
        for design, slope in zip(_lag_designs(means, lag, order), slopes.T, strict=True)
    ]
    noises = list(map(means.noise_covariance, designs, y.T))
    solution, covariance = _generalised_least_squares(designs, 1 + len(turns), y, noises)
    sizes, of_sizes = solution[-len(turns) :], covariance[-len(turns) :, -len(turns) :]
    times = sqrt(float(sizes @ np.linalg.solve(of_sizes, sizes)) / chdtri(len(sizes), _TURNING))
    off = float(np.max(np.abs(shared @ sizes)))
    if times < 1.0 or off < step / 2.0:
        return
    pace = float(np.mean([leg.pace for leg in means.legs]))
    cause = f"follows by a second one: change the temperature at {pace / times:.2g} °C/min or slower"
    if np.argmax(sizes**2 / np.diag(of_sizes)) == 1:
        cause = f"was not at rest at the start: begin at a temperature that was steady for {10.0 * lag:.0f} s"
    raise EstimateError(
        f"at {pace:.2g} °C/min the residuals turn with the temperature, by up to {off:.2g} °C of it: one lag of "
        f"{lag:.0f} s does not describe the record, because the element {cause}"
    )


def _generalised_least_squares(
    designs: Sequence[Array], shared: int, values: Array, noises: Sequence[Array]
) -> tuple[Array, Array]:
    """Solve for the unknowns of each channel and some that all share, the last columns; return them and the covariance.

    Each channel has a design of shape (means, p + shared) and a covariance of its noise, shape (means, means).
    """
    channels, p = len(designs), designs[0].shape[1] - shared
    normal, against = np.zeros((channels * p + shared,) * 2), np.zeros(channels * p + shared)
    for c, (design, noise, column) in enumerate(zip(designs, noises, values.T, strict=True)):
        unknowns = [*range(c * p, (c + 1) * p), *range(channels * p, len(against))]
        weighted = np.linalg.solve(noise, design)
        normal[np.ix_(unknowns, unknowns)] += design.T @ weighted
        against[unknowns] += weighted.T @ column
    size = np.sqrt(np.diag(normal))
    covariance = np.linalg.pinv(normal / np.outer(size, size), hermitian=True) / np.outer(size, size)
    return covariance @ against, covariance
