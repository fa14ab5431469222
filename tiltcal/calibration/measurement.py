"""The measured positions of the sensors of a fixture, and the stated uncertainties of the bench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tiltcal.core.attitude import STRAIGHT
from tiltcal.core.ramp.record import RampRecord
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.samples import SampleSummary
from tiltcal.drivers.model import Model
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.results import PositionRecord
from tiltcal.stated_arguments import require_from_zero


@dataclass(frozen=True)
class BenchUncertainty:
    """The standard uncertainties that a user states of the bench; None where one is not stated.

    Attributes
    ----------
    jig : float or None
        Of a set angle, degrees. Not stated, the scatter of the positions shows it. A procedure of free positions takes
        none: there the directions of the measurements are a first guess, and unit gravity determines the rest.
    table : float or None
        Of the lean of the table that all positions share, degrees per axis. Not stated, positions at several headings
        show it.
    heading : float or None
        Of a heading, degrees. Not stated, headings count as exact.
    thermometer : float or None
        Of a temperature, °C. Not stated, it is the step of the sensors' own thermometers, or nothing.

    UsageError: one is negative or no number.
    """

    jig: float | None = None
    thermometer: float | None = None
    table: float | None = None
    heading: float | None = None

    def __post_init__(self) -> None:
        for option, value in (
            ("--jig", self.jig),
            ("--thermometer", self.thermometer),
            ("--table-lean", self.table),
            ("--heading-uncertainty", self.heading),
        ):
            require_from_zero(option, value)


@dataclass(frozen=True)
class Measurement:
    """One position of one sensor, ready for the estimator.

    Attributes
    ----------
    gravity : tuple of float
        Up in the sensor frame as set, g.
    tilt : mapping of str to float or None
        As set, degrees; None where the position is given by its direction.
    temperature : float or None
        °C.
    summaries : mapping of str to SampleSummary
        Per channel of the sensor.
    when : mapping of str to Any
        How the position is found again: its time, or its rows of a log.
    heading : float or None
        How far the fixture was turned about the vertical, degrees.
    stage : float or None
        Angle of the rotary stage, degrees; recorded, and used by no estimate.
    """

    position: str
    gravity: tuple[float, float, float]
    tilt: Mapping[str, float] | None
    temperature: float | None
    summaries: Mapping[str, SampleSummary]
    when: Mapping[str, Any] = field(default_factory=dict)
    heading: float | None = None
    stage: float | None = None

    def record(self, channels: Sequence[str]) -> PositionRecord:
        """Return what was measured, for the calibration file, with the digits that its uncertainty warrants."""
        summaries = {channel: self.summaries[channel] for channel in channels}
        return PositionRecord(
            position=self.position,
            mean={c: round_to(summary.mean, summary.u) for c, summary in summaries.items()},
            std={c: significant(summary.std, 4) for c, summary in summaries.items()},
            u={c: significant(summary.u, 4) for c, summary in summaries.items()},
            n=next(iter(summaries.values())).n,
            temperature=None if self.temperature is None else round(self.temperature, 3),
            **self.when,
        )


def missing_temperature(base: CalibrationRecord, measurement: Measurement) -> str:
    """Return why a position without a temperature cannot be read by a calibration; empty where it can."""
    thermal = base.coefficients.thermal
    if measurement.temperature is not None or thermal is None or not (thermal.drift.any() or thermal.gain.any()):
        return ""
    return (
        f"the reading of {base.sensor.serial} changes with temperature, and {measurement.position} has none: type it "
        "at the prompt (t), name a thermometer in the bench file, or a column of the log"
    )


def rails_of(
    channels: Sequence[str], nominal: Model | None, base: CalibrationRecord | None
) -> Mapping[str, tuple[float, float]]:
    """Return the lowest and the highest reading of each channel, unit: of the model, or those that a base states."""
    if nominal is not None:
        return dict.fromkeys(channels, nominal.rails)
    return {} if base is None else {c: at for c, at in base.limits.reading.items() if c in channels}


def at_rail(channel: str, reading: str, rails: tuple[float, float]) -> str:
    """Return what a reading at a rail means, and what to look at."""
    return (
        f"{channel} reads {reading}, at its rail or beyond ({rails[0]:g} to {rails[1]:g}): is this the sensor, are "
        "these its readings in its unit, and is the angle within its range?"
    )


@dataclass(frozen=True)
class MeasuredSensor:
    """One sensor of a fixture with what was measured of it.

    Attributes
    ----------
    nominal : Model or None
        The sensor's model, whose facts stand in where a procedure does not determine them; None where it is not known,
        or reads another unit.
    orientation : sequence of sequence of float
        3 by 3; takes a vector of the fixture's frame to the sensor's.
    thermometer : float or None
        Standard uncertainty from the step of the sensor's own thermometer, °C; None where it did not take the
        temperatures.
    ramp : RampRecord or None
        Of a ramp, the continuous record; its one measurement is the attitude.
    base : CalibrationRecord or None
        The sensor's own calibration: a mounting or a new level completes it, and its sensitivity stands in where a
        procedure determines none.
    reopened : bool
        Whether its bus failed in the session and was opened again.
    """

    sensor: SensorIdentity
    measurements: Sequence[Measurement]
    nominal: Model | None = None
    orientation: Sequence[Sequence[float]] = STRAIGHT.matrix
    thermometer: float | None = None
    base: CalibrationRecord | None = None
    ramp: RampRecord | None = None
    reopened: bool = False
