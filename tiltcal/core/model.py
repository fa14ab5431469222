"""The one measurement model: what a sensor reads, and the derivatives of its reading.

For channel i at temperature T, with dT = T - T_ref::

    u_i = offset_i + drift_i(dT) + (1 + gain_i(dT)) * S_ii B_i(a_i) + noise
    S_ii a_i = sum_j S_ij g_j,    B_i(a) = a (1 + n_i2 a + n_i3 a²)

``g`` is the unit vector that points UP in the sensor frame: the reading of an ideal sensor at rest. Level is (0, 0, 1);
an axis that points up reads +1 g. ``drift_i``, the temperature drift of the offset, and ``gain_i``, the temperature
coefficient of the sensitivity, are polynomials without a constant term. ``B_i`` is the nonlinearity: the identity
unless a procedure determined it. ``S_ii`` is the channel's sensitivity to its own axis, so the n are pure numbers.
Of devices that print angles :mod:`tiltcal.core.angle_readings` has the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.angle_readings import DEGREES, AngleReadings
from tiltcal.errors import EstimateError

Array = NDArray[np.float64]

AXES = ("x", "y", "z")

_KINDS = ("offset.", "sensitivity.", "temperature.offset.", "temperature.sensitivity.", "nonlinearity.")  # in order
NEWTON_STEPS = 4  # iterations of the nonlinearity's inverse: 5 % needs three for double precision


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

    ``drift`` and ``gain`` have the shape (channels, order): column k multiplies dT**(k+1), unit/°C**(k+1) and
    1/°C**(k+1). ``range`` are the temperatures that were covered, °C. The sensing element is later than the thermometer
    by ``lag``, s; see :mod:`tiltcal.core.thermal_lag`.
    """

    reference: float  # T_ref, °C
    range: tuple[float, float] | None
    drift: Array
    gain: Array
    lag: float = 0.0


@dataclass(frozen=True)
class Coefficients:
    """The coefficients that calibrate one sensor; its channels are the rows, the axes that were determined the columns.

    ``offset``, (channels,), is the reading at 0 g and the reference temperature, unit; ``sensitivity`` is S, unit/g.
    Column k of ``nonlinearity`` multiplies the (k+2)-nd power of the acceleration along the channel's own axis, pure
    numbers. What was not measured is None, as is the mounting of a sensor whose frame is the application's. Where the
    readings are ``angles``, S is in unit per degree.
    """

    channels: tuple[str, ...]
    axes: tuple[str, ...]
    offset: Array
    sensitivity: Array
    thermal: Thermal | None = None
    mounting: Mounting | None = None
    nonlinearity: Array | None = None
    angles: AngleReadings | None = None

    @cached_property
    def models(self) -> tuple[ChannelModel, ...]:
        """The model of each channel."""
        drift, gain = (0, 0) if self.thermal is None else (self.thermal.drift.shape[1], self.thermal.gain.shape[1])
        shares = 0 if self.nonlinearity is None else self.nonlinearity.shape[1]
        return tuple(ChannelModel(name, self.axes, drift, gain, shares, self.angles) for name in self.channels)

    @property
    def vectors(self) -> Array:
        """The coefficients of each channel in the order of :attr:`ChannelModel.coefficients`, a row per channel."""
        thermal = [] if self.thermal is None else [self.thermal.drift, self.thermal.gain]
        shares = [] if self.nonlinearity is None else [self.nonlinearity]
        return np.hstack([self.offset[:, None], self.sensitivity, *thermal, *shares])

    def own_sensitivity(self, channel: str) -> float:
        """Return the sensitivity of a channel along its own axis, unit/g, of one that prints angles near level."""
        own = float(self.sensitivity[self.channels.index(channel), self.axes.index(channel)])
        return own * self.per_radian

    @property
    def per_radian(self) -> float:
        """What makes a sensitivity one per g near level: the degrees of a radian where the readings are angles."""
        return 1.0 if self.angles is None else DEGREES

    def predict(self, gravity: Array, temperature: Array | None = None) -> Array:
        """Compute the readings, (n, channels), for up, (n, 3), g, and temperatures, (n,), °C, else the reference."""
        return np.stack([reading.value for reading in self.read(gravity, temperature)], axis=1)

    def read(self, gravity: Array, temperature: Array | None = None) -> list[ModelReading]:
        """Compute the reading of each channel with its derivatives; see :meth:`predict`."""
        up, dt = np.asarray(gravity, dtype=float), np.zeros(len(gravity))
        if self.thermal is not None and temperature is not None:
            dt = np.asarray(temperature, dtype=float) - self.thermal.reference
        return [model.read(theta, up, dt) for model, theta in zip(self.models, self.vectors, strict=True)]


@dataclass(frozen=True)
class Limits:
    """The ranges in which a calibration holds: tilts per axis, radians; °C; readings between rails per channel, unit.

    ``length`` is by how much the length of gravity of three axes may differ from 1 g, g; None where its uncertainty
    decides, infinite for means, whose length says nothing. ``directions`` of three axes, if stated, count in place of
    ``tilt``, which then is how far they reach: see :mod:`tiltcal.core.directions`.
    """

    tilt: dict[str, tuple[float, float]] = field(default_factory=dict)
    temperature: tuple[float, float] | None = None
    reading: dict[str, tuple[float, float]] = field(default_factory=dict)
    length: float | None = None
    directions: tuple[tuple[float, float, float], ...] | str | None = None


def overlap(first: tuple[float, float] | None, second: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return what is inside both of two ranges; None counts as no limit."""
    ranges = [given for given in (first, second) if given is not None]
    return (max(low for low, _ in ranges), min(high for _, high in ranges)) if ranges else None


def polynomial(coefficients: Array, variable: Array) -> Array:
    """Evaluate a polynomial by Horner, of which element k multiplies variable**(k+1)."""
    value = np.zeros(variable.shape)
    for coefficient in coefficients[::-1]:
        value += coefficient
        value *= variable
    return value


def polynomial_slope(coefficients: Array, variable: Array) -> Array:
    """Evaluate the derivative of a :func:`polynomial` by its variable."""
    return polynomial(coefficients[1:] * np.arange(2, 1 + len(coefficients)), variable) + float(coefficients[:1].sum())


def take_out_nonlinearity(signal: Array, coefficients: Coefficients) -> None:
    """Invert B in the signal S_ii B(a) of each channel, (channels, n), in place, by Newton: S_ii a is left."""
    if coefficients.nonlinearity is None:
        return
    for row, channel, shares in zip(signal, coefficients.channels, coefficients.nonlinearity, strict=True):
        if shares.any():
            own = coefficients.own_sensitivity(channel)
            target, bend = row / own, np.append(1.0, shares)
            a = target.copy()
            for _ in range(NEWTON_STEPS):
                a -= (polynomial(bend, a) - target) / polynomial_slope(bend, a)
            np.multiply(a, own, out=row)


@dataclass(frozen=True)
class ModelReading:
    """The readings that the model expects of a channel in n positions, in its unit, with their derivatives, (n, ...).

    ``by_signal`` is that by S g, a ratio; ``sensitivity``, (3,), has 0 along an axis that was not determined, unit/g.
    ``across``, (n, 3), is by gravity beside S g, as a roll follows the pitch; None for none.
    """

    value: Array
    by_coefficient: Array
    by_signal: Array
    by_temperature: Array
    sensitivity: Array
    across: Array | None

    @property
    def by_gravity(self) -> Array:
        """Derivatives by gravity, shape (n, 3), unit/g."""
        along = self.by_signal[:, None] * self.sensitivity
        return along if self.across is None else along + self.across


@dataclass(frozen=True)
class ChannelModel:
    """The coefficients of one channel, and its reading with the derivatives that the estimator needs.

    ``axes`` are the columns of the sensitivity; drift, gain and nonlinearity are orders: of the temperature
    polynomials, and how many powers from the square on the nonlinearity has.
    """

    name: str
    axes: tuple[str, ...]
    drift: int
    gain: int
    nonlinearity: int
    angles: AngleReadings | None

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
        """Compute the reading for up, (n, 3), g, and °C from the reference, (n,), and its derivatives."""
        sensitivity, drift, gain, shares = self.split(theta)
        columns = [AXES.index(axis) for axis in self.axes]
        along, first, scale = gravity.T[columns], 1 + len(self.axes), 1.0 + polynomial(gain, dt)
        signal, by_signal = sensitivity @ along, scale
        table, across = np.empty((len(theta), len(dt))), None
        table[0], table[1:first] = 1.0, along
        to_axes = np.zeros(3)
        to_axes[columns] = sensitivity
        if self.angles is not None and not to_axes.any():  # before the first round, near level
            table[1:first] *= DEGREES
        elif self.angles is not None:
            signal, by_sensitivity, by_gravity = self.angles.linearised(self.name, to_axes, gravity.T)
            table[1:first] = by_sensitivity[columns]
            by_signal = (to_axes @ by_gravity) / (to_axes @ to_axes)
            across = (scale * (by_gravity - np.outer(to_axes, by_signal))).T
            by_signal = scale * by_signal
        if self.nonlinearity:
            place = self.axes.index(self.name)
            own = sensitivity[place]
            a = signal / own if own else np.zeros_like(signal)
            slope = polynomial_slope(np.append(1.0, shares), a)
            by_signal, signal = scale * slope, signal * (1.0 + polynomial(shares, a))
            table[1:first] *= slope
            table[1 + place] += a * (1.0 + polynomial(shares, a) - slope)
            table[-self.nonlinearity :] = own * scale
            _multiply_by_powers(table[-self.nonlinearity :], a, a)
        if self.gain or self.nonlinearity:
            table[1:first] *= scale
        value, by_temperature, second = theta[0] + scale * signal, np.zeros_like(signal), first + self.drift
        if self.drift:
            table[first:second] = 1.0
            _multiply_by_powers(table[first:second], dt)
            value += polynomial(drift, dt)
            by_temperature = polynomial_slope(drift, dt)
        if self.gain:
            table[second : second + self.gain] = signal
            _multiply_by_powers(table[second : second + self.gain], dt)
            by_temperature = by_temperature + polynomial_slope(gain, dt) * signal
        by_signal = np.full(signal.shape, by_signal)
        return ModelReading(value, table.T, by_signal, by_temperature, to_axes, across)


def _multiply_by_powers(table: Array, variable: Array, power: Array | float = 1.0) -> None:
    """Multiply row k by variable**(k+1), or by ``power`` times that."""
    for row in table:
        power = power * variable
        row *= power


# Coefficients by their dotted names, and at another reference temperature


def values(coefficients: Coefficients) -> dict[str, float]:
    """Return every coefficient by its dotted name."""
    named = dict(zip(_names(coefficients), coefficients.vectors.ravel().tolist(), strict=True))
    return {name: value for kind in _KINDS for name, value in named.items() if name.startswith(kind)}


def vector_of(coefficients: Coefficients, names: Sequence[str]) -> Array:
    """Return the coefficients with some names, shape (k,); an EstimateError where there is none of a name."""
    return coefficients.vectors.ravel()[_places(coefficients, names)]


def with_vector(coefficients: Coefficients, names: Sequence[str], vector: Array) -> Coefficients:
    """Return coefficients with other values for some names, shape (k,)."""
    vectors = coefficients.vectors
    vectors.ravel()[_places(coefficients, names)] = vector
    sensitivity, drift, gain, shares = coefficients.models[0].split(vectors)
    thermal = None if coefficients.thermal is None else replace(coefficients.thermal, drift=drift, gain=gain)
    bend = None if coefficients.nonlinearity is None else shares
    return replace(coefficients, offset=vectors[:, 0], sensitivity=sensitivity, thermal=thermal, nonlinearity=bend)


def referred(coefficients: Coefficients, reference: float | None) -> Coefficients:
    """Return the same coefficients at another reference temperature, °C; None for their own.

    A polynomial p(dT) without a constant term becomes p(dT + s) - p(s) with s the shift of the reference; the offset
    takes p(s) over, and the sensitivity the factor 1 + gain(s), by which the new gain is divided.
    """
    thermal = coefficients.thermal
    if thermal is None or reference is None or thermal.reference == reference:
        return coefficients
    shift = reference - thermal.reference
    drift, gain = (
        np.array([polynomial(row, np.array(shift)) for row in table]) for table in (thermal.drift, thermal.gain)
    )
    return replace(
        coefficients,
        offset=coefficients.offset + drift,
        sensitivity=coefficients.sensitivity * (1.0 + gain)[:, None],
        thermal=replace(
            thermal,
            reference=reference,
            drift=_shifted(thermal.drift, shift),
            gain=_shifted(thermal.gain, shift) / (1.0 + gain)[:, None],
        ),
    )


def _names(coefficients: Coefficients) -> list[str]:
    """Return the dotted names, channel by channel, as :attr:`Coefficients.vectors` has them."""
    return [name for model in coefficients.models for name in model.coefficients]


def _places(coefficients: Coefficients, names: Sequence[str]) -> list[int]:
    return _places_among(coefficients.models, tuple(names))


@cache
def _places_among(models: tuple[ChannelModel, ...], names: tuple[str, ...]) -> list[int]:
    known = {name: place for place, name in enumerate(name for model in models for name in model.coefficients)}
    for name in names:
        if name not in known:
            raise EstimateError(f"the calibration has no coefficient {name!r}")
    return [known[name] for name in names]


def _shifted(table: Array, shift: float) -> Array:
    """Return the coefficients of p(dT + shift) - p(shift), row by row, without the constant term."""
    rows = []
    for row in table:
        moved = np.polynomial.Polynomial([0.0, *row])(np.polynomial.Polynomial([shift, 1.0]))
        rows.append(np.pad(moved.coef[1:], (0, len(row) - len(moved.coef[1:]))))
    return np.array(rows, dtype=float).reshape(table.shape)
