"""The temperature of the sensing element in a record, for any thermal lag."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.record import RampRecord
from tiltcal.core.thermal_lag import ThermalLag

_STEPS = 4


class ElementTemperature:
    """The temperature of the sensing element in the parts of a record, from the reference, °C, shape (parts,).

    Temperatures are filtered row by row, and then averaged over the rows of a part.

    Parameters
    ----------
    starts : ndarray of int, shape (parts,)
        The first row of each part.
    reference : float
        °C.
    running : bool
        Whether the temperature was changing before the record, at the pace of its start.
    """

    def __init__(self, record: RampRecord, starts: NDArray[np.intp], reference: float, *, running: bool) -> None:
        self._record = record
        self._starts = starts
        self._reference = reference
        self._running = running
        self._by_lag: dict[float, Array] = {}
        self._by_pair: dict[tuple[float, float], tuple[Array, Array]] = {}

    def at(self, lag: float) -> Array:
        """Return the temperature of an element with a lag, s."""
        if lag not in self._by_lag:
            self._by_lag[lag] = self._averaged(self._filtered(lag))
        return self._by_lag[lag]

    def of_pair(self, lags: tuple[float, float]) -> tuple[Array, Array]:
        """Return two temperatures of which that of an element with two lags is a mixture.

        Where the thermometer is later, the first lag is the element's own, or a second one of the thermometer.
        """
        if lags[1] > 0.0:
            return self.at(lags[0]), self.at(lags[1])
        if lags not in self._by_pair:
            own = self._filtered(lags[0])
            both = own - lags[1] * self._slope_of(own)
            self._by_pair[lags] = self._averaged(own), self._averaged(both)
        return self._by_pair[lags]

    def in_log(self, lag: float) -> Array:
        """Return the temperature that the filter of a log gives, from rows before alone."""
        if lag >= 0.0:
            return self.at(lag)
        return self._averaged(ThermalLag(lag)(self._record.time, self._record.temperature))

    def with_play(self, width: float) -> Array:
        """Return a temperature that follows that of the thermometer with a play of some °C."""
        temperature, behind = self._record.temperature, 1
        low, high = temperature - width / 2.0, temperature + width / 2.0
        low[0] = high[0] = temperature[0]
        # A row limits the place of the row before; here it limits those of 1, 2, 4, ... rows before, until all agree.
        while behind < len(temperature):
            low[behind:], high[behind:] = (
                np.clip(limit[:-behind], low[behind:], high[behind:]) for limit in (low, high)
            )
            behind *= 2
        return self._averaged(low)

    def by_lag(self, lag: float) -> Array:
        """Return the derivative of the temperature by the lag, °C/s."""
        low, high = lag - self._step, lag + self._step
        return np.asarray((self.at(high) - self.at(low)) / (high - low))

    def closest_lag(self, element: Array, lag: float) -> float:
        """Return the lag whose temperature is closest to another one, near a first guess, s."""
        for _ in range(_STEPS):
            slope = self.by_lag(lag)
            lag += float(slope @ (element - self.at(lag)) / (slope @ slope))
        return lag

    def _averaged(self, rows: Array) -> Array:
        """Return the means of the temperatures of the rows, °C, from the reference."""
        return means_of(rows, self._starts) - self._reference

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
        return np.asarray(CubicSpline(means_of(time, self._knots), means_of(temperature, self._knots))(time, 1))

    @cached_property
    def _knots(self) -> NDArray[np.intp]:
        """Rows that are about an interval apart: between rows of a burst, noise would make any slope."""
        time, starts = self._record.time.tolist(), [0]
        apart = 0.8 * (time[-1] - time[0]) / len(time)
        for row, seconds in enumerate(time):
            if seconds - time[starts[-1]] >= apart:
                starts.append(row)
        return np.array(starts)

    @cached_property
    def _step(self) -> float:
        return 1e-4 * float(np.ptp(self._record.time))


def means_of(values: Array, starts: NDArray[np.intp]) -> Array:
    """Return the means of rows from each start to the next one."""
    if len(starts) == len(values):
        return values
    sizes = np.diff(starts, append=len(values)).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / sizes)
