"""What of a row each coefficient's error is multiplied with: the derivatives of the model, channel by channel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tiltcal.core.compensation import KernelChunk
from tiltcal.core.model import Array, Coefficients
from tiltcal.errors import EstimateError

TURN = "mounting.turn."
"""A small turn of the mounting about one of the application's axes, by its dotted name."""


class AngleTerm(NamedTuple):
    """One feature of a row.

    ``kind`` is ``drift`` (the slope of the straight signal over the reading, times a power of dT), ``g`` (a component
    in the sensor's frame), ``own`` (what the own sensitivity bends), ``gain`` (the signal times a power of dT),
    ``bend`` (a power of the own acceleration), ``warm`` (the slope times the reading's over the temperature) or ``up``
    (a component in the application's frame). ``place`` is the channel, or the axis; None where all channels have the
    same.
    """

    kind: str
    place: int | None
    power: int = 0


class AngleTerms:
    """Features of rows, computed together.

    Parameters
    ----------
    coefficients : Coefficients
    seen : sequence of str
        The axes of the sensor's frame that its channels see.
    turn : ndarray, shape (3, 3)
        From the sensor's frame to the application's.
    """

    def __init__(self, coefficients: Coefficients, seen: Sequence[str], turn: Array) -> None:
        self._thermal = coefficients.thermal
        self._channels, self._axes = coefficients.channels, coefficients.axes
        self._seen = tuple(seen)
        self._turn = turn
        table = coefficients.nonlinearity
        self._bend = None if table is None else np.pad(table, ((0, 0), (0, 2 - table.shape[1])))
        self._own = [
            float(row[self._axes.index(channel)]) if channel in self._axes else 0.0
            for channel, row in zip(coefficients.channels, coefficients.sensitivity, strict=True)
        ]
        self._places: dict[AngleTerm, int] = {}

    def __len__(self) -> int:
        return len(self._places)

    def add(self, term: AngleTerm) -> None:
        """Have a feature computed."""
        self._places.setdefault(term, len(self._places))

    def place(self, term: AngleTerm) -> int:
        """Which row of the result it is."""
        return self._places[term]

    def of_coefficient(self, name: str) -> list[tuple[int, AngleTerm]]:
        """The channel that a coefficient is of, and the terms that the straight signal's error has of it, with a minus.

        Raises
        ------
        EstimateError
            The coefficients have none of that name.
        """
        try:
            match name.split("."):
                case ["offset", channel]:
                    i = self._channels.index(channel)
                    return [(i, self.of_reading(i))]
                case ["sensitivity", channel, axis]:
                    i = self._channels.index(channel)
                    bent = axis == channel and self._bend is not None
                    return [(i, AngleTerm("g", self._axes.index(axis))), *([(i, AngleTerm("own", i))] if bent else [])]
                case ["temperature", "offset", channel, power] if self._thermal is not None:
                    i = self._channels.index(channel)
                    return [(i, self._drift(i, int(power)))]
                case ["temperature", "sensitivity", channel, power] if self._thermal is not None:
                    i = self._channels.index(channel)
                    return [(i, AngleTerm("gain", i, int(power)))]
                case ["nonlinearity", channel, power] if self._bend is not None:
                    i = self._channels.index(channel)
                    return [(i, AngleTerm("bend", i, int(power)))]
        except ValueError:
            pass
        raise EstimateError(f"the calibration has no coefficient {name!r}")

    def of_reading(self, channel: int) -> AngleTerm:
        """What the error of a channel's reading is multiplied with."""
        return self._drift(channel, 0)

    def of_temperature(self, channel: int) -> list[tuple[AngleTerm, float]]:
        """Terms and weights of the temperature's error in a channel, with a minus."""
        if self._thermal is None:
            return []
        if not self._is_plain(channel):
            return [(AngleTerm("warm", channel), 1.0)]
        drift = self._thermal.drift[channel].tolist()
        return [(self._drift(channel, power), (power + 1) * value) for power, value in enumerate(drift) if value]

    def _drift(self, channel: int, power: int) -> AngleTerm:
        """The slope times a power of dT; one term for all channels whose slope is 1."""
        return AngleTerm("drift", None if self._is_plain(channel) else channel, power)

    def __call__(self, stage: KernelChunk) -> Array:
        """The features of rows, shape (features, n)."""
        table = np.empty((len(self._places), stage.signal.shape[1]))
        for term, row in self._places.items():
            table[row] = self._value(term, stage)
        return table

    def _is_plain(self, channel: int) -> bool:
        """Whether the slope of a channel is 1 everywhere."""
        gain = self._thermal is not None and bool(self._thermal.gain[channel].any())
        return not gain and not (self._bend is not None and bool(self._bend[channel].any()))

    def _value(self, term: AngleTerm, stage: KernelChunk) -> Array | float:
        kind, place, power = term
        if place is None:
            return _power(stage.dt, power)
        match kind:
            case "g":
                return self._sensed(stage, self._axes[place])
            case "up":
                return self._up(stage, place)
        gain = self._gain(place, stage)
        own, a, bent, steep = self._bent(place, stage)
        match kind:
            case "drift":
                return _power(stage.dt, power) / (gain * steep)
            case "own":
                return bent / steep - a
            case "gain":
                return own * bent * _power(stage.dt, power) / (gain * steep)
            case "bend":
                return own * a**power / steep
        return self._per_degree(place, stage, own * bent) / (gain * steep)

    def _gain(self, channel: int, stage: KernelChunk) -> Array | float:
        if self._thermal is None or stage.dt is None:
            return 1.0
        return 1.0 + _polynomial(self._thermal.gain[channel], stage.dt)

    def _per_degree(self, channel: int, stage: KernelChunk, signal: Array) -> Array | float:
        """How much a reading changes with the temperature, unit/°C."""
        if self._thermal is None or stage.dt is None:
            return 0.0
        drift, gain = (
            _polynomial(row[channel] * np.arange(1, row.shape[1] + 1), stage.dt, lowest=0)
            for row in (self._thermal.drift, self._thermal.gain)
        )
        return drift + gain * signal

    def _bent(self, channel: int, stage: KernelChunk) -> tuple[float, Array, Array, Array | float]:
        """Own sensitivity, own acceleration a, its bend B(a) and B'(a); without an own axis the signal itself."""
        own = self._own[channel] or 1.0
        a = stage.signal[channel] / own
        if self._bend is None:
            return own, a, a, 1.0
        square, cube = self._bend[channel].tolist()
        return own, a, a * (1.0 + a * (square + a * cube)), 1.0 + a * (2.0 * square + 3.0 * a * cube)

    def _up(self, stage: KernelChunk, axis: int) -> Array:
        """A component of g in the application's frame."""
        application = stage.out.gravity.T
        if axis < len(application):
            return np.asarray(application[axis])
        return np.asarray(self._turn[axis, :2] @ stage.own[:2] + self._turn[axis, 2] * self._sensed(stage, "z"))

    def _sensed(self, stage: KernelChunk, axis: str) -> Array:
        """A component of g in the sensor's frame."""
        if axis in self._seen:
            return np.asarray(stage.own[self._seen.index(axis)])
        if stage.hidden is not None:
            return stage.hidden
        return np.asarray(np.sqrt(np.maximum(1.0 - np.sum(stage.own**2, axis=0), 0.0)))


def _power(dt: Array | None, power: int) -> Array | float:
    """A power of dT, 0 where no temperature counts."""
    if power == 0:
        return 1.0
    if dt is None:
        return 0.0
    value = dt
    for _ in range(power - 1):
        value = value * dt
    return value


def _polynomial(coefficients: Array, dt: Array, lowest: int = 1) -> Array:
    """A polynomial of which the first coefficient is that of dT**lowest."""
    value = np.zeros_like(dt)
    for coefficient in coefficients[::-1]:
        value *= dt
        value += coefficient
    return value if lowest == 0 else value * dt
