"""The step of a recorded reading, and whether samples that are all alike can be chance.

Nobody states the step of a log: it is the smallest difference between two values in it, of any channel, because one
converter reads them all, and one that stands still shows no step of its own. A reading with more noise than that
averages the step out; one with less stands at a rounded value, and is uncertain by the rounding.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import erf, log, sqrt

import numpy as np

from tiltcal.core.model import Array

DUST = 1e-12
"""Differences below this share of the values are left by arithmetic, and no step."""

CHANCE = 1e-6
"""Probability of identical samples below which they are no chance."""


def step_of(channels: Iterable[Array]) -> float:
    """The smallest difference between two values of a channel that differ; 0 where all are alike.

    Parameters
    ----------
    channels : iterable of ndarray, shape (n,)
        NaN where a value is missing.
    """
    steps = []
    for values in channels:
        different = np.unique(values[np.isfinite(values)])
        gaps = np.diff(different)
        steps += gaps[gaps > DUST * np.max(np.abs(different), initial=0.0)].tolist()
    return min(steps, default=0.0)


def alike_by_chance(count: int, noise: float, step: float) -> bool:
    """Whether noise can leave so many samples in one step.

    Parameters
    ----------
    count : int
        Of the samples that are identical.
    noise : float
        Standard deviation, in the unit of the readings.
    step : float
        Same unit.
    """
    if noise == 0.0:
        return True
    # Of normal noise no step holds more than the one in the middle.
    most = erf(step / noise / sqrt(8.0))
    return most > 0.0 and count * log(most) >= log(CHANCE)
