"""Hysteresis: the difference between two visits to one position at one temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import hypot, radians, sqrt

import numpy as np

from tiltcal.core.estimation.design import Observation
from tiltcal.core.estimation.estimate import Estimate
from tiltcal.core.model import AXES

ALIKE = 1.5
"""Temperatures that are no further apart are one temperature met twice, °C."""


@dataclass(frozen=True)
class Loop:
    """The largest difference between two readings in one position at one temperature.

    Attributes
    ----------
    difference, u : float
        The later residual minus the earlier one, and its standard uncertainty, in the sensor's unit.
    between : tuple of (str, str)
        The positions.
    """

    difference: float
    u: float
    between: tuple[str, str]


def largest_loops(found: Estimate, observations: Sequence[Observation], jig: float) -> dict[str, Loop]:
    """Return the largest hysteresis loop of each channel; empty where no temperature was met twice.

    Parameters
    ----------
    found : Estimate
    observations : sequence of Observation
        The positions of the estimate.
    jig : float
        Standard uncertainty of a set angle, degrees: two attitudes that were set apart differ by as much.
    """
    stands = np.cumsum([not one.held for one in observations])
    pairs = [
        (i, j)
        for (i, one), (j, other) in combinations(enumerate(observations), 2)
        if np.array_equal(one.gravity, other.gravity)
        and one.heading == other.heading
        and one.temperature is not None
        and other.temperature is not None
        and abs(one.temperature - other.temperature) <= ALIKE
    ]
    loops: dict[str, Loop] = {}
    axes = [AXES.index(axis) for axis in found.coefficients.axes]
    for column, channel in enumerate(found.coefficients.channels if pairs else ()):
        measured = []
        for i, j in pairs:
            across = np.cross(np.eye(3)[axes].T @ found.coefficients.sensitivity[column], observations[i].gravity)
            by_jig = 0.0 if stands[i] == stands[j] else sqrt(2.0) * radians(jig) * float(np.linalg.norm(across))
            difference = float(found.residuals[j, column] - found.residuals[i, column])
            u = hypot(observations[i].u[column], observations[j].u[column], by_jig)
            measured.append(Loop(difference, u, (observations[i].position, observations[j].position)))
        loops[channel] = max(measured, key=lambda one: abs(one.difference) / one.u)
    return loops
