"""The dialect of a CSV log, found in its first lines: separator, decimal mark, and whether it has a header."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tiltcal.logs.columns import is_number

if TYPE_CHECKING:
    import polars as pl

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

    A ``#`` in front of names between blanks is none of them. A first line that merely counts (0,1,2 or 1,2,3), as some
    programs write above columns that nobody named, is a header.
    """
    first, _, rows = top.partition("\n")
    first, second = first.removesuffix("\r"), rows.partition("\n")[0].removesuffix("\r")
    if "," not in first and not _has_tabs_alone(first, second):
        if names := _numbered(first.split()):
            return Dialect(names, has_header=False, has_blanks=len(names) > 1)
        names = tuple(first.removeprefix("#").split())
        if len(names) > 1 and "," not in second and len(second.split()) == len(names):
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


def _has_tabs_alone(first: str, second: str) -> bool:
    """Return whether one tab is between any two fields, as spreadsheets write it: then a cell may be empty."""
    tabs = first.count("\t")
    whole = tabs > 0 and second.count("\t") == tabs and len(first.split()) == tabs + 1
    return whole and " " not in first + second and not first.startswith("#")


def _named(header: str, separator: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in next(csv.reader([header], delimiter=separator, strict=True), []))


def _numbered(fields: list[str]) -> tuple[str, ...]:
    """Return the columns' numbers where the fields of a first line are a row of numbers; none where they are names."""
    filled = [field.strip() for field in fields if field.strip()]  # a cell of a first row may be missing
    if not filled or not all(map(is_number, filled)):
        return ()
    counted = filled in ([str(first + k) for k in range(len(filled))] for first in (0, 1))
    return () if counted and len(fields) > 1 else tuple(str(place) for place in range(1, len(fields) + 1))
