"""The record of what a calibration file was made of: files, bench, software and time."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from typing import Annotated

from tiltcal.files.record import Count, FiniteFromZero, FromOne, Record, Text, about

VIRTUAL = "the virtual bench: no real sensor was measured"
"""``made_by`` of a file that no real sensor made."""


class FileRecord(Record, kw_only=True):
    """A file that was read."""

    name: Annotated[Text, about("its name")]
    sha256: Annotated[Text | None, about("the SHA-256 of its bytes")] = None

    @classmethod
    def of_text(cls, name: str, text: str) -> FileRecord:
        """Return the record of a file with this text."""
        return cls(name=name, sha256=sha256(text.encode()).hexdigest())


class LogRecord(FileRecord, kw_only=True):
    """A log that was read."""

    rows: Annotated[Count | None, about("how many rows it has")] = None
    missing: Annotated[Count | None, about("how many of them were left out")] = None


class SegmentsRecord(Record, kw_only=True):
    """The origin of the still segments of a log: a file, or how they were found."""

    name: Annotated[Text | None, about("of their file")] = None
    sha256: Annotated[Text | None, about("the SHA-256 of their file")] = None
    found: Annotated[Text | None, about("by what they were found")] = None
    window_rows: Annotated[FromOne | None, about("rows in which the sensor held still")] = None
    threshold: Annotated[FiniteFromZero | None, about("the largest standard deviation, unit")] = None
    times_noise: Annotated[FiniteFromZero | None, about("the threshold over the noise")] = None


class BenchSensorRecord(Record, kw_only=True):
    """One sensor on the stage of a pair calibration."""

    serial: Annotated[Text, about("its serial number")]
    model: Annotated[Text | None, about("its model")] = None
    address: Annotated[Text | None, about("its address")] = None


class BenchRecord(Record, kw_only=True):
    """The bench that measured."""

    address: Annotated[Text | None, about("of the sensor")] = None
    axes: Annotated[
        tuple[Text, ...], about("of the fixture that the sensor's axes point along, where it does not sit straight")
    ] = ()
    thermometer: Annotated[Text | None, about("address of the thermometer")] = None
    sensors: Annotated[tuple[BenchSensorRecord, ...], about("of a pair: the sensors on the stage")] = ()


class Provenance(Record, kw_only=True):
    """The provenance of a tilt calibration."""

    made_by: Annotated[Text | None, about("`measurement`, `the virtual bench …`, `fit of …`")] = None
    operator: Annotated[Text | None, about("who led the session")] = None
    bench: Annotated[BenchRecord | None, about("`address`, `axes` and `thermometer`")] = None
    base: Annotated[FileRecord | None, about("the calibration that it builds on (`--base`): `name`, `sha256`")] = None
    sources: Annotated[
        tuple[FileRecord, ...], about("the calibrations that `combine` put together: `name`, `sha256`")
    ] = ()
    log: Annotated[LogRecord | None, about("the log: `name`, `rows`, `missing`, `sha256`")] = None
    table: Annotated[FileRecord | None, about("the table of positions: `name`, `sha256`")] = None
    segments: Annotated[SegmentsRecord | None, about("the segments: `name` and `sha256`, or how they were `found`")] = (
        None
    )
    software: Annotated[Text | None, about("program and version")] = None
    started: Annotated[Text | None, about("when the session began, UTC")] = None
    ended: Annotated[Text | None, about("when the session ended, UTC")] = None
    journal: Annotated[FileRecord | None, about("the journal: `name`, `sha256`")] = None
    link_statistics: Annotated[
        Mapping[str, Count] | None,
        about("[what became of what a sensor said](../explanation.md#lost-and-damaged)", formerly="reception"),
    ] = None


class SamplesRecord(Record, kw_only=True):
    """The numbers of samples of a rotation."""

    used: Annotated[Count, about("samples that were used")]
    left_out: Annotated[Count, about("samples that were left out")]


class PairProvenance(Record, kw_only=True):
    """The provenance of a pair calibration."""

    made_by: Annotated[Text | None, about("`measurement`, `the virtual bench …`, `match of …`")] = None
    operator: Annotated[Text | None, about("who led the session")] = None
    bench: Annotated[BenchRecord | None, about("`sensors`: `serial`, `model` and `address` of each")] = None
    software: Annotated[Text | None, about("program and version")] = None
    log: Annotated[LogRecord | None, about("the log: `name`, `rows`, `missing`, `sha256`")] = None
    stage_angle: Annotated[Text | None, about("how the stage angle was found, where it was estimated")] = None
    started: Annotated[Text | None, about("when the session began, UTC")] = None
    ended: Annotated[Text | None, about("when the session ended, UTC")] = None
    journal: Annotated[FileRecord | None, about("the journal: `name`, `sha256`")] = None
    link_statistics: Annotated[
        Mapping[str, Mapping[str, Count]] | None,
        about(
            "per serial number, [what became of what the sensors said](../explanation.md#lost-and-damaged)",
            formerly="reception",
        ),
    ] = None
    procedure: Annotated[Text | None, about("the name of the rotation procedure")] = None
    samples: Annotated[SamplesRecord | None, about("`used` and `left_out`")] = None
    stopped: Annotated[Text | None, about("why the rotation ended")] = None
    not_matched: Annotated[tuple[Text, ...], about("pairs that could not be matched, and why")] = ()
