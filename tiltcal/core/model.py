"""The one measurement model: what a sensor reads, and the derivatives of its reading.

For channel i at temperature T, with dT = T - T_ref::

    u_i = offset_i + drift_i(dT) + (1 + gain_i(dT)) * S_ii B_i(a_i) + noise
    S_ii a_i = sum_j S_ij g_j,    B_i(a) = a (1 + n_i2 a + n_i3 a²)

``g`` is the unit vector that points UP in the sensor frame: the reading of an ideal sensor at rest. Level is (0, 0, 1);
an axis that points up reads +1 g. ``drift_i``, the temperature drift of the offset, and ``gain_i``, the temperature
coefficient of the sensitivity, are polynomials without a constant term. ``B_i`` is the nonlinearity: the identity
unless a procedure determined it. ``S_ii`` is the channel's sensitivity to its own axis, so the n are pure numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tiltcal.errors import EstimateError

Array = NDArray[np.float64]

AXES = ("x", "y", "z")

NEWTON_STEPS = 4
"""Of the nonlinearity's inverse: a nonlinearity of 5 % needs three to reach double precision."""


@dataclass(frozen=True)
class Mounting:
    """How the sensor sits in the application: roll first, then pitch, then yaw, in radians.

    See :func:`tiltcal.core.attitude.mounting_matrix` for what the angles mean.
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
    lag : float
        By how much the sensing element is later than the thermometer, s; see :mod:`tiltcal.core.thermal_lag`.
    """

    reference: float
    range: tuple[float, float] | None
    drift: Array
    gain: Array
    lag: float = 0.0


@dataclass(frozen=True)
class Coefficients:
    """The coefficients that calibrate one sensor.

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

    @property
    def models(self) -> tuple[ChannelModel, ...]:
        """The model of each channel."""
        drift, gain = (0, 0) if self.thermal is None else (self.thermal.drift.shape[1], self.thermal.gain.shape[1])
        shares = 0 if self.nonlinearity is None else self.nonlinearity.shape[1]
        return tuple(ChannelModel(name, self.axes, drift, gain, shares) for name in self.channels)

    @property
    def vectors(self) -> Array:
        """The coefficients of each channel in the order of :attr:`ChannelModel.coefficients`, a row per channel."""
        thermal = [] if self.thermal is None else [self.thermal.drift, self.thermal.gain]
        shares = [] if self.nonlinearity is None else [self.nonlinearity]
        return np.hstack([self.offset[:, None], self.sensitivity, *thermal, *shares])

    def own_sensitivity(self, channel: str) -> float:
        """Return the sensitivity of a channel along its own axis, unit/g."""
        return float(self.sensitivity[self.channels.index(channel), self.axes.index(channel)])

    def predict(self, gravity: Array, temperature: Array | None = None) -> Array:
        """Compute the readings that the model expects, shape (n, channels), in the unit of the offset.

        Parameters
        ----------
        gravity : ndarray, shape (n, 3)
            Up, in the sensor frame, g.
        temperature : ndarray, shape (n,), optional
            °C; the reference temperature where it is left out.
        """
        columns = [AXES.index(axis) for axis in self.axes]
        readings = np.asarray(gravity, dtype=float)[:, columns] @ self.sensitivity.T
        if self.nonlinearity is not None:
            for i, (channel, shares) in enumerate(zip(self.channels, self.nonlinearity, strict=True)):
                readings[:, i] *= 1.0 + polynomial(shares, readings[:, i] / self.own_sensitivity(channel))
        if self.thermal is not None and temperature is not None:
            dt = np.asarray(temperature, dtype=float) - self.thermal.reference
            for i, (drift, gain) in enumerate(zip(self.thermal.drift, self.thermal.gain, strict=True)):
                readings[:, i] = polynomial(drift, dt) + (1.0 + polynomial(gain, dt)) * readings[:, i]
        return self.offset + readings


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
    length : float or None
        By how much the length of gravity of three axes may differ from 1 g, g; None where its uncertainty decides,
        infinite for means, whose length says nothing.
    """

    tilt: dict[str, tuple[float, float]] = field(default_factory=dict)
    temperature: tuple[float, float] | None = None
    reading: dict[str, tuple[float, float]] = field(default_factory=dict)
    length: float | None = None


def overlap(first: tuple[float, float] | None, second: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return what is inside both of two ranges; None counts as no limit."""
    ranges = [given for given in (first, second) if given is not None]
    return (max(low for low, _ in ranges), min(high for _, high in ranges)) if ranges else None


def polynomial(coefficients: Array, variable: Array) -> Array:
    """Evaluate a polynomial without a constant term, by Horner's rule in place; the shape is that of the variable.

    Parameters
    ----------
    coefficients : ndarray, shape (order,)
        Element k multiplies variable**(k+1). With shape (..., order) the result has a row for each polynomial.
    variable : ndarray, any shape
    """
    value = np.zeros(_polynomial_shape(coefficients, variable))
    for power in range(coefficients.shape[-1], 0, -1):
        value += _coefficient(coefficients, power)
        value *= variable
    return value


def polynomial_slope(coefficients: Array, variable: Array) -> Array:
    """Evaluate the derivative of :func:`polynomial` by its variable."""
    value = np.zeros(_polynomial_shape(coefficients, variable))
    for power in range(coefficients.shape[-1], 0, -1):
        value *= variable
        value += power * _coefficient(coefficients, power)
    return value


def _coefficient(coefficients: Array, power: int) -> Array:
    return coefficients[power - 1] if coefficients.ndim == 1 else coefficients[..., power - 1, None]


def _polynomial_shape(coefficients: Array, variable: Array) -> tuple[int, ...]:
    return variable.shape if coefficients.ndim == 1 else (*coefficients.shape[:-1], variable.shape[-1])


def nonlinearity_slope(shares: Array, a: Array) -> Array:
    """Evaluate B'(a), the derivative of a (1 + n2 a + n3 a² + ...); ``shares`` are the n."""
    return 1.0 + polynomial(shares * np.arange(2, 2 + len(shares)), a)


def take_out_nonlinearity(signal: Array, coefficients: Coefficients) -> None:
    """Invert B in the signal S_ii B(a) of each channel, in place, by Newton's method: S_ii a is left.

    Parameters
    ----------
    signal : ndarray, shape (channels, n)
        Unit.
    """
    if coefficients.nonlinearity is None:
        return
    for row, channel, shares in zip(signal, coefficients.channels, coefficients.nonlinearity, strict=True):
        if shares.any():
            own = coefficients.own_sensitivity(channel)
            target = row / own
            a = target.copy()
            for _ in range(NEWTON_STEPS):
                a -= (a * (1.0 + polynomial(shares, a)) - target) / nonlinearity_slope(shares, a)
            np.multiply(a, own, out=row)


@dataclass(frozen=True)
class ModelReading:
    """The readings that the model expects of a channel in n positions, or of several channels alike.

    Several channels have one more axis in front, ``...`` below.

    Attributes
    ----------
    value : ndarray, shape (..., n)
        In the sensor's unit.
    by_coefficient : ndarray, shape (..., n, coefficients)
    by_signal : ndarray, shape (..., n)
        By the signal S g, a ratio.
    by_temperature : ndarray, shape (..., n)
        unit/°C.
    sensitivity : ndarray, shape (..., 3)
        To x, y and z, 0 along an axis that was not determined, unit/g.
    """

    value: Array
    by_coefficient: Array
    by_signal: Array
    by_temperature: Array
    sensitivity: Array

    @property
    def by_gravity(self) -> Array:
        """Derivatives by gravity, shape (..., n, 3), unit/g."""
        return np.asarray(self.by_signal[..., None] * self.sensitivity[..., None, :])


@dataclass(frozen=True)
class ChannelModel:
    """The coefficients of one channel, and its reading with the derivatives that the estimator needs.

    Attributes
    ----------
    axes : tuple of str
        Columns of the sensitivity.
    drift, gain, nonlinearity : int
        Orders: of the temperature polynomials, and how many powers from the square on the nonlinearity has.
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
        """Return sensitivity, drift, gain and nonlinearity of vectors of coefficients, shape (..., coefficients)."""
        first = 1 + len(self.axes)
        second = first + self.drift
        third = second + self.gain
        return theta[..., 1:first], theta[..., first:second], theta[..., second:third], theta[..., third:]

    def read(self, theta: Array, gravity: Array, dt: Array) -> ModelReading:
        """Compute the reading and its derivatives.

        Parameters
        ----------
        theta : ndarray, shape (coefficients,)
            Or shape (..., channels, coefficients), of channels that have no nonlinearity and are alike but for their
            names.
        gravity : ndarray, shape (n, 3)
            Up in the sensor frame, g; shape (..., n, 3) with several channels.
        dt : ndarray, shape (n,)
            Temperature from the reference, °C; shape (..., n) with several channels.
        """
        sensitivity, drift, gain, _ = self.split(theta)
        columns = [AXES.index(axis) for axis in self.axes]
        signal, by_signal, by_coefficient = self._derivatives(theta, np.swapaxes(gravity, -1, -2)[..., columns, :], dt)
        if theta.ndim > 1:
            dt = dt[..., None, :]
        value = theta[..., :1] + (1.0 + polynomial(gain, dt)) * signal
        if self.drift or self.gain:
            value += polynomial(drift, dt)
        to_axes = np.zeros((*theta.shape[:-1], 3))
        to_axes[..., columns] = sensitivity
        return ModelReading(
            value=value,
            by_coefficient=np.swapaxes(by_coefficient, -1, -2),
            by_signal=np.broadcast_to(by_signal, signal.shape),
            by_temperature=self.by_temperature(theta, signal, dt),
            sensitivity=to_axes,
        )

    def by_temperature(self, theta: Array, signal: Array, dt: Array) -> Array:
        """Compute the derivative by the temperature, unit/°C; ``signal`` is S g with its nonlinearity, unit."""
        if not (self.drift or self.gain):
            return np.zeros_like(signal)
        _, drift, gain, _ = self.split(theta)
        return polynomial_slope(drift, dt) + polynomial_slope(gain, dt) * signal

    def _derivatives(self, theta: Array, along: Array, dt: Array) -> tuple[Array, Array, Array]:
        """Return S g with its nonlinearity, and the derivatives of the reading by S g and by the coefficients.

        The shapes are (..., n), (..., n) and (..., coefficients, n); ``along`` is gravity along :attr:`axes`, shape
        (..., axes, n), g.
        """
        sensitivity, _, gain, shares = self.split(theta)
        signal = sensitivity @ along
        if theta.ndim > 1:
            along, dt = along[..., None, :, :], dt[..., None, :]
        scale = 1.0 + polynomial(gain, dt)
        by_signal = scale
        table = np.empty((*theta.shape, dt.shape[-1]))
        first = 1 + len(self.axes)
        table[..., 0, :] = 1.0
        table[..., 1:first, :] = along
        if self.nonlinearity:
            place = self.axes.index(self.name)
            own = sensitivity[place]
            a = signal / own if own else np.zeros_like(signal)
            slope = nonlinearity_slope(shares, a)
            by_signal = scale * slope
            signal = signal * (1.0 + polynomial(shares, a))
            table[1:first] *= slope
            table[1 + place] += a * (1.0 + polynomial(shares, a) - slope)
            table[-self.nonlinearity :] = own * scale
            _multiply_by_powers(table[-self.nonlinearity :], a, a)
        if self.gain or self.nonlinearity:
            table[..., 1:first, :] *= scale[..., None, :]
        if self.drift or self.gain:
            second = first + self.drift
            table[..., first:second, :] = 1.0
            table[..., second : second + self.gain, :] = signal[..., None, :]
            _multiply_by_powers(table[..., first:second, :], dt)
            _multiply_by_powers(table[..., second : second + self.gain, :], dt)
        return signal, by_signal, table


def _multiply_by_powers(table: Array, variable: Array, power: Array | float = 1.0) -> None:
    """Multiply row k by variable**(k+1), or by ``power`` times that."""
    for k in range(table.shape[-2]):
        power = power * variable
        table[..., k, :] *= power


def vector_of(coefficients: Coefficients, names: Sequence[str]) -> Array:
    """Return the coefficients with these dotted names.

    EstimateError: the coefficients have none of that name.
    """
    return np.array([table[place] for table, place in (_place(coefficients, name) for name in names)])


def with_vector(coefficients: Coefficients, names: Sequence[str], vector: Array) -> Coefficients:
    """Return coefficients with other values for these dotted names."""
    offset, sensitivity = coefficients.offset.copy(), coefficients.sensitivity.copy()
    thermal, shares = coefficients.thermal, coefficients.nonlinearity
    if thermal is not None:
        thermal = replace(thermal, drift=thermal.drift.copy(), gain=thermal.gain.copy())
    shares = None if shares is None else shares.copy()
    changed = replace(coefficients, offset=offset, sensitivity=sensitivity, thermal=thermal, nonlinearity=shares)
    for name, value in zip(names, vector, strict=True):
        table, place = _place(changed, name)
        table[place] = value
    return changed


def _place(coefficients: Coefficients, name: str) -> tuple[Array, tuple[int, ...]]:
    """Return the array that holds a coefficient, and its place there."""
    thermal = coefficients.thermal
    try:
        match name.split("."):
            case ["offset", channel]:
                return coefficients.offset, (coefficients.channels.index(channel),)
            case ["sensitivity", channel, axis]:
                place = coefficients.channels.index(channel), coefficients.axes.index(axis)
                return coefficients.sensitivity, place
            case ["temperature", "offset", channel, power] if thermal is not None:
                return thermal.drift, (coefficients.channels.index(channel), int(power) - 1)
            case ["temperature", "sensitivity", channel, power] if thermal is not None:
                return thermal.gain, (coefficients.channels.index(channel), int(power) - 1)
            case ["nonlinearity", channel, power] if coefficients.nonlinearity is not None:
                return coefficients.nonlinearity, (coefficients.channels.index(channel), int(power) - 2)
    except ValueError:
        pass
    raise EstimateError(f"the calibration has no coefficient {name!r}")
