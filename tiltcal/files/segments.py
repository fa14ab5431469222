"""Segments of a recorded log: which rows were taken in which position."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import StringIO
from itertools import pairwise
from pathlib import Path

from tiltcal.core.frames import Vector, normalised
from tiltcal.errors import InputError
from tiltcal.files.document import parse_document, read_text
from tiltcal.files.node import Node, Scalar

DIRECTION = ("gx", "gy", "gz")

_REQUIRED = ("position", "start", "end")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")


@dataclass(frozen=True)
class Segment:
    """Rows of a log during which the sensor was held still.

    Attributes
    ----------
    name : str
        Of the position.
    start, end : int
        Row numbers counted from 0 after the header; the end is exclusive.
    gravity : tuple of float or None
        Up in the sensor frame, a unit vector; None where the procedure says it by the position's name.
    line : int or None
        Where the segment stands in its file.
    """

    name: str
    start: int
    end: int
    gravity: Vector | None
    line: int | None


def read_segments(path: str | Path) -> list[Segment]:
    """Read and check a segments file.

    Parameters
    ----------
    path : str or Path
        CSV with the columns ``position,start,end`` and, all three or none, ``gx,gy,gz``; or a JSON list of objects with
        these keys.

    Returns
    -------
    list of Segment
        In the order of the file. A position may come more than once.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and column.
    """
    text = read_text(path)
    # A CSV header begins with a name; a JSON list with its bracket.
    is_json = text.lstrip().startswith(("[", "{"))
    records = parse_document(text, str(path)).items() if is_json else _csv_records(text, str(path))
    segments = [_segment_of(record) for record in records]
    if not segments:
        raise InputError("the file has no segment", file=path)
    _refuse_overlap(segments, path)
    return segments


def _segment_of(record: Node) -> Segment:
    section = record.mapping(required=_REQUIRED, optional=DIRECTION)
    start = section["start"].integer(minimum=0)
    end = section["end"].integer(minimum=0)
    if start >= end:
        raise section["end"].error(f"the end {end} is not after the start {start}; the end is exclusive")
    return Segment(section["position"].text(), start, end, _direction_of(record, section), record.line)


def _direction_of(record: Node, section: dict[str, Node]) -> Vector | None:
    given = [section[name].number() for name in DIRECTION if name in section]
    if not given:
        return None
    if len(given) != len(DIRECTION):
        missing = ", ".join(name for name in DIRECTION if name not in section)
        raise record.error(f"{missing} is missing; a direction has all of gx, gy and gz")
    try:
        return normalised(given)
    except InputError as failure:
        raise record.error(failure.message) from None


def _refuse_overlap(segments: Iterable[Segment], path: str | Path) -> None:
    ordered = sorted(segments, key=lambda segment: segment.start)
    for before, after in pairwise(ordered):
        if after.start < before.end:
            raise InputError(
                f"rows {after.start} to {min(before.end, after.end) - 1} belong to {after.name!r} and, by line "
                f"{before.line}, to {before.name!r}; segments do not overlap",
                file=path,
                line=after.line,
            )


def _csv_records(text: str, file: str) -> Iterator[Node]:
    """The rows as mappings, so that CSV and JSON are checked alike; a blank field is an absent one."""
    rows = csv.reader(StringIO(text, newline=""), strict=True)
    try:
        header = [name.strip() for name in next(rows, [])]
        _check_header(header, file)
        line = rows.line_num + 1
        for row in rows:
            if row:
                yield _csv_record(header, row, file, line)
            line = rows.line_num + 1
    except csv.Error as failure:
        raise InputError(f"not CSV: {failure}", file=file, line=rows.line_num) from None


def _check_header(header: list[str], file: str) -> None:
    if not header:
        raise InputError("the file is empty", file=file)
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise InputError(f"the column {twice[0]!r} is there twice", file=file, line=1)
    Node({name: Node(Scalar("", True), file, 1, name) for name in header}, file, 1, None).mapping(
        required=_REQUIRED, optional=DIRECTION
    )


def _csv_record(header: list[str], row: list[str], file: str, line: int) -> Node:
    if len(row) != len(header):
        raise InputError(f"the row has {len(row)} fields, the header {len(header)}", file=file, line=line)
    fields = {
        name: Node(Scalar(field.strip(), plain=_NUMBER.fullmatch(field.strip()) is not None), file, line, name)
        for name, field in zip(header, row, strict=True)
        if field.strip()
    }
    return Node(fields, file, line, None)
