"""The largest error of an angle that a program makes which does not hold all of a calibration."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from math import pi, sqrt

import numpy as np

from tiltcal.core.compensation import Compensation
from tiltcal.core.model import AXES, Array, Coefficients, Limits, overlap

Formula = Callable[[Array, Array], Array]
"""Gravity, shape (n, axes), of readings, shape (n, channels), and temperatures, °C, shape (n,)."""

ROOM = 25.0  # the temperature of a calibration that states none, °C
_TEMPERATURES, _ANGLES, _DIRECTIONS = 9, 65, 4000
_BETWEEN = 1.1  # an error between the attitudes and temperatures that are tried may be larger by this factor


def largest_error(
    coefficients: Coefficients, limits: Limits, formula: Formula, rounding: Array, step: float = 0.0
) -> float:
    """Return by how much an angle of a formula differs at most from that of ``apply`` in the calibrated range, degrees.

    ``rounding`` is how far each component of gravity may be off beside the formula, g, shape (axes,); ``step`` is that
    of readings which the formula takes in whole numbers, unit. Three axes are compared by the angle between the
    directions, which no tilt exceeds.
    """
    up, temperature = calibrated_range(coefficients, limits)
    readings = coefficients.predict(up, temperature)
    if step:
        readings = np.rint(readings / step) * step
    true = Compensation(coefficients, limits)(readings, temperature)
    gravity = formula(readings, temperature)
    if gravity.shape[1] == 3:
        unit, expected = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (gravity, true.gravity))
        # The length of the chord is exact for small angles, where the arccosine of a product is not.
        errors = 2.0 * np.arcsin(np.clip(np.linalg.norm(unit - expected, axis=1) / 2.0, 0.0, 1.0))
        largest = errors.max() + np.linalg.norm(rounding)
    else:
        tilts = np.radians(true.tilt)
        shifted = (np.arcsin(np.clip(gravity + shift, -1.0, 1.0)) for shift in (-rounding, 0.0, rounding))
        largest = max(np.abs(tilt - tilts).max() for tilt in shifted)
    return _BETWEEN * float(np.degrees(largest))


def calibrated_range(coefficients: Coefficients, limits: Limits) -> tuple[Array, Array]:
    """Return attitudes in the sensor's frame, shape (n, 3), and temperatures, °C, shape (n,), that are covered."""
    thermal = coefficients.thermal
    covered = overlap(limits.temperature, None if thermal is None else thermal.range)
    reference = ROOM if thermal is None else thermal.reference
    temperatures = np.linspace(*covered, _TEMPERATURES) if covered else np.array([reference])
    up = _sphere(limits) if len(coefficients.channels) == 3 else _cap(coefficients, limits)
    return np.repeat(up, len(temperatures), axis=0), np.tile(temperatures, len(up))


def _sphere(limits: Limits) -> Array:
    """Return directions all over the sphere, the axes among them, as far as the tilts are covered."""
    number = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * number / _DIRECTIONS, number * pi * (3.0 - sqrt(5.0))
    across = np.sqrt(1.0 - z * z)
    up = np.vstack([np.column_stack([across * np.cos(turn), across * np.sin(turn), z]), np.eye(3), -np.eye(3)])
    tilts = np.arcsin(up)
    ranges = [limits.tilt.get(axis, (-pi / 2, pi / 2)) for axis in AXES]
    return up[
        np.all([(tilt >= low) & (tilt <= high) for tilt, (low, high) in zip(tilts.T, ranges, strict=True)], axis=0)
    ]


def _cap(coefficients: Coefficients, limits: Limits) -> Array:
    """Return directions that one or two channels are turned to, on the half sphere that they were mounted for."""
    ranges = [
        limits.tilt.get(axis, (-pi / 2, pi / 2)) if axis in coefficients.channels else (0.0, 0.0) for axis in "xy"
    ]
    pairs = np.array(list(product(*(np.sin(np.linspace(*one, _ANGLES)) for one in ranges))))
    pairs /= np.maximum(1.0, np.linalg.norm(pairs, axis=1))[:, None]
    z = np.sqrt(np.maximum(0.0, 1.0 - np.sum(pairs**2, axis=1)))
    return np.column_stack([pairs, -z if Compensation(coefficients).upside_down else z])
