"""A record of a ramp in few means of consecutive rows: the temperature of the element for any lag, and the noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.record import Leg, RampRecord, averaged, row_noise
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.errors import EstimateError

LAGS = 14  # of either sign that are tried first
TINY = np.finfo(float).tiny

_MEANS = 256  # of a record that is fitted
_NOISE_SHARE = 0.02  # what noise of a thermometer that is later may add to a mean, in parts of the loop
_FEWEST_MEANS = 12  # of a leg, however noisy the thermometer
_END_WEIGHT = 4.0  # the end of a line through n points has this weight over n (its leverage)
_LASTS = np.geomspace(1.0 / 64.0, 1.2, 8)  # how long noise lasts, in times of the record; the last as a random walk
_RATIOS = np.concatenate([[0.0], np.geomspace(1e-2, 1e5, 22)])  # variance of noise that lasts over that of white noise
_PRIOR = np.concatenate([[0.5], np.full(22, 0.5 / 22)])  # half of the weight is on white noise alone
_WIDER = 1.2  # of the variance of noise that lasts: 1.96 deviations of a mixture of sizes hold less than 95 %
_DISTANCES = (1, 2, 4, 8)  # of second differences, in means: a step of the thermometer may last several


class RampMeans:
    """A record in few means of consecutive rows, each within a leg.

    ``readings``, unit, shape (means, channels), belong to the legs of the numbers ``leg`` at the times ``time``, s;
    ``rising`` is 1 on the way up, -1 on the way down, and ``scale`` the scatter about a polynomial by which errors of
    several channels are compared, unit; ``reference`` is in °C. Because rounding does not average out at the turns, the
    curve may be shifted by ``shift``, °C.

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
            raise EstimateError("a leg of the record has hardly any rows: let the temperature go all the way each time")
        bounds = [np.linspace(leg.start, leg.end, n + 1).astype(int) for leg, n in zip(legs, counts, strict=True)]
        self._starts = np.concatenate([one[:-1] for one in bounds])
        self._powers: dict[float, Array] = {}
        self.legs = legs
        self.leg: NDArray[np.intp] = np.repeat(np.arange(len(legs)), counts)
        self.rising = np.where(np.array([leg.rising for leg in legs])[self.leg], 1.0, -1.0)
        self.time, self.readings = self.averaged(record.time), self.averaged(record.readings)
        self.shift = min(_END_WEIGHT * len(legs) / steps, 1.0) * record.step / sqrt(12.0)
        x = self.powers(0.0, highest)
        smallest = 1e-12 * np.max(np.abs(self.readings), axis=0) + TINY
        self.scale = np.maximum(np.std(self.readings - x @ least_squares(x, self.readings), axis=0), smallest)

    def averaged(self, rows: Array) -> Array:
        """Return the means of rows."""
        return averaged(rows, self._starts)

    def temperature(self, lag: float) -> Array:
        """Return the temperature of the element from the reference, °C, shape (means,).

        The inverse filter takes the slope from the rows before and behind.
        """
        time, temperature = self._record.time, self._record.temperature
        rows = ThermalLag(lag)(time, temperature) if lag >= 0.0 else temperature - lag * self._slope
        return self.averaged(rows) - self.reference

    def temperature_in_log(self, lag: float) -> Array:
        """Return the temperature as the filter of a log makes it, °C from the reference, shape (means,)."""
        return self.averaged(ThermalLag(lag)(self._record.time, self._record.temperature)) - self.reference

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
        grid = np.geomspace(longest / 1000.0, longest / 2.0, LAGS)
        lags = np.concatenate([-grid[::-1], [0.0], grid])
        return lowest(lambda lag: self.cost(self.powers(lag, order), kept), lags)[0]

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
        return self._powers_of(self.averaged(low) - self.reference)

    def noise_covariance(self, design: Array, values: Array) -> Array:
        """Return the covariance of the noise of one channel: white, and a process whose correlation decays with time.

        Their sizes and the correlation time are not known. The restricted likelihood (Patterson and Thompson, 1971)
        weighs them, and the covariance is the mean over what it allows: an estimate of them alone would make intervals
        too narrow. Values, shape (means,), are left by columns, shape (means, p), of which the first is constant.
        """
        n, p = design.shape
        x = np.linalg.qr(design)[0]
        off = values - x @ (x.T @ values)
        # A process that took up what lasts a few means, such as steps of the thermometer, would take up the drift too.
        second = [off[2 * k :] - 2.0 * off[k:-k] + off[: -2 * k] for k in _DISTANCES if 2 * k < n]
        least = min(max(float(np.mean(some**2)) / 6.0 for some in second), float(off @ off) / (n - p)) + TINY
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
