"""Small tables in CSV or JSON, read as strictly as YAML: positions with their mean readings, and segments of a log.

An error names file, line and column.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from tiltcal.column_names import meaning
from tiltcal.core.attitude import Vector, normalised
from tiltcal.core.model import AXES
from tiltcal.dialect import WITH_COMMA, Dialect, split
from tiltcal.errors import InputError
from tiltcal.files.document import Document, document_of, parse_document
from tiltcal.files.procedure_file import Temperature
from tiltcal.files.record import AboveZero, Count, FromOne, Number, Record, Text, about, keys_of
from tiltcal.files.yaml_text import read_text
from tiltcal.log_head import SEPARATORS, dialect_of
from tiltcal.stated_arguments import require_printable
from tiltcal.units import split_unit

Table = str | Path | Sequence[Mapping[str, Any]]  # a file of CSV, or of a JSON list of objects; or such rows


def table_rows(
    table: Table, file: str | Path, keys: Mapping[str, bool], columns: Mapping[str, str] | None = None
) -> Iterator[Document]:
    """Yield the rows of a small table that messages call ``file``; ``keys`` are columns, and whether each is needed.

    ``columns`` says which column, by name or number, is a key; those that are none are then left out.
    """
    if not isinstance(table, str | Path):
        rows: Iterable[Document] = document_of(list(table), str(file)).items()
    elif (text := read_text(table)).lstrip().startswith(("[", "{")):  # a CSV header begins with a name
        rows = parse_document(text, str(file)).items()
    else:
        rows = _csv_rows(text, str(file), keys, columns or {})
    for number, row in enumerate(rows, 1):
        if not keys.get("position", True):
            row = Document({"position": f"row {number}", **row.data}, row.lines, row.file)
        _require_columns(row, keys)
        yield row


def _require_columns(row: Document, keys: Mapping[str, bool]) -> None:
    row.require_keys(row.members(), [*sorted(keys, key=lambda name: not keys[name])])
    needed = [name for name, is_needed in keys.items() if is_needed]
    row.require_keys([name for name in needed if row.data.get(name) is not None], needed, complete=True)


def _csv_rows(text: str, file: str, keys: Mapping[str, bool], columns: Mapping[str, str]) -> Iterator[Document]:
    lines = text.splitlines()
    found = _dialect_of_table(lines, keys, file)
    body = lines[found.first if found.named is None else found.named :]
    if not found.is_plain:
        body = [found.fields_of(line) for line in body]
    rows = csv.reader(body, strict=True, delimiter=found.separator)
    before = len(lines) - len(body)
    try:
        header = [name.strip() for name in next(rows, [])] if found.has_header else list(found.names)
        for name in header:
            if header.count(name) > 1:
                raise InputError(f"the column {name!r} is there twice", file=file, line=1)
        names = _keys_of(header, columns, found.has_header or bool(columns), file)
        listed = [name for name in names if name in keys] if names != header else names
        _require_columns(Document(dict.fromkeys(listed, ""), {(): 1 + before}, file), keys)
        line = before + rows.line_num + 1
        for row in rows:
            if row and len(row) != len(header):
                raise InputError(f"the row has {len(row)} fields, the header {len(header)}", file=file, line=line)
            if row:
                require_printable("".join(row), None, file, line)
                cells = zip(names, (found.with_point(field.strip()) for field in row), strict=True)
                yield Document({name: cell for name, cell in cells if cell and name in listed}, {(): line}, file)
            line = before + rows.line_num + 1
    except csv.Error as failure:
        raise InputError(f"not CSV: {failure}", file=file, line=before + rows.line_num) from None


def _dialect_of_table(lines: Sequence[str], keys: Mapping[str, bool], file: str) -> Dialect:
    """Return how a table is written: by the keys in its first line, else as a log."""
    first = next((line for line in lines if line.strip()), None)
    if first is None:
        raise InputError("the file is empty", file=file)
    for separator in SEPARATORS[:-1]:
        if {*keys} & {cell.strip('"') for cell in split(first, separator)}:
            commas = separator != "," and any(
                WITH_COMMA.fullmatch(cell) for line in lines for cell in split(line, separator)
            )
            return Dialect(tuple(split(first, separator)), separator, "," if commas else ".", named=lines.index(first))
    return dialect_of(lines)


def _keys_of(header: Sequence[str], columns: Mapping[str, str], named: bool, file: str) -> list[str]:
    """Return the key of each column: as ``columns`` says, as its name means, or x, y, z of three without names."""
    names = list(header)
    for key, column in columns.items():
        place = header.index(column) if column in header else int(column) - 1 if column.isdigit() else -1
        if not 0 <= place < len(names):
            raise InputError(f"there is no column {column!r}; the table has {', '.join(header)}", file=file, line=1)
        names[place] = key
    if not named:
        return list(AXES) if len(header) == len(AXES) else names
    if not {*AXES} & {*names}:
        names = [axis if (axis := meaning(split_unit(name)[0])) in AXES else name for name in names]
    return names


@dataclass(frozen=True)
class Segment:
    """Rows of a log during which the sensor was held still, from 0 after the header, the end exclusive."""

    name: str
    start: int
    end: int
    gravity: Vector | None  # up in the sensor frame; None where the procedure's position has this name
    line: int | None


@dataclass(frozen=True)
class TabledPosition:
    """One row of a table of positions; what the table does not state is None."""

    name: str
    gravity: Vector | None  # up in the sensor frame; None where the procedure's position has this name
    mean: dict[str, float]  # by channel, unit
    u: dict[str, float] | None  # standard uncertainties of the means, unit
    n: int | None
    temperature: float | None  # °C
    line: int | None


class Direction(Record):
    """The direction that points up, as a row of a table gives it."""

    gx: Annotated[Number | None, about("with `gy` and `gz` up, where the position is not the procedure's")] = None
    gy: Annotated[Number | None, about("likewise")] = None
    gz: Annotated[Number | None, about("likewise")] = None

    def vector(self, row: Document) -> Vector | None:
        """Return the direction as a unit vector, None where the row has none; an InputError where it is incomplete."""
        missing = [name for name in ("gx", "gy", "gz") if getattr(self, name) is None]
        if len(missing) == 3:
            return None
        if missing:
            raise row.error(f"{', '.join(missing)} is missing; a direction has all of gx, gy and gz")
        with row.locating():
            return normalised([self.gx or 0.0, self.gy or 0.0, self.gz or 0.0])


class SegmentRow(Direction, kw_only=True):
    """One row of a segments file."""

    position: Annotated[Text, about("its name, the procedure's or another one")]
    start: Annotated[Count, about("first row of the log, counted from 0 after its header")]
    end: Annotated[Count, about("the row after the last one")]


class TabledRow(Direction, kw_only=True):
    """One row of a table of positions, as it stands in its file."""

    position: Annotated[Text, about("its name")]
    x: Annotated[Number | None, about("mean reading, unit; needed where the sensor has the channel")] = None
    y: Annotated[Number | None, about("likewise")] = None
    z: Annotated[Number | None, about("likewise")] = None
    ux: Annotated[AboveZero | None, about("standard uncertainty of the mean, unit, in every row or none")] = None
    uy: Annotated[AboveZero | None, about("likewise")] = None
    uz: Annotated[AboveZero | None, about("likewise")] = None
    n: Annotated[FromOne | None, about("number of samples behind the means")] = None
    temperature: Annotated[Temperature | None, about("°C")] = None


def read_segments(segments: Table) -> list[Segment]:
    """Read and check a segments file, in which a position may come more than once.

    In consecutive rows they are parts of one placement that was interrupted, elsewhere the sensor was put there again.
    """
    path = segments if isinstance(segments, str | Path) else "the segments"
    read = []
    for row in table_rows(segments, path, keys_of(SegmentRow)):
        stated = row.read(SegmentRow)
        if stated.start >= stated.end:
            raise row.error(f"the end {stated.end} is not after the start {stated.start}; the end is exclusive", "end")
        read.append(Segment(stated.position, stated.start, stated.end, stated.vector(row), row.line))
    if not read:
        raise InputError("the file has no segment", file=path)
    for before, after in pairwise(sorted(read, key=lambda segment: segment.start)):
        if after.start < before.end:
            also = "and" if before.line is None else f"and, by line {before.line},"
            both = f"rows {after.start} to {min(before.end, after.end) - 1} belong to {after.name!r} {also} to"
            raise InputError(f"{both} {before.name!r}; segments do not overlap", file=path, line=after.line)
    return read


def read_positions(
    table: Table, channels: Sequence[str], columns: Mapping[str, str] | None = None, *, unnamed: bool = False
) -> list[TabledPosition]:
    """Read and check a table of positions, in the order of the file, with a mean for each channel.

    ``columns`` is that of :func:`table_rows`; where ``unnamed``, positions need no name.
    """
    absent = [f"{lead}{axis}" for axis in AXES if axis not in channels for lead in ("", "u")]
    keys = {key: needed or key in channels for key, needed in keys_of(TabledRow).items() if key not in absent}
    keys["position"] = not unnamed
    path = table if isinstance(table, str | Path) else "the table"
    positions = [_position(row, channels) for row in table_rows(table, path, keys, columns)]
    if not positions:
        raise InputError("the table has no position", file=path)
    stated = [position for position in positions if position.u is not None]
    silent = next((position for position in positions if position.u is None), None)
    if stated and silent is not None:
        why = f"{silent.name} has no uncertainty, and {stated[0].name} has one: give it for every position, or for none"
        raise InputError(why, file=path, line=silent.line)
    return positions


def tabled_channels(table: Table, axes: Sequence[str], columns: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """Return those of some axes that a table has a reading of."""
    path = table if isinstance(table, str | Path) else "the table"
    rows = [row.read(TabledRow) for row in table_rows(table, path, keys_of(TabledRow), columns)]
    return tuple(axis for axis in axes if any(getattr(row, axis) is not None for row in rows))


def _position(row: Document, channels: Sequence[str]) -> TabledPosition:
    stated = row.read(TabledRow)
    mean, u = ({channel: getattr(stated, f"{lead}{channel}") for channel in channels} for lead in ("", "u"))
    missing = [f"u{channel}" for channel, value in u.items() if value is None]
    if 0 < len(missing) < len(channels):
        raise row.error(f"{', '.join(missing)} is missing; give the uncertainty of every mean, or of none")
    direction, n, temperature = stated.vector(row), stated.n, stated.temperature
    return TabledPosition(stated.position, direction, mean, None if missing else u, n, temperature, row.line)
