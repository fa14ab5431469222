"""The calibration file of one sensor, ``kind: tilt``.

Angles are computed with the sections sensor, calibration, uncertainty and limits. The others (derived, fit, procedure,
positions, provenance) are records for people and later questions. Every key and value of them all is checked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, radians
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.model import AXES, Coefficients, Limits
from tiltcal.core.mounting_angles import mounting_matrix
from tiltcal.core.mounting_rotation import rotation_vector
from tiltcal.core.named_coefficients import CoefficientChange, changes, difference_of, values
from tiltcal.core.uncertainty_inputs import TURN
from tiltcal.errors import UsageError
from tiltcal.files.coefficients import COEFFICIENTS, in_degrees
from tiltcal.files.declaration import ANY, ByChannel, Context, Converted, Format, ListOf, Section, entry
from tiltcal.files.derived_record import DerivedRecord
from tiltcal.files.document import read_document
from tiltcal.files.emitter import yaml_text
from tiltcal.files.fit_record import FitRecord
from tiltcal.files.node import Node
from tiltcal.files.position_record import PositionRecord, ProcedureRecord
from tiltcal.files.provenance_record import Provenance
from tiltcal.files.scalars import Choice, Range, Text
from tiltcal.files.uncertainty import UNCERTAINTY, Uncertainty, known_coefficients, known_turns


def _channels(found: tuple[str, ...], node: Node, context: Context) -> tuple[str, ...]:
    if not found or len(set(found)) < len(found):
        raise node.error("channels are one to three different ones of x, y, z")
    return found


UNKNOWN_MODEL = "recorded"
"""The model in a file of `fit`, where the user named none."""


@dataclass(frozen=True)
class SensorIdentity:
    """The sensor that a calibration belongs to."""

    model: str = entry(Text(), "its model, such as `sca100t-d02`; `recorded` where `fit` was given none")
    serial: str = entry(Text(), "its serial number")
    unit: str = entry(Text(), "of its readings: `count`, `V`, `duty`, `m/s2`, …")
    channels: tuple[str, ...] = entry(
        Converted(ListOf(Choice(AXES)), _channels, more={"minItems": 1, "maxItems": 3, "uniqueItems": True}),
        "its readings, one to three of x, y, z",
    )


@dataclass(frozen=True)
class Ranges(ByChannel[tuple[float, float]]):
    """A range for each of some channels or axes, or one for all of them."""

    item: Format[tuple[float, float]] = Range()

    def read(self, node: Node, context: Context = ANY) -> dict[str, tuple[float, float]]:
        # A third column of a two-channel sensor is no axis whose tilt is reported.
        known = context.channels if self.of == "channels" else context.axes[: len(context.channels)]
        return self._read(node, known, context) if node.is_mapping else dict.fromkeys(known, node.interval())

    def schema(self) -> dict[str, Any]:
        return {"anyOf": [self.item.schema(), super().schema()]}


@dataclass(frozen=True, kw_only=True)
class LimitsSection:
    """The section ``limits`` as it stands in a file."""

    tilt: Mapping[str, tuple[float, float]] = entry(
        Ranges(of="axes"), "`[low, high]` per axis, or for all of them, degrees", default={}
    )
    temperature: tuple[float, float] | None = entry(Range(), "`[low, high]`, °C", default=None)
    reading: Mapping[str, tuple[float, float]] = entry(
        Ranges(of="channels"), "the rails `[low, high]` per channel, or for all of them, unit", default={}
    )


def _limits_of(section: LimitsSection, node: Node, context: Context) -> Limits:
    tilt = {axis: (radians(low), radians(high)) for axis, (low, high) in section.tilt.items()}
    return Limits(tilt=tilt, temperature=section.temperature, reading=dict(section.reading))


def _limits_section(limits: Limits) -> LimitsSection:
    tilt = {axis: (in_degrees(low), in_degrees(high)) for axis, (low, high) in limits.tilt.items()}
    return LimitsSection(tilt=tilt, temperature=limits.temperature, reading=limits.reading)


@dataclass(frozen=True)
class CalibrationRecord:
    """The content of a calibration file; angles of the coefficients and the limits are in radians."""

    sensor: SensorIdentity = entry(Section(SensorIdentity), "which sensor it is")
    coefficients: Coefficients = entry(COEFFICIENTS, "the coefficients", key="calibration")
    uncertainty: Uncertainty = entry(
        UNCERTAINTY, "standard uncertainties (k = 1) in the shape of `calibration`", default=Uncertainty(), kept=True
    )
    limits: Limits = entry(
        Converted(Section(LimitsSection), _limits_of, _limits_section),
        "the ranges that were covered",
        default=Limits(),
        kept=True,
    )
    derived: DerivedRecord = entry(
        Section(DerivedRecord), "what follows from the coefficients", default=DerivedRecord(), kept=True
    )
    fit: FitRecord = entry(Section(FitRecord), "how well the positions agree", default=FitRecord(), kept=True)
    procedure: ProcedureRecord = entry(
        Section(ProcedureRecord), "the procedure as run", default=ProcedureRecord(), kept=True
    )
    positions: tuple[PositionRecord, ...] = entry(
        ListOf(Section(PositionRecord)),
        "what was measured in each position; those of a mounting and of a level come last",
        default=(),
        kept=True,
    )
    provenance: Provenance = entry(Section(Provenance), "how it was made", default=Provenance(), kept=True)

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


def _names(key: str, found: Mapping[str, Any], context: Context) -> Context:
    """Return the channels, axes and coefficients that the later sections may name."""
    if "coefficients" in found:
        coefficients: Coefficients = found["coefficients"]
        return Context(coefficients.channels, coefficients.axes, tuple(values(coefficients)))
    return Context(found["sensor"].channels)


TILT = Section(CalibrationRecord, follow=_names, kind="tilt")
"""The calibration file."""


def read_calibration(path: str | Path) -> CalibrationRecord:
    """Read and check a calibration file; an InputError names file, line and key."""
    return TILT.read(read_document(path))


def dump_calibration(calibration: CalibrationRecord) -> str:
    """Return the text of a calibration file, its numbers as they are: round them before.

    An InputError names a NaN, an infinity or data that is not plain.
    """
    return yaml_text(TILT.write(calibration), _comments(calibration.sensor.unit))


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


def changes_between(before: CalibrationRecord, after: CalibrationRecord) -> list[CoefficientChange]:
    """Return the change of every coefficient between two calibrations, at the later one's reference temperature."""
    thermal = after.coefficients.thermal
    reference = None if thermal is None else thermal.reference
    known = (
        known_coefficients(calibration.uncertainty, calibration.coefficients, reference)
        for calibration in (before, after)
    )
    found = changes(before.coefficients, after.coefficients, *known)
    return [*found, *_change_of_lag(before, after), *_turns_between(before, after)]


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
        yield CoefficientChange(name, 0.0, angle, *difference_of(*(turns.get(name) for turns in stated)))
