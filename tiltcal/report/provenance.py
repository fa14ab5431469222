"""The head of the page: what was calibrated, when, by whom and from which data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.record import plain
from tiltcal.files.results import FileRecord, PairProvenance, Provenance

_VIRTUAL = "virtual"
"""The mark of a file that was made without a real sensor."""

_WORDS = {
    "made_by": "Made by",
    "operator": "Operator",
    "bench.address": "Address",
    "bench.axes": "Axes on the bench",
    "bench.thermometer": "Thermometer",
    "software": "Software",
    "base.name": "Calibration it builds on",
    "base.sha256": "SHA-256 of that calibration",
    "sources": "Combined of",
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
class Fact:
    """One line of the head; ``code`` for text in a fixed-width font."""

    label: str
    value: str
    code: bool = False


def facts(calibration: CalibrationRecord, source: FileRecord) -> list[Fact]:
    """Return what was calibrated, when and by whom, and the rest of the provenance."""
    sensor = calibration.sensor
    return [
        Fact("Sensor", sensor.model),
        Fact("Serial number", sensor.serial),
        Fact("Readings", f"{', '.join(sensor.channels)}, in {sensor.unit}"),
        *provenance_facts(calibration.provenance, source),
    ]


def provenance_facts(provenance: Provenance | PairProvenance, source: FileRecord) -> list[Fact]:
    """Return the content of a provenance, times first, and the calibration file that states it."""
    file = Fact("Calibration file", source.name), Fact("SHA-256 of the file", source.sha256 or "", code=True)
    return [fact for fact in (*_facts(provenance), *file) if fact.value]


def _facts(provenance: Provenance | PairProvenance) -> Iterator[Fact]:
    yield Fact("Calibrated", period(provenance))
    for name, value in _leaves(plain(provenance)):
        if name not in ("started", "ended") and not (name == "made_by" and notice(provenance)):
            label = _WORDS.get(name, name[:1].upper() + name[1:].replace("_", " ").replace(".", ": "))
            yield Fact(label, value, code=name.endswith(("sha256", "address")))


def period(provenance: Provenance | PairProvenance) -> str:
    """Return the start and end of the session in UTC, to the second."""
    started, ended = provenance.started, provenance.ended
    if not started or not ended:
        return _moment(started or ended or "")
    first, last = _moment(started), _moment(ended)
    day, _, _ = first.partition(" ")
    return f"{first} to {last.removeprefix(day + ' ')}" if last != first else first


def notice(provenance: Provenance | PairProvenance) -> str:
    """Return the notice that no real sensor was measured; empty for a real one."""
    made_by = provenance.made_by or ""
    return f"Made by {made_by}." if _VIRTUAL in made_by else ""


def procedure_facts(calibration: CalibrationRecord) -> list[Fact]:
    """Return the procedure and its settings."""
    run = calibration.procedure
    said = [
        ("Procedure", " – ".join(filter(None, (run.name, run.title)))),
        ("Source", run.source),
        ("Samples per position", run.samples and str(run.samples)),
        ("Still before sampling", run.settle_seconds is not None and f"{run.settle_seconds:g} s"),
    ]
    for label, completing in (("Mounting", run.mounting), ("Level", run.level)):
        if completing is not None:
            kept = _leaves(plain(completing))
            said.append((label, "; ".join(f"{name.replace('_', ' ')} {value}" for name, value in kept)))
    return [Fact(label, value) for label, value in said if value]


def _leaves(record: Mapping[str, Any], lead: str = "") -> Iterator[tuple[str, str]]:
    """Return the content of a record, by dotted names."""
    for key, value in record.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{lead}{key}.")
        else:
            yield f"{lead}{key}", _in_words(value)


def _in_words(value: Any) -> str:
    """Return a value as text."""
    if isinstance(value, float):
        return f"{value:g}" if abs(value) < 1e6 else str(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_in_words(member)}" for key, member in value.items())
    if isinstance(value, list):
        return ", ".join(_in_words(member) for member in value)
    return str(value)


def _moment(stamp: str) -> str:
    """Return a time of the file without its fractions: ``2026-05-01 12:00:00 UTC``."""
    day, _, clock = stamp.partition("T")
    if not clock:
        return stamp
    seconds, _, _ = clock.removesuffix("Z").partition(".")
    return f"{day} {seconds}{' UTC' if clock.endswith('Z') else ''}"
