"""The one measurement model, and the coefficients that fill it.

For channel i at temperature T, with dT = T - T_ref::

    u_i = offset_i + drift_i(dT) + (1 + gain_i(dT)) * bent_i(sum_j S_ij g_j) + noise
    bent_i(s) = s + S_ii * (n_i2 (s / S_ii)² + n_i3 (s / S_ii)³)

``g`` is the unit vector that points UP in the sensor frame: what an ideal sensor at rest reads. Level is (0, 0, 1); an
axis that points up reads +1 g. ``drift_i`` and ``gain_i`` are polynomials without a constant term. ``bent_i`` is the
straight line ``s`` unless a procedure determined the non-linearity: ``S_ii`` is the channel's sensitivity to its own
axis, so that the n are pure numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Mounting:
    """How the sensor sits in the application: roll first, then pitch, then yaw, in radians.

    See :func:`tiltcal.core.mounting.mounting_matrix` for what the angles mean.
    """

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0


@dataclass(frozen=True)
class Thermal:
    """The temperature terms of the model.

    Attributes
    ----------
    reference : float
        T_ref, °C.
    range : tuple of float or None
        The temperatures that were covered, °C.
    drift : ndarray, shape (channels, order)
        Column k holds the coefficient of dT**(k+1), unit/°C**(k+1).
    gain : ndarray, shape (channels, order)
        Column k holds the coefficient of dT**(k+1), 1/°C**(k+1).
    """

    reference: float
    range: tuple[float, float] | None
    drift: Array
    gain: Array


@dataclass(frozen=True)
class Coefficients:
    """What calibrates one sensor.

    Attributes
    ----------
    channels : tuple of str
        The readings, one per row of ``sensitivity``.
    axes : tuple of str
        The axes of the sensor frame that were determined, one per column of ``sensitivity``.
    offset : ndarray, shape (channels,)
        Reading at 0 g and the reference temperature, unit.
    sensitivity : ndarray, shape (channels, axes)
        S, unit/g.
    thermal : Thermal or None
        None where temperature was not measured.
    mounting : Mounting or None
        None where the application frame is the sensor frame.
    nonlinearity : ndarray, shape (channels, order), or None
        Column k multiplies the (k+2)-nd power of the acceleration along the channel's own axis; pure numbers.
    """

    channels: tuple[str, ...]
    axes: tuple[str, ...]
    offset: Array
    sensitivity: Array
    thermal: Thermal | None = None
    mounting: Mounting | None = None
    nonlinearity: Array | None = None

    def predict(self, gravity: Array, temperature: Array | None = None) -> Array:
        """Readings that the model expects.

        Parameters
        ----------
        gravity : ndarray, shape (n, 3)
            Up, in the sensor frame, g.
        temperature : ndarray, shape (n,), optional
            °C; the reference temperature where it is left out.

        Returns
        -------
        ndarray, shape (n, channels)
            In the unit of the offset.
        """
        columns = [AXES.index(axis) for axis in self.axes]
        signal = self._bent(np.asarray(gravity, dtype=float)[:, columns] @ self.sensitivity.T)
        if self.thermal is None or temperature is None:
            return self.offset + signal
        dt = np.asarray(temperature, dtype=float) - self.thermal.reference
        drift = polynomial(self.thermal.drift, dt)
        gain = polynomial(self.thermal.gain, dt)
        return self.offset + drift + (1.0 + gain) * signal

    def _bent(self, signal: Array) -> Array:
        """The signal of each channel, shape (n, channels), with its non-linearity."""
        if self.nonlinearity is None:
            return signal
        bent = signal.copy()
        for i, channel in enumerate(self.channels):
            own = self.sensitivity[i, self.axes.index(channel)]
            for power, share in enumerate(self.nonlinearity[i], start=2):
                bent[:, i] += own * share * (signal[:, i] / own) ** power
        return bent


@dataclass(frozen=True)
class Limits:
    """The ranges in which a calibration holds.

    Attributes
    ----------
    tilt : mapping of str to (low, high)
        Per axis, radians.
    temperature : tuple of float or None
        °C.
    reading : mapping of str to (low, high)
        Per channel: a reading at or beyond one of these is at the rail, unit.
    """

    tilt: dict[str, tuple[float, float]] = field(default_factory=dict)
    temperature: tuple[float, float] | None = None
    reading: dict[str, tuple[float, float]] = field(default_factory=dict)


def polynomial(coefficients: Array, dt: Array) -> Array:
    """Evaluate one polynomial without a constant term per channel, by Horner's rule.

    Parameters
    ----------
    coefficients : ndarray, shape (channels, order)
        Column k multiplies dt**(k+1).
    dt : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n, channels)
    """
    value = np.zeros((len(dt), len(coefficients)))
    for column in coefficients.T[::-1]:
        value = (value + column) * dt[:, None]
    return value
