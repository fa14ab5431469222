"""What was calibrated, when, by whom and from what: the head of the page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from tiltcal.files.calibration import CalibrationRecord
from tiltcal.report.record import leaves, section, text

VIRTUAL = "virtual"
"""What a file that no real sensor made says of itself."""

_WORDS = {
    "made_by": "Made by",
    "operator": "Operator",
    "bench.address": "Address",
    "bench.axes": "Axes on the bench",
    "bench.thermometer": "Thermometer",
    "software": "Software",
    "journal.name": "Journal",
    "journal.sha256": "SHA-256 of the journal",
    "log.name": "Log",
    "log.rows": "Rows of the log",
    "log.missing": "Rows left out",
    "log.sha256": "SHA-256 of the log",
    "segments.name": "Segments",
    "segments.sha256": "SHA-256 of the segments",
    "table.name": "Table of positions",
    "table.sha256": "SHA-256 of the table",
    "stage_angle": "Stage angle",
}


@dataclass(frozen=True)
class FileFacts:
    """A calibration file as it lies on the disk."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Fact:
    """One line of the head; ``code`` where it is for machines."""

    label: str
    value: str
    code: bool = False


def facts(calibration: CalibrationRecord, source: FileFacts) -> list[Fact]:
    """What was calibrated, when and by whom, and everything else that the provenance says."""
    sensor = calibration.sensor
    return [
        Fact("Sensor", sensor.model),
        Fact("Serial number", sensor.serial),
        Fact("Readings", f"{', '.join(sensor.channels)}, in {sensor.unit}"),
        *provenance_facts(calibration.provenance),
        Fact("Calibration file", source.name),
        Fact("SHA-256 of the file", source.sha256, code=True),
    ]


def provenance_facts(provenance: Mapping[str, Any]) -> list[Fact]:
    """All that a provenance says, times first."""
    return [fact for fact in _facts(provenance) if fact.value]


def _facts(provenance: Mapping[str, Any]) -> Iterator[Fact]:
    yield Fact("Calibrated", period(provenance))
    for name, value in leaves(provenance):
        if name not in ("started", "ended") and not (name == "made_by" and notice(provenance)):
            label = _WORDS.get(name, name[:1].upper() + name[1:].replace("_", " ").replace(".", ": "))
            yield Fact(label, value, code=name.endswith(("sha256", "address")))


def period(provenance: Mapping[str, Any]) -> str:
    """When the session began and ended, to the second, in UTC."""
    started, ended = text(provenance, "started"), text(provenance, "ended")
    if not started or not ended:
        return _moment(started or ended or "")
    first, last = _moment(started), _moment(ended)
    day, _, _ = first.partition(" ")
    return f"{first} to {last.removeprefix(day + ' ')}" if last != first else first


def notice(provenance: Mapping[str, Any]) -> str:
    """What has to be said above all: that no real sensor was measured; empty for a real one."""
    made_by = text(provenance, "made_by") or ""
    return f"Made by {made_by}." if VIRTUAL in made_by else ""


def procedure_facts(calibration: CalibrationRecord) -> list[Fact]:
    """Which procedure was run, and how."""
    run = calibration.procedure
    said = [
        ("Procedure", " – ".join(filter(None, (text(run, "name"), text(run, "title"))))),
        ("Source", text(run, "source")),
        ("Samples per position", text(run, "samples")),
        ("Still before sampling", f"{text(run, 'settle_seconds')} s" if text(run, "settle_seconds") else None),
    ]
    left = {
        key: value
        for key, value in run.items()
        if key not in ("name", "title", "source", "samples", "settle_seconds", "set", "mounting")
    }
    more = [(name.replace("_", " ").capitalize(), value) for name, value in leaves(left)]
    mounting = section(run, "mounting")
    if mounting:
        more.append(("Mounting", "; ".join(f"{name.replace('_', ' ')} {value}" for name, value in leaves(mounting))))
    return [Fact(label, value) for label, value in (*said, *more) if value]


def _moment(stamp: str) -> str:
    """A time of the file without its fractions: ``2026-05-01 12:00:00 UTC``."""
    day, _, clock = stamp.partition("T")
    if not clock:
        return stamp
    seconds, _, _ = clock.removesuffix("Z").partition(".")
    return f"{day} {seconds}{' UTC' if clock.endswith('Z') else ''}"
