"""The measured positions of the sensors of a fixture, what the user states of the bench, and checks of both.

A calibration of swapped or turned channels corrects them, so that it is remarked and not refused: it goes with the
wiring as it is. Two copies of one channel determine nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from math import acos, degrees
from typing import TYPE_CHECKING, Any

import numpy as np

from tiltcal.core.angle_readings import DEGREES
from tiltcal.core.attitude import STRAIGHT, Orientation
from tiltcal.core.model import AXES, Coefficients
from tiltcal.core.plausibility import UNKNOWN_OFFSET
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.samples import SampleSummary
from tiltcal.drivers.model import OF_G, OF_TILT, Model
from tiltcal.errors import Argument, EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import PositionProcedure
from tiltcal.files.results import PositionRecord, PositionSet

if TYPE_CHECKING:  # `check` needs no estimator
    from tiltcal.core.estimation.estimate import Estimate
    from tiltcal.core.estimation.positions import InstrumentErrors
    from tiltcal.core.ramp.record import RampRecord


@dataclass(frozen=True)
class BenchUncertainty:
    """The standard uncertainties that a user states of the bench."""

    jig: float | None = None  # of a set angle, degrees; not stated, the scatter of the positions shows it
    thermometer: float | None = None  # °C; not stated, the step of the sensors' own thermometers
    table_lean: float | None = None  # that all share, degrees per axis; not stated, several headings show it
    heading: float | None = None  # degrees; not stated, headings count as exact
    instrument: InstrumentErrors | None = None  # of a reference that says what was set; the jig is its repeatability


@dataclass(frozen=True)
class Measurement:
    """One position of one sensor, ready for the estimator."""

    position: str
    gravity: tuple[float, float, float]  # up in the sensor frame as set, g
    tilt: Mapping[str, float] | None  # as set, degrees; None where the position is given by its direction
    temperature: float | None  # °C
    summaries: Mapping[str, SampleSummary]  # per channel
    noted: Mapping[str, Any] = field(default_factory=dict)  # for its record: its time, or its rows of a log, ...
    heading: float | None = None  # how far the fixture was turned about the vertical, degrees
    stage: float | None = None  # angle of the rotary stage, degrees; used by no estimate

    @property
    def as_set(self) -> PositionSet:
        """What was actually set."""
        if self.tilt is None:
            up = tuple(significant(component, 9) for component in self.gravity)
            return PositionSet(gravity=up, heading=self.heading, stage=self.stage)
        tilt = {axis: float(angle) for axis, angle in self.tilt.items()}
        return PositionSet(tilt=tilt, heading=self.heading, stage=self.stage)

    def record(self, channels: Sequence[str]) -> PositionRecord:
        """Return what was measured, for the calibration file, with the digits that its uncertainty warrants."""
        summaries = [(channel, self.summaries[channel]) for channel in channels]
        return PositionRecord(
            position=self.position,
            mean={c: round_to(summary.mean, summary.u) for c, summary in summaries},
            std={c: significant(summary.std, 4) for c, summary in summaries},
            u={c: significant(summary.u, 4) for c, summary in summaries},
            n=summaries[0][1].n,
            temperature=None if self.temperature is None else round(self.temperature, 3),
            **self.noted,
        )


@dataclass(frozen=True)
class MeasuredSensor:
    """One sensor of a fixture with what was measured of it."""

    sensor: SensorIdentity
    measurements: Sequence[Measurement]
    nominal: Model | None = None  # its facts stand in for what a procedure does not determine; None: not known
    orientation: Sequence[Sequence[float]] = STRAIGHT.matrix  # takes a vector of the fixture's frame to the sensor's
    thermometer_rounding: float = 0.0  # u by the step of its own thermometer, °C; 0 where another was read
    base: CalibrationRecord | None = None  # its calibration, which is completed, or lends its sensitivity
    ramp: RampRecord | None = None  # the record of a ramp, whose one measurement is the attitude
    attitude_stated: bool = True  # of a ramp: else its base says in which attitude it was, and keeps its offset
    temperature_step: float = 0.0  # with which temperatures were recorded, °C; 0 where it is not known


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


def rail_in_words(channel: str, reading: str, rails: tuple[float, float]) -> str:
    """Return what a reading at a rail means, and what to look at."""
    return (
        f"{channel} reads {reading}, at its rail or beyond ({rails[0]:g} to {rails[1]:g}): is this the sensor, are "
        "these its readings in its unit, and is the angle within its range?"
    )


STEP = 0.05  # numbers whose step is more than this, g (3° near level), have too few digits
LEAST_ANGLE = 15.0  # channels whose directions are closer are one channel twice, degrees; ours: no part is so skew
REACTION = 3.0  # expanded uncertainties that a sensitivity must be above zero: by one, noise is in 5 of 100
ROUNDING = 1e-9  # the share of a reading below which a sensitivity is a rounding error
CLEARLY = 2.0  # so many times the sensitivity to its own axis, or to what its unit says, is another axis or unit; ours

COPIES = ("two copies of one channel? Look at the wiring, and at ", Argument("columns"))


def require_tilt(procedure: PositionProcedure, model: Model) -> None:
    """Refuse a device whose readings are no components of gravity, with a UsageError."""
    if not model.senses_tilt:
        others = [channel for channel in model.channels if channel not in AXES]
        raise UsageError(
            f"{procedure.name} takes tilt sensors, which read x, y and z; {model.name} reads {', '.join(others)} "
            "there: in the columns of its address call what senses gravity x, y or z, and skip the rest with -"
        )
    if not procedure.known and tuple(model.channels) != AXES:
        raise UsageError(
            f"free positions need a sensor of three channels x, y and z, and {model.name} has "
            f"{', '.join(model.channels)}: unit gravity does not determine fewer; name a procedure that sets positions"
        )


def unchecked(model: Model) -> str:
    """Return which check of the positions is off, because the address states no nominal value; else nothing."""
    if not model.scaled:
        return "no sensitivity= is stated, so that neither a wrong position nor a small movement is detected"
    if model.offset_spread > UNKNOWN_OFFSET:
        return "no offset= is stated, so that positions are compared with each other alone, and the first with none"
    return ""


def require_suitable(procedure: PositionProcedure, model: Model, orientation: Orientation = STRAIGHT) -> None:
    """Refuse a device that reads no tilt, and positions beyond its rails, with a UsageError."""
    require_tilt(procedure, model)
    for position in procedure.positions:
        gravity = orientation.seen(position.gravity)
        for channel in model.channels:
            expected = model.offset + model.sensitivity * gravity[AXES.index(channel)]
            if not model.rails[0] < expected < model.rails[1]:
                raise UsageError(
                    f"position {position.name} is outside the range of {model.name}: {channel} would read about "
                    f"{expected:.5g} {model.unit}, and reads from {model.rails[0]:g} to {model.rails[1]:g}",
                    advice="" if procedure.angle is None else ("a smaller ", Argument("tilt"), " brings it in range"),
                )


def require_own_readings(sensor: MeasuredSensor) -> None:
    """Refuse readings at a rail, and two channels that read alike, noise and all, with an EstimateError."""
    rails = rails_of(sensor.sensor.channels, sensor.nominal, sensor.base) if sensor.ramp is None else {}
    for channel, (low, high) in rails.items():
        for measurement in sensor.measurements:
            mean = measurement.summaries[channel].mean
            if not low < mean < high:
                reads = f"{mean:.6g} {sensor.sensor.unit} in {measurement.position}"
                raise EstimateError(rail_in_words(channel, reads, (low, high)))
    for first, second in combinations(sensor.sensor.channels, 2):
        pairs = [(measurement.summaries[first], measurement.summaries[second]) for measurement in sensor.measurements]
        if any(a.std for a, _ in pairs) and all(a.mean == b.mean and a.std == b.std for a, b in pairs):
            raise EstimateError(f"{first} and {second} read the same in every position", advice=COPIES)


def judge_channels(sensor: MeasuredSensor, found: Estimate) -> tuple[str, ...]:
    """Return remarks on the wiring that the sensitivities show; refused where one is zero or two are alike."""
    u, factors, coefficients = found.uncertainty(), found.uncertain.by_name(found.uncertain.factors), found.coefficients
    near_level, unit = coefficients.per_radian, sensor.sensor.fitted_unit
    rows = dict(zip(coefficients.channels, near_level * coefficients.sensitivity, strict=True))
    remarks: list[str] = []
    for channel, row in rows.items():
        sensitivity, axis = max((abs(float(value)), axis) for axis, value in zip(coefficients.axes, row, strict=True))
        name = f"sensitivity.{channel}.{axis}"
        largest = max(abs(measurement.summaries[channel].mean) for measurement in sensor.measurements)
        expanded = near_level * factors.get(name, 2.0) * u[name]
        usual = sensor.nominal.sensitivity if sensor.nominal is not None and sensor.nominal.scaled else 0.0
        usual = abs(usual) or near_level_of(unit)
        step = max(measurement.summaries[channel].resolution for measurement in sensor.measurements)
        coarse = f"the numbers of {channel} have a step of {step:g} {unit}"
        reacts = usual and sensitivity > usual / CLEARLY  # as much as it should, however uncertain
        if not reacts and sensitivity <= max(REACTION * expanded, ROUNDING * largest):
            raise EstimateError(
                f"{channel} of {sensor.sensor.serial} does not react to gravity: its sensitivity is "
                f"{significant(sensitivity, 3):g} ± {significant(expanded, 2):g} "
                f"{unit}/g; "
                + (
                    f"{coarse}: give them with more digits"
                    if step > STEP * sensitivity
                    else "see that the channel is wired, and that its sensor converts"
                )
            )
        if step > STEP * sensitivity:
            remarks.append(f"{coarse}, {degrees(step / sensitivity):.2g}° near level: give them with more digits")
    for (first, a), (second, b) in combinations(rows.items(), 2):
        angle = degrees(acos(min(abs(float(a @ b)) / float(np.linalg.norm(a) * np.linalg.norm(b)), 1.0)))
        if angle < LEAST_ANGLE:
            raise EstimateError(f"{first} and {second} answer to gravity alike, {angle:.1f}° apart", advice=COPIES)
    return (*remarks, *remarks_on_wiring(coefficients, unit))


def near_level_of(unit: str) -> float:
    """Return what 1 g, or near level a radian, is in a unit; 0 where the unit does not say it."""
    return OF_G.get(unit) or OF_TILT.get(unit, 0.0)


def remarks_on_wiring(coefficients: Coefficients, unit: str) -> Iterator[str]:
    """Yield remarks on channels that are exchanged or turned, and on readings of another unit."""
    axes, takes = coefficients.axes, {}
    for channel, row in zip(coefficients.channels, np.abs(coefficients.sensitivity), strict=True):
        if channel in axes:  # it measures its own axis, unless its sensitivity to another is clearly larger
            strongest = int(np.argmax(row))
            takes[channel] = axes[strongest] if row[strongest] > CLEARLY * row[axes.index(channel)] else channel
    for first, second in combinations(takes, 2):
        if takes[first] == second and takes[second] == first:
            yield f"{first} and {second} are swapped: each answers to the other's axis; look at the wiring or --columns"
    for channel, axis in takes.items():
        if axis != channel and takes.get(axis) != channel:
            yield f"channel {channel} answers to axis {axis} more than to its own: look at the wiring or --columns"
        if axis == channel and coefficients.own_sensitivity(channel) < 0.0:
            yield f"the sign of {channel} is turned: it reads less where +{channel} points up; look at how it sits"
    for channel, row in zip(coefficients.channels, coefficients.sensitivity, strict=True):
        size, usual = coefficients.per_radian * float(np.linalg.norm(row)), near_level_of(unit)
        if usual and not usual / CLEARLY < size < usual * CLEARLY:
            half = f"{channel} reads {size / 2:.3g} {unit} for 0.5 g, which is {usual / 2:.3g} {unit}"
            other = "degrees" if DEGREES / CLEARLY < size < DEGREES * CLEARLY else f"in {unit}"
            if unit in OF_TILT:
                other = "components of gravity, in g" if size < CLEARLY else f"in {unit}"
            yield f"{half}: are the readings {other}?"
