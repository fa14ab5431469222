"""The means of a record that are fitted, and the columns of the equations that are solved for them."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.element import ElementTemperature, means_of
from tiltcal.core.ramp.record import Leg, RampRecord

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


class FittedMeans:
    """A record in few means, each of several parts of consecutive rows.

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

    Attributes
    ----------
    element : ElementTemperature
        In the parts.
    time : ndarray, shape (means,)
        s.
    readings : ndarray, shape (means, channels)
        Unit.
    leg : ndarray of int, shape (means,)
        The number of the leg that each mean belongs to.
    shift : float
        By how much the curve is shifted because rounding does not average out at the turns, °C.
    """

    def __init__(
        self,
        record: RampRecord,
        legs: list[Leg],
        reference: float,
        *,
        running: bool,
        group: int = 1,
        noisy: bool = False,
    ) -> None:
        self._record = record
        self._running = running
        self._reference = reference
        n = len(record.time)
        # Over a whole step of the thermometer its rounding averages out; parts of one would look like noise that lasts.
        steps = sum(leg.high - leg.low for leg in legs) / record.step if record.step else np.inf
        parts = np.unique(np.linspace(0, n, int(min(BLOCKS, n, steps)) + 1).astype(int)[:-1])
        of_legs = np.searchsorted([leg.start for leg in legs], parts, side="right") - 1
        bounds = np.searchsorted(of_legs, np.arange(len(legs) + 1))
        self._groups = np.concatenate([np.arange(start, end, group) for start, end in pairwise(bounds.tolist())])
        self._powers: dict[float, Array] = {}
        self.element = ElementTemperature(record, parts, reference, running=running)
        self.group = group
        self.noisy = noisy
        self.legs = legs
        self.shift = min(END_WEIGHT * len(legs) / steps, 1.0) * record.step / sqrt(12.0)
        self.time = self.averaged(means_of(record.time, parts))
        self.readings = np.stack([self.averaged(means_of(column, parts)) for column in record.readings.T], axis=1)
        self.leg: NDArray[np.intp] = of_legs[self._groups]

    def __len__(self) -> int:
        """Return the number of means."""
        return len(self.time)

    def temperature(self, lag: float) -> Array:
        """Return the temperature of the element from the reference, °C, shape (means,)."""
        return self.averaged(self.element.at(lag))

    def averaged(self, parts: Array) -> Array:
        """Return the means of an array that has a row for each part."""
        return means_of(parts, self._groups)

    def grouped(self, lag: float, coefficients: Array) -> FittedMeans:
        """Return means so long that a thermometer that is later adds little noise to that of the readings.

        The inverse filter makes of noise e of its rows |lag| (e_end - e_start) / t, in a mean over a time t.

        The coefficients have the shape (order + 1, channels).
        """
        if lag >= 0.0:
            return self
        record, squares = self._record, np.mean(slopes_of(self.element.at(lag), coefficients.T) ** 2, axis=0)
        of_rows = 2.0 * lag**2 * max(_row_variance(record.temperature), record.step**2 / 12.0)
        of_readings = np.array([_row_variance(column) for column in record.readings.T])
        ratio = float(np.max(squares * of_rows / np.maximum(of_readings, np.finfo(float).tiny)))
        seconds = float(np.ptp(record.time)) / len(self)
        group = ratio * len(record.time) / len(self) / (THERMOMETER_SHARE * seconds**2)
        most = max(len(self) // (FEWEST_MEANS * len(self.legs)), 1)
        return FittedMeans(
            record,
            self.legs,
            self._reference,
            group=int(min(max(group, 1), most)),
            noisy=group > most,
            running=self._running,
        )

    def powers(self, lag: float, order: int) -> Array:
        """Return the powers 0 to ``order`` of the temperature of the element, shape (means, order + 1)."""
        known = self._powers.get(lag)
        if known is None or known.shape[1] <= order:
            known = self._powers[lag] = self.powers_of(self.element.at(lag), order)
        return known[:, : order + 1]

    def powers_of(self, element: Array, order: int) -> Array:
        """Return the means of the powers of a temperature that changes steadily in a part, shape (means, order + 1)."""
        powers = np.vander(element, order + 1, increasing=True)
        within, k = np.gradient(element) ** 2 / 12.0, np.arange(2, order + 1)
        powers[:, 2:] += 0.5 * k * (k - 1) * powers[:, :-2] * within[:, None]
        return self.averaged(powers)

    def ways(self, powers: Array, terms: int) -> Array:
        """Return the first of some powers, as they are on the way up, and with the other sign on the way down."""
        return np.asarray(powers[:, :terms] * self._rising[:, None])

    @property
    def behind_turns(self) -> NDArray[np.bool_]:
        """Whether a mean is so close behind a turn that hysteresis has not got to the other side."""
        element = self.temperature(0.0)
        first = np.searchsorted(self.leg, np.arange(len(self.legs)))
        near = np.array([BEHIND_TURN * (leg.high - leg.low) for leg in self.legs])
        return np.asarray(np.abs(element - element[first][self.leg]) < near[self.leg])

    @cached_property
    def _rising(self) -> Array:
        return np.where(np.array([leg.rising for leg in self.legs])[self.leg], 1.0, -1.0)

    def played(self, width: float, order: int) -> Array:
        """Return the powers of a temperature with a play of some °C: hysteresis that takes no time."""
        return self.powers_of(self.element.with_play(width), order)

    @property
    def between_turns(self) -> Array:
        """The product of the distances from both turns, °C², above zero on the way up and below it on the way down."""
        element = self.temperature(0.0) + self._reference
        low, high = (np.array([getattr(leg, end) for leg in self.legs])[self.leg] for end in ("low", "high"))
        return np.asarray(self._rising * (element - low) * (high - element))

    def by_lag(self, lag: float, coefficients: Array) -> Array:
        """Return the derivative of the readings by the lag, unit/s, shape (means, channels).

        The coefficients have the shape (order + 1, channels).
        """
        slopes = slopes_of(self.element.at(lag), coefficients.T)
        return self.averaged(slopes * self.element.by_lag(lag)[:, None])

    @cached_property
    def correlations(self) -> list[tuple[Array, Array, Array]]:
        """Correlations that decay with time, each with its eigenvalues and eigenvectors.

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


def _row_variance(values: Array) -> float:
    """Return the variance of white noise in rows, by fourth differences, in which a ramp shows at its turns alone."""
    return float(np.quantile(np.diff(values, 4) ** 2, 0.9)) / (70.0 * SQUARE_OF_90_PERCENT)
