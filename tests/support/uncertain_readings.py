"""The errors of an angle: those of the coefficients, of a reading and its temperature, of how the sensor sits."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.uncertain import ALIGNMENT, READING, Uncertain, degrees_of_freedom


def uncertain_readings(
    names: Sequence[str],
    covariance: NDArray[np.float64],
    factors: NDArray[np.float64],
    readings: Sequence[float] | NDArray[np.float64] = (),
    temperature: float = 0.0,
    alignment: float = 0.0,
) -> Uncertain:
    """Return coefficients with their coverage factors beside readings of the first channels, uncorrelated."""
    others = [f"{READING}{channel}" for channel, _ in zip("xyz", readings, strict=False)]
    u = np.array([*readings, temperature, alignment])
    alone = Uncertain.errors((*others, f"{READING}temperature", ALIGNMENT), np.diag(u**2))
    return Uncertain.errors(names, covariance, degrees_of_freedom(factors)).beside(alone)
