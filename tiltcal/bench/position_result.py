"""One measured position, from the runner to the estimator: what was set, what every sensor read, what was expected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tiltcal.calibration.measurement import Measurement
from tiltcal.core.model import Array
from tiltcal.core.quantisation import ReadingStep
from tiltcal.files.procedure import Position


@dataclass(frozen=True)
class PositionResult:
    """A measured position.

    Attributes
    ----------
    position : Position
        As it was actually set.
    measurements : mapping of str to Measurement
        What each sensor gave, by serial number, as the estimator takes it.
    typed : bool
        Whether the operator typed the temperature.
    expected : mapping of str to mapping of str to float
        By serial number and channel: the reading that the positions before predict, in the sensor's unit; empty where
        nothing predicts it.
    left_out : int
        Samples that were far off, and were taken again.
    asked : float or None
        The temperature that the procedure asks for, °C.
    """

    position: Position
    measurements: Mapping[str, Measurement]
    typed: bool = False
    expected: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    left_out: int = 0
    asked: float | None = None

    def with_steps(self, steps: Mapping[str, ReadingStep]) -> PositionResult:
        """Return this position with the steps that a session's readings have shown, where the models state none."""
        measurements = {}
        for serial, measurement in self.measurements.items():
            step = steps[serial].step()
            summaries = {
                channel: summary.with_resolution(step) if step else summary
                for channel, summary in measurement.summaries.items()
            }
            measurements[serial] = replace(measurement, summaries=summaries)
        return replace(self, measurements=measurements)

    def mean(self, serial: str) -> Array:
        """Return the mean reading of each channel of a sensor, in its unit."""
        return np.array([summary.mean for summary in self.measurements[serial].summaries.values()])

    def values(self, serial: str) -> dict[str, Any]:
        """Return mean, scatter, number and temperature of one sensor, as the journal and a program get them."""
        measurement = self.measurements[serial]
        return {
            "mean": {channel: summary.mean for channel, summary in measurement.summaries.items()},
            "std": {channel: summary.std for channel, summary in measurement.summaries.items()},
            "n": next(iter(measurement.summaries.values())).n,
            "temperature": measurement.temperature,
            **({"left_out": self.left_out} if self.left_out else {}),
        }

    def record(self) -> dict[str, Any]:
        """Return the accepted position as the journal notes it."""
        return {
            "position": self.position.name,
            "sensors": {serial: self.values(serial) for serial in self.measurements},
        }
