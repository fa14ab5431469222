"""The change of a sensor's readings within a step of the time between two calibrations.

Between two calibrations all coefficients lie on lines. A compensation is made for the middle of a step; by what the
model reads of the gravity of a row with the coefficients at the end of the step and at its beginning, its readings are
moved to the middle. That gravity comes from the compensation of the middle, and is off by half the change of a step:
where a sensitivity changes by 5 % in 64 steps, by 4e-4 of itself. The same share of that is left, 2e-7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.compensation import Compensated, Compensation
from tiltcal.core.matrix_product import product
from tiltcal.core.model import Array, Coefficients, Mounting
from tiltcal.core.mounting_angles import mounting_matrix


@dataclass(frozen=True)
class StepChange:
    """What all coefficients but offset and drift change of a reading from the beginning of a step to its end.

    Attributes
    ----------
    middle : Compensation
        Shows the gravity of a row, in the frame of the sensor at the middle of the step.
    edges : sequence of Coefficients
        At the beginning and at the end, without offset and drift.
    turns : sequence of ndarray, shape (3, 3)
        From the frame of the middle to that of each edge; they differ where the mountings do.
    matrix : ndarray, shape (channels, axes), or None
        The change by what the sensor's axes read; None where that does not suffice.
    """

    middle: Compensation
    edges: Sequence[Coefficients]
    turns: Sequence[Array]
    matrix: Array | None

    @classmethod
    def of(cls, begin: Coefficients, middle: Coefficients, end: Coefficients) -> StepChange:
        compensation, edges = Compensation(middle), [_without_offset(edge) for edge in (begin, end)]
        turns = [_turn(middle.mounting, edge.mounting) for edge in edges]
        gains = [edge.thermal.gain for edge in edges if edge.thermal is not None]
        linear = end.nonlinearity is None and not np.any(gains) and begin.mounting == end.mounting
        matrix = edges[1].sensitivity - edges[0].sensitivity if linear and end.axes == compensation.axes else None
        return cls(compensation, edges, turns, matrix)

    def __call__(self, readings: Array, temperature: Array | None) -> Array:
        """Return the change, shape (n, channels), in the unit of the readings."""
        out = Compensated.empty(len(readings), len(self.middle.axes))
        with np.errstate(all="ignore"):
            chunk = self.middle.unjudged(slice(0, len(readings)), readings.T, temperature, out)
            if self.matrix is not None:
                return np.asarray(product(self.matrix, chunk.own).T)
            thermal, gravity = self.edges[1].thermal, self.middle.sensed(chunk)
            if temperature is not None and thermal is not None:
                temperature = np.where(np.isfinite(temperature), temperature, thermal.reference)
            turned = zip(self.edges, self.turns, strict=True)
            first, last = (edge.predict((turn @ gravity).T, temperature) for edge, turn in turned)
            return np.asarray(last - first)


def _without_offset(coefficients: Coefficients) -> Coefficients:
    """Return coefficients whose reading is that of gravity alone."""
    thermal = coefficients.thermal
    if thermal is not None:
        thermal = replace(thermal, drift=np.zeros_like(thermal.drift))
    return replace(coefficients, offset=np.zeros_like(coefficients.offset), thermal=thermal)


def _turn(one: Mounting | None, other: Mounting | None) -> Array:
    """Return the rotation from the sensor's frame in one mounting to that in another."""
    if one is None or other is None or one == other:
        return np.eye(3)
    return mounting_matrix(other).T @ mounting_matrix(one)
