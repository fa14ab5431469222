"""Segments of a recorded log: which rows were taken in which position."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from tiltcal.core.gravity_direction import Vector, normalised
from tiltcal.errors import InputError
from tiltcal.files.csv_tables import Table, table_rows
from tiltcal.files.document import Document
from tiltcal.files.record import Count, Number, Record, Text, about, keys_of


@dataclass(frozen=True)
class Segment:
    """Rows of a log during which the sensor was held still, from 0 after the header, the end exclusive.

    Up is a unit vector in the sensor frame, None where the position's name gives it by the procedure.
    """

    name: str
    start: int
    end: int
    gravity: Vector | None
    line: int | None


class Direction(Record, kw_only=True):
    """The direction that points up, as a row of a table gives it."""

    gx: Annotated[
        Number | None,
        about("with `gy` and `gz` the direction that points up, where the position is not the procedure's"),
    ] = None
    gy: Annotated[Number | None, about("likewise")] = None
    gz: Annotated[Number | None, about("likewise")] = None

    def vector(self, row: Document) -> Vector | None:
        """Return the direction as a unit vector, None where the row has none; an InputError where it is incomplete."""
        parts = {"gx": self.gx, "gy": self.gy, "gz": self.gz}
        given = [value for value in parts.values() if value is not None]
        if not given:
            return None
        if len(given) < len(parts):
            missing = ", ".join(name for name, value in parts.items() if value is None)
            raise row.error(f"{missing} is missing; a direction has all of gx, gy and gz")
        with row.locating():
            return normalised(given)


class SegmentRow(Direction, kw_only=True):
    """One row of a segments file."""

    position: Annotated[Text, about("its name, the procedure's or another one")]
    start: Annotated[Count, about("first row of the log, counted from 0 after its header")]
    end: Annotated[Count, about("the row after the last one")]


def _segment_of(document: Document) -> Segment:
    row = document.read(SegmentRow)
    if row.start >= row.end:
        why = f"the end {row.end} is not after the start {row.start}; the end is exclusive"
        raise document.error(why, "end")
    return Segment(row.position, row.start, row.end, row.vector(document), document.line)


def read_segments(segments: Table) -> list[Segment]:
    """Read and check a segments file.

    ``segments`` are CSV with the columns ``position,start,end`` and, all three or none, ``gx,gy,gz``; or a JSON list of
    objects with these keys; or such rows. A position may come more than once: in consecutive rows they are parts of one
    placement that was interrupted, elsewhere the sensor was put there again. An InputError names file, line and column.
    """
    path = segments if isinstance(segments, str | Path) else "the segments"
    found = [_segment_of(row) for row in table_rows(segments, path, keys_of(SegmentRow))]
    if not found:
        raise InputError("the file has no segment", file=path)
    _refuse_overlap(found, path)
    return found


def _refuse_overlap(segments: Iterable[Segment], path: str | Path) -> None:
    ordered = sorted(segments, key=lambda segment: segment.start)
    for before, after in pairwise(ordered):
        if after.start < before.end:
            also = "and" if before.line is None else f"and, by line {before.line},"
            raise InputError(
                f"rows {after.start} to {min(before.end, after.end) - 1} belong to {after.name!r} {also} to "
                f"{before.name!r}; segments do not overlap",
                file=path,
                line=after.line,
            )
