"""The measured positions of the sensors of a fixture, and the stated uncertainties of the bench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from tiltcal.core.attitude import STRAIGHT
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.samples import SampleSummary
from tiltcal.drivers.model import Model
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.results import PositionRecord
from tiltcal.stated_arguments import require_from_zero

if TYPE_CHECKING:
    from tiltcal.core.ramp.record import RampRecord


@dataclass(frozen=True)
class BenchUncertainty:
    """The standard uncertainties that a user states of the bench; a UsageError where one is negative or no number."""

    jig: float | None = None  # of a set angle, degrees; not stated, the scatter of the positions shows it
    thermometer: float | None = None  # °C; not stated, the step of the sensors' own thermometers
    table: float | None = None  # of the lean that all share, degrees per axis; not stated, several headings show it
    heading: float | None = None  # degrees; not stated, headings count as exact

    def __post_init__(self) -> None:
        require_from_zero("--jig", self.jig)
        require_from_zero("--thermometer", self.thermometer)
        require_from_zero("--table-lean", self.table)
        require_from_zero("--heading-uncertainty", self.heading)


@dataclass(frozen=True)
class Measurement:
    """One position of one sensor, ready for the estimator."""

    position: str
    gravity: tuple[float, float, float]  # up in the sensor frame as set, g
    tilt: Mapping[str, float] | None  # as set, degrees; None where the position is given by its direction
    temperature: float | None  # °C
    summaries: Mapping[str, SampleSummary]  # per channel
    when: Mapping[str, Any] = field(default_factory=dict)  # how it is found again: its time, or its rows of a log
    heading: float | None = None  # how far the fixture was turned about the vertical, degrees
    stage: float | None = None  # angle of the rotary stage, degrees; used by no estimate

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


@dataclass(frozen=True)
class MeasuredSensor:
    """One sensor of a fixture with what was measured of it."""

    sensor: SensorIdentity
    measurements: Sequence[Measurement]
    nominal: Model | None = None  # its facts stand in for what a procedure does not determine; None: not known
    orientation: Sequence[Sequence[float]] = STRAIGHT.matrix  # takes a vector of the fixture's frame to the sensor's
    thermometer: float | None = None  # u of the step of its own thermometer, °C; None where another was read
    base: CalibrationRecord | None = None  # its calibration, which is completed, or lends its sensitivity
    ramp: RampRecord | None = None  # the record of a ramp, whose one measurement is the attitude
    reopened: bool = False  # its bus failed in the session and was opened again


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
