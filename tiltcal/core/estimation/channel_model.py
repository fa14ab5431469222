"""The reading of one channel and its derivatives: the model as the estimator sees it.

The coefficients of channel i stand in one vector::

    offset, S_ij for each axis j, drift_k (k = 1, 2, ...), gain_k (k = 1, 2, ...), n_k (k = 2, 3, ...)

    u = offset + sum_k drift_k dT^k + (1 + sum_k gain_k dT^k) * bent(s)
    s = sum_j S_ij g_j,    bent(s) = s + S_ii sum_k n_k (s / S_ii)^k
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiltcal.core.model import AXES, Array


@dataclass(frozen=True)
class ModelReading:
    """What one channel reads in n positions.

    Attributes
    ----------
    value : ndarray, shape (n,)
        In the sensor's unit.
    by_coefficient : ndarray, shape (n, coefficients)
    by_gravity : ndarray, shape (n, 3)
        unit/g.
    by_temperature : ndarray, shape (n,)
        unit/°C.
    """

    value: Array
    by_coefficient: Array
    by_gravity: Array
    by_temperature: Array


@dataclass(frozen=True)
class ChannelModel:
    """Which coefficients one channel has.

    Attributes
    ----------
    name : str
    axes : tuple of str
        Columns of the sensitivity.
    drift, gain, nonlinearity : int
        Orders: of the temperature polynomials, and how many powers from the square on bend the line.
    """

    name: str
    axes: tuple[str, ...]
    drift: int = 0
    gain: int = 0
    nonlinearity: int = 0

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Dotted names of the coefficients, in the order of their vector."""
        return (
            f"offset.{self.name}",
            *(f"sensitivity.{self.name}.{axis}" for axis in self.axes),
            *(f"temperature.offset.{self.name}.{k + 1}" for k in range(self.drift)),
            *(f"temperature.sensitivity.{self.name}.{k + 1}" for k in range(self.gain)),
            *(f"nonlinearity.{self.name}.{k + 2}" for k in range(self.nonlinearity)),
        )

    def split(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """Sensitivity, drift, gain and non-linearity of a vector of coefficients."""
        ends = np.cumsum([1, len(self.axes), self.drift, self.gain])
        sensitivity, drift, gain, bend = np.split(theta, ends)[1:]
        return sensitivity, drift, gain, bend

    def read(self, theta: Array, gravity: Array, dt: Array) -> ModelReading:
        """The reading and its derivatives.

        Parameters
        ----------
        theta : ndarray, shape (coefficients,)
        gravity : ndarray, shape (n, 3)
            Up in the sensor frame, g.
        dt : ndarray, shape (n,)
            Temperature from the reference, °C.
        """
        sensitivity, drift, gain, bend = self.split(theta)
        columns = [AXES.index(axis) for axis in self.axes]
        seen = gravity[:, columns]
        signal = seen @ sensitivity
        bent, slope, by_own, by_bend = self._bent(signal, sensitivity, bend)
        powers = dt[:, None] ** np.arange(1, max(self.drift, self.gain) + 1)
        rises = _derivative_of_powers(dt, max(self.drift, self.gain))
        scale = 1.0 + powers[:, : self.gain] @ gain
        by_sensitivity = slope[:, None] * seen
        if self.nonlinearity:
            by_sensitivity[:, self.axes.index(self.name)] += by_own
        by_gravity = np.zeros((len(dt), 3))
        by_gravity[:, columns] = (scale * slope)[:, None] * sensitivity
        return ModelReading(
            value=theta[0] + powers[:, : self.drift] @ drift + scale * bent,
            by_coefficient=np.hstack(
                [
                    np.ones((len(dt), 1)),
                    scale[:, None] * by_sensitivity,
                    powers[:, : self.drift],
                    powers[:, : self.gain] * bent[:, None],
                    scale[:, None] * by_bend,
                ]
            ),
            by_gravity=by_gravity,
            by_temperature=rises[:, : self.drift] @ drift + (rises[:, : self.gain] @ gain) * bent,
        )

    def _bent(self, signal: Array, sensitivity: Array, bend: Array) -> tuple[Array, Array, Array, Array]:
        """The bent line, its slope, and its derivatives by the own sensitivity and by each n."""
        n = len(signal)
        if not self.nonlinearity:
            return signal, np.ones(n), np.zeros(n), np.zeros((n, 0))
        own = sensitivity[self.axes.index(self.name)]
        powers = np.arange(2, 2 + self.nonlinearity)
        share = signal[:, None] / own if own else np.zeros((n, 1))
        raised = share**powers
        return (
            signal + own * (raised @ bend),
            1.0 + (share ** (powers - 1)) @ (powers * bend),
            raised @ ((1 - powers) * bend),
            own * raised,
        )


def _derivative_of_powers(dt: Array, order: int) -> Array:
    """Column k is the derivative of dT^(k+1)."""
    powers = np.arange(order)
    return np.asarray((powers + 1) * dt[:, None] ** powers)
