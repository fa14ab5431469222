"""What a ``tiltcal.toml`` states for the sessions of a bench; the commands that measure read it, nothing else does."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from tiltcal.errors import InputError
from tiltcal.files.bench import BenchFile
from tiltcal.files.document import Document, document_of
from tiltcal.files.record import FromZero, Record, Text, about
from tiltcal.files.results import Reference, Standard
from tiltcal.files.yaml_text import Place, read_text

DEFAULTS = "tiltcal.toml"  # the name of the file, of the user and of a project

_LINE = re.compile(r"\s*(?:\[([\w. \"'-]+)\]|([\w. \"'-]+)=)")


class DefaultsFile(Record):
    """The content of a ``tiltcal.toml``."""

    operator: Annotated[Text | None, about("the name of who stands there, as in a bench file")] = None
    references: Annotated[Mapping[Standard, Reference], about("the standards, as in a bench file")] = {}
    folder: Annotated[Text | None, about("of calibration files without `-o`; a path counts from this file")] = None
    jig: Annotated[
        FromZero | None, about("standard uncertainty of a set angle, degrees; in the file of a project alone")
    ] = None


@dataclass(frozen=True)
class Defaults:
    """What files state, by key the value and its file; ``remark`` gets each that is used."""

    values: Mapping[str, tuple[Any, str]] = field(default_factory=dict)
    remark: Callable[[str], None] = print

    def instead(self, key: str, stated: Any) -> Any:
        """Return what is stated, and where nothing is the default."""
        if stated not in (None, {}) or key not in self.values:
            return stated
        value, file = self.values[key]
        self.remark(f"{key} {in_words(value)}: not stated, so it is that of {file}")
        return value

    def completing(self, bench: BenchFile, *keys: str) -> BenchFile:
        """Return a bench with the default of each key that it does not state."""
        return bench.replaced(**{key: self.instead(key, getattr(bench, key)) for key in keys})


def in_words(value: Any) -> str:
    """Return a default as one reads it; of references their names."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {one.id}" for name, one in value.items())
    return f"{value:g}°" if isinstance(value, float) else str(value)


def read_defaults(users: Path, projects: Path, remark: Callable[[str], None]) -> Defaults:
    """Return the defaults of both files, those of the project first; a file that is not there states nothing."""
    values: dict[str, tuple[Any, str]] = {}
    for path in (users, projects):
        if os.path.isfile(path):
            document = _document(path)
            stated = document.read(DefaultsFile)
            for name, reference in stated.references.items():
                document.at("references", name).require_moments(reference, "due")
            if path == users and stated.jig is not None:
                why = f"a jig is of one bench: state it in the {DEFAULTS} of the folder where that bench is measured"
                raise document.error(why, "jig")
            found = {key: getattr(stated, key) for key in stated.__struct_fields__}
            if stated.folder is not None:
                found["folder"] = path.parent / Path(stated.folder).expanduser()
            values |= {key: (value, str(path)) for key, value in found.items() if value not in (None, {})}
    return Defaults(values, remark)


def _document(path: Path) -> Document:
    text = read_text(path)
    try:
        data = json.loads(json.dumps(tomllib.loads(text), default=str))  # a date is its text in ISO 8601
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"line (\d+)", str(error))
        raise InputError(str(error), file=str(path), line=int(line[1]) if line else None) from None
    return Document(document_of(data, str(path)).data, _lines(text.split("\n")), str(path))


def _lines(text: Sequence[str]) -> dict[Place, int]:
    """Return the line of each key, by its place."""
    lines: dict[Place, int] = {}
    table: tuple[str, ...] = ()
    for number, line in enumerate(text, start=1):
        if (found := _LINE.match(line)) is not None:
            place = tuple(part.strip(" \"'") for part in (found[1] or found[2]).split("."))
            table = place if found[1] else table
            lines.setdefault(place if found[1] else (*table, *place), number)
    return lines
