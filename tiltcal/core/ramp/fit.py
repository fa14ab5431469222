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
from functools import cached_property
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.record import Leg, RampRecord, legs_of, row_noise
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.errors import EstimateError

LEG_LAGS = 4.0
"""A leg must last so many lags: else the element does not follow."""

LAG_RESOLUTION = 0.1
"""A lag has to be known better than the time in which the temperature crosses this part of its range."""

RESOLVED = 2.0
"""Standard uncertainties that a lag is away from 0 where it is used."""

WORSE = 0.02
"""Part by which the mean square error of a channel may grow on a leg and not count as worse."""

CHANCE, TURNING = 0.01, 1e-4
"""Probability with which noise alone makes a loop, and residuals that turn with the temperature."""

TURNS = 3.0
"""Mean square of the residuals behind the turns, over that of the others, from which on a loop turns there."""

BEHIND_TURN = 0.1
"""Part of a leg's range in which hysteresis gets from one side to the other."""

PLACES = 8
"""Temperatures at which the ways are compared."""

_PARTS = 256  # means of a record that are fitted
_NOISE_SHARE = 0.02  # what noise of a thermometer that is later may add to a mean, in parts of the loop
_FEWEST_MEANS = 12  # of a leg, however noisy the thermometer
_END_WEIGHT = 4.0  # the end of a line through n points has this weight over n (its leverage)
_LAGS = 14  # of either sign that are tried first
_LOOP_TERMS = 3  # of the polynomial of a loop: a play of a cubic, and Rayleigh's loop, have three
_RATIOS = np.concatenate([[0.0], np.geomspace(1e-2, 1e5, 22)])  # variance of noise that lasts over that of white noise
_PRIOR = np.concatenate([[0.5], np.full(22, 0.5 / 22)])  # half of the weight is on white noise alone
_LASTS = np.geomspace(
    1.0 / 64.0, 1.2, 8
)  # how long noise lasts, in times of the record; the longest like a random walk
_WIDER = 1.2  # of the variance of noise that lasts: 1.96 deviations of a mixture of sizes hold less than 95 %
_DISTANCES = (1, 2, 4, 8)  # of second differences, in means: a step of the thermometer may last several
_TINY = np.finfo(float).tiny


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
    places : ndarray, shape (places,)
        Temperatures at which the ways are compared, °C from the reference.
    loops : ndarray, shape (places, channels)
        The way up less the way down that is left there, unit.
    loop_covariance : ndarray, shape (channels (order + 1),) twice
        What that adds to the covariance of the coefficients.
    u_element : float
        Standard uncertainty of the element's temperature in a log because its filter smooths the turns of a thermometer
        that is later, °C.
    polynomial, lagged : ndarray, shape (legs, channels)
        Root mean square error of each leg, predicted from the others by the polynomial alone and with a lag, unit.
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
    places: Array
    loops: Array
    loop_covariance: Array
    u_element: float
    polynomial: Array
    lagged: Array
    error_by_order: Mapping[int, float]
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
        The legs do not separate lag and drift, or one lag does not describe the turns; the message has the pace to
        take.
    """
    means = RampMeans(record, legs_of(record), reference, highest)
    if means.lag(highest) < 0.0:
        means = RampMeans(record, means.legs, reference, highest, late=True)
    orders = range(1, highest + 1)
    plain = {order: _left_out(means, order, lambda *_: 0.0) for order in orders}
    lagged = {order: _left_out(means, order, means.lag) for order in orders}
    order_alone, order = (min(errors, key=lambda one: float(np.mean(errors[one]))) for errors in (plain, lagged))
    found_lag, *by_lag = _with_lag(means, order)
    u_lag = sqrt(by_lag[1][-1, -1])
    _require_lag_resolved(means.legs, found_lag, u_lag)
    gained = np.mean(plain[order_alone] - lagged[order], axis=1) > 0.0
    used = bool(
        gained.all()
        and np.all(lagged[order] <= (1.0 + WORSE) * plain[order_alone])
        and abs(found_lag) > RESOLVED * u_lag
        and means.cost(means.powers(means.lag(order), order)) < _cost_of_hysteresis(means, order)
    )
    places = means.shared_temperatures()
    loops = [_loops(means, places, lag, order) for lag in (0.0, found_lag)]
    explained = 1.0 - np.mean(loops[1] ** 2, axis=0) / np.maximum(np.mean(loops[0] ** 2, axis=0), _TINY)
    u_element, lag = 0.0, found_lag if used else 0.0
    coefficients, covariance, loop_covariance = _beside_loop(means, lag, order if used else order_alone)
    if used:
        coefficients, covariance = by_lag
        _require_one_lag(means, found_lag, order, record.step)
        if found_lag < 0.0:
            in_log = means.in_parts(ThermalLag(found_lag)(record.time, record.temperature)) - reference
            u_element = float(np.sqrt(np.mean((in_log - means.element(found_lag)) ** 2)))
    return RampFit(
        reference=reference,
        coefficients=coefficients,
        lag=lag,
        covariance=covariance + _of_rounded_temperature(means, coefficients),
        found_lag=found_lag,
        u_lag=u_lag,
        explained=explained,
        places=places,
        loops=loops[1] if used else loops[0],
        loop_covariance=loop_covariance,
        u_element=u_element,
        polynomial=np.sqrt(plain[order_alone]) * means.scale,
        lagged=np.sqrt(lagged[order]) * means.scale,
        error_by_order={order: float(np.mean(error)) for order, error in (lagged if used else plain).items()},
        means=means,
    )


class RampMeans:
    """A record in few means, each of some parts of consecutive rows.

    Parameters
    ----------
    late : bool
        Whether the thermometer is later than the element. The noise of a row becomes |lag| (e_end - e_start) / t in a
        mean over a time t: means are so long that it hides no loop, and powers are those of their parts.

    Attributes
    ----------
    time : ndarray, shape (means,)
        s.
    readings : ndarray, shape (means, channels)
        Unit.
    leg : ndarray of int, shape (means,)
        The number of the leg that each mean belongs to.
    rising : ndarray, shape (means,)
        1 on the way up, -1 on the way down.
    scale : ndarray, shape (channels,)
        Scatter about a polynomial: what errors of several channels are compared by, unit.
    shift : float
        By how much the curve is shifted because rounding does not average out at the turns, °C.
    """

    def __init__(
        self, record: RampRecord, legs: Sequence[Leg], reference: float, highest: int, *, late: bool = False
    ) -> None:
        self._record, self._reference, self._highest = record, reference, highest
        n, degrees = len(record.time), sum(leg.high - leg.low for leg in legs)
        # Over a whole step of the thermometer its rounding averages out; parts of one would look like noise that lasts.
        steps = degrees / record.step if record.step else np.inf
        self._parts = np.unique(np.linspace(0, n, int(min(_PARTS, n, steps)) + 1).astype(int)[:-1])
        parts = len(self._parts)
        group = 1.0
        if late:
            noise = max(row_noise(record.temperature), record.step / sqrt(12.0))
            group = min(sqrt(2.0) * noise / _NOISE_SHARE * parts / degrees, parts / (_FEWEST_MEANS * len(legs)))
        of_legs = np.searchsorted([leg.start for leg in legs], self._parts, side="right") - 1
        bounds = np.searchsorted(of_legs, np.arange(len(legs) + 1)).tolist()
        self._groups = np.concatenate([np.arange(start, end, max(int(group), 1)) for start, end in pairwise(bounds)])
        self._powers: dict[float, Array] = {}
        self.legs = legs
        self.leg: NDArray[np.intp] = of_legs[self._groups]
        if len(np.unique(self.leg)) < len(legs):
            raise EstimateError("a leg of the record has hardly any rows: let the temperature go all the way each time")
        self.rising = np.where(np.array([leg.rising for leg in legs])[self.leg], 1.0, -1.0)
        self.time = self.averaged(self.in_parts(record.time))
        self.readings = self.averaged(self.in_parts(record.readings))
        self.shift = min(_END_WEIGHT * len(legs) / steps, 1.0) * record.step / sqrt(12.0)
        x = self.powers(0.0, highest)
        smallest = 1e-12 * np.max(np.abs(self.readings), axis=0) + _TINY
        self.scale = np.maximum(np.std(self.readings - x @ _least_squares(x, self.readings), axis=0), smallest)

    def in_parts(self, rows: Array) -> Array:
        """Return the means of rows in the parts."""
        return _means(rows, self._parts)

    def averaged(self, parts: Array) -> Array:
        """Return the means of parts."""
        return _means(parts, self._groups)

    def temperature(self, lag: float) -> Array:
        """Return the temperature of the element from the reference, °C, shape (means,)."""
        return self.averaged(self.element(lag))

    def element(self, lag: float) -> Array:
        """Return the temperature of the element from the reference, °C, shape (parts,).

        The inverse filter takes the slope from the rows before and behind.
        """
        time, temperature = self._record.time, self._record.temperature
        rows = ThermalLag(lag)(time, temperature) if lag >= 0.0 else temperature - lag * self._slope
        return self.in_parts(rows) - self._reference

    def powers(self, lag: float, order: int) -> Array:
        """Return the powers 0 to ``order`` of the temperature of the element, shape (means, order + 1)."""
        if lag not in self._powers:
            self._powers[lag] = self.powers_of(self.element(lag))
        return self._powers[lag][:, : order + 1]

    def powers_of(self, element: Array) -> Array:
        """Return the means of all powers of a temperature that changes steadily in a part."""
        powers = np.vander(element, self._highest + 1, increasing=True)
        within, k = np.gradient(element) ** 2 / 12.0, np.arange(2, self._highest + 1)
        powers[:, 2:] += 0.5 * k * (k - 1) * powers[:, :-2] * within[:, None]
        return self.averaged(powers)

    def by_lag(self, lag: float, order: int) -> Array:
        """Return the derivative of the powers by the lag, °C^k/s, shape (means, order + 1)."""
        step = 1e-4 * float(np.ptp(self.time))
        return (self.powers(lag + step, order) - self.powers(lag - step, order)) / (2.0 * step)

    def cost(self, x: Array, kept: NDArray[np.bool_] | slice = slice(None)) -> float:
        """Return the sum of squares that some columns leave of the readings, over their scale squared."""
        left = self.readings[kept] - x[kept] @ _least_squares(x[kept], self.readings[kept])
        return float(np.sum((left / self.scale) ** 2))

    def lag(self, order: int, kept: NDArray[np.bool_] | slice = slice(None)) -> float:
        """Return the lag of either sign, up to half of the longest leg, that describes some means best, s."""
        longest = max(leg.seconds for leg in self.legs)
        grid = np.geomspace(longest / 1000.0, longest / 2.0, _LAGS)
        lags = np.concatenate([-grid[::-1], [0.0], grid])
        return _lowest(lambda lag: self.cost(self.powers(lag, order), kept), lags)[0]

    def played(self, width: float) -> Array:
        """Return the powers of a temperature that follows that of the thermometer with a play of some °C."""
        temperature, behind = self._record.temperature, 1
        low, high = temperature - width / 2.0, temperature + width / 2.0
        low[0] = high[0] = temperature[0]
        # A row limits the place of the row before; here it limits those of 1, 2, 4, ... rows before, until all agree.
        while behind < len(temperature):
            low[behind:], high[behind:] = (
                np.clip(limit[:-behind], low[behind:], high[behind:]) for limit in (low, high)
            )
            behind *= 2
        return self.powers_of(self.in_parts(low) - self._reference)

    def shared_temperatures(self) -> Array:
        """Return temperatures that the ways up and down have in common, °C from the reference, shape (places,)."""
        element, up = self.temperature(0.0), self.rising > 0.0
        low, high = max(element[up].min(), element[~up].min()), min(element[up].max(), element[~up].max())
        return np.asarray(low + (high - low) * (np.arange(PLACES) + 0.5) / PLACES)

    @cached_property
    def correlations(self) -> list[tuple[Array, Array, Array]]:
        """Correlations that decay with time, each with its eigenvalues and eigenvectors."""
        distance = np.abs(self.time[:, None] - self.time) / np.ptp(self.time)
        return [(block, *np.linalg.eigh(block)) for block in (np.exp(-distance / lasts) for lasts in _LASTS)]

    @cached_property
    def _slope(self) -> Array:
        """The slope of the thermometer's temperature in the rows, °C/s; rows of a burst count as one."""
        from scipy.interpolate import CubicSpline

        time, temperature = self._record.time, self._record.temperature
        apart = 0.8 * np.ptp(time) / len(time)
        knots = np.flatnonzero(np.diff(time, prepend=-np.inf) >= apart)
        return np.asarray(CubicSpline(_means(time, knots), _means(temperature, knots))(time, 1))


def _with_lag(means: RampMeans, order: int) -> tuple[float, Array, Array]:
    """Return the lag that all channels share, polynomials of shape (channels, order + 1), and their covariance."""
    lag, noises = means.lag(order), list[Array]()
    for _ in range(2):
        designs = _lag_designs(means, lag, order)
        noises = noises or [noise_covariance(means, *one) for one in zip(designs, means.readings.T, strict=True)]
        solution, covariance = _joint_least_squares(designs, 1, means.readings, noises)
        lag += float(solution[-1])
    return lag, solution[:-1].reshape(-1, order + 1), covariance


def _lag_designs(means: RampMeans, lag: float, order: int) -> list[Array]:
    """Return the powers of the temperature and the derivative by the lag, for each channel."""
    x = means.powers(lag, order)
    slopes = means.by_lag(lag, order) @ _least_squares(x, means.readings)
    return [np.column_stack([x, slope]) for slope in slopes.T]


def _beside_loop(means: RampMeans, lag: float, order: int) -> tuple[Array, Array, Array]:
    """Return polynomials for a given lag that lie between the ways, their covariance, and what the loop adds to it.

    A reading is on one way or the other: half of their difference is that of a rectangular distribution.
    """
    from scipy.special import chdtri

    x, p, channels = means.powers(lag, order), order + 1, means.readings.shape[1]
    ways = x[:, :_LOOP_TERMS] * means.rising[:, None]
    half_places = slice(p, p + ways.shape[1])
    coefficients, covariance = np.zeros((channels, p)), np.zeros((channels * p + 1, channels * p + 1))
    added = np.zeros((channels * p, channels * p))
    for c, values in enumerate(means.readings.T):
        design = np.column_stack([x, ways])
        if lag == 0.0:
            design = _with_turns(means, design, values)
        noise = noise_covariance(means, design, values)
        solution, of_solution = _joint_least_squares([design], 0, values[:, None], [noise], by_noise=False)
        half = solution[half_places]
        start = c * p
        if half @ np.linalg.solve(of_solution[half_places, half_places], half) > chdtri(len(half), CHANCE):
            loop = slice(start, start + len(half))
            added[loop, loop] = np.outer(half, half) / 3.0
        else:
            solution, of_solution = _joint_least_squares([x], 0, values[:, None], [noise_covariance(means, x, values)])
        coefficients[c] = solution[:p]
        covariance[start : start + p, start : start + p] = of_solution[:p, :p]
    return coefficients, covariance, added


def _with_turns(means: RampMeans, design: Array, values: Array) -> Array:
    """Return a design with unknowns for the means behind the turns, where they are no part of its ways.

    There hysteresis such as a play is on its way from one side to the other.
    """
    temperature = means.temperature(0.0)
    turns = temperature[np.searchsorted(means.leg, means.leg)]
    near = np.array([BEHIND_TURN * (leg.high - leg.low) for leg in means.legs])
    behind = np.abs(temperature - turns) < near[means.leg]
    square = (values - design @ _least_squares(design, values)) ** 2
    if not behind.any() or np.mean(square[behind]) < TURNS * np.mean(square[~behind]):
        return design
    return np.column_stack([design, np.eye(len(design))[:, behind]])


def _loops(means: RampMeans, places: Array, lag: float, order: int) -> Array:
    """Return the way up less the way down at some temperatures from the reference, unit, shape (places, channels)."""
    x = means.powers(lag, order)
    ways = x[:, :_LOOP_TERMS] * means.rising[:, None]
    half = _least_squares(np.column_stack([x, ways]), means.readings)[order + 1 :]
    return np.asarray(2.0 * np.vander(places, len(half), increasing=True) @ half)


def _cost_of_hysteresis(means: RampMeans, order: int) -> float:
    """Return the sum of squares that the best hysteresis without time leaves, over the scale squared.

    Two forms are tried. A play of the temperature makes, at one pace, the loop that a lag makes; only the turns differ.
    Rayleigh's loop (1887) grows from both turns: its two ways are parabolas between them.
    """
    element = means.temperature(0.0)
    low, high = (
        np.array([bound(element[means.leg == k]) for k in range(len(means.legs))]) for bound in (np.min, np.max)
    )
    grown = means.rising * (element - low[means.leg]) * (high[means.leg] - element)
    widest = max(leg.high - leg.low for leg in means.legs) / 2.0
    widths = np.geomspace(widest / 1000.0, widest, _LAGS)
    return min(
        means.cost(np.column_stack([means.powers(0.0, order), grown])),
        _lowest(lambda width: means.cost(means.played(width)[:, : order + 1]), widths)[1],
    )


def _left_out(means: RampMeans, order: int, lag_of: Callable[[int, NDArray[np.bool_]], float]) -> Array:
    """Return the mean square errors, over the scale squared, of each leg from the others, shape (legs, channels)."""
    errors = []
    for number in range(len(means.legs)):
        kept = means.leg != number
        x = means.powers(lag_of(order, kept), order)
        left = means.readings[~kept] - x[~kept] @ _least_squares(x[kept], means.readings[kept])
        errors.append(np.mean((left / means.scale) ** 2, axis=0))
    return np.array(errors)


def _require_lag_resolved(legs: Sequence[Leg], lag: float, u: float) -> None:
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
    x, y = means.powers(lag, order), means.readings
    slopes = x[:, :-1] @ (np.arange(1, order + 1)[:, None] * _least_squares(x, y)[1:])
    shared = np.stack(turns, axis=1)
    designs = [
        np.column_stack([design, slope[:, None] * shared])
        for design, slope in zip(_lag_designs(means, lag, order), slopes.T, strict=True)
    ]
    noises = [noise_covariance(means, *one) for one in zip(designs, y.T, strict=True)]
    solution, covariance = _joint_least_squares(designs, 1 + len(turns), y, noises)
    sizes, of_sizes = solution[-len(turns) :], covariance[-len(turns) :, -len(turns) :]
    times = sqrt(float(sizes @ np.linalg.solve(of_sizes, sizes)) / chdtri(len(sizes), TURNING))
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


def noise_covariance(means: RampMeans, design: Array, values: Array) -> Array:
    """Return the covariance of the noise of one channel: white, and a process whose correlation decays with time.

    Their sizes and the correlation time are not known. The restricted likelihood (Patterson and Thompson, 1971) weighs
    them, and the covariance is the mean over what it allows: an estimate of them alone would make intervals too narrow.

    Parameters
    ----------
    design : ndarray, shape (means, p)
        Columns that the noise is left by; the first is constant.
    values : ndarray, shape (means,)
    """
    n, p = design.shape
    x = np.linalg.qr(design)[0]
    off = values - x @ (x.T @ values)
    # A process that took up what lasts a few means, such as steps of the thermometer, would take up the drift with it.
    second = [off[2 * k :] - 2.0 * off[k:-k] + off[: -2 * k] for k in _DISTANCES if 2 * k < n]
    least = min(max(float(np.mean(some**2)) / 6.0 for some in second), float(off @ off) / (n - p)) + _TINY
    likelihood, variances = [], []
    for _, eigenvalues, vectors in means.correlations:
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
    for (correlation, _, _), part in zip(means.correlations, parts, strict=True):
        covariance += _WIDER * float(part @ _RATIOS) * correlation
    return covariance


def _of_rounded_temperature(means: RampMeans, coefficients: Array) -> Array:
    """Return what rounding of the thermometer, which does not average out at the turns, adds to the covariance."""
    from scipy.linalg import block_diag

    slopes = np.pad(coefficients[:, 1:] * np.arange(1, coefficients.shape[1]), ((0, 0), (0, 1)))
    return np.asarray(block_diag(*[np.outer(slope, slope) * means.shift**2 for slope in slopes], 0.0))


def _joint_least_squares(
    designs: Sequence[Array], shared: int, values: Array, noises: Sequence[Array], *, by_noise: bool = True
) -> tuple[Array, Array]:
    """Solve for the unknowns of each channel and some that all share, the last columns; return them and the covariance.

    Parameters
    ----------
    designs : sequence of ndarray, shape (means, p + shared)
    values : ndarray, shape (means, channels)
    noises : sequence of ndarray, shape (means, means)
        Covariance of each channel.
    by_noise : bool
        Weight means by the noise that lasts, too. It would follow one way of a loop here and the other there.
    """
    n, channels, p = len(values), len(designs), designs[0].shape[1] - shared
    table = np.zeros((channels, n, channels * p + shared))
    whiteners = [np.linalg.inv(np.linalg.cholesky(noise)) if by_noise else np.eye(n) for noise in noises]
    for c, (design, whitener) in enumerate(zip(designs, whiteners, strict=True)):
        table[c][:, c * p : (c + 1) * p] = whitener @ design[:, :p]
        table[c][:, channels * p :] = whitener @ design[:, p:]
    sizes = np.sqrt(np.sum(table**2, axis=(0, 1)))
    solve = np.linalg.pinv((table / sizes).reshape(channels * n, -1)) / sizes[:, None]
    each = [part @ whitener for part, whitener in zip(np.hsplit(solve, channels), whiteners, strict=True)]
    covariance = sum(part @ noise @ part.T for part, noise in zip(each, noises, strict=True))
    return sum(part @ column for part, column in zip(each, values.T, strict=True)), np.asarray(covariance)


def _lowest(cost: Callable[[float], float], grid: Array) -> tuple[float, float]:
    """Return where a cost is lowest, between the neighbours of the best value of a grid, and how low."""
    from scipy.optimize import minimize_scalar

    costs = [cost(value) for value in grid.tolist()]
    best = int(np.argmin(costs))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    options = {"xatol": 1e-5 * float(high - low)}
    found = minimize_scalar(cost, bounds=(float(low), float(high)), method="bounded", options=options)
    return (float(found.x), float(found.fun)) if found.fun < costs[best] else (float(grid[best]), costs[best])


def _least_squares(x: Array, y: Array) -> Array:
    return np.asarray(np.linalg.lstsq(x, y, rcond=None)[0], dtype=np.float64)


def _means(values: Array, starts: NDArray[np.intp]) -> Array:
    """Return the means of rows from each start to the next one."""
    sizes = np.diff(starts, append=len(values)).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / sizes)
