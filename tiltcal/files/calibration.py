"""The calibration file of one sensor, ``kind: tilt``.

Angles are computed with the sections sensor, calibration, uncertainty and limits. The others (derived, fit, procedure,
positions, provenance) are records for people and later questions. Every key and value of them all is checked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import radians
from pathlib import Path
from typing import Any

from tiltcal.core.comparison import CoefficientChange, changes
from tiltcal.core.model import AXES, Coefficients, Limits
from tiltcal.errors import UsageError
from tiltcal.files.coefficients import (
    in_degrees,
    read_coefficients,
    write_coefficients,
)
from tiltcal.files.declaration import Format, ListOf, Section
from tiltcal.files.document import FORMAT_VERSION, read_tiltcal_file
from tiltcal.files.emitter import yaml_text
from tiltcal.files.node import Node
from tiltcal.files.records import DerivedRecord, FitRecord, PositionRecord, ProcedureRecord, Provenance
from tiltcal.files.uncertainty import Uncertainty, known_coefficients, read_uncertainty, write_uncertainty
from tiltcal.files.whole import write_whole

RECORDS: Mapping[str, Format[Any]] = {
    "derived": Section(DerivedRecord),
    "fit": Section(FitRecord),
    "procedure": Section(ProcedureRecord),
    "positions": ListOf(Section(PositionRecord)),
    "provenance": Section(Provenance),
}


@dataclass(frozen=True)
class SensorIdentity:
    """Which sensor a calibration belongs to.

    Attributes
    ----------
    model : str
        Such as ``sca100t-d02``.
    serial : str
    unit : str
        Of its readings: ``count``, ``V``, ``duty``, ``m/s2``, ...
    channels : tuple of str
        Its readings, distinct ones of x, y, z.
    """

    model: str
    serial: str
    unit: str
    channels: tuple[str, ...]


@dataclass(frozen=True)
class CalibrationRecord:
    """The content of a calibration file.

    Attributes
    ----------
    sensor : SensorIdentity
    coefficients : Coefficients
        Angles in radians.
    uncertainty : Uncertainty
        Standard uncertainties (k = 1) by dotted name, such as ``uncertainty["sensitivity.x.y"]``.
    limits : Limits
        Where the calibration holds; angles in radians.
    derived : DerivedRecord
    fit : FitRecord
    procedure : ProcedureRecord
        As run.
    positions : tuple of PositionRecord
    provenance : Provenance
    """

    sensor: SensorIdentity
    coefficients: Coefficients
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    limits: Limits = field(default_factory=Limits)
    derived: DerivedRecord = field(default_factory=DerivedRecord)
    fit: FitRecord = field(default_factory=FitRecord)
    procedure: ProcedureRecord = field(default_factory=ProcedureRecord)
    positions: tuple[PositionRecord, ...] = ()
    provenance: Provenance = field(default_factory=Provenance)


def read_calibration(path: str | Path) -> CalibrationRecord:
    """Read and check a calibration file.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    CalibrationRecord

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key.
    """
    return calibration_of(read_tiltcal_file(path, "tilt"))


def write_calibration(path: str | Path, calibration: CalibrationRecord) -> None:
    """Write a calibration file, whole or not at all.

    Parameters
    ----------
    path : str or Path
    calibration : CalibrationRecord
        Its numbers are written as they are; round them before.

    Raises
    ------
    UsageError
        The file cannot be written there.
    InputError
        A record holds NaN, an infinity or data that is not plain.
    """
    write_whole(path, dump_calibration(calibration))


def dump_calibration(calibration: CalibrationRecord) -> str:
    """The text of a calibration file; the same calibration gives the same text."""
    sensor, coefficients = calibration.sensor, calibration.coefficients
    data: dict[str, Any] = {
        "tiltcal": FORMAT_VERSION,
        "kind": "tilt",
        "sensor": {
            "model": sensor.model,
            "serial": sensor.serial,
            "unit": sensor.unit,
            "channels": list(sensor.channels),
        },
        "calibration": write_coefficients(coefficients),
        "uncertainty": write_uncertainty(calibration.uncertainty),
        "limits": _write_limits(calibration.limits),
    }
    data.update((name, form.write(getattr(calibration, name))) for name, form in RECORDS.items())
    return yaml_text(data, _comments(sensor.unit))


def calibration_of(document: Node) -> CalibrationRecord:
    """The calibration that a checked document of ``kind: tilt`` holds.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key.
    """
    top = document.mapping(
        required=("tiltcal", "kind", "sensor", "calibration"), optional=("uncertainty", "limits", *RECORDS)
    )
    sensor = _read_sensor(top["sensor"])
    coefficients = read_coefficients(top["calibration"], sensor.channels)
    records: dict[str, Any] = {name: form.read(top[name]) for name, form in RECORDS.items() if name in top}
    return CalibrationRecord(
        sensor=sensor,
        coefficients=coefficients,
        uncertainty=read_uncertainty(top["uncertainty"], coefficients) if "uncertainty" in top else Uncertainty(),
        limits=_read_limits(top["limits"], coefficients) if "limits" in top else Limits(),
        **records,
    )


def require_same_sensor(old: CalibrationRecord, new: CalibrationRecord) -> None:
    """See that two calibrations are of one sensor.

    Raises
    ------
    UsageError
        They are not; the message says in what they differ.
    """
    for what in ("serial", "model", "unit", "channels"):
        a, b = getattr(old.sensor, what), getattr(new.sensor, what)
        if a != b:
            raise UsageError(f"not two calibrations of one sensor: its {what} is {a} in one and {b} in the other")


def _read_sensor(node: Node) -> SensorIdentity:
    section = node.mapping(required=("model", "serial", "unit", "channels"))
    channels = tuple(item.choice(AXES) for item in section["channels"].items())
    if not channels or len(set(channels)) < len(channels):
        raise section["channels"].error("channels are one to three different ones of x, y, z")
    return SensorIdentity(section["model"].text(), section["serial"].text(), section["unit"].text(), channels)


def _read_limits(node: Node, coefficients: Coefficients) -> Limits:
    section = node.mapping(optional=("tilt", "temperature", "reading"))
    # A third column of a two-channel sensor is no axis whose tilt is reported.
    tilted = coefficients.axes[: len(coefficients.channels)]
    tilt = _read_ranges(section["tilt"], tilted) if "tilt" in section else {}
    return Limits(
        tilt={axis: (radians(low), radians(high)) for axis, (low, high) in tilt.items()},
        temperature=section["temperature"].interval() if "temperature" in section else None,
        reading=_read_ranges(section["reading"], coefficients.channels) if "reading" in section else {},
    )


def _read_ranges(node: Node, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """A range for each of some names, or one for all of them."""
    if node.is_mapping:
        return {name: value.interval() for name, value in node.mapping(optional=names).items()}
    return dict.fromkeys(names, node.interval())


def _write_limits(limits: Limits) -> dict[str, Any]:
    section: dict[str, Any] = {}
    if limits.tilt:
        section["tilt"] = {axis: [in_degrees(low), in_degrees(high)] for axis, (low, high) in limits.tilt.items()}
    if limits.temperature is not None:
        section["temperature"] = list(limits.temperature)
    if limits.reading:
        section["reading"] = {channel: list(bounds) for channel, bounds in limits.reading.items()}
    return section


def _comments(unit: str) -> dict[str, str]:
    """The unit behind each key of the ``calibration`` section, and behind the sections that need a word."""
    return {
        "calibration.offset": f"{unit}, at the reference temperature",
        "calibration.sensitivity": f"{unit}/g, row = channel, column = axis",
        "calibration.nonlinearity": "shares of the square and the cube of the own acceleration",
        "calibration.temperature.reference": "°C",
        "calibration.temperature.range": "°C",
        "calibration.temperature.offset": f"{unit}/°C, {unit}/°C², ...",
        "calibration.temperature.sensitivity": "1/°C, 1/°C², ...",
        "calibration.mounting": "degrees",
        "uncertainty": "standard uncertainty, k = 1",
        "limits": "the ranges that were covered, degrees and °C",
    }


def changes_between(before: CalibrationRecord, after: CalibrationRecord) -> list[CoefficientChange]:
    """Every coefficient that two calibrations of one sensor have, at the later one's reference temperature."""
    thermal = after.coefficients.thermal
    reference = None if thermal is None else thermal.reference
    known = (known_coefficients(one.uncertainty, one.coefficients, reference) for one in (before, after))
    return changes(before.coefficients, after.coefficients, *known)
