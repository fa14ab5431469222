"""A measured position: how it was set, and what its samples give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import dist
from typing import Any

import numpy as np

from tiltcal.calibration.measurement import Measurement
from tiltcal.core.attitude import gravity_from_tilt, normalised
from tiltcal.core.detection import TILTED
from tiltcal.core.model import Array
from tiltcal.core.samples import ReadingStep, summarise
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import InputError
from tiltcal.files.bench import BenchSensor
from tiltcal.files.procedure import Position
from tiltcal.journal.lines import OperatorAnswer
from tiltcal.journal.playback import Sample


@dataclass(frozen=True)
class PositionResult:
    """A measured position, as it was actually set.

    ``measurements`` are what each sensor gave, by serial number; ``typed`` is whether the operator typed the
    temperature, and ``asked`` the one that the procedure asks for, °C; ``left_out`` samples were far off.
    """

    position: Position
    measurements: Mapping[str, Measurement]
    typed: bool
    left_out: int
    asked: float | None

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

    def values(self) -> dict[str, dict[str, Any]]:
        """Return mean, scatter, number and temperature by serial number, as the journal and a program get them."""
        return {
            serial: {
                "mean": {channel: summary.mean for channel, summary in measurement.summaries.items()},
                "std": {channel: summary.std for channel, summary in measurement.summaries.items()},
                "n": next(iter(measurement.summaries.values())).n,
                "temperature": measurement.temperature,
                **({"left_out": self.left_out} if self.left_out else {}),
            }
            for serial, measurement in self.measurements.items()
        }


def result_of(
    sensors: Sequence[BenchSensor],
    actual: Position,
    asked: Position,
    samples: Sequence[Sample],
    when: str,
    *,
    typed: float | None = None,
    left_out: int = 0,
    takes: int = 1,
    steps: Mapping[str, ReadingStep] | None = None,
) -> PositionResult:
    """Return what the samples of a position give at a time; of a ramp, without ``steps``, but for those at a rail.

    Readings stay in the sensor's own frame. The temperature is the one that was typed, else the mean of the
    thermometer, else the one that was asked for. Where a model states no step, the one that the readings show is added
    to ``steps``.
    """
    where = {"time": when, **({"left_out": left_out} if left_out else {}), **({"takes": takes} if takes > 1 else {})}
    measurements = {}
    for sensor in sensors:
        readings, model = [sample[sensor.serial] for sample in samples], sensor.wired
        if steps is None:
            readings = [reading for reading in readings if not at_rail(reading, model)]
        elif not model.resolution:
            values = np.array([reading.values for reading in readings]).T
            steps[sensor.serial].add(values, min(reading.step for reading in readings))
        measured = [reading.temperature for reading in readings if reading.temperature is not None]
        thermometer = summarise(measured).mean if measured else actual.temperature
        measurements[sensor.serial] = Measurement(
            actual.name,
            sensor.orientation.seen(actual.gravity),
            actual.tilt if sensor.orientation.straight else None,
            thermometer if typed is None else typed,
            {
                channel: summarise([reading.values[place] for reading in readings], model.resolution)
                for place, channel in enumerate(model.channels)
            },
            where,
            heading=actual.heading,
            stage=actual.stage,
        )
    return PositionResult(actual, measurements, typed is not None, left_out, asked.temperature)


def at_rail(reading: Reading, model: Model) -> str:
    """Return which channel of a reading is at a rail, and what to look at; nothing where none is."""
    low, high = model.rails
    for channel, value in zip(model.channels, reading.values, strict=True):
        if not low < value < high:
            return (
                f"{channel} reads {value:.6g}, at its rail: is the angle within the sensor's range, and is it wired "
                "right?"
            )
    return ""


class ReadingSpans:
    """The lowest and the highest reading of each channel that a session has seen, moves between positions included."""

    def __init__(self, sensors: Sequence[BenchSensor]) -> None:
        self._sensors = sensors
        self._models = {sensor.serial: sensor.wired for sensor in sensors}
        self._spans: dict[str, list[tuple[float, float, float]]] = {}

    def add(self, readings: Sample) -> None:
        """Take one sample, by serial number; a reading at a rail is none."""
        for serial, reading in readings.items():
            step = self._models[serial].resolution or reading.step
            before = self._spans.get(serial) or [(value, value, step) for value in reading.values]
            if not at_rail(reading, self._models[serial]):
                spans = zip(before, reading.values, strict=True)
                self._spans[serial] = [(min(low, one), max(high, one), step) for (low, high, _), one in spans]

    def quiet_channels(self, positions: Sequence[Position]) -> dict[str, dict[str, int]]:
        """Return by serial number the channels that no position tilts and that showed one value or two, with the count.

        Two are the normal state of a sound sensor whose step is coarse, and of a dead converter that flickers.
        """
        quiet: dict[str, dict[str, int]] = {}
        for sensor in self._sensors:
            seen = np.array([sensor.orientation.seen(one.gravity) for one in positions])
            flat = [channel for channel, by in zip("xyz", np.ptp(seen, axis=0), strict=True) if by <= TILTED]
            spans = zip(sensor.wired.channels, self._spans.get(sensor.serial, []), strict=False)
            quiet[sensor.serial] = {
                name: 1 + (high > low) for name, (low, high, step) in spans if high - low <= 1.5 * step and name in flat
            }
        return quiet


SAME = 1e-4  # directions that differ by less are one, g: 0.006°


def as_set(position: Position, answer: OperatorAnswer) -> Position:
    """Return a position with the angles and the temperature that the operator actually set.

    InputError: no direction has these angles, or they contradict the direction that was set.
    """
    if answer.temperature is not None and position.temperature is not None:
        position = replace(position, temperature=answer.temperature)
    direction = None if answer.gravity is None else normalised(answer.gravity)
    if answer.tilt:
        tilt = {**(position.tilt or {}), **answer.tilt}
        reached = gravity_from_tilt(tilt)
        if direction is not None and min(dist(direction, reached), dist(direction, position.gravity)) > SAME:
            raise InputError(
                "the answer has a tilt and a gravity that contradict each other: give the one that was reached"
            )
        return replace(position, gravity=reached, tilt=tilt)
    return position if direction is None else replace(position, gravity=direction, tilt=None)
