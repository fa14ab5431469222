"""The CSV door: a recorded log, read block by block so that its size does not matter.

The first line names the columns, every other line is a row (:mod:`tiltcal.logs.csv_rows` says what that is). Where the
first line holds numbers alone it is a row, and the columns are called by number; fields may be parted by blanks
(:mod:`tiltcal.logs.whitespace_separated`). Empty lines at the very end of the file are nothing.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from typing import BinaryIO

from tiltcal.errors import InputError
from tiltcal.logs.csv_rows import CsvBlock, parse_rows
from tiltcal.logs.whitespace_separated import WhitespaceSeparated, blank_separated_names, numbered_columns

_BLOCK = 4 << 20
_LONGEST_ROW = 16 << 20
_UTF8_BOM = b"\xef\xbb\xbf"
_UTF16_BOMS = (b"\xff\xfe", b"\xfe\xff")


class CsvLog:
    """A log in CSV, read once from its beginning to its end.

    Parameters
    ----------
    stream : BinaryIO
        A file or standard input.
    name : str
        The log as the user named it, for messages.
    skip_bad_rows : bool
        Keep rows that cannot be parsed, named in :attr:`Rows.faults`, instead of raising.
    block : int
        How much to read at a time, bytes.

    Attributes
    ----------
    header : bytes
        The first line as it stands, byte-order mark and all, without its line end; the columns, parted by commas, in a
        log without a header or parted by blanks.
    names : tuple of str
        The columns.
    header_line : int
        Where they are named: the first.
    line_end : str
        LF or CRLF, as the first line has it.
    bytes_read : int
        So far.

    Raises
    ------
    InputError
        The file is empty or no text, or its header names a column twice.
    """

    header_line = 1

    def __init__(self, stream: BinaryIO, *, name: str, skip_bad_rows: bool = False, block: int = _BLOCK) -> None:
        self._stream: BinaryIO | WhitespaceSeparated = stream
        self._name = name
        self._skip_bad_rows = skip_bad_rows
        self._block = block
        self._line = 1
        self.bytes_read = 0
        first, self._pending = self._first_line()
        self._line = 2
        self.line_end = "\r\n" if first.endswith(b"\r\n") else "\n"
        self.header = first.removesuffix(b"\n").removesuffix(b"\r")
        self._refuse_what_is_no_text()
        text = _text(self.header.removeprefix(_UTF8_BOM))
        numbers = numbered_columns(text)
        if numbers is not None:
            self.names = numbers
            self._begin_without_header(first, stream)
            return
        names = blank_separated_names(text, self._second_line(text))
        self.names = self._distinct(self._comma_separated_names(text) if names is None else names)
        if names is not None:
            self._begin_behind_blanks(stream)

    def rows(self, columns: Sequence[int], time: int | None = None, texts: Sequence[int] = ()) -> Iterator[CsvBlock]:
        """The rows, block after block.

        Parameters
        ----------
        columns : sequence of int
            Indices of the columns that hold needed numbers.
        time : int, optional
            Of them, the one that may hold moments in ISO 8601, which become seconds.
        texts : sequence of int
            Indices of other columns that are wanted as text.

        Yields
        ------
        CsvBlock

        Raises
        ------
        InputError
            There is no row, or a row cannot be parsed; the message names file and line, and what was found there.
        """
        empty = True
        for data, ended, unended in self._blocks():
            rows = parse_rows(data, self.names, columns, time=time, texts=texts, unended=unended)
            if rows.faults and not self._skip_bad_rows:
                row = min(rows.faults)
                raise self._error(rows.faults[row], self._line + rows.starts[row])
            self._line += rows.line_count
            if rows.rest and (ended or len(rows.rest) > _LONGEST_ROW):
                raise self._error("a quoted field opens here and does not end as it should", self._line)
            self._pending = rows.rest + self._pending
            if len(rows.lines):
                empty = False
                yield rows
        if empty:
            raise self._error("the log has a header and no rows", self._line)

    def _blocks(self) -> Iterator[tuple[bytes, bool, bool]]:
        """Whole lines; whether they are the last; whether the very last had no end."""
        ended = False
        # A stream may have brought rows along with its header, and nothing more for a while.
        arrived = _end_of_content(self._pending) > 0
        while not ended:
            if not arrived:
                more = self._read()
                ended = not more
                self._pending += more
            arrived = False
            unended = ended and not self._pending.endswith(b"\n")
            if unended and self._pending:
                data, self._pending = self._pending + b"\n", b""
            else:
                cut = _end_of_content(self._pending)
                data, self._pending = self._pending[:cut], self._pending[cut:]
            self._refuse_endless(self._pending, data)
            if data:
                yield data, ended, unended

    def _read(self) -> bytes:
        data = self._stream.read(self._block)
        self.bytes_read += len(data)
        return data

    def _first_line(self) -> tuple[bytes, bytes]:
        """The first line, and what was read behind it."""
        data = b""
        while b"\n" not in data and (more := self._read()):
            data += more
            self._refuse_endless(data)
        first, end, rest = data.partition(b"\n")
        if not data.removeprefix(_UTF8_BOM).strip():
            raise InputError("the log is empty", file=self._name)
        return first + end, rest

    def _refuse_what_is_no_text(self) -> None:
        if self.header.startswith(_UTF16_BOMS) or b"\0" in self.header:
            raise self._error("this is no CSV text: save the log as CSV in UTF-8", 1)
        if b"\r" in self.header:
            raise self._error("the lines end in CR alone: save the log with LF or CRLF", 1)

    def _comma_separated_names(self, header: str) -> tuple[str, ...]:
        try:
            return tuple(name.strip() for name in next(csv.reader([header], strict=True), []))
        except csv.Error as failure:
            raise self._error(f"the header cannot be parsed: {failure}", 1) from None

    def _distinct(self, names: tuple[str, ...]) -> tuple[str, ...]:
        if not any(names):
            raise self._error("the first line is empty: it must name the columns", 1)
        seen: set[str] = set()
        for name in filter(None, names):
            if name in seen:
                raise self._error(f"the header names column {name!r} twice: rename one of them", 1)
            seen.add(name)
        return names

    def _begin_without_header(self, first: bytes, stream: BinaryIO) -> None:
        """Take the first line for the first row."""
        self.header = ",".join(self.names).encode()
        self._line = 1
        self._pending = first.removeprefix(_UTF8_BOM) + self._pending
        if len(self.names) > 1 and b"," not in first:
            self._stream, self._pending = WhitespaceSeparated(self._pending, stream), b""

    def _second_line(self, first: str) -> str:
        """The line below a header that may be parted by blanks; it stays to be read."""
        if "," in first or len(first.split()) < 2:
            return ""
        while b"\n" not in self._pending and (more := self._read()):
            self._pending += more
            self._refuse_endless(self._pending)
        return _text(self._pending.partition(b"\n")[0])

    def _begin_behind_blanks(self, stream: BinaryIO) -> None:
        """Take all lines below the header for rows that are parted by blanks."""
        self.header = ",".join(self.names).encode()
        self._stream, self._pending = WhitespaceSeparated(self._pending, stream), b""

    def _refuse_endless(self, pending: bytes, before: bytes = b"") -> None:
        """Stop at what is no log, before it fills the memory; ``before`` are the lines in front of it."""
        if len(pending) > _LONGEST_ROW:
            line = self._line + before.count(b"\n")
            raise self._error(f"the row does not end within {_LONGEST_ROW >> 20} MB: is this a CSV log?", line)

    def _error(self, message: str, line: int) -> InputError:
        return InputError(message, file=self._name, line=line)


def _end_of_content(data: bytes) -> int:
    """Where the last whole line ends that is not empty: empty ones behind it may be the end of the file."""
    content = len(data[: data.rfind(b"\n") + 1].rstrip(b"\r\n"))
    return data.find(b"\n", content) + 1 if content else 0


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")
