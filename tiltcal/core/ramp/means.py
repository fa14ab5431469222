"""The means that are fitted, and the temperature of the element at them for any lag."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.record import Leg, RampRecord
from tiltcal.core.thermal_lag import ThermalLag

BLOCKS = 256
"""Means of a record that are fitted."""

END_WEIGHT = 4.0
"""The end of a line through n points has this weight over n (its leverage)."""

LONGEST = 1.2
"""The longest correlation of the noise, in times of the record."""

BEHIND_TURN = 0.1
"""Part of a leg's range in which hysteresis gets from one side to the other."""

THERMOMETER_SHARE = 0.1
"""Part of the variance of readings that the noise of a thermometer that is later should not exceed."""

FEWEST_MEANS = 12
"""Of a leg, however noisy the thermometer."""

SQUARE_OF_90_PERCENT = 2.706
"""What the square of a normal variable of variance 1 is below in 90 % of cases."""

_STEPS = 4


class FittedMeans:
    """A record in few means; temperatures are filtered before they are averaged.

    Parameters
    ----------
    reference : float
        °C.
    group : int
        Consecutive parts that make one mean; the powers of a temperature are those of its parts.
    noisy : bool
        Whether the thermometer's noise hides what a second lag makes at the turns.
    running : bool
        Whether the temperature was changing before the record, at the pace of its start.
    """

    def __init__(
        self,
        record: RampRecord,
        legs: list[Leg],
        reference: float,
        group: int = 1,
        noisy: bool = False,
        running: bool = False,
    ) -> None:
        self._record = record
        self._running = running
        self._reference = reference
        n = len(record.time)
        # Over a whole step of the thermometer its rounding averages out; parts of one would look like noise that lasts.
        steps = sum(leg.high - leg.low for leg in legs) / record.step if record.step else np.inf
        self._starts = np.unique(np.linspace(0, n, int(min(BLOCKS, n, steps)) + 1).astype(int)[:-1])
        of_legs = np.searchsorted([leg.start for leg in legs], self._starts, side="right") - 1
        bounds = np.searchsorted(of_legs, np.arange(len(legs) + 1))
        self._groups = np.concatenate([np.arange(start, end, group) for start, end in pairwise(bounds.tolist())])
        self._elements: dict[float, Array] = {}
        self._pairs: dict[tuple[float, float], tuple[Array, Array]] = {}
        self._powers: dict[float, Array] = {}
        self.group = group
        self.noisy = noisy
        self.legs = legs
        self.shift = min(END_WEIGHT * len(legs) / steps, 1.0) * record.step / sqrt(12.0)
        """By how much the curve is shifted because rounding does not average out at the turns, °C."""
        self.time = self.averaged(self._parts(record.time))
        self.readings = np.stack([self.averaged(self._parts(column)) for column in record.readings.T], axis=1)
        self.leg: NDArray[np.intp] = of_legs[self._groups]
        """Which leg each mean belongs to."""

    def __len__(self) -> int:
        """Return the number of means."""
        return len(self.time)

    def _parts(self, rows: Array) -> Array:
        return _means(rows, self._starts)

    def averaged(self, parts: Array) -> Array:
        """Return the means of an array that has a row for each part."""
        return _means(parts, self._groups)

    def element(self, lag: float) -> Array:
        """Return the temperature of the element from the reference, °C, shape (parts,)."""
        if lag not in self._elements:
            self._elements[lag] = self._parts(self._filtered(lag)) - self._reference
        return self._elements[lag]

    def elements_of(self, lags: tuple[float, float]) -> tuple[Array, Array]:
        """Return two temperatures from the reference, of which that of an element with two lags is a mixture, °C.

        Where the thermometer is later, the first lag is the element's own, or a second one of the thermometer.
        """
        if lags[1] > 0.0:
            return self.element(lags[0]), self.element(lags[1])
        if lags not in self._pairs:
            own = self._filtered(lags[0])
            both = own - lags[1] * self._slope_of(own)
            self._pairs[lags] = self._parts(own) - self._reference, self._parts(both) - self._reference
        return self._pairs[lags]

    def _filtered(self, lag: float) -> Array:
        """Return the temperature of the element in the rows, °C; the inverse filter takes the slope from both sides."""
        time, temperature = self._record.time, self._record.temperature
        if lag < 0.0:
            return np.asarray(temperature - lag * self._slope)
        filtered = ThermalLag(lag)(time, temperature)
        if self._running and lag > 0.0:
            start = slice(max(int(np.searchsorted(time, time[0] + 0.5 * lag)), 2))
            pace = float(np.polyfit(time[start] - time[0], temperature[start], 1)[0])
            filtered -= lag * pace * np.exp((time[0] - time) / lag)
        return filtered

    @cached_property
    def _slope(self) -> Array:
        return self._slope_of(self._record.temperature)

    def _slope_of(self, temperature: Array) -> Array:
        """Return the slope of temperatures of the rows, from rows before and behind, °C/s."""
        from scipy.interpolate import CubicSpline

        time = self._record.time
        return np.asarray(CubicSpline(_means(time, self._knots), _means(temperature, self._knots))(time, 1))

    @cached_property
    def _knots(self) -> NDArray[np.intp]:
        """Rows that are about an interval apart: between rows of a burst, noise would make any slope."""
        time, starts = self._record.time.tolist(), [0]
        apart = 0.8 * (time[-1] - time[0]) / len(time)
        for row, seconds in enumerate(time):
            if seconds - time[starts[-1]] >= apart:
                starts.append(row)
        return np.array(starts)

    def in_log(self, lag: float) -> Array:
        """Return the temperature that the filter of a log gives, from rows before alone, °C, shape (parts,)."""
        if lag >= 0.0:
            return self.element(lag)
        return self._parts(ThermalLag(lag)(self._record.time, self._record.temperature)) - self._reference

    def grouped(self, lag: float, coefficients: Array) -> FittedMeans:
        """Return means so long that a thermometer that is later adds little noise to that of the readings.

        The inverse filter makes of noise e of its rows |lag| (e_end - e_start) / t, in a mean over a time t.

        The coefficients have the shape (order + 1, channels).
        """
        if lag >= 0.0:
            return self
        record, squares = self._record, np.mean(slopes_of(self.element(lag), coefficients.T) ** 2, axis=0)
        of_rows = 2.0 * lag**2 * max(_row_variance(record.temperature), record.step**2 / 12.0)
        of_readings = np.array([_row_variance(column) for column in record.readings.T])
        ratio = float(np.max(squares * of_rows / np.maximum(of_readings, np.finfo(float).tiny)))
        seconds = float(np.ptp(record.time)) / len(self)
        group = ratio * len(record.time) / len(self) / (THERMOMETER_SHARE * seconds**2)
        most = max(len(self) // (FEWEST_MEANS * len(self.legs)), 1)
        return FittedMeans(
            record, self.legs, self._reference, int(min(max(group, 1), most)), group > most, self._running
        )

    def powers(self, lag: float, order: int) -> Array:
        """Return the powers 0 to ``order`` of that temperature, shape (means, order + 1)."""
        known = self._powers.get(lag)
        if known is None or known.shape[1] <= order:
            known = self._powers[lag] = self.powers_of(self.element(lag), order)
        return known[:, : order + 1]

    def powers_of(self, element: Array, order: int) -> Array:
        """Return the means of the powers of a temperature that changes steadily in a part, shape (means, order + 1)."""
        powers = np.vander(element, order + 1, increasing=True)
        within, k = np.gradient(element) ** 2 / 12.0, np.arange(2, order + 1)
        powers[:, 2:] += 0.5 * k * (k - 1) * powers[:, :-2] * within[:, None]
        return self.averaged(powers)

    def ways(self, powers: Array, terms: int) -> Array:
        """Return the first of some powers, as they are on the way up, and less than nothing on the way down."""
        return np.asarray(powers[:, :terms] * self._rising[:, None])

    @property
    def behind_turns(self) -> NDArray[np.bool_]:
        """Whether a mean is so close behind a turn that hysteresis has not got to the other side."""
        element = self.averaged(self.element(0.0))
        first = np.searchsorted(self.leg, np.arange(len(self.legs)))
        near = np.array([BEHIND_TURN * (leg.high - leg.low) for leg in self.legs])
        return np.asarray(np.abs(element - element[first][self.leg]) < near[self.leg])

    @cached_property
    def _rising(self) -> Array:
        return np.where(np.array([leg.rising for leg in self.legs])[self.leg], 1.0, -1.0)

    def played(self, width: float, order: int) -> Array:
        """Return the powers of a temperature with a play of some °C: hysteresis that takes no time."""
        temperature, behind = self._record.temperature, 1
        low, high = temperature - width / 2.0, temperature + width / 2.0
        low[0] = high[0] = temperature[0]
        # A row limits the place of the row before; here it limits those of 1, 2, 4, ... rows before, until all agree.
        while behind < len(temperature):
            low[behind:], high[behind:] = (
                np.clip(limit[:-behind], low[behind:], high[behind:]) for limit in (low, high)
            )
            behind *= 2
        return self.powers_of(self._parts(low) - self._reference, order)

    @property
    def between_turns(self) -> Array:
        """Return the distance from both turns, °C², above zero on the way up and below it on the way down."""
        element = self.averaged(self.element(0.0)) + self._reference
        low, high = (np.array([getattr(leg, end) for leg in self.legs])[self.leg] for end in ("low", "high"))
        return np.asarray(self._rising * (element - low) * (high - element))

    def by_lag(self, lag: float, coefficients: Array) -> Array:
        """Return the derivative of the readings by the lag, unit/s, shape (means, channels).

        The coefficients have the shape (order + 1, channels).
        """
        slopes = slopes_of(self.element(lag), coefficients.T)
        return self.averaged(slopes * self._element_by_lag(lag)[:, None])

    def closest_lag(self, element: Array, lag: float) -> float:
        """Return the lag whose element is closest to another temperature from the reference, near a first guess, s."""
        for _ in range(_STEPS):
            slope = self._element_by_lag(lag)
            lag += float(slope @ (element - self.element(lag)) / (slope @ slope))
        return lag

    def _element_by_lag(self, lag: float) -> Array:
        low, high = lag - self._step, lag + self._step
        return np.asarray((self.element(high) - self.element(low)) / (high - low))

    @cached_property
    def _step(self) -> float:
        return 1e-4 * float(np.ptp(self._record.time))

    @cached_property
    def correlations(self) -> list[tuple[Array, Array, Array]]:
        """Return correlations that decay with time, each with its eigenvalues and eigenvectors.

        The longest is as long as the record or a little more: the uncertainty of its mean is then the distance that a
        random walk has between its start and its mean.
        """
        span = float(np.ptp(self.time))
        distance = np.abs(self.time[:, None] - self.time[None, :])
        found = [np.exp(-distance / decay) for decay in np.geomspace(span / 64.0, LONGEST * span, 8)]
        return [(block, *np.linalg.eigh(block)) for block in found]


def slopes_of(element: Array, coefficients: Array) -> Array:
    """Return the slopes of polynomials with coefficients of shape (channels, p), unit/°C, shape (n, channels)."""
    terms = coefficients.shape[1] - 1
    return np.asarray(np.vander(element, terms, increasing=True) @ (coefficients[:, 1:] * np.arange(1, terms + 1)).T)


def _means(values: Array, starts: NDArray[np.intp]) -> Array:
    """Return the means of rows from each start to the next one."""
    if len(starts) == len(values):
        return values
    sizes = np.diff(starts, append=len(values)).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / sizes)


def _row_variance(values: Array) -> float:
    """Return the variance of white noise in rows, by fourth differences, in which a ramp shows at its turns alone."""
    return float(np.quantile(np.diff(values, 4) ** 2, 0.9)) / (70.0 * SQUARE_OF_90_PERCENT)
