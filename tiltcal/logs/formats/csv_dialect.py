"""How a CSV log is written: its separator, its decimal mark and whether it has a header, recognised at its top.

Fields are separated by commas, semicolons, tabs or blanks; numbers between semicolons or tabs may have a decimal comma.
Fields between blanks are handed on to the reader as between commas; a ``#`` in front of their names is none of them.

A log whose first line holds nothing but numbers has no header: its columns are called by number, counted from 1. A
first line that merely counts (0,1,2 or 1,2,3), as some programs write above columns that nobody named, is a header.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tiltcal.logs.columns import is_number
from tiltcal.logs.streams import ByteReader

if TYPE_CHECKING:
    import polars as pl

UTF8_BOM = b"\xef\xbb\xbf"

_LONGEST_LINE = 32 << 20
"""Bytes; what is longer is handed on as it is, to be refused there."""

_MARGINS = re.compile(rb"^[ \t]+|[ \t]+(?=\r?$)", re.MULTILINE)
_GAPS = re.compile(rb"[ \t]+")
_DECIMAL_COMMA = r"(?:^|{0})[ \t]*[+-]?\d*,\d+(?:[eE][+-]?\d+)?[ \t]*(?={0}|\r?$)"
_SWAPPED = str.maketrans(".,", ",.")


@dataclass(frozen=True)
class Dialect:
    """How the rows of a CSV log are written; ``has_blanks``: these are between fields in place of the separator."""

    names: tuple[str, ...]
    separator: str = ","
    decimal: str = "."
    has_header: bool = True
    has_blanks: bool = False

    def with_point(self, cell: str) -> str:
        """Return a cell with its decimal mark as a point; a point in place of a decimal comma is no longer one."""
        return cell if self.decimal == "." else cell.translate(_SWAPPED)

    def with_points(self, cells: pl.Series, *, moments: bool = False) -> pl.Series:
        """Return cells likewise; of ``moments``, which may have a point nevertheless, points stay."""
        if self.decimal == ".":
            return cells
        marks = ([","], ["."]) if moments else ([".", ","], [",", "."])
        return cells.str.replace_many(*marks)


def dialect_of(top: str) -> Dialect:
    """Return how a log is written whose first lines these are, the last of them perhaps torn.

    csv.Error: the header cannot be parsed.
    """
    first, _, rows = top.partition("\n")
    first, second = first.removesuffix("\r"), rows.partition("\n")[0].removesuffix("\r")
    if (names := _numbered(first.split())) and "," not in first:
        return Dialect(names, has_header=False, has_blanks=len(names) > 1)
    names = tuple(first.removeprefix("#").split())
    if len(names) > 1 and "," not in first + second and len(second.split()) == len(names):
        return Dialect(names, has_blanks=True)
    for separator in ";\t":
        if separator not in first or first.count(separator) != second.count(separator):
            continue
        comma = re.search(_DECIMAL_COMMA.format(separator), first + "\n" + rows, re.MULTILINE) is not None
        cells = [cell.translate(_SWAPPED) if comma else cell for cell in first.split(separator)]
        names = _numbered(cells)
        if names or "," not in first:
            return Dialect(names or _named(first, separator), separator, "," if comma else ".", not names)
    names = _numbered(first.split(","))
    return Dialect(names or _named(first, ","), has_header=not names)


def _named(header: str, separator: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in next(csv.reader([header], delimiter=separator, strict=True), []))


def _numbered(fields: list[str]) -> tuple[str, ...]:
    """Return the columns' numbers where the fields of a first line are a row of numbers; none where they are names."""
    filled = [field.strip() for field in fields if field.strip()]  # a cell of a first row may be missing
    if not filled or not all(map(is_number, filled)):
        return ()
    counted = filled in ([str(first + k) for k in range(len(filled))] for first in (0, 1))
    return () if counted and len(fields) > 1 else tuple(str(place) for place in range(1, len(fields) + 1))


class BlankSeparated:
    """The bytes of a log whose fields are separated by blanks, as CSV: what was read already, and the rest of it."""

    def __init__(self, beginning: bytes, stream: ByteReader) -> None:
        self._pending = beginning
        self._stream = stream

    def read(self, size: int) -> bytes:
        """Return some lines, reading the log by so many bytes at a time; nothing at the end."""
        data, more = self._pending, b" "
        # A line is turned as a whole: a blank at the end of what was read may be a margin or a gap.
        while b"\n" not in data and more and len(data) < _LONGEST_LINE:
            more = self._stream.read(size)
            data += more
        cut = data.rfind(b"\n") + 1 if more else len(data)
        self._pending = data[cut or len(data) :]
        return _GAPS.sub(b",", _MARGINS.sub(b"", data[: cut or len(data)]))
