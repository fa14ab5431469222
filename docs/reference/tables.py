"""The tables of docs/reference/files.md, from the types of the records."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import NoneType
from typing import Any, NamedTuple, get_args, get_origin

from msgspec import NODEFAULT, Struct
from msgspec.structs import fields

from tiltcal.files.bench import BenchFile
from tiltcal.files.calibration import LimitsSection, SensorIdentity, TiltFile
from tiltcal.files.coefficients import CoefficientsSection, UncertaintySection
from tiltcal.files.defaults import DefaultsFile
from tiltcal.files.device import DeviceFile
from tiltcal.files.pair import PairFile
from tiltcal.files.procedure_file import ProcedureFile, RotationSection
from tiltcal.files.results import DerivedRecord, FitRecord, PositionRecord, ProcedureRecord, Provenance
from tiltcal.files.tables import SegmentRow, TabledRow
from tiltcal.files.twin import DiskSection, TwinFile
from tiltcal.journal.header import Setup

PAGE = Path(__file__).with_name("files.md")

TABLES: dict[str, type[Struct]] = {
    "sensor": SensorIdentity,
    "calibration": CoefficientsSection,
    "uncertainty": UncertaintySection,
    "limits": LimitsSection,
    "derived": DerivedRecord,
    "fit": FitRecord,
    "procedure-run": ProcedureRecord,
    "positions-measured": PositionRecord,
    "provenance": Provenance,
    "pair": PairFile,
    "procedure": ProcedureFile,
    "rotation": RotationSection,
    "bench": BenchFile,
    "defaults": DefaultsFile,
    "device": DeviceFile,
    "twin": TwinFile,
    "disk": DiskSection,
    "segments": SegmentRow,
    "table": TabledRow,
    "journal-header": Setup,
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
    for key in keys_in(TiltFile):
        yield _row(key.name, key, f"{key.text}, [below](#section-{key.name})")


def _rows(record: type[Struct], lead: str = "") -> Iterator[str]:
    for key in keys_in(record):
        yield _row(f"{lead}{key.name}", key, key.text)
        inner, suffix = _section_in(key.kind)
        if inner not in (None, DeviceFile):
            yield from _rows(inner, f"{lead}{key.name}{suffix}.")


class Key(NamedTuple):
    """A key of a section, as its type declares it."""

    name: str
    kind: Any
    text: str
    usual: str
    default: Any


def keys_in(record: type[Struct]) -> Iterator[Key]:
    """Yield the keys of a section, in the order of the file."""
    for field in fields(record):
        about = field.type.__metadata__[-1]
        default = field.default if field.default_factory is NODEFAULT else field.default_factory()
        yield Key(field.encode_name, field.type, about.description, about.extra["usual"], default)


def _row(name: str, key: Key, text: str) -> str:
    return f"| `{name}` | {_default(key)} | {text} |".replace("|  |", "| |")


def _default(key: Key) -> str:
    if key.default is NODEFAULT:
        return "needed"
    if key.usual or key.default is None:
        return key.usual
    if isinstance(key.default, bool):
        return f"`{str(key.default).lower()}`"
    return f"{key.default:g}" if isinstance(key.default, int | float) else ""


def _section_in(kind: Any) -> tuple[type[Struct] | None, str]:
    """The section that a value is made of, and how its keys are reached from the value's key."""
    if isinstance(kind, type) and issubclass(kind, Struct):
        return kind, ""
    if hasattr(kind, "__metadata__"):
        return _section_in(kind.__origin__)
    members = [member for member in get_args(kind) if member is not NoneType]
    members = [one for one in members if isinstance(one, type) and issubclass(one, Struct)] or members
    suffix = {tuple: "[]", Mapping: ".*"}.get(get_origin(kind), "")
    if not members or (suffix == "" and len(members) > 1):
        return None, ""
    inner, more = _section_in(members[-1] if suffix == ".*" else members[0])
    return inner, f"{suffix}{more}"
