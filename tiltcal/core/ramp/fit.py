"""The drift of a sensor at rest whose temperature goes up and down: polynomial, thermal lag, and what loop is left.

A reading of channel i, in one attitude, at the thermometer's temperature T(t)::

    u_i(t) = c_i0 + c_i1 dT + c_i2 dT² + ... + noise,    dT = F(T; lag)(t) - T_ref

F being the filter of :mod:`tiltcal.core.thermal_lag`. For a given lag this is linear; the lag is found by variable
projection (Golub and Pereyra, 1973). A lag separates the way up from the way down by a loop as wide as the lag times
the pace, and so does hysteresis; zero drift separates any two legs. What distinguishes them is whether a lag
that is fitted to some legs predicts another one. So every leg is left out once, and the lag is used only where it
predicts each of them better, and where hysteresis without time does not explain the record as well.

One lag is all: a record whose residuals depend on temperature, by a second lag or because it starts on the way, is
refused with the pace at which one lag describes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.record import Leg, RampRecord, averaged, legs_of, row_noise
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.errors import EstimateError

RESOLVED = 2.0  # a lag is used if it is more standard uncertainties from 0
PLACES = 8  # number of temperatures at which legs are compared
_LAG_RESOLUTION = 0.1  # largest uncertainty of a lag, as a fraction of the time to cross the temperature range
_LEG_LAGS = 4.0  # shortest leg, in lags: in a shorter one the element does not follow
_WORSE = 0.02  # largest relative growth of a leg's mean square error that is no worsening
_LOOP, _TURNING = 0.01, 1e-4  # p-values below which a loop, and residuals that depend on temperature, are real
_TURNS = 3.0  # least ratio of mean square residuals behind the turns to the others that shows hysteresis
_BEHIND_TURN = 0.1  # part of a leg, behind a turn, in which hysteresis changes sides
_APART = 3.0  # legs differ at one temperature by more standard uncertainties of white noise: the zero wanders
_LOOP_TERMS = 3  # terms of the polynomial of a loop: a play of a cubic, and Rayleigh's loop, have three
_ONE_SIDED, _TWO_SIDED = 1.645, 1.96  # one- and two-sided 95 % normal quantiles
_LAGS = 14  # grid points per sign in the initial search
_SINGULAR = 1e-12  # an eigenvalue of a scaled normal matrix below this is what rounding leaves of zero
_TINY = np.finfo(float).tiny
_MEANS = 256  # most means to which a record is reduced before the fit
_NOISE_SHARE = 0.02  # largest thermometer noise in a mean, as a fraction of the loop
_FEWEST_MEANS = 12  # fewest means per leg, however noisy the thermometer
_END_WEIGHT = 4.0  # leverage of an end of a line through n points, times n
_LASTS = np.geomspace(1.0 / 64.0, 1.2, 8)  # noise correlation times, in record lengths; the last is a random walk
_RATIOS = np.concatenate([[0.0], np.geomspace(1e-2, 1e5, 22)])  # ratios of correlated to white noise variance
_PRIOR = np.concatenate([[0.5], np.full(22, 0.5 / 22)])  # prior of the grid: half on white noise alone
_WIDER = 1.2  # factor on the variance of correlated noise: 1.96 sigma of a mixture hold less than 95 %
_DISTANCES = (1, 2, 4, 8)  # spacings of second differences, in means: a step of the thermometer may last several


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


def fit_ramp(record: RampRecord, *, reference: float, highest: int) -> RampFit:
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
            in_log = means.averaged(ThermalLag(lag)(record.time, record.temperature)) - reference
            u_element = float(np.sqrt(np.mean((in_log - means.temperature(lag)) ** 2)))
    left = np.abs(loops[1] if used else loops[0])
    apart = np.max(left, axis=0, where=left > _APART * _white_loops(means, places), initial=0.0)
    _add_zero_drift(loop_covariance, _blocks(coefficients), apart, high - low)
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
        explained=1.0 - np.mean(loops[1] ** 2, axis=0) / np.maximum(np.mean(loops[0] ** 2, axis=0), _TINY),
        places=places,
        loops=loops[1] if used else loops[0],
        loop_covariance=loop_covariance,
        u_element=u_element,
        polynomial=np.sqrt(plain[order_alone]) * means.scale,
        lagged=np.sqrt(lagged[order]) * means.scale,
        error_by_order={order: float(np.mean(error)) for order, error in (lagged if used else plain).items()},
        means=means,
    )


def _add_zero_drift(covariance: Array, blocks: Sequence[slice], apart: Array, width: float) -> None:
    """Add zero drift to a covariance where no loop counts, by how far apart the legs are, (channels,).

    The legs differ at one temperature: the curve may follow one leg and the truth another, all along its width.
    """
    for block, difference in zip(blocks, apart.tolist(), strict=True):
        if not covariance[block, block].any():
            turned = 2.0 * difference / sqrt(3.0) / width
            for term, u in enumerate((difference / sqrt(3.0), turned)):
                covariance[block.start + term, block.start + term] += u**2


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
    """Return polynomials for a lag that lie between the ways, their covariance, and what the loop adds to it."""
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
            square, square_of_ways = x.T @ x, x[:, : len(half)].T @ x[:, : len(half)]
            noise_on_ways = np.sum(square * of_solution[:p, :p]) + np.sum(square_of_ways * of_half)
            ratio = sqrt(float(half @ square_of_ways @ half / noise_on_ways))
            # So much of half the loop squared that 1.96 standard uncertainties hold 95 % of both ways.
            weight = min((((ratio + _ONE_SIDED) / _TWO_SIDED) ** 2 - 1.0) / ratio**2, 1.0)
            added[loop, loop] = of_half + weight * np.outer(half, half)
        else:
            noise = means.noise_covariance(x, values)
            solution, of_solution = _generalised_least_squares([x], 0, values[:, None], [noise])
        coefficients[c], covariance[block, block] = solution[:p], of_solution[:p, :p]
    return coefficients, covariance, added


def _blocks(polynomials: Array) -> list[slice]:
    """Return where the coefficients of each channel are, for polynomials of shape (channels, p)."""
    channels, p = polynomials.shape
    return [slice(c * p, (c + 1) * p) for c in range(channels)]


def _with_turns(means: RampMeans, design: Array, values: Array) -> Array:
    """Return a design with unknowns for the means behind the turns, where hysteresis is on its way between sides."""
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


def _white_loops(means: RampMeans, places: Array) -> Array:
    """Return the standard uncertainties of :func:`_loops` by the noise of single readings, unit, (places, channels)."""
    ways = means.powers(0.0, _LOOP_TERMS - 1)
    by_means = np.linalg.pinv(np.column_stack([ways, ways * means.rising[:, None]]))[ways.shape[1] :]
    by_places = 2.0 * np.vander(places, len(by_means), increasing=True) @ by_means
    return np.asarray(np.linalg.norm(by_places, axis=1)[:, None] * means.white)


def _cost_of_hysteresis(means: RampMeans, order: int) -> float:
    """Return the sum of squares that the best hysteresis without time leaves, over the scale squared.

    A play makes, at one pace, the loop that a lag makes; only the turns differ. Rayleigh's loop (1887) has parabolas.
    """
    element = means.temperature(0.0)
    legs = [element[means.leg == k] for k in range(len(means.legs))]
    low, high = (np.array([bound(leg) for leg in legs])[means.leg] for bound in (np.min, np.max))
    grown = means.rising * (element - low) * (high - element)
    widest = max(leg.high - leg.low for leg in means.legs) / 2.0
    widths = np.geomspace(widest / 1000.0, widest, _LAGS)
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
    shortest, widest = min(leg.seconds for leg in legs), max(leg.high - leg.low for leg in legs)
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
    """Refuse a record whose residuals depend on temperature, by more than rounding of the thermometer explains.

    A second lag acts like the second derivative by the lag, a start on the way decays; both grow with the pace.
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
        f"at {pace:.2g} °C/min residuals depend on temperature (up to {off:.2g} °C equivalent): one lag of "
        f"{lag:.0f} s does not describe the record, because the element {cause}"
    )


def _generalised_least_squares(
    designs: Sequence[Array], shared: int, values: Array, noises: Sequence[Array]
) -> tuple[Array, Array]:
    """Solve for the unknowns of each channel and some that all share, the last columns; with their covariance."""
    channels, p = len(designs), designs[0].shape[1] - shared
    normal, against = np.zeros((channels * p + shared,) * 2), np.zeros(channels * p + shared)
    for c, (design, noise, column) in enumerate(zip(designs, noises, values.T, strict=True)):
        unknowns = [*range(c * p, (c + 1) * p), *range(channels * p, len(against))]
        root = np.linalg.cholesky(noise)  # so that no product is negative where noise that lasts is far above the other
        white, measured = np.linalg.solve(root, design), np.linalg.solve(root, column)
        normal[np.ix_(unknowns, unknowns)] += white.T @ white
        against[unknowns] += white.T @ measured
    size = np.sqrt(np.diag(normal))
    scaled = normal / np.outer(size, size)
    covariance = np.linalg.pinv(scaled, rcond=_SINGULAR, hermitian=True) / np.outer(size, size)
    return covariance @ against, covariance


# The record in few means


class RampMeans:
    """A record in few means of consecutive rows, each within a leg.

    Where the thermometer is ``late``, the noise of a row becomes |lag| (e_end - e_start) / t in a mean over a time t:
    means are so long that it hides no loop.
    """

    def __init__(
        self, record: RampRecord, legs: Sequence[Leg], reference: float, highest: int, *, late: bool = False
    ) -> None:
        self._record, self.reference, self._highest = record, reference, highest
        rows, degrees = len(record.time), sum(leg.high - leg.low for leg in legs)
        # Over a whole step of the thermometer its rounding averages out; parts of one would look like noise that lasts.
        steps = degrees / record.step if record.step else np.inf
        most = min(_MEANS, rows, steps)
        if late:
            noise = max(row_noise(record.temperature), record.step / sqrt(12.0))
            most = min(most, max(_NOISE_SHARE * degrees / (sqrt(2.0) * noise), _FEWEST_MEANS * len(legs)))
        counts = [int(most * (leg.end - leg.start) / rows) for leg in legs]
        if min(counts) < 2:
            raise EstimateError("a leg of the record has few rows: each leg must span the full temperature range")
        bounds = [np.linspace(leg.start, leg.end, n + 1).astype(int) for leg, n in zip(legs, counts, strict=True)]
        self._starts = np.concatenate([one[:-1] for one in bounds])
        self._powers: dict[float, Array] = {}
        self.legs = legs
        self.leg: NDArray[np.intp] = np.repeat(np.arange(len(legs)), counts)
        self.rising = np.where(np.array([leg.rising for leg in legs])[self.leg], 1.0, -1.0)  # -1 on the way down
        self.time, self.readings = self.averaged(record.time), self.averaged(record.readings)
        self.white = record.noise / sqrt(record.rows / len(self.leg))  # of a mean by noise of single readings, unit
        # What rounding does not average out at the turns may shift the curve by so much, °C.
        self.shift = min(_END_WEIGHT * len(legs) / steps, 1.0) * record.step / sqrt(12.0)
        x = self.powers(0.0, highest)
        smallest = 1e-12 * np.max(np.abs(self.readings), axis=0) + _TINY
        # The scatter about a polynomial, by which errors of several channels are compared, unit.
        self.scale = np.maximum(np.std(self.readings - x @ least_squares(x, self.readings), axis=0), smallest)

    def averaged(self, rows: Array) -> Array:
        return averaged(rows, self._starts)

    def temperature(self, lag: float) -> Array:
        """Return the temperature of the element from the reference, °C, shape (means,)."""
        time, temperature = self._record.time, self._record.temperature
        rows = ThermalLag(lag)(time, temperature) if lag >= 0.0 else temperature - lag * self._slope
        return self.averaged(rows) - self.reference

    def powers(self, lag: float, order: int) -> Array:
        """Return the powers 0 to ``order`` of the temperature of the element, shape (means, order + 1)."""
        if lag not in self._powers:
            self._powers[lag] = self._powers_of(self.temperature(lag))
        return self._powers[lag][:, : order + 1]

    def _powers_of(self, element: Array) -> Array:
        """Return the means of all powers of a temperature that changes steadily in a mean."""
        powers, k = np.vander(element, self._highest + 1, increasing=True), np.arange(2, self._highest + 1)
        steps = np.concatenate([np.gradient(element[self.leg == number]) for number in range(len(self.legs))])
        powers[:, 2:] += k * (k - 1) / 24.0 * powers[:, :-2] * steps[:, None] ** 2
        return powers

    def by_lag(self, lag: float, order: int) -> Array:
        """Return the derivative of the powers by the lag, °C^k/s, shape (means, order + 1)."""
        step = 1e-4 * float(np.ptp(self.time))
        return (self.powers(lag + step, order) - self.powers(lag - step, order)) / (2.0 * step)

    def cost(self, x: Array, kept: NDArray[np.bool_] | slice = slice(None)) -> float:
        """Return the sum of squares that some columns leave of the readings, over their scale squared."""
        left = self.readings[kept] - x[kept] @ least_squares(x[kept], self.readings[kept])
        return float(np.sum((left / self.scale) ** 2))

    def lag(self, order: int, kept: NDArray[np.bool_] | slice = slice(None)) -> float:
        """Return the lag of either sign, up to half of the longest leg, that describes some means best, s."""
        longest = max(leg.seconds for leg in self.legs)
        grid = np.geomspace(longest / 1000.0, longest / 2.0, _LAGS)
        lags = np.concatenate([-grid[::-1], [0.0], grid])
        return lowest(lambda lag: self.cost(self.powers(lag, order), kept), lags)[0]

    def played(self, width: float) -> Array:
        """Return the powers of a temperature that follows that of the thermometer with a play of some °C."""
        place, followed = float(self._record.temperature[0]), []
        for temperature in self._record.temperature.tolist():
            place = min(max(place, temperature - width / 2.0), temperature + width / 2.0)
            followed.append(place)
        return self._powers_of(self.averaged(np.array(followed)) - self.reference)

    def noise_covariance(self, design: Array, values: Array) -> Array:
        """Return the covariance of the noise of one channel: white, and a process whose correlation decays with time.

        It is the mean over the sizes and correlation times that the restricted likelihood (Patterson and Thompson,
        1971) allows: an estimate of them alone would make intervals too narrow.
        """
        n, p = design.shape
        x = np.linalg.qr(design)[0]
        off = values - x @ (x.T @ values)
        # A process that took up what lasts a few means, such as steps of the thermometer, would take up the drift too.
        second = [off[2 * k :] - 2.0 * off[k:-k] + off[: -2 * k] for k in _DISTANCES if 2 * k < n]
        least = min(max(float(np.mean(some**2)) / 6.0 for some in second), float(off @ off) / (n - p)) + _TINY
        likelihood, variances = [], []
        for _, eigenvalues, vectors in self._correlations:
            xr, yr = vectors.T @ x, vectors.T @ values
            weight = 1.0 / (1.0 + _RATIOS[:, None] * np.maximum(eigenvalues, 0.0))
            normal = np.einsum("ni,rn,nj->rij", xr, weight, xr, optimize=True)
            solution = np.linalg.solve(normal, ((weight * yr) @ xr)[:, :, None])[:, :, 0]
            square = np.sum(weight * (yr - solution @ xr.T) ** 2, axis=1)
            variance = np.maximum(square / (n - p), least)
            determinant = np.linalg.slogdet(normal)[1] - np.sum(np.log(weight), axis=1)
            likelihood.append(np.log(_PRIOR) - 0.5 * ((n - p) * np.log(variance) + square / variance + determinant))
            variances.append(variance)
        weights = np.exp(np.array(likelihood) - np.max(likelihood))
        parts = weights / weights.sum() * np.array(variances)
        covariance = float(parts.sum()) * np.eye(n)
        for (correlation, _, _), part in zip(self._correlations, parts, strict=True):
            covariance += _WIDER * float(part @ _RATIOS) * correlation
        return covariance

    @cached_property
    def _correlations(self) -> list[tuple[Array, Array, Array]]:
        """Correlations that decay with time, each with its eigenvalues and eigenvectors."""
        distance = np.abs(self.time[:, None] - self.time) / np.ptp(self.time)
        return [(block, *np.linalg.eigh(block)) for block in (np.exp(-distance / lasts) for lasts in _LASTS)]

    @cached_property
    def _slope(self) -> Array:
        """The slope of the thermometer's temperature in the rows, °C/s."""
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(self._record.time, self._record.temperature)(self._record.time, 1))


def lowest(cost: Callable[[float], float], grid: Array) -> tuple[float, float]:
    """Return where a cost is lowest, between the neighbours of the best value of a grid, and how low."""
    from scipy.optimize import minimize_scalar

    costs = [cost(value) for value in grid.tolist()]
    best = int(np.argmin(costs))
    low, high = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, len(grid) - 1)])
    refined = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-5 * (high - low)})
    return (float(refined.x), float(refined.fun)) if refined.fun < costs[best] else (float(grid[best]), costs[best])


def least_squares(x: Array, y: Array) -> Array:
    return np.asarray(np.linalg.lstsq(x, y, rcond=None)[0], dtype=np.float64)
