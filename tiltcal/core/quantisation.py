"""Quantisation: the step of readings that are rounded."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf

import numpy as np

from tiltcal.core.model import Array

ARITHMETIC = 1e-12  # differences below this share of the values come from arithmetic, and are no step of the reading
_MOST_VALUES = 4096  # different values beyond which a reading counts as continuous
_ENOUGH_VALUES = 1 << 16  # different values among which two neighbours are a step apart
_TOGETHER = 1 << 16  # samples that are looked at together, so that a long channel takes little memory
_WHOLE = 0.01  # by how many steps rounded readings are off a whole number of them, at most
_REPEATED = 4.0  # how often a rounded reading takes each value, on average, at the least
_EVEN = 0.02
"""How far the distances of values may be off whole steps, in steps: readings are written with so many digits."""


def resolution(channels: Iterable[Array]) -> float:
    """Return the step of a recorded reading, its unit: the smallest difference between two values of a channel.

    Nobody states the step of a log. One converter reads all channels, and one that stands still shows no step of its
    own; so the smallest step of any channel counts. Channels, shape (n,), are NaN where a value is missing; 0 where all
    values are alike.
    """
    steps = []
    for samples in channels:
        values = _different_values(samples, _ENOUGH_VALUES)
        gaps = np.diff(values)
        largest = np.max(np.abs(values), initial=0.0)
        steps.append(float(np.min(gaps, initial=inf, where=gaps > ARITHMETIC * largest)))
    smallest = min(steps, default=inf)
    return smallest if smallest < inf else 0.0


def _different_values(samples: Array, enough: int) -> Array:
    """Return the different values of a channel, rising; so many at the least, where there are more."""
    values = np.empty(0)
    for start in range(0, len(samples), _TOGETHER):
        some = np.asarray(samples[start : start + _TOGETHER])
        values = np.unique(np.concatenate([values, some[np.isfinite(some)]]))
        if len(values) >= enough:
            break
    return values


def even_step(samples: Array) -> float:
    """Return the step of a channel that takes few values at even distances, unit; 0 where it is continuous.

    Samples, shape (n,), are NaN where a value is missing.
    """
    values = _different_values(samples, _MOST_VALUES + 1)
    if not 1 < len(values) <= _MOST_VALUES or np.count_nonzero(np.isfinite(samples)) < _REPEATED * len(values):
        return 0.0
    distances = np.diff(values)
    steps = distances / distances.min()
    whole = np.round(steps)
    return float(distances.sum() / whole.sum()) if np.all(np.abs(steps - whole) <= _EVEN * whole) else 0.0


def common_step(readings: Array) -> float:
    """Return the step that all readings are whole numbers of, apart from an offset; 0 where they are not rounded.

    Readings, shape (n, channels), are all there.
    """
    step = resolution(readings.T)
    steps = (readings - readings[0]) / (step or 1.0)
    return step if np.max(np.abs(steps - np.round(steps))) < _WHOLE else 0.0


class ReadingStep:
    """The step of a sensor's readings: the smallest that they take within a position, else the one that is stated.

    The readings of different positions show none: those of a device without noise differ by many steps.
    """

    def __init__(self) -> None:
        self._taken = self._stated = inf

    def add(self, samples: Iterable[Array], stated: float) -> None:
        """Take the samples of a position, shape (n,) of each channel, and the step they were written with, 0 if any."""
        self._taken = min(self._taken, resolution(samples) or inf)
        self._stated = min(self._stated, stated or inf)

    def step(self) -> float:
        """Return the step, unit; 0 where none is known."""
        step = self._taken if self._taken < inf else self._stated
        return step if step < inf else 0.0
