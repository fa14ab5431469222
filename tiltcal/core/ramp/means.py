"""The means that are fitted, and the temperature of the element at them for any lag."""

from __future__ import annotations

from functools import cached_property
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

_STEPS = 4

FIT_SMOOTHING = 0.02
"""Of the derivative of the thermometer, where it is later, as a part of its lag: the means average its noise."""


class FittedMeans:
    """A record in few means; temperatures are filtered before they are averaged.

    Parameters
    ----------
    reference : float
        °C.
    """

    def __init__(self, record: RampRecord, legs: list[Leg], reference: float) -> None:
        self._record = record
        self._reference = reference
        n = len(record.time)
        # Over a whole step of the thermometer its rounding averages out; parts of one would look like noise that lasts.
        steps = sum(leg.high - leg.low for leg in legs) / record.step if record.step else np.inf
        self._starts = np.unique(np.linspace(0, n, int(min(BLOCKS, n, steps)) + 1).astype(int)[:-1])
        self._sizes = np.diff([*self._starts, n])
        self._elements: dict[float, Array] = {}
        self.legs = legs
        self.shift = min(END_WEIGHT * len(legs) / steps, 1.0) * record.step / sqrt(12.0)
        """By how much the curve is shifted because rounding does not average out at the turns, °C."""
        self.time = self._mean(record.time)
        self.readings = np.stack([self._mean(column) for column in record.readings.T], axis=1)
        self.leg: NDArray[np.intp] = np.searchsorted([leg.start for leg in legs], self._starts, side="right") - 1
        """Which leg each mean belongs to."""

    def __len__(self) -> int:
        """Return the number of means."""
        return len(self.time)

    def _mean(self, values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, self._starts) / self._sizes)

    def element(self, lag: float) -> Array:
        """Return the temperature of the element from the reference, °C, shape (means,)."""
        if lag not in self._elements:
            filtered = ThermalLag(lag, FIT_SMOOTHING)(self._record.time, self._record.temperature)
            self._elements[lag] = self._mean(filtered) - self._reference
        return self._elements[lag]

    def powers(self, lag: float, order: int) -> Array:
        """Return the powers 0 to ``order`` of that temperature, shape (means, order + 1)."""
        return np.vander(self.element(lag), order + 1, increasing=True)

    def ways(self, powers: Array, terms: int) -> Array:
        """Return the first of some powers, as they are on the way up, and less than nothing on the way down."""
        return np.asarray(powers[:, :terms] * self._rising[:, None])

    @property
    def behind_turns(self) -> NDArray[np.bool_]:
        """Whether a mean is so close behind a turn that hysteresis has not got to the other side."""
        element = self.element(0.0)
        first = np.searchsorted(self.leg, np.arange(len(self.legs)))
        near = np.array([BEHIND_TURN * (leg.high - leg.low) for leg in self.legs])
        return np.asarray(np.abs(element - element[first][self.leg]) < near[self.leg])

    @cached_property
    def _rising(self) -> Array:
        return np.where(np.array([leg.rising for leg in self.legs])[self.leg], 1.0, -1.0)

    def played(self, width: float, order: int) -> Array:
        """Return the powers of a temperature with a play of some °C: hysteresis that takes no time."""
        place, half = float(self._record.temperature[0]), width / 2.0
        follows = np.empty(len(self._record.time))
        for k, value in enumerate(self._record.temperature.tolist()):
            place = min(max(place, value - half), value + half)
            follows[k] = place
        return np.vander(self._mean(follows) - self._reference, order + 1, increasing=True)

    @property
    def between_turns(self) -> Array:
        """Return the distance from both turns, °C², above zero on the way up and below it on the way down."""
        element = self.element(0.0) + self._reference
        low, high = (np.array([getattr(leg, end) for leg in self.legs])[self.leg] for end in ("low", "high"))
        return np.asarray(self._rising * (element - low) * (high - element))

    def by_lag(self, lag: float, coefficients: Array) -> Array:
        """Return the derivative of the readings by the lag, unit/s, shape (means, channels).

        Parameters
        ----------
        lag : float
            s.
        coefficients : ndarray, shape (order + 1, channels)
        """
        order = len(coefficients) - 1
        slope = self.powers(lag, order - 1) @ (coefficients[1:] * np.arange(1, order + 1)[:, None])
        return np.asarray(slope * self._element_by_lag(lag)[:, None])

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
