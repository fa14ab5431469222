"""Quantisation: the step of readings that are rounded."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array

ARITHMETIC = 1e-12
"""Differences below this share of the values come from arithmetic, and are no step of the reading."""

MOST_VALUES = 4096
"""Different values beyond which a reading counts as continuous."""

_ENOUGH_VALUES = 1 << 16
"""Different values among which two neighbours are a step apart."""

_TOGETHER = 1 << 14
"""Samples that are looked up together: so many stay in the processor's cache."""

_MOST_STEPS = 1 << 18
"""From the smallest value to the largest, where the values are tabulated."""

_WHOLE = 0.01
"""By how many steps rounded readings are off a whole number of them, at most."""

_REPEATED = 4.0
"""How often a rounded reading takes each value, on average, at the least."""

_EVEN = 0.02
"""How far the distances of values may be off whole steps, in steps: readings are written with so many digits."""


def resolution(channels: Iterable[Array]) -> float:
    """Return the step of a recorded reading: the smallest difference between two values of a channel that differ.

    Nobody states the step of a log. One converter reads all channels, and one that stands still shows no step of its
    own; so the smallest step of any channel counts.

    Parameters
    ----------
    channels : iterable of ndarray, shape (n,)
        NaN where a value is missing.

    Returns
    -------
    float
        In the unit of the readings; 0 where all values are alike.
    """
    steps = []
    for values in channels:
        rising = np.sort(values)
        rising = rising[slice(rising.searchsorted(-np.inf, "right"), rising.searchsorted(np.inf))]  # NaN is last
        gaps = np.diff(rising)
        largest = np.max(np.abs(rising[:: max(len(gaps), 1)]), initial=0.0)  # of the first and the last
        steps.append(float(np.min(gaps, initial=np.inf, where=gaps > ARITHMETIC * largest)))
    smallest = min(steps, default=np.inf)
    return smallest if smallest < np.inf else 0.0


class DifferentValues:
    """Collects the different values of a channel block by block, until there are so many that a step is among them.

    Parameters
    ----------
    enough : int
        Different values at which it stops.
    """

    def __init__(self, enough: int = _ENOUGH_VALUES) -> None:
        self._enough = enough
        self._values = np.empty(0)
        self._new: list[Array] = []
        self._table, self._start, self._per_step = np.full(1, np.nan), 0.0, 0.0

    def add(self, samples: Array) -> None:
        """Take the next samples, shape (n,)."""
        for start in range(0, len(samples), _TOGETHER):
            if len(self._values) >= self._enough:
                return
            some = samples[start : start + _TOGETHER]
            known = self._table.take(self._places(some), mode="clip") == some
            if not known.all():
                self._add_new(some[~known])

    def _add_new(self, samples: Array) -> None:
        new = np.unique(samples[np.isfinite(samples)])
        if not len(new):
            return
        self._new.append(new)
        places = np.clip(self._places(new), 0, len(self._table) - 1)
        if np.all(np.diff(places)) and np.all(np.isnan(self._table[places])):
            self._table[places] = new
        else:
            self._tabulate()

    @property
    def values(self) -> Array:
        """Those so far, rising."""
        if self._new:
            self._values = np.unique(np.concatenate([self._values, *self._new]))
            self._new.clear()
        return self._values

    def step(self) -> float:
        """Return the :func:`resolution` of the channel."""
        return resolution([self.values])

    def _tabulate(self) -> None:
        """Put each value at its whole number of steps, where it is found at once."""
        step = self.step()
        first, last = float(self._values[0]), float(self._values[-1])
        self._table, self._start, self._per_step = np.full(1, np.nan), 0.0, 0.0
        if step and last - first < _MOST_STEPS * step:
            steps = round((last - first) / step)
            room = steps // 8 + 1  # on either side, for the values to come
            self._start, self._per_step = first - (room + 0.5) * step, 1.0 / step
            self._table = np.full(steps + 2 * room + 1, np.nan)
            self._table.put(self._places(self._values), self._values, mode="clip")

    def _places(self, samples: Array) -> NDArray[np.intp]:
        with np.errstate(over="ignore", invalid="ignore"):
            steps = samples - self._start
            steps *= self._per_step
            return steps.astype(np.intp)


class ReadingStep:
    """The step of a sensor's readings: the smallest that they take within a position, else the one that is stated."""

    def __init__(self) -> None:
        self._taken = self._stated = inf

    def add(self, samples: Iterable[Array], stated: float) -> None:
        """Take the samples of a position.

        Parameters
        ----------
        samples : iterable of ndarray, shape (n,)
            Of each channel.
        stated : float
            The step with which they were written, unit; 0 where it is not known.
        """
        self._taken = min(self._taken, resolution(samples) or inf)
        self._stated = min(self._stated, stated or inf)

    def step(self) -> float:
        """Return the step, unit; 0 where none is known.

        The readings of different positions show none: those of a device without noise differ by many steps.
        """
        step = self._taken if self._taken < inf else self._stated
        return step if step < inf else 0.0


def common_step(readings: Array) -> float:
    """Return the step that all readings are whole numbers of, apart from an offset; 0 where they are not rounded.

    Parameters
    ----------
    readings : ndarray, shape (n, channels)
        None of them missing.
    """
    step = resolution(readings.T)
    steps = (readings - readings[0]) / (step or 1.0)
    return step if np.max(np.abs(steps - np.round(steps))) < _WHOLE else 0.0


class StepFinder:
    """Finds the step of one channel from its different values, sample by sample."""

    def __init__(self) -> None:
        self._different = DifferentValues(MOST_VALUES + 1)
        self._samples = 0

    def add(self, samples: Array) -> None:
        """Take more samples, none of them missing, shape (n,)."""
        self._samples += len(samples)
        self._different.add(samples)

    @property
    def values(self) -> Array | None:
        """Those seen so far, rising; None where there are too many."""
        found = self._different.values
        return found if len(found) <= MOST_VALUES else None

    def result(self) -> float:
        """Return the step; 0 where the reading is continuous, as far as the readings show."""
        values = self.values
        if values is None or len(values) < 2 or self._samples < _REPEATED * len(values):
            return 0.0
        distances = np.diff(values)
        smallest = float(distances.min())
        whole = np.round(distances / smallest)
        if np.any(np.abs(distances / smallest - whole) > _EVEN * whole):
            return 0.0
        return float(distances.sum() / whole.sum())
