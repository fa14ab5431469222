"""The errors of an angle: those of the coefficients, of a reading and its temperature, of how the sensor sits."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiltcal.core.attitude import mounting_angles, mounting_matrix
from tiltcal.core.model import Coefficients, vector_of, with_vector
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


def moved(known: Coefficients, names: tuple[str, ...], vector: NDArray[np.float64]) -> Coefficients:
    """The coefficients with errors added, the mounting's as a turn behind it."""
    own = [k for k, name in enumerate(names) if not name.startswith("mounting")]
    some = tuple(names[k] for k in own)
    found = with_vector(known, some, vector_of(known, some) + vector[own])
    if known.mounting is None or len(own) == len(names):
        return found
    turned = Rotation.from_rotvec(vector[-3:]).as_matrix() @ mounting_matrix(known.mounting)
    return replace(found, mounting=mounting_angles(turned)[0])
