"""Hysteresis: two readings in one position at one temperature, which was reached from two sides.

The truth is anywhere between the two ways, half a loop to either side, with a rectangular distribution (GUM 4.3.7). It
may be off by the same for all positions of the setting that shows the loop, and for each of them that was met only once
by itself. The coefficients follow as the estimator does, when the readings there are moved by the loop.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import hypot, radians, sqrt

import numpy as np

from tiltcal.core.estimation.design import Observation, SensorObservations
from tiltcal.core.estimation.equations import HYSTERESIS
from tiltcal.core.estimation.estimate import Estimate, estimate
from tiltcal.core.model import AXES, Array
from tiltcal.core.uncertain import Uncertain

ALIKE = 1.5
"""Temperatures that are no further apart are one temperature met twice, °C."""

SIGNIFICANT = 3.0
"""Standard uncertainties above which the difference of two readings at one temperature is hysteresis."""


@dataclass(frozen=True)
class Loop:
    """The largest difference between two readings in one position at one temperature.

    Attributes
    ----------
    difference, u : float
        The later residual minus the earlier one, and its standard uncertainty, in the sensor's unit.
    """

    difference: float
    u: float

    @property
    def significant(self) -> bool:
        """Whether it is more than noise and jig explain."""
        return abs(self.difference) > SIGNIFICANT * self.u


def largest_loops(found: Estimate, observations: Sequence[Observation], jig: float) -> dict[str, Loop]:
    """Return the largest hysteresis loop of each channel; empty where no temperature was met twice.

    Parameters
    ----------
    observations : sequence of Observation
        The positions of the estimate.
    jig : float
        Standard uncertainty of a set angle, degrees: two attitudes that were set apart differ by as much.
    """
    settings, pairs = _settings(observations), _met_twice(observations)
    loops: dict[str, Loop] = {}
    axes = [AXES.index(axis) for axis in found.coefficients.axes]
    for column, channel in enumerate(found.coefficients.channels if pairs else ()):
        measured = []
        for i, j in pairs:
            across = np.cross(np.eye(3)[axes].T @ found.coefficients.sensitivity[column], observations[i].gravity)
            by_jig = 0.0 if settings[i] == settings[j] else sqrt(2.0) * radians(jig) * float(np.linalg.norm(across))
            difference = float(found.residuals[j, column] - found.residuals[i, column])
            u = hypot(observations[i].u[column], observations[j].u[column], by_jig)
            measured.append(Loop(difference, u))
        # Readings of which no uncertainty is known have none here.
        loops[channel] = max(
            measured, key=lambda loop: abs(loop.difference) / loop.u if loop.u else abs(loop.difference)
        )
    return loops


def with_hysteresis(found: Estimate, sensor: SensorObservations) -> Estimate:
    """Return the estimate with the loops between temperatures that were met twice in its uncertainty.

    Parameters
    ----------
    sensor : SensorObservations
        From which the estimate was made.
    """
    if found.coefficients.thermal is None:
        return found
    stated = found.estimated_jig if sensor.design.jig is None else sensor.design.jig
    jig = stated or 0.0
    loops = largest_loops(found, sensor.observations, jig)
    added = np.zeros_like(found.uncertain.covariance)
    for column, channel in enumerate(found.coefficients.channels):
        if channel not in loops or not loops[channel].significant:
            continue
        for rows in _moved_together(sensor.observations):
            by = _follow(replace(sensor, design=replace(sensor.design, jig=jig)), rows, column, loops[channel])
            added += np.outer(by, by) / 12.0
    if not added.any():
        return found
    loops_left = Uncertain.errors(found.uncertain.names, added, source=HYSTERESIS)
    return replace(found, uncertain=found.uncertain + loops_left)


def _follow(sensor: SensorObservations, rows: Sequence[int], column: int, loop: Loop) -> Array:
    """Compute by how much the coefficients change when one channel's readings in some positions move by a loop."""
    vectors = []
    for way in (-0.5, 0.5):
        moved = list(sensor.observations)
        for row in rows:
            mean = moved[row].mean.copy()
            mean[column] += way * loop.difference
            moved[row] = replace(moved[row], mean=mean)
        vectors.append(estimate(moved, sensor.design).coefficients.vectors.ravel())
    return np.asarray(vectors[1] - vectors[0])


def _moved_together(observations: Sequence[Observation]) -> Iterator[list[int]]:
    """Yield the positions of each setting that shows a loop, and each of them that was met once."""
    settings, twice = _settings(observations), {index for pair in _met_twice(observations) for index in pair}
    for setting in dict.fromkeys(settings[index] for index in sorted(twice)):
        rows = [row for row, its in enumerate(settings) if its == setting]
        yield rows
        yield from ([row] for row in rows if row not in twice)


def _settings(observations: Sequence[Observation]) -> list[int]:
    """Number how often the fixture had been set before each position."""
    return [int(count) for count in np.cumsum([not observation.held for observation in observations])]


def _met_twice(observations: Sequence[Observation]) -> list[tuple[int, int]]:
    """Return the pairs of positions with one attitude and one temperature."""
    return [
        (i, j)
        for (i, first), (j, second) in combinations(enumerate(observations), 2)
        if np.array_equal(first.gravity, second.gravity)
        and first.heading == second.heading
        and first.temperature is not None
        and second.temperature is not None
        and abs(first.temperature - second.temperature) <= ALIKE
    ]
