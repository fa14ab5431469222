"""How a log or a device writes its lines: fields between separators, or numbers with texts around them.

One grammar serves recorded logs, ``serial-columns`` and ``probe``. A row is fields between separators, or numbers with
the texts of a pattern around them: labels (``X: 1.5 Y: 0.2``), units, the keys of a JSON object. The clock of a serial
monitor may stand in front. :mod:`tiltcal.log_head` finds it in the first lines of a file.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from itertools import chain
from operator import xor
from typing import TYPE_CHECKING, Any

from tiltcal.column_names import AXES, role_of
from tiltcal.units import is_unit

if TYPE_CHECKING:
    import polars as pl

MISSING = frozenset({"", "nan", "+nan", "-nan", "na", "n/a", "null", "none"})
"""Cells that are a missing value, in small letters."""

COMMENTS = ("#", "//", "%")

_DIGITS = r"(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?"
_PRINTED = re.compile(rf"(?<![\w.^²])[-+]?{_DIGITS}(?=m?g\b|m/s|V\b|deg\b|(?![\w.]|\s*[:=]))")
_NUMBER = re.compile(rf"[-+]?(?:{_DIGITS}|inf|infinity)", re.IGNORECASE)
WITH_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
_CLOCK = r"\d{1,2}:\d\d(?::\d\d(?:[.,:]\d+)?)?(?: ?[AaPp][Mm])?"
MOMENT = re.compile(
    rf"\d{{1,4}}[-/.](?:\d\d?|[A-Za-z]{{3}})[-/.]\d{{1,4}}(?:[T ]+\d{{1,2}}[:.][-+:.,\dZ APMUTC]*)?|{_CLOCK}"
)
_FRONT = re.compile(rf"\s*(?:\[((?:\d{{4}}-\d\d-\d\d[T ])?{_CLOCK})\]|({_CLOCK})(?= (?:->|>)))\s*(?:->|>)?[ \t]*")
"""What monitors of serial lines print before a line: ``12:03:11.123 -> `` or ``[12:03:11.123] ``."""
LABEL = re.compile(r"(?<![\w.])([A-Za-z_][\w./ ]{0,60}?)['\"]?[ \t]*[:=]")
BEHIND = re.compile(r"[ \t]*[(\[]?([^\s,;|()\[\]]+)")  # a number: its unit
_SENTENCE = re.compile(r"\$(.*)\*([0-9A-Fa-f]{2})\s*")
_GAPS, _MARGINS = re.compile(rb"[ \t]+"), re.compile(rb"^[ \t]+|[ \t]+(?=\r?$)", re.MULTILINE)
_SWAPPED = str.maketrans(".,", ",.")
_SPARE = bytes(code for code in range(1, 32) if code not in b"\t\n\r")


def kind_of(cell: str, decimal: str = ".") -> str:
    """Return what a cell holds: ``number``, ``time``, ``missing`` or ``text``."""
    text = cell.strip()
    if text.casefold() in MISSING:
        return "missing"
    if _NUMBER.fullmatch(text) or (decimal == "," and WITH_COMMA.fullmatch(text)):
        return "number"
    return "time" if MOMENT.fullmatch(text) else "text"


@dataclass(frozen=True)
class Pattern:
    """The texts around the numbers of a row: one before each, and one behind the last; ``keys`` of a JSON object."""

    texts: tuple[str, ...]
    keys: tuple[str, ...] = ()

    @cached_property
    def _row(self) -> re.Pattern[str]:
        parts = [r"[ \t]*".join(map(re.escape, text.split())) for text in self.texts]
        cell = rf"[ \t]*([-+]?(?:{_DIGITS}|nan|inf|null|n/a|ovf)|)[ \t]*"
        return re.compile(rf"[ \t]*{cell.join(parts)}[ \t]*", re.IGNORECASE)

    def cells(self, line: str) -> list[str] | None:
        """Return the cells of a line; None where it is none of these rows."""
        if not self.keys:
            found = self._row.fullmatch(line)
            return None if found is None else list(found.groups())
        try:
            members = flattened(json.loads(line))
        except (ValueError, RecursionError):
            return None
        return None if members.keys() - {*self.keys} else [members.get(key, "") for key in self.keys]

    def at_once(self, lines: bytes, separator: bytes) -> bytes | None:
        """Return whole lines as fields, where all of them have these texts to the letter; None where one might not.

        Each text becomes a mark of its own; rows that are sound have all the marks in their order.
        """
        texts = [text.encode() for text in self.texts]
        marks = [_SPARE[place : place + 1] for place in range(len(texts))]
        if len(texts) > len(_SPARE) or lines.translate(None, _SPARE) != lines:
            return None
        lines = b"\n" + lines
        used = [(b"\n" * (not place) + text + b"\n" * (place == len(texts) - 1), mark)
                for place, (text, mark) in enumerate(zip(texts, marks, strict=True)) if text]  # fmt: skip
        for text, mark in sorted(used, key=lambda one: -len(one[0])):
            framed = (b"\n" if text.startswith(b"\n") else b"") + mark + (b"\n" if text.endswith(b"\n") else b"")
            lines = lines.replace(text, framed)
        import numpy as np

        order = np.frombuffer(b"".join(mark for text, mark in zip(texts, marks, strict=True) if text) + b"\n", np.uint8)
        codes = np.frombuffer(lines, np.uint8)[1:]
        found = codes[(codes < 32) & (codes != 9)]
        if len(found) % len(order) or not (found.reshape(-1, len(order)) == order).all():
            return None
        outer = (marks[0] if texts[0] else b"") + (marks[-1] if texts[-1] else b"")
        table = bytes.maketrans(b"".join(marks), separator * len(marks))
        return lines[1:].translate(table, outer)


def flattened(members: Any, lead: str = "") -> dict[str, str]:
    """Return the members of a JSON object by their keys, with those of an object in it behind a point, as text."""
    if isinstance(members, list):
        members = {AXES[place] if len(members) == 3 else str(place): one for place, one in enumerate(members)}
    if not isinstance(members, dict):
        raise ValueError("no object")
    flat: dict[str, str] = {}
    for key, member in members.items():
        if isinstance(member, dict | list):
            flat |= flattened(member, f"{lead}{key}.")
        else:
            flat[lead + key] = "" if member is None else member if isinstance(member, str) else json.dumps(member)
    return flat


@dataclass(frozen=True)
class Dialect:
    """How the rows of a log are written.

    names: of its columns; their numbers from 1 where the log does not name them (``has_header`` is False).
    separator, decimal: of the fields, and the decimal mark of the numbers, as they are once the row is fields.
    has_blanks: blanks are between fields in place of the separator.
    pattern: of rows that are no fields; ``others`` are further patterns of lines, which are no rows.
    has_clock: the clock of a monitor stands in front of each line, and is the first column.
    has_sum: lines are sentences of NMEA 0183, ``$...*5A``; one with another check sum is no row.
    first: the number of lines before the first row; ``head`` are these lines, ``named`` is the place of the names.
    units: of columns by name, from a line of units.
    comments: the marks behind which a line is none, but for a whole row where rows begin with text.
    kinds: what most cells of each column are, see :func:`kind_of`.
    dates: whether ``day`` or ``month`` is first in dates such as 03/04/2026; ``open`` where none shows it.
    """

    names: tuple[str, ...]
    separator: str = ","
    decimal: str = "."
    has_header: bool = True
    has_blanks: bool = False
    pattern: Pattern | None = None
    others: tuple[Pattern, ...] = ()
    has_clock: bool = False
    has_sum: bool = False
    first: int = 1
    head: tuple[str, ...] = ()
    named: int | None = 0
    units: Mapping[str, str] = field(default_factory=dict)
    comments: tuple[str, ...] = COMMENTS
    dates: str = ""
    kinds: tuple[str, ...] = ()

    @property
    def column_names(self) -> tuple[str, ...]:
        """The names of the columns; the number of one that has none."""
        return tuple(name or str(place) for place, name in enumerate(self.names, 1))

    @property
    def is_plain(self) -> bool:
        """Whether the lines of the file are fields as they stand."""
        return not (self.has_blanks or self.has_clock or self.has_sum or self.pattern)

    def with_point(self, cell: str) -> str:
        """Return a cell with its decimal mark as a point; a point in place of a decimal comma is no longer one."""
        return cell if self.decimal == "." else cell.translate(_SWAPPED)

    def with_points(self, cells: pl.Series, *, moments: bool = False) -> pl.Series:
        """Return cells likewise; of ``moments``, which may have a point nevertheless, points stay."""
        if self.decimal == ".":
            return cells
        marks = ([","], ["."]) if moments else ([".", ","], [",", "."])
        return cells.str.replace_many(*marks)

    def fields(self, lines: bytes) -> bytes | None:
        """Return whole lines as fields between separators, at once; None where a line might be none of the rows."""
        if self.is_plain:
            return lines
        if self.has_clock or self.has_sum or (self.has_blanks and self.pattern is not None):
            return None
        if self.pattern is not None:
            return self.pattern.at_once(lines, self.separator.encode())
        return _GAPS.sub(self.separator.encode(), _MARGINS.sub(b"", lines))

    def fields_of(self, line: str) -> str:
        """Return one line as fields; a line that is no row is a single one, in quotes."""
        if self.is_plain:
            return line
        front, rest = without_clock(line)
        if self.has_sum:
            rest = without_sum(rest)
        cells: list[str] | None = [rest]
        if self.pattern is not None:
            cells = self.pattern.cells(rest)
        elif self.has_blanks:
            cells = rest.split()
        if cells is None or not rest or (self.has_clock and not front):
            return in_quotes(line)
        if self.pattern is not None:
            cells = [quoted(cell, self.separator) for cell in cells]
        return self.separator.join([front.replace(",", ".")] * self.has_clock + cells)

    def no_row(self, line: str) -> str:
        """Return what a line is that is no row: ``empty``, ``comment``, ``header``, ``other``; nothing if it is one."""
        text = (without_clock(line)[1] if self.has_clock else line).strip()
        if not text:
            return "empty"
        if text in self._head:
            return "header"
        if text.startswith(self.comments) and not (
            self.kinds[:1] == ("text",) and len(split(text, self.separator)) == len(self.names)
        ):
            return "comment"
        return "other" if any(other.cells(text) is not None for other in self.others) else ""

    @cached_property
    def _head(self) -> frozenset[str]:
        lines = (line for line in self.head if not self._has_numbers(line))
        texts = ((without_clock(line)[1] if self.has_clock else line).strip() for line in lines)
        return frozenset(text for text in texts if text)

    def _has_numbers(self, line: str) -> bool:
        """Return whether a line could be a row: what stood before the table may come again as one."""
        cells = split(self.fields_of(line.strip()), self.separator)
        return len(cells) == len(self.names) and "number" in map(kind_of, cells)

    def is_other_header(self, line: str) -> bool:
        """Return whether a line inside the table names columns, other ones than those of the table."""
        cells = split(line, self.separator)
        return len(cells) > 1 and {kind_of(cell) for cell in cells} == {"text"} and any(map(role_of, cells))


def in_quotes(cell: str) -> str:
    """Return a cell as CSV has it where it may hold anything."""
    return '"' + cell.replace('"', '""') + '"'


def quoted(cell: str, separator: str) -> str:
    """Return a cell as CSV has it."""
    return in_quotes(cell) if separator in cell or '"' in cell else cell


def without_clock(line: str) -> tuple[str, str]:
    """Return the clock of a monitor in front of a line, empty where there is none, and what is behind it."""
    found = _FRONT.match(line)
    return (found[1] or found[2], line[found.end() :]) if found else ("", line)


def without_sum(line: str) -> str:
    """Return a sentence of NMEA 0183 without its check sum; nothing where that is wrong."""
    found = _SENTENCE.fullmatch(line)
    return f"${found[1]}" if found and reduce(xor, found[1].encode(), 0) == int(found[2], 16) else ""


def split(line: str, separator: str) -> list[str]:
    """Return the fields of a line without the blanks around them; an unfinished quote is a character."""
    if separator == " ":
        return line.split()
    if '"' in line:
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, strict=True), [])]
        except csv.Error:
            pass
    return [cell.strip() for cell in line.split(separator)]


def printed(line: str) -> tuple[list[str], list[str]]:
    """Return the texts around the numbers of a line, one more than numbers, and the numbers."""
    numbers = list(_PRINTED.finditer(line))
    bounds = [0, *chain(*(found.span() for found in numbers)), len(line)]
    return [line[bounds[k] : bounds[k + 1]] for k in range(0, len(bounds), 2)], [found[0] for found in numbers]


def labels_of(texts: Sequence[str]) -> list[str]:
    """Return the name of each number of a pattern, empty where no label stands before it.

    Of two labels the first is that of a group (``Gyro: X: 1 Y: 2``), which holds up to the next one; three numbers
    behind a label are x, y and z.
    """
    names, group = list[str](), ""
    for place, text in enumerate(texts[:-1]):
        if place and (unit := BEHIND.match(text)) and is_unit(unit[1]):
            text = text[unit.end() :]
        found = [label.strip() for label in LABEL.findall(text)]
        group = found[-2] if len(found) > 1 else group
        names.append(f"{group} {found[-1]}".strip() if found else "")
    starts = [place for place, name in enumerate(names) if name or not place]
    listed = list[str]()
    for start, end in zip(starts, [*starts[1:], len(names)], strict=False):
        run = range(end - start)
        listed += [f"{names[start]} {AXES[k] if len(run) == 3 else k + 1}".strip() for k in run if len(run) > 1]
        listed += [names[start]] * (len(run) == 1)
    return listed
