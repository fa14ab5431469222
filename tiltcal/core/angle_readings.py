"""Readings that are angles: what a channel that prints its own tilt reads, and what that says of gravity.

With n_i a unit vector near the channel's axis, ``sensitivity`` = k_i n_i in unit per degree::

    u_i = offset_i + drift_i(dT) + (1 + gain_i(dT)) * k_i asin(n_i g)

A zero that was set in the device, its scale and a turn about the vertical are exact in it, which they are not in a
model that is linear in the angle. A device of Euler angles prints the roll atan2(g_y, g_z) as y.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import asin, atan, cos, degrees, pi, radians, sin, tan
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]  # of real numbers, and of complex ones where derivatives are taken
Rows = NDArray[np.bool_]

DEGREES = degrees(1.0)  # degrees of a radian
USABLE = radians(85.0)  # no position beyond is fitted: the arcsine is too steep there, radians
BEYOND = radians(91.0)  # a reading to there is one of 90°, radians
CONVENTION_SHOWS = radians(15.0)  # both axes must be tilted so far for a position to show the convention, radians
CONVENTION_COUNTS = radians(5.0)  # where both axes are tilted further, the convention counts, radians
_STEP = 1e-30  # of the complex step, which loses no digits
_LARGEST = 1.0 - 1e-12  # argument of an arcsine whose slope is finite


@dataclass(frozen=True)
class AngleReadings:
    """How a device prints angles: ``slope`` is its reading of a tangent of 1, where it prints slopes, else 0.

    ``euler`` says whether y is the roll of Euler angles and not the inclination of its axis, if known.
    """

    slope: float
    euler: bool | None

    def angle(self, reading: Array) -> Array:
        """Return readings of a slope in degrees; others as they are."""
        return np.degrees(np.arctan(reading / self.slope)) if self.slope else reading

    def steepness(self, reading: Array) -> Array:
        """Return the derivative of :meth:`angle`."""
        return DEGREES / self.slope / (1.0 + (reading / self.slope) ** 2) if self.slope else np.ones_like(reading)

    def per_degree(self, sensitivity: float) -> float:
        """Return what 1° is in readings of a sensitivity, unit/g near level; slopes are degrees themselves."""
        return 1.0 if self.slope else sensitivity / DEGREES

    def components(self, channels: Sequence[str], signals: Sequence[float]) -> list[float]:
        """Return the components of gravity, g, of readings over their sensitivities near level."""
        angles = [atan(one) if self.slope else min(max(one, -pi / 2), pi / 2) for one in signals]
        sines = dict(zip(channels, map(sin, angles), strict=True))
        if self.euler and {"x", "y"} <= set(channels):
            sines["y"] *= cos(angles[channels.index("x")])
        return list(sines.values())

    def near_level(self, component: float) -> float:
        """Return the reading of a component over its sensitivity near level."""
        angle = asin(min(max(component, -1.0), 1.0))
        return tan(angle) if self.slope else angle

    def signal(self, channel: str, sensitivity: Array, gravity: Array) -> Array:
        """Return the readings of a channel without offset, (n,), of S, (3,), unit/°, and gravity, (3, n), g."""
        size = np.sqrt(sensitivity @ sensitivity)
        own = sensitivity / size
        argument = own @ gravity
        if self.euler and channel == "y":
            across = np.array([1.0, 0.0, 0.0]) - own[0] * own
            pitch = (across / np.sqrt(across @ across)) @ gravity
            argument = argument / np.sqrt(np.maximum(1.0 - (pitch * pitch).real, 1e-12) - 1j * (pitch * pitch).imag)
        steep = np.abs(argument.real) > _LARGEST
        argument = np.where(steep, np.copysign(_LARGEST, argument.real) + 1j * argument.imag, argument)
        return np.asarray(DEGREES * size * np.arcsin(argument))

    def linearised(self, channel: str, sensitivity: Array, gravity: Array) -> tuple[Array, Array, Array]:
        """Return the signal, (n,), and its derivatives by sensitivity and by gravity, (3, n)."""

        def by(function: Callable[[Array], Array], steps: Array) -> Array:
            return np.array([function(step).imag / _STEP for step in steps])

        value = self.signal(channel, sensitivity, gravity + 0j).real
        steps = 1j * _STEP * np.eye(3)
        by_sensitivity = by(lambda step: self.signal(channel, sensitivity + step, gravity + 0j), steps)
        by_gravity = by(lambda step: self.signal(channel, sensitivity, gravity + step[:, None]), steps)
        return value, by_sensitivity, by_gravity

    def to_components(self, signal: Array, channels: tuple[str, ...], sensitivity: Array) -> tuple[Rows, Rows, Rows]:
        """Replace angles by k sin(angle) in place, (channels, n); return rows that clip, are lost, or are ambiguous."""
        sizes = np.linalg.norm(sensitivity, axis=1) * DEGREES
        angles = np.remainder(signal / sizes[:, None] + np.pi, 2.0 * np.pi) - np.pi
        away = np.abs(angles)
        lost = np.any(away > BEYOND, axis=0)
        clipped = np.any(away > np.pi / 2, axis=0) & ~lost
        np.clip(angles, -np.pi / 2, np.pi / 2, out=angles)
        sines = np.sin(angles)
        ambiguous = np.zeros(signal.shape[1], dtype=bool)
        if {"x", "y"} <= set(channels):
            x, y = channels.index("x"), channels.index("y")
            if self.euler:
                sines[y] *= np.cos(angles[x])
            elif self.euler is None:
                ambiguous = (away[x] > CONVENTION_COUNTS) & (away[y] > CONVENTION_COUNTS)
        np.multiply(sines, sizes[:, None] / DEGREES, out=signal)
        signal[:, lost] = 0.0
        return clipped, lost, ambiguous


def reads_steep(angles: AngleReadings | None, component: float) -> bool:
    """Return whether a channel that prints angles is too near ±90° to be fitted, where its component is so large, g."""
    return angles is not None and abs(component) > sin(USABLE)
