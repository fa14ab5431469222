"""Hysteresis: two readings in one position at one temperature, which was reached from two sides.

The truth is anywhere between the two ways, half a loop to either side, with a rectangular distribution (GUM 4.3.7). It
may be off by the same for all positions of the setting that shows the loop, and for each of them that was met only once
by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from math import hypot, radians, sqrt

import numpy as np

from tiltcal.core.estimation.equations import HYSTERESIS
from tiltcal.core.estimation.estimate import Estimate
from tiltcal.core.estimation.positions import Observation, SensorObservations
from tiltcal.core.model import AXES
from tiltcal.core.uncertain import Uncertain

ALIKE = 1.5
"""Temperatures that are no further apart are one temperature met twice, °C."""

SIGNIFICANT = 3.0
"""Standard uncertainties above which the difference of two readings at one temperature is hysteresis."""


def with_hysteresis(fitted: Estimate, sensor: SensorObservations) -> Estimate:
    """Return the estimate with the loops between temperatures that were met twice in its uncertainty."""
    observations, pairs = sensor.observations, _met_twice(sensor.observations)
    if fitted.coefficients.thermal is None or fitted.by_reading is None or not pairs:
        return fitted
    jig = fitted.estimated_jig if sensor.design.jig is None else sensor.design.jig
    settings = np.cumsum([not observation.held for observation in observations])
    axes = [AXES.index(axis) for axis in fitted.coefficients.axes]
    added = np.zeros_like(fitted.uncertain.covariance)
    for column, sensitivity in enumerate(fitted.coefficients.sensitivity):
        loops = []
        for i, j in pairs:
            # Two attitudes that were set apart differ by the jig.
            across = float(np.linalg.norm(np.cross(np.eye(3)[axes].T @ sensitivity, observations[i].gravity)))
            by_jig = 0.0 if settings[i] == settings[j] else sqrt(2.0) * radians(jig or 0.0) * across
            u = hypot(observations[i].u[column], observations[j].u[column], by_jig)
            loop = abs(float(fitted.residuals[j, column] - fitted.residuals[i, column]))
            loops.append((loop / u if u else loop, loop, u))
        _, loop, u = max(loops)
        if loop > SIGNIFICANT * u:
            for rows in _moved_together(settings.tolist(), {index for pair in pairs for index in pair}):
                moved = fitted.by_reading[:, rows, column].sum(axis=1) * loop
                added += np.outer(moved, moved) / 12.0
    if not added.any():
        return fitted
    by_loops = Uncertain.errors(fitted.uncertain.names, added, source=HYSTERESIS)
    return replace(fitted, uncertain=fitted.uncertain + by_loops)


def _moved_together(settings: Sequence[int], twice: set[int]) -> Iterator[list[int]]:
    """Yield the positions of each setting that shows a loop, and each of them that was met once."""
    for setting in dict.fromkeys(settings[index] for index in sorted(twice)):
        rows = [row for row, its in enumerate(settings) if its == setting]
        yield rows
        yield from ([row] for row in rows if row not in twice)


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
