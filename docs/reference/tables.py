"""The tables of docs/reference/files.md, from the declarations of the formats."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tiltcal.files.bench import BenchFile
from tiltcal.files.calibration import CalibrationRecord, LimitsSection, SensorIdentity
from tiltcal.files.coefficients import CoefficientsSection
from tiltcal.files.declaration import (
    ByKey,
    ByName,
    Converted,
    Either,
    Format,
    KeyDeclaration,
    ListOf,
    Section,
    entries_of,
)
from tiltcal.files.derived_record import DerivedRecord
from tiltcal.files.fit_record import FitRecord
from tiltcal.files.journal_header import Header
from tiltcal.files.pair import PairRecord
from tiltcal.files.position_record import PositionRecord, ProcedureRecord
from tiltcal.files.positions import TabledRow
from tiltcal.files.procedure import Procedure
from tiltcal.files.provenance_record import Provenance
from tiltcal.files.rotation import Rotation
from tiltcal.files.segments import SegmentRow
from tiltcal.files.twin import DiskSection, TwinFile
from tiltcal.files.uncertainty import UncertaintySection

PAGE = Path(__file__).with_name("files.md")

TABLES: dict[str, type[Any]] = {
    "sensor": SensorIdentity,
    "calibration": CoefficientsSection,
    "uncertainty": UncertaintySection,
    "limits": LimitsSection,
    "derived": DerivedRecord,
    "fit": FitRecord,
    "procedure-run": ProcedureRecord,
    "positions-measured": PositionRecord,
    "provenance": Provenance,
    "pair": PairRecord,
    "procedure": Procedure,
    "rotation": Rotation,
    "bench": BenchFile,
    "twin": TwinFile,
    "disk": DiskSection,
    "segments": SegmentRow,
    "table": TabledRow,
    "journal-header": Header,
}

_TABLE = re.compile(r"(<!-- table ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def page() -> str:
    """Return files.md with its tables made anew."""
    return _TABLE.sub(lambda found: f"{found[1]}{table(found[2])}{found[3]}", PAGE.read_text(encoding="utf-8"))


def table(name: str) -> str:
    """Return the table of a section: its keys and those of the sections in it, their defaults and meaning."""
    rows = _top() if name == "calibration-file" else _rows(TABLES[name])
    return "\n".join(["| key | needed or default | meaning |", "|---|---|---|", *rows, ""])


def _top() -> Iterator[str]:
    """The sections of a calibration file, each of which has a table of its own."""
    for one in entries_of(CalibrationRecord).values():
        yield _row(one.key, one, f"{one.text}, [below](#section-{one.key})")


def _rows(record: type[Any], lead: str = "") -> Iterator[str]:
    for one in entries_of(record).values():
        yield _row(f"{lead}{one.key}", one, one.text)
        inner, suffix = _section_in(one.form)
        if inner is not None:
            yield from _rows(inner, f"{lead}{one.key}{suffix}.")


def _row(key: str, one: KeyDeclaration, text: str) -> str:
    return f"| `{key}` | {_default(one)} | {text} |".replace("|  |", "| |")


def _default(one: KeyDeclaration) -> str:
    if one.required:
        return "needed"
    if one.usual or one.default is None:
        return one.usual
    if isinstance(one.default, bool):
        return f"`{str(one.default).lower()}`"
    return f"{one.default:g}" if isinstance(one.default, int | float) else ""


def _section_in(form: Format[Any]) -> tuple[type[Any] | None, str]:
    """The section that a value is made of, and how its keys are reached from the value's key."""
    match form:
        case Section():
            return form.record, ""
        case Converted():
            return _section_in(form.form)
        case Either():
            return _section_in(form.usual)
        case ListOf():
            inner, suffix = _section_in(form.item)
            return inner, f"[]{suffix}"
        case ByKey() | ByName():
            inner, suffix = _section_in(form.item)
            return inner, f".*{suffix}"
    return None, ""
