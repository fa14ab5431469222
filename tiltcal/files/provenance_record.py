"""The record of what a calibration file was made of: files, bench, software and time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256

from tiltcal.files.declaration import ByName, ListOf, Section, entry
from tiltcal.files.moments import MOMENT
from tiltcal.files.scalars import FROM_ZERO, Integer, Text

VIRTUAL = "the virtual bench: no real sensor was measured"
"""``made_by`` of a file that no real sensor made."""


@dataclass(frozen=True, kw_only=True)
class FileRecord:
    """A file that was read."""

    name: str = entry(Text(), "its name")
    sha256: str | None = entry(Text(), "the SHA-256 of its bytes", default=None)

    @classmethod
    def of_text(cls, name: str, text: str) -> FileRecord:
        """Return the record of a file with this text."""
        return cls(name=name, sha256=sha256(text.encode()).hexdigest())


@dataclass(frozen=True, kw_only=True)
class LogRecord(FileRecord):
    """A log that was read."""

    rows: int | None = entry(Integer(minimum=0), "how many rows it has", default=None)
    missing: int | None = entry(Integer(minimum=0), "how many of them were left out", default=None)


@dataclass(frozen=True, kw_only=True)
class SegmentsRecord:
    """The origin of the still segments of a log: a file, or how they were found."""

    name: str | None = entry(Text(), "of their file", default=None)
    sha256: str | None = entry(Text(), "the SHA-256 of their file", default=None)
    found: str | None = entry(Text(), "by what they were found", default=None)
    window_rows: int | None = entry(Integer(minimum=1), "rows in which the sensor held still", default=None)
    threshold: float | None = entry(FROM_ZERO, "the largest standard deviation, unit", default=None)
    times_noise: float | None = entry(FROM_ZERO, "the threshold over the noise", default=None)


@dataclass(frozen=True, kw_only=True)
class BenchSensorRecord:
    """One sensor on the stage of a pair calibration."""

    serial: str = entry(Text(), "its serial number")
    model: str | None = entry(Text(), "its model", default=None)
    address: str | None = entry(Text(), "its address", default=None)


@dataclass(frozen=True, kw_only=True)
class BenchRecord:
    """The bench that measured."""

    address: str | None = entry(Text(), "of the sensor", default=None)
    axes: tuple[str, ...] = entry(
        ListOf(Text()), "of the fixture that the sensor's axes point along, where it does not sit straight", default=()
    )
    thermometer: str | None = entry(Text(), "address of the thermometer", default=None)
    sensors: tuple[BenchSensorRecord, ...] = entry(
        ListOf(Section(BenchSensorRecord)), "of a pair: the sensors on the stage", default=()
    )


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """The provenance of a tilt calibration."""

    made_by: str | None = entry(Text(), "`measurement`, `the virtual bench …`, `fit of …`", default=None)
    operator: str | None = entry(Text(), "who led the session", default=None)
    bench: BenchRecord | None = entry(Section(BenchRecord), "`address`, `axes` and `thermometer`", default=None)
    base: FileRecord | None = entry(
        Section(FileRecord), "the calibration that it builds on (`--base`): `name`, `sha256`", default=None
    )
    sources: tuple[FileRecord, ...] = entry(
        ListOf(Section(FileRecord)), "the calibrations that `combine` put together: `name`, `sha256`", default=()
    )
    log: LogRecord | None = entry(Section(LogRecord), "the log: `name`, `rows`, `missing`, `sha256`", default=None)
    table: FileRecord | None = entry(Section(FileRecord), "the table of positions: `name`, `sha256`", default=None)
    segments: SegmentsRecord | None = entry(
        Section(SegmentsRecord), "the segments: `name` and `sha256`, or how they were `found`", default=None
    )
    software: str | None = entry(Text(), "program and version", default=None)
    started: str | None = entry(MOMENT, "when the session began, UTC", default=None)
    ended: str | None = entry(MOMENT, "when the session ended, UTC", default=None)
    journal: FileRecord | None = entry(Section(FileRecord), "the journal: `name`, `sha256`", default=None)
    link_statistics: Mapping[str, int] | None = entry(
        ByName(Integer(minimum=0)),
        "[what became of what a sensor said](../explanation.md#lost-and-damaged)",
        default=None,
        formerly="reception",
    )


@dataclass(frozen=True, kw_only=True)
class SamplesRecord:
    """The numbers of samples of a rotation."""

    used: int = entry(Integer(minimum=0), "samples that were used")
    left_out: int = entry(Integer(minimum=0), "samples that were left out")


@dataclass(frozen=True, kw_only=True)
class PairProvenance:
    """The provenance of a pair calibration."""

    made_by: str | None = entry(Text(), "`measurement`, `the virtual bench …`, `match of …`", default=None)
    operator: str | None = entry(Text(), "who led the session", default=None)
    bench: BenchRecord | None = entry(
        Section(BenchRecord), "`sensors`: `serial`, `model` and `address` of each", default=None
    )
    software: str | None = entry(Text(), "program and version", default=None)
    log: LogRecord | None = entry(Section(LogRecord), "the log: `name`, `rows`, `missing`, `sha256`", default=None)
    stage_angle: str | None = entry(Text(), "how the stage angle was found, where it was estimated", default=None)
    started: str | None = entry(MOMENT, "when the session began, UTC", default=None)
    ended: str | None = entry(MOMENT, "when the session ended, UTC", default=None)
    journal: FileRecord | None = entry(Section(FileRecord), "the journal: `name`, `sha256`", default=None)
    link_statistics: Mapping[str, Mapping[str, int]] | None = entry(
        ByName(ByName(Integer(minimum=0))),
        "per serial number, [what became of what the sensors said](../explanation.md#lost-and-damaged)",
        default=None,
        formerly="reception",
    )
    procedure: str | None = entry(Text(), "the name of the rotation procedure", default=None)
    samples: SamplesRecord | None = entry(Section(SamplesRecord), "`used` and `left_out`", default=None)
    stopped: str | None = entry(Text(), "why the rotation ended", default=None)
    not_matched: tuple[str, ...] = entry(ListOf(Text()), "pairs that could not be matched, and why", default=())
