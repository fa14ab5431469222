"""Segments of a recorded log: which rows were taken in which position."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from tiltcal.core.frames import Vector, normalised
from tiltcal.errors import InputError
from tiltcal.files.csv_tables import table_records
from tiltcal.files.node import Node

DIRECTION = ("gx", "gy", "gz")

_REQUIRED = ("position", "start", "end")


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


def read_segments(segments: str | Path | Sequence[Mapping[str, Any]]) -> list[Segment]:
    """Read and check a segments file.

    Parameters
    ----------
    segments : str, Path or sequence of mapping
        CSV with the columns ``position,start,end`` and, all three or none, ``gx,gy,gz``; or a JSON list of objects with
        these keys; or such rows.

    Returns
    -------
    list of Segment
        In the order of the file. A position may come more than once: in consecutive rows they are parts of one
        placement that was interrupted, elsewhere the sensor was put there again.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and column.
    """
    path = segments if isinstance(segments, str | Path) else "the segments"
    found = [_segment_of(record) for record in table_records(segments, path, _REQUIRED, DIRECTION)]
    if not found:
        raise InputError("the file has no segment", file=path)
    _refuse_overlap(found, path)
    return found


def _segment_of(record: Node) -> Segment:
    section = record.mapping(required=_REQUIRED, optional=DIRECTION)
    start = section["start"].integer(minimum=0)
    end = section["end"].integer(minimum=0)
    if start >= end:
        raise section["end"].error(f"the end {end} is not after the start {start}; the end is exclusive")
    return Segment(section["position"].text(), start, end, direction_of(record, section), record.line)


def direction_of(record: Node, section: dict[str, Node]) -> Vector | None:
    """The direction that a record gives in gx, gy and gz, as a unit vector; None where it gives none.

    Raises
    ------
    InputError
        One or two of the three, or all zero.
    """
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
