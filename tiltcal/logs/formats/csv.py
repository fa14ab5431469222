"""CSV: a log read block by block so that its size does not matter, and written with columns behind its own.

The first line names the columns, every other line is a row (:mod:`tiltcal.logs.formats.csv_rows` defines it). Where the
first line holds numbers alone it is a row, and the columns are called by number; fields may be parted by blanks
(:mod:`tiltcal.logs.formats.whitespace`).
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from io import BytesIO
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import numpy as np

from tiltcal.errors import InputError, UsageError
from tiltcal.logs.formats.csv_rows import UTF8_BOM, CsvBlock, parse_rows
from tiltcal.logs.formats.csv_short import SHORT, short_rows, short_text
from tiltcal.logs.formats.whitespace import WhitespaceSeparated, blank_separated_names, numbered_columns
from tiltcal.logs.log import LogBlock, LogReader, LogSource, LogWriter, Table
from tiltcal.logs.streams import ByteReader, refused_by_system
from tiltcal.logs.text_to_numbers import unread_time

if TYPE_CHECKING:
    import polars as pl

_BLOCK = 6 << 20
_LONGEST_ROW = 16 << 20
_UTF16_BOMS = (b"\xff\xfe", b"\xfe\xff")


class CsvReader(LogReader):
    """A log in CSV.

    Parameters
    ----------
    block : int
        How much to read at a time, bytes.

    Attributes
    ----------
    header : bytes
        The first line as it stands, byte-order mark and all, without its line end; the columns, parted by commas, in a
        log without a header or parted by blanks.
    line_end : str
        LF or CRLF, as the first line has it.

    InputError: the file is empty or no text, or its header names a column twice.
    """

    header_line = 1

    def __init__(self, source: LogSource, *, block: int = _BLOCK) -> None:
        super().__init__(source)
        stream = self._stream
        self._block = block
        self._line = 1
        first, self._pending = self._first_line()
        self._line = 2
        self.line_end = "\r\n" if first.endswith(b"\r\n") else "\n"
        self.header = first.removesuffix(b"\n").removesuffix(b"\r")
        self._refuse_what_is_no_text()
        text = _text(self.header.removeprefix(UTF8_BOM))
        numbers = numbered_columns(text)
        if numbers is not None:
            self.names = numbers
            self._begin_without_header(first, stream)
            return
        names = blank_separated_names(text, self._second_line(text))
        self.names = self._distinct(self._comma_separated_names(text) if names is None else names)
        if names is not None:
            self._begin_behind_blanks(stream)

    @property
    def _reads_ahead(self) -> bool:
        return self.source.size is not None and self.source.size > self._block

    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]:
        if not frames:
            short = time is None and self.source.size is not None and self.source.size <= SHORT
            yield from self._parsed(columns, time, short=short)
            return
        from tiltcal.logs.formats.csv_types import ColumnTypes

        types = ColumnTypes(self.names, columns, time, file=self.name)
        for block in self._parsed(columns, time, types.others):
            yield types.typed(block)

    def _parsed(
        self, columns: Sequence[int], time: int | None, texts: Sequence[int] = (), *, short: bool = False
    ) -> Iterator[CsvBlock]:
        """Yield the rows, block after block, and with them the text of some other columns."""
        empty, timed = True, time is None
        for data, ended, unended in self._lines():
            plain = short_rows(data, len(self.names), columns, unended=unended) if short else None
            rows = plain or parse_rows(data, self.names, columns, time=time, texts=texts, unended=unended)
            if rows.faults and not self.source.skip_bad_rows:
                row = min(rows.faults)
                raise self._error(rows.faults[row], self._line + rows.starts[row])
            if time is not None and not timed and len(rows):
                timed = bool(np.isfinite(rows.values[time]).any())
                if not timed:
                    rows = replace(rows, wrong_time=self._unread_time(data, columns, time, unended=unended))
            self._line += rows.line_count
            if rows.rest and (ended or len(rows.rest) > _LONGEST_ROW):
                raise self._error("a quoted field opens here and does not end as it should", self._line)
            self._pending = rows.rest + self._pending
            if len(rows):
                empty = False
                yield rows
        if empty:
            raise self._error("the log has a header and no rows", self._line)

    def _unread_time(self, data: bytes, columns: Sequence[int], time: int, *, unended: bool) -> InputError | None:
        rows = parse_rows(data, self.names, columns, time=time, texts=[time], unended=unended)
        found = unread_time(rows.texts[time].scatter([*rows.faults], None), self.names[time])
        return None if found is None else self._error(found[1], self._line + rows.starts[found[0]])

    def _lines(self) -> Iterator[tuple[bytes, bool, bool]]:
        """Whole lines; whether they are the last; whether the very last had no end."""
        ended = False
        # A stream may have brought rows along with its header, and nothing more for a while.
        arrived = b"\n" in self._pending
        while not ended:
            more = b"" if arrived else self._read()
            ended, arrived = not more and not arrived, False
            unended = ended and not self._pending.endswith(b"\n")
            if unended and self._pending:
                data, self._pending = self._pending + b"\n", b""
            elif cut := more.rfind(b"\n") + 1:  # the lines that were just read are many, and copied once
                data, self._pending = b"".join((self._pending, memoryview(more)[:cut])), more[cut:]
            else:
                self._pending += more
                cut = self._pending.rfind(b"\n") + 1
                data, self._pending = self._pending[:cut], self._pending[cut:]
            self._refuse_endless(self._pending, data)
            if data:
                yield data, ended, unended

    def _read(self) -> bytes:
        data = self._stream.read(self._block)
        self.bytes_read += len(data)
        return data

    def _first_line(self) -> tuple[bytes, bytes]:
        """Return the first line, and what was read behind it."""
        data = b""
        while b"\n" not in data and (more := self._read()):
            data += more
            self._refuse_endless(data)
        first, end, rest = data.partition(b"\n")
        if not data.removeprefix(UTF8_BOM).strip():
            raise InputError("the log is empty", file=self.name)
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

    def _begin_without_header(self, first: bytes, stream: ByteReader) -> None:
        """Take the first line for the first row."""
        self.header = ",".join(self.names).encode()
        self._line = 1
        self._pending = first.removeprefix(UTF8_BOM) + self._pending
        if len(self.names) > 1 and b"," not in first:
            self._stream, self._pending = WhitespaceSeparated(self._pending, stream), b""

    def _second_line(self, first: str) -> str:
        """Return the line below a header that may be parted by blanks; it stays to be read."""
        if "," in first or len(first.split()) < 2:
            return ""
        while b"\n" not in self._pending and (more := self._read()):
            self._pending += more
            self._refuse_endless(self._pending)
        return _text(self._pending.partition(b"\n")[0])

    def _begin_behind_blanks(self, stream: ByteReader) -> None:
        """Take all lines below the header for rows that are parted by blanks."""
        self.header = ",".join(self.names).encode()
        self._stream, self._pending = WhitespaceSeparated(self._pending, stream), b""

    def _refuse_endless(self, pending: bytes, before: bytes = b"") -> None:
        """Stop at what is no log, before it fills the memory; ``before`` are the lines in front of it."""
        if len(pending) > _LONGEST_ROW:
            line = self._line + before.count(b"\n")
            raise self._error(f"the row does not end within {_LONGEST_ROW >> 20} MB: is this a CSV log?", line)

    def _error(self, message: str, line: int) -> InputError:
        return InputError(message, file=self.name, line=line)


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


class CsvWriter(LogWriter):
    """Writes the rows of a CSV log as they stand, byte for byte, with columns behind their own.

    The rows of a log whose columns have types become text: numbers with the digits that bring them back, moments in
    ISO 8601, missing values as nothing.
    """

    @property
    def frames(self) -> bool:
        """Whether the blocks must have their columns with types, because the log has no text of its own."""
        return not isinstance(self._log, CsvReader)

    def write(self, blocks: Iterable[tuple[LogBlock, Table]]) -> None:
        """Write each block while the next is read and compensated; a single thread keeps the order."""
        with ThreadPoolExecutor(max_workers=1) as thread:
            written: Future[object] | None = None
            for block, table in blocks:
                # Means of rows are no rows that could stay as they are.
                verbatim = isinstance(block, CsvBlock) and block.counts is None
                rows = _split(cast("CsvBlock", block)) if verbatim else block
                if written is not None:
                    written.result()
                else:
                    self._sink.write(self._header() if verbatim else self._header_of(block))
                    self._sink.flush()  # the engine writes to the file itself
                written = thread.submit(self._write_as_it_stands if verbatim else self._write_in_words, rows, table)
            if written is not None:
                written.result()

    def _header(self) -> bytes:
        log = cast("CsvReader", self._log)
        return log.header + "".join(f",{name}" for name in self._added).encode() + log.line_end.encode()

    def _write_as_it_stands(self, block: LogBlock, table: Table) -> None:
        rows, line_end = cast("CsvBlock", block), cast("CsvReader", self._log).line_end
        if isinstance(rows.text, list):
            self._sink.write(short_text(rows.text, table, line_end))
            self._sink.flush()
            return
        import polars as pl

        utf8 = rows.encoding == "utf-8"
        text = self._sink if utf8 else BytesIO()
        _write_csv(text, pl.DataFrame({"": rows.lines, **table}), quote_style="never", line_terminator=line_end)
        if isinstance(text, BytesIO) and not utf8:
            self._sink.write(text.getvalue().decode().encode(rows.encoding))
            self._sink.flush()

    def _header_of(self, block: LogBlock) -> bytes:
        import polars as pl

        for column in _frame(block):
            if column.dtype.is_nested() or column.dtype in (pl.Binary, pl.Object):
                raise UsageError(
                    f"column {column.name!r} holds {column.dtype}, which CSV has no place for: write Parquet instead"
                )
        text = BytesIO()
        _write_csv(text, pl.DataFrame(schema=[*self._log.names, *self._added]), include_header=True)
        return text.getvalue()

    def _write_in_words(self, block: LogBlock, table: Table) -> None:
        import polars as pl

        frame = _frame(block)
        added = [pl.Series(name, column) for name, column in table.items()]
        _write_csv(self._sink, frame.with_columns(*map(_words, frame)).hstack(added))


def _split(block: CsvBlock) -> CsvBlock:
    """Split the text of a block into its rows, here and not in the thread that writes, which has the most to do."""
    return block if isinstance(block.text, list) else replace(block, text=block.lines)


def _frame(block: LogBlock) -> pl.DataFrame:
    if block.frame is None:
        raise TypeError("a block without its columns cannot be written as CSV")
    return block.frame


def _write_csv(sink: BinaryIO, frame: pl.DataFrame, *, include_header: bool = False, **options: Any) -> None:
    with refused_by_system():
        frame.write_csv(sink, include_header=include_header, **options)


def _words(column: pl.Series) -> pl.Series:
    """Return a column as its cells are to be written, where the engine has no way, or a way of its own."""
    import polars as pl

    kind = column.dtype
    if isinstance(kind, pl.Duration):
        return column.dt.to_string("iso")
    if not isinstance(kind, pl.Datetime):
        return column
    if kind.time_zone is None:
        return column.dt.to_string("%Y-%m-%dT%H:%M:%S%.f")
    return column.dt.convert_time_zone("UTC").dt.to_string("%Y-%m-%dT%H:%M:%S%.fZ")
