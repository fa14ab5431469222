"""The temperature of the sensing element, which is later or earlier than its thermometer.

An element that is later by a lag τ > 0 has the temperature E of a first-order filter::

    τ dE/dt + E = T

T being the thermometer's. Where the thermometer is later than the element, τ < 0, the filter is the inverse one::

    E = T + |τ| dT/dt

whose derivative is that of a first-order filter of the time constant ``LOG_SMOOTHING`` |τ|: it is exact on a steady
ramp, and amplifies the noise of the thermometer by no more than 1 + 1 / LOG_SMOOTHING.
"""

from __future__ import annotations

import numpy as np

from tiltcal.core.model import Array

LOG_SMOOTHING = 0.1  # time constant of the derivative where the thermometer is later, as a part of its lag


class ThermalLag:
    """The filter from the thermometer to the sensing element, for the rows of one log in order.

    Between two rows the temperature changes linearly, so irregular times and gaps need nothing of their own: after a
    gap much longer than the lag, only the mean pace in the gap counts. At the first row, and where time goes back, the
    element has the temperature of the thermometer. The lag, s, is positive where the element is later.
    """

    def __init__(self, lag: float) -> None:
        self._lag = lag
        self._constant = lag if lag > 0.0 else -LOG_SMOOTHING * lag
        self._time = self._temperature = self._filtered = np.nan

    def __call__(self, time: Array, temperature: Array) -> Array:
        """Return the temperatures of the element in more rows, °C, (n,), by time, s, and thermometer; else NaN."""
        if self._lag == 0.0:
            return np.array(temperature, dtype=float)
        known = np.isfinite(time) & np.isfinite(temperature)
        element = np.full(len(time), np.nan)
        if known.any():
            element[known] = self._filter(time[known], temperature[known])
        return element

    def _filter(self, time: Array, temperature: Array) -> Array:
        step = np.diff(time, prepend=self._time)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            x = step / self._constant
            decay = np.exp(-x)
            mean = np.where(x > 0.0, -np.expm1(-x) / x, 1.0)
        before = np.concatenate([[self._temperature], temperature[:-1]])
        added = (mean - decay) * before + (1.0 - mean) * temperature
        fresh = ~(step >= 0.0)
        decay[fresh], added[fresh] = 0.0, temperature[fresh]
        last, each = 0.0 if np.isnan(self._filtered) else self._filtered, []
        for factor, value in zip(decay.tolist(), added.tolist(), strict=True):
            last = factor * last + value
            each.append(last)
        filtered = np.array(each)
        self._time, self._temperature, self._filtered = float(time[-1]), float(temperature[-1]), last
        if self._lag > 0.0:
            return filtered
        return np.asarray(temperature + (temperature - filtered) / LOG_SMOOTHING)
