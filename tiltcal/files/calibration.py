"""The calibration file of one sensor, ``kind: tilt``.

Angles are computed with the sections sensor, calibration, uncertainty and limits. The others (derived, fit, procedure,
positions, provenance) are records for people and later questions. Every key and value of them all is checked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, radians
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from tiltcal.core.model import AXES, Array, Coefficients, Limits
from tiltcal.core.mounting_angles import mounting_matrix
from tiltcal.core.mounting_rotation import rotation_vector
from tiltcal.core.named_coefficients import CoefficientChange, changes, difference_of, referred, values
from tiltcal.core.uncertainty_inputs import TURN
from tiltcal.errors import UsageError
from tiltcal.files.coefficients import CoefficientsSection, coefficients_of, coefficients_section, in_degrees
from tiltcal.files.document import Document, read_document
from tiltcal.files.emitter import yaml_text
from tiltcal.files.record import Axis, ByAxis, Range, Record, Text, about, file_data
from tiltcal.files.results import DerivedRecord, FitRecord, PositionRecord, ProcedureRecord, Provenance
from tiltcal.files.uncertainty import (
    Uncertainty,
    UncertaintySection,
    known_coefficients,
    known_turns,
    uncertainty_of,
    uncertainty_section,
)

UNDETERMINED = 1e-3
"""The positions do not determine a coefficient whose uncertainty is its prior's within this share."""

UNKNOWN_MODEL = "recorded"
"""The model in a file of `fit`, where the user named none."""


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


class LimitsSection(Record, kw_only=True):
    """The section ``limits`` as it stands in a file."""

    tilt: Annotated[Range | ByAxis[Range], about("`[low, high]` per axis, or for all of them, degrees")] = {}
    temperature: Annotated[Range | None, about("`[low, high]`, °C")] = None
    reading: Annotated[
        Range | ByAxis[Range], about("the rails `[low, high]` per channel, or for all of them, unit")
    ] = {}


class TiltFile(Record, kw_only=True):
    """The content of a calibration file as it stands there."""

    always_written = ("uncertainty", "limits", "derived", "fit", "procedure", "positions", "provenance")

    sensor: Annotated[SensorIdentity, about("which sensor it is")]
    calibration: Annotated[CoefficientsSection, about("the coefficients")]
    uncertainty: Annotated[
        UncertaintySection, about("standard uncertainties (k = 1) in the shape of `calibration`")
    ] = UncertaintySection()
    limits: Annotated[LimitsSection, about("the ranges that were covered")] = LimitsSection()
    derived: Annotated[DerivedRecord, about("what follows from the coefficients")] = DerivedRecord()
    fit: Annotated[FitRecord, about("how well the positions agree")] = FitRecord()
    procedure: Annotated[ProcedureRecord, about("the procedure as run")] = ProcedureRecord()
    positions: Annotated[
        tuple[PositionRecord, ...],
        about("what was measured in each position; those of a mounting and of a level come last"),
    ] = ()
    provenance: Annotated[Provenance, about("how it was made")] = Provenance()


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
    def runs(self) -> tuple[tuple[PositionRecord, ...], ...]:
        """The positions of the calibration itself, of its mounting and of its level."""
        completing = (self.procedure.mounting, self.procedure.level)
        mounted, levelled = (0 if run is None else len(run.positions) for run in completing)
        first, second = len(self.positions) - mounted - levelled, len(self.positions) - levelled
        return self.positions[:first], self.positions[first:second], self.positions[second:]

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
    coefficients = coefficients_of(file.calibration, document.child("calibration"), channels)
    uncertainty = uncertainty_of(file.uncertainty, document.child("uncertainty"), coefficients)
    for key in ("budget", "priors"):
        document.require_keys(getattr(file.fit, key), list(values(coefficients)), "fit", key)
    for number, leg in enumerate(file.fit.ramp.legs if file.fit.ramp else ()):
        document.require_order(leg.temperature, "fit", "ramp", "legs", number, "temperature")
    for number, position in enumerate(file.positions):
        document.require_moments(position, "time", place=("positions", number))
        if position.rows and position.rows not in (position.row_ranges, *position.row_ranges):
            raise document.error("rows are two numbers [first, end]", "positions", number, "rows")
    document.require_moments(file.provenance, "started", "ended", place=("provenance",))
    return CalibrationRecord(
        sensor=file.sensor,
        coefficients=coefficients,
        uncertainty=uncertainty,
        limits=_limits_of(file.limits, document.child("limits"), coefficients),
        **{name: getattr(file, name) for name in ("derived", "fit", "procedure", "positions", "provenance")},
    )


def _limits_of(section: LimitsSection, place: Document, coefficients: Coefficients) -> Limits:
    # A third column of a two-channel sensor is no axis whose tilt is reported.
    channels, axes = coefficients.channels, coefficients.axes[: len(coefficients.channels)]
    place.require_order(section.temperature, "temperature")
    tilt = _by_name(section.tilt, axes, place, "tilt")
    return Limits(
        tilt={axis: (radians(low), radians(high)) for axis, (low, high) in tilt.items()},
        temperature=section.temperature,
        reading=_by_name(section.reading, channels, place, "reading"),
    )


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


def read_calibration(path: str | Path) -> CalibrationRecord:
    """Read and check a calibration file; an InputError names file, line and key."""
    return tilt_record(read_document(path))


def dump_calibration(calibration: CalibrationRecord) -> str:
    """Return the text of a calibration file, its numbers as they are: round them before.

    An InputError names a NaN, an infinity or data that is not plain.
    """
    limits = calibration.limits
    tilt = {axis: (in_degrees(low), in_degrees(high)) for axis, (low, high) in limits.tilt.items()}
    file = TiltFile(
        sensor=calibration.sensor,
        calibration=coefficients_section(calibration.coefficients),
        uncertainty=uncertainty_section(calibration.uncertainty),
        limits=LimitsSection(tilt=tilt, temperature=limits.temperature, reading=limits.reading),
        **{name: getattr(calibration, name) for name in ("derived", "fit", "procedure", "positions", "provenance")},
    )
    return yaml_text(file_data("tilt", file), _comments(calibration.sensor.unit))


def require_same_sensor(
    old: CalibrationRecord, new: CalibrationRecord, names: tuple[str, str] = ("one", "the other")
) -> None:
    """Refuse two calibrations that are not of one sensor, with a UsageError that names what differs."""
    for what in ("serial", "model", "unit", "channels"):
        a, b = getattr(old.sensor, what), getattr(new.sensor, what)
        if a != b:
            raise UsageError(
                f"not two calibrations of one sensor: its {what} is {a} in {names[0]} and {b} in {names[1]}"
            )


def _comments(unit: str) -> dict[str, str]:
    """Return the comments of a calibration file: the units of the coefficients, by dotted key."""
    return {
        "calibration.offset": f"{unit}, at the reference temperature",
        "calibration.sensitivity": f"{unit}/g, row = channel, column = axis",
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


def changes_between(
    before: CalibrationRecord, after: CalibrationRecord, reference: float | None
) -> list[CoefficientChange]:
    """Return the change of every coefficient between two calibrations at a temperature, °C, where they have drifts."""
    old, new = (referred(record.coefficients, reference) for record in (before, after))
    earlier, later = (
        known_coefficients(record.uncertainty, record.coefficients, reference) for record in (before, after)
    )
    common: dict[str, float] = {}
    if before.fit.priors == after.fit.priors:
        first, last = responses_to_priors(before), responses_to_priors(after)
        common = {name: float(first[name] @ last[name]) for name in first if name in last}
    found = changes(old, new, earlier, later, common)
    return [*found, *_change_of_lag(before, after), *_turns_between(before, after)]


def responses_to_priors(record: CalibrationRecord) -> dict[str, Array]:
    """Return by how much each coefficient follows each of the data sheet's priors, over that one's uncertainty.

    The sums of products of two files are the covariance of their errors: a prior errs alike in all files of a sensor.
    One that the positions determine in part counts as determined by them.
    """
    covariance, priors = record.uncertainty.covariance, record.fit.priors
    if covariance is None or not set(priors) <= set(covariance.parameters):
        return {}
    places, u = [covariance.parameters.index(name) for name in priors], np.array(list(priors.values()))
    matrix = covariance.as_array()
    undetermined = np.isclose(np.sqrt(np.diag(matrix))[places], u, rtol=UNDETERMINED)
    return dict(zip(covariance.parameters, matrix[:, places] / u * undetermined, strict=True))


def _change_of_lag(before: CalibrationRecord, after: CalibrationRecord) -> Iterator[CoefficientChange]:
    """Yield the change of a thermal lag that both have."""
    thermals = [record.coefficients.thermal for record in (before, after)]
    first, last = (0.0 if thermal is None else thermal.lag for thermal in thermals)
    if first and last:
        u = [record.uncertainty.get("temperature.lag", 0.0) for record in (before, after)]
        yield CoefficientChange("temperature.lag", first, last, hypot(*u) if all(u) else None)


def _turns_between(before: CalibrationRecord, after: CalibrationRecord) -> Iterator[CoefficientChange]:
    """Yield the turn from one mounting to another about each axis of the application, degrees."""
    first, last = (record.coefficients.mounting for record in (before, after))
    if first is None or last is None or first == last:
        return
    turn = rotation_vector(mounting_matrix(last) @ mounting_matrix(first).T)
    stated = [known_turns(record.uncertainty, record.coefficients) for record in (before, after)]
    for axis, angle in zip(AXES, np.degrees(turn).tolist(), strict=True):
        name = f"{TURN}{axis}"
        yield CoefficientChange(name, 0.0, angle, *difference_of(stated[0].get(name), stated[1].get(name)))
