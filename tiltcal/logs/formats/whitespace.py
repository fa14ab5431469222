"""Tables of numbers as programs print them: without a header, or parted by blanks.

A log whose first line holds nothing but numbers has no header: its columns are called by number, counted from 1. A
first line that merely counts (0,1,2 or 1,2,3), as some programs write above columns that nobody named, is a header.

Where the first line has no comma, its fields may be parted by blanks and tabs, which are handed on to the
readers as commas. A header is, where the line below it has as many fields and no comma either; a ``#`` in front of its
names is none of them.
"""

from __future__ import annotations

import re

from tiltcal.logs.columns import is_number
from tiltcal.logs.streams import ByteReader

_LONGEST_LINE = 32 << 20
"""Bytes; what is longer is handed on as it is, to be refused there."""

_MARGINS = re.compile(rb"^[ \t]+|[ \t]+(?=\r?$)", re.MULTILINE)
_GAPS = re.compile(rb"[ \t]+")


def numbered_columns(first_line: str) -> tuple[str, ...] | None:
    """Return the columns' numbers, where a first line is a row of numbers; None where it names the columns."""
    fields = [field.strip() for field in first_line.split(",")] if "," in first_line else first_line.split()
    filled = [field for field in fields if field]  # a cell of a first row may be missing
    if not filled or not all(is_number(field) for field in filled):
        return None
    counted = filled in ([str(first + k) for k in range(len(filled))] for first in (0, 1))
    return None if counted and len(fields) > 1 else tuple(str(number) for number in range(1, len(fields) + 1))


def blank_separated_names(first_line: str, second_line: str) -> tuple[str, ...] | None:
    """Return the columns that a first line names whose fields are parted by blanks; None where they are not."""
    names = first_line.removeprefix("#").split()
    parted = len(names) > 1 and "," not in first_line + second_line and len(second_line.split()) == len(names)
    return tuple(names) if parted else None


class WhitespaceSeparated:
    """The bytes of a log whose fields are parted by blanks, as CSV: of what was read already, and of the rest of it."""

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
