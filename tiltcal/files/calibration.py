"""The calibration file of one sensor, ``kind: tilt``.

Angles are computed with the sections sensor, calibration, uncertainty and limits. The others (derived, fit, procedure,
positions, provenance) are records for people and later questions. Every key and value of them all is checked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import radians
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from tiltcal.core.angle_readings import AngleReadings
from tiltcal.core.attitude import is_locked, normalised
from tiltcal.core.directions import tilts
from tiltcal.core.model import Coefficients, Limits, Mounting, values
from tiltcal.core.uncertain import Uncertain, uncertain_at
from tiltcal.drivers.model import SLOPES
from tiltcal.files.coefficients import CoefficientsSection, Uncertainty, UncertaintySection, in_degrees
from tiltcal.files.device import DeviceFile
from tiltcal.files.document import Document, parse_document, read_document
from tiltcal.files.record import Axis, ByAxis, Range, Record, Text, about, file_data, one_of
from tiltcal.files.results import (
    DerivedRecord,
    Direction,
    FileRecord,
    FitRecord,
    PositionRecord,
    ProcedureRecord,
    Provenance,
    Sensors,
)
from tiltcal.files.yaml_text import yaml_text
from tiltcal.units import CONVENTIONS

UNKNOWN_MODEL = "recorded"  # the model in a file of `fit`, where the user named none
_ROUNDED = 1e-9  # of a stated pitch, radians: at 90° roll and yaw together are determined
ANGLE = "angle"
INCLINATION, EULER = CONVENTIONS


class SensorIdentity(Record):
    """The sensor that a calibration belongs to."""

    model: Annotated[Text, about("its model, such as `sca100t-d02`; `recorded` where `fit` was given none")]
    serial: Annotated[Text, about("its serial number")]
    unit: Annotated[Text, about("of its readings: `count`, `V`, `duty`, `m/s2`, …")]
    channels: Annotated[
        tuple[Axis, ...],
        Meta(extra_json_schema={"minItems": 1, "maxItems": 3, "uniqueItems": True}),
        about("its readings, one to three of x, y, z"),
    ]
    columns: Annotated[ByAxis[Text], about("the columns of the log it was fitted from: `apply` looks for them")] = {}
    unit_from: Annotated[Text | None, about("`length` where the length of gravity at rest shows the unit")] = None
    reads: Annotated[Annotated[str, one_of(ANGLE)] | None, about("`angle`: each channel prints its own tilt")] = None
    angles: Annotated[
        Annotated[str, one_of(INCLINATION, EULER)] | None,
        about("each channel the arcsine of its component, or pitch and roll; not known where absent"),
    ] = None

    @property
    def angle_readings(self) -> AngleReadings | None:
        """How its channels print angles; None where they read components of gravity."""
        if self.reads is None:
            return None
        return AngleReadings(SLOPES.get(self.unit, 0.0), None if self.angles is None else self.angles == EULER)

    @property
    def fitted_unit(self) -> str:
        """The unit of the coefficients: that of the readings, of slopes degrees."""
        return "°" if self.reads is not None and self.unit in SLOPES else self.unit


class LimitsSection(Record):
    """The section ``limits`` as it stands in a file."""

    directions: Annotated[
        tuple[Direction, ...] | Annotated[str, one_of("all")] | None,
        about("of gravity that three axes met, in the sensor's own frame, or `all`; in place of `tilt`"),
    ] = None
    tilt: Annotated[Range | ByAxis[Range], about("`[low, high]` per axis, or for all of them, degrees")] = {}
    temperature: Annotated[Range | None, about("`[low, high]`, °C")] = None
    reading: Annotated[Range | ByAxis[Range], about("the rails `[low, high]` per channel, or for all, unit")] = {}

    def checked(self, place: Document, axes: Sequence[str], channels: Sequence[str]) -> Limits:
        """Return the limits, angles in radians; an InputError where they contradict the axes or the channels."""
        place.require_order(self.temperature, "temperature")
        tilt, directions = _by_name(self.tilt, axes, place, "tilt"), self.directions
        reach = {axis: (radians(low), radians(high)) for axis, (low, high) in tilt.items()}
        if directions is not None:
            if tilt or len(channels) < 3:
                raise place.error("directions are of three axes, in place of tilt: leave one out", "directions")
            directions = directions if isinstance(directions, str) else tuple(map(normalised, directions))
            reach = tilts(directions)
        reading = _by_name(self.reading, channels, place, "reading")
        return Limits(reach, self.temperature, reading, directions=directions)

    @classmethod
    def of(cls, limits: Limits) -> LimitsSection:
        """Return the section of a file."""
        ranges = limits.tilt.items() if limits.directions is None else ()
        tilt = {axis: (in_degrees(low), in_degrees(high)) for axis, (low, high) in ranges}
        return cls(directions=limits.directions, tilt=tilt, temperature=limits.temperature, reading=limits.reading)


def _by_name(
    ranges: tuple[float, float] | Mapping[str, tuple[float, float]], names: Sequence[str], place: Document, key: str
) -> dict[str, tuple[float, float]]:
    """Return a range for each of the names, which one may state for all."""
    if not isinstance(ranges, Mapping):
        place.require_order(ranges, key)
        return dict.fromkeys(names, ranges)
    place.require_keys(ranges, names, key)
    for name, interval in ranges.items():
        place.require_order(interval, key, name)
    return dict(ranges)


class TiltFile(Record):
    """The content of a calibration file as it stands there."""

    always_written = ("uncertainty", "limits", "derived", "fit", "procedure", "positions", "provenance")

    sensor: Annotated[SensorIdentity, about("which sensor it is")]
    calibration: Annotated[CoefficientsSection, about("the coefficients")]
    uncertainty: Annotated[UncertaintySection, about("standard uncertainties (k = 1)")] = UncertaintySection()
    limits: Annotated[LimitsSection, about("the ranges that were covered")] = LimitsSection()
    derived: Annotated[DerivedRecord, about("what follows from the coefficients")] = DerivedRecord()
    fit: Annotated[FitRecord, about("how well the positions agree")] = FitRecord()
    procedure: Annotated[ProcedureRecord, about("the procedure as run")] = ProcedureRecord()
    positions: Annotated[tuple[PositionRecord, ...], about("what was measured; of a mounting and a level last")] = ()
    provenance: Annotated[Provenance, about("how it was made")] = Provenance()


RECORDS = ("derived", "fit", "procedure", "positions", "provenance")  # alike in a file and in its record


@dataclass(frozen=True)
class CalibrationRecord:
    """The content of a calibration file; angles of the coefficients and the limits are in radians."""

    sensor: SensorIdentity
    coefficients: Coefficients
    uncertainty: Uncertainty = Uncertainty()
    limits: Limits = Limits()
    derived: DerivedRecord = DerivedRecord()
    fit: FitRecord = FitRecord()
    procedure: ProcedureRecord = ProcedureRecord()
    positions: tuple[PositionRecord, ...] = ()
    provenance: Provenance = Provenance()

    @property
    def device(self) -> DeviceFile | None:
        """What the file of a text device says."""
        return None if self.provenance.bench is None else self.provenance.bench.device

    @property
    def uncertain(self) -> Uncertain:
        """The errors of its coefficients and of the mounting's turn; none where no uncertainty is stated."""
        return self.uncertainty.errors(self.coefficients.mounting)

    def uncertain_at(self, reference: float | None) -> Uncertain:
        """Return these errors at another reference temperature, °C."""
        return uncertain_at(self.coefficients, self.uncertain, reference)

    @property
    def text(self) -> str:
        """The text of its file, its numbers as they are: round them before."""
        file = TiltFile(
            sensor=self.sensor,
            calibration=CoefficientsSection.of(self.coefficients),
            uncertainty=UncertaintySection.of(self.uncertainty),
            limits=LimitsSection.of(self.limits),
            **{name: getattr(self, name) for name in RECORDS},
        )
        return yaml_text(file_data("tilt", file), _comments(self.sensor))

    @property
    def sensors(self) -> Sensors:
        """What it is of, so that its file replaces no other."""
        return ("tilt", (self.sensor.model, self.sensor.serial))

    def with_mounting(self, mounting: Mounting) -> CalibrationRecord:
        """Return a calibration with a mounting that is known, and exact; one that it has is replaced."""
        return replace(
            self,
            coefficients=replace(self.coefficients, mounting=mounting),
            uncertainty=self.uncertainty.without_mounting(),
            derived=self.derived.replaced(gimbal_lock=is_locked(mounting.pitch, _ROUNDED)),
            fit=self.fit.replaced(mounting=None),
            procedure=self.procedure.replaced(mounting=None),
            positions=self.positions_with(mounting=()),
        )

    @property
    def runs(self) -> tuple[tuple[PositionRecord, ...], ...]:
        """The positions of the calibration itself, of its mounting and of its level."""
        completing = (self.procedure.mounting, self.procedure.level)
        mounted, levelled = (0 if run is None else len(run.positions) for run in completing)
        first, second = len(self.positions) - mounted - levelled, len(self.positions) - levelled
        return self.positions[:first], self.positions[first:second], self.positions[second:]

    @property
    def offset_positions(self) -> tuple[PositionRecord, ...]:
        """The positions that determined its offset: a level renews it at its own temperature."""
        own, _, levelled = self.runs
        return levelled or own

    @property
    def temperature(self) -> float | None:
        """The reference temperature, without a drift the mean of its positions, °C; None where none is stated."""
        if self.coefficients.thermal is not None:
            return self.coefficients.thermal.reference
        met = [position.temperature for position in self.offset_positions if position.temperature is not None]
        return float(np.mean(met)) if met else None

    def positions_with(
        self, *, mounting: Sequence[PositionRecord] | None = None, level: Sequence[PositionRecord] | None = None
    ) -> tuple[PositionRecord, ...]:
        """Return the positions with others of a mounting or a level; None leaves those that there are."""
        own, mounted, levelled = self.runs
        return (*own, *(mounted if mounting is None else mounting), *(levelled if level is None else level))


def tilt_record(document: Document) -> CalibrationRecord:
    """Return the content of a calibration file, checked; an InputError names file, line and key."""
    document = document.body("tilt")
    file = document.read(TiltFile)
    channels = file.sensor.channels
    if not channels or len(set(channels)) < len(channels):
        raise document.error("channels are one to three different ones of x, y, z", "sensor", "channels")
    coefficients = file.calibration.checked(document.at("calibration"), channels, file.sensor.angle_readings)
    uncertainty = file.uncertainty.checked(document.at("uncertainty"), coefficients)
    for key in ("budget", "priors"):
        document.require_keys(getattr(file.fit, key), list(values(coefficients)), "fit", key)
    for number, leg in enumerate(file.fit.ramp.legs if file.fit.ramp else ()):
        document.require_order(leg.temperature, "fit", "ramp", "legs", number, "temperature")
    for number, position in enumerate(file.positions):
        document.at("positions", number).require_moments(position, "time")
        if position.rows and position.rows not in (position.row_ranges, *position.row_ranges):
            raise document.error("rows are two numbers [first, end]", "positions", number, "rows")
    completing = sum(len(run.positions) for run in (file.procedure.mounting, file.procedure.level) if run is not None)
    if completing > len(file.positions):
        raise document.error(
            f"{len(file.positions)} positions, and a mounting and a level name {completing}", "positions"
        )
    document.at("provenance").require_moments(file.provenance, "started", "ended")
    # A third column of a two-channel sensor is no axis whose tilt is reported.
    axes = coefficients.axes[: len(channels)]
    return CalibrationRecord(
        sensor=file.sensor,
        coefficients=coefficients,
        uncertainty=uncertainty,
        limits=file.limits.checked(document.at("limits"), axes, channels),
        **{name: getattr(file, name) for name in RECORDS},
    )


def read_calibration(path: str | Path) -> CalibrationRecord:
    """Read and check a calibration file; an InputError names file, line and key."""
    return tilt_record(read_document(path))


class BaseFile(Record):
    """A calibration file that a session builds on, whole: the session's journal keeps it."""

    text: Annotated[Text, about("the whole text of the file")]
    name: Annotated[Text, about("its name")]

    @property
    def calibration(self) -> CalibrationRecord:
        """The calibration in it; an InputError names file, line and key of what is wrong."""
        return _record_of(self.text, self.name)

    @property
    def origin(self) -> FileRecord:
        """Its name and SHA-256."""
        return FileRecord.of_text(self.name, self.text)


@lru_cache
def _record_of(text: str, name: str) -> CalibrationRecord:
    return tilt_record(parse_document(text, name))


def _comments(sensor: SensorIdentity) -> dict[str, str]:
    """Return the comments of a calibration file: the units of the coefficients, by dotted key."""
    unit, per = sensor.fitted_unit, "g" if sensor.reads is None else "°"
    return {
        "calibration.offset": f"{unit}, at the reference temperature",
        "calibration.sensitivity": f"{unit}/{per}, row = channel, column = axis",
        "calibration.nonlinearity": "shares of the square and the cube of the own acceleration",
        "calibration.temperature.reference": "°C",
        "calibration.temperature.range": "°C",
        "calibration.temperature.offset": f"{unit}/°C, {unit}/°C², ...",
        "calibration.temperature.sensitivity": "1/°C, 1/°C², ...",
        "calibration.temperature.lag": "s, positive where the sensing element is later than the thermometer",
        "calibration.mounting": "degrees",
        "uncertainty": "standard uncertainty, k = 1",
        "limits": "the ranges that were covered, degrees and °C",
    }
