"""CSV: a log read block by block so that its size does not matter, and written with columns behind its own.

:mod:`tiltcal.logs.formats.csv_dialect` finds how it is written, :mod:`tiltcal.logs.formats.csv_rows` defines a row.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from hashlib import sha256
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from tiltcal.errors import InputError
from tiltcal.logs.formats.csv_dialect import Dialect, dialect_of
from tiltcal.logs.formats.csv_rows import UTF8_BOM, CsvBlock, RowGrammar, between_commas, in_utf8
from tiltcal.logs.log import LogBlock, LogReader, LogSource, LogWriter, Table
from tiltcal.logs.numbers_and_times import numbers
from tiltcal.logs.streams import refusing

if TYPE_CHECKING:
    import polars as pl

_BLOCK = 6 << 20
_TOP = 1 << 16  # bytes in which the dialect is looked for
_LONGEST_ROW = 16 << 20
_UTF16_BOMS = (b"\xff\xfe", b"\xfe\xff")
_LOSES_ITSELF = r"^\s*[+-]?(?:0\d|\d{16})"
"""What a number begins with that a double would not give back as it stood."""


class CsvReader(LogReader):
    """A log in CSV, read by ``block`` bytes at a time.

    ``header`` is the first line as it stands, byte-order mark and all, without its line end; in a log without a header,
    or with blanks between its fields, the columns between commas. ``line_end`` is LF or CRLF, as the first line has it.
    """

    header_line = 1

    def __init__(self, source: LogSource, *, block: int = _BLOCK) -> None:
        super().__init__(source)
        self._block, self._line = block, 1
        self._digest = sha256() if source.size is None else None  # a pipe gives its bytes once
        top = self._top()
        first, end, self._pending = top.partition(b"\n")
        self.header = in_utf8(first.removesuffix(b"\r"))
        self.line_end = "\r\n" if first.endswith(b"\r") and end else "\n"
        if self.header.startswith(_UTF16_BOMS) or b"\0" in self.header:
            raise self._error("this is no CSV text: save the log as CSV in UTF-8")
        if b"\r" in self.header:
            raise self._error("the lines end in CR alone: save the log with LF or CRLF")
        top = top.removeprefix(UTF8_BOM)
        self.dialect = self._dialect(top[: top.rfind(b"\n", 0, max(_TOP, len(first) + 1)) + 1] or top)
        self.names = self.dialect.names
        if not self.dialect.has_header:
            self.header, self._pending = self.dialect.separator.join(self.names).encode(), top
        elif self.dialect.has_blanks:
            self.header = ",".join(self.names).encode()
        self._line += self.dialect.has_header

    @property
    def sha256(self) -> str | None:
        return super().sha256 if self._digest is None else self._digest.hexdigest()

    def read(self, size: int) -> bytes:
        """Return so many bytes of the file, fewer at its end."""
        data = self.source.stream.read(size)
        self.bytes_read += len(data)
        if self._digest is not None:
            self._digest.update(data)
        return data

    def _top(self) -> bytes:
        """Read the first two lines, and what comes with them."""
        data = b""
        while data.count(b"\n") < 2 and (more := self.read(self._block)):
            data += more
            if b"\n" not in data:
                self._refuse_endless(data)
        if not data.removeprefix(UTF8_BOM).strip():
            raise InputError("the log is empty", file=self.name)
        return data

    def _dialect(self, top: bytes) -> Dialect:
        try:
            dialect = dialect_of(in_utf8(top).decode())
        except csv.Error as failure:
            raise self._error(f"the header cannot be parsed: {failure}") from None
        named = [name for name in dialect.names if name]
        if not named:
            raise self._error("the first line is empty: it must name the columns")
        if len({*named}) < len(named):
            twice = next(name for place, name in enumerate(named) if name in named[:place])
            raise self._error(f"the header names column {twice!r} twice: rename one of them")
        return dialect

    @property
    def _reads_ahead(self) -> bool:
        return self.source.size is not None and self.source.size > self._block

    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]:
        if not frames:
            yield from self._parsed(RowGrammar(self.dialect, columns, time))
            return
        types = ColumnTypes(self.dialect, columns, time, file=self.name)
        for block in self._parsed(RowGrammar(self.dialect, columns, time, types.others)):
            yield types.typed(block)

    def _parsed(self, grammar: RowGrammar) -> Iterator[CsvBlock]:
        """Yield the rows, block after block."""
        rows = 0
        for data, unended in self._lines():
            block = grammar.parse(between_commas(data) if self.dialect.has_blanks else data, unended=unended)
            if block.faults and not self.source.skip_bad_rows:
                row = min(block.faults)
                raise self._row_error(block.faults[row], rows + row)
            rows += len(block)
            self._line += len(block)
            yield block
        if not rows:
            raise self._error("the log has a header and no rows")

    def _lines(self) -> Iterator[tuple[bytes, bool]]:
        """Whole lines, and whether they are the very last one, which had no end."""
        pending, more = b"", self._pending or self.read(self._block)
        while more:
            if cut := more.rfind(b"\n") + 1:
                yield b"".join((pending, memoryview(more)[:cut])), False
                pending = more[cut:]
            else:
                pending += more
            self._refuse_endless(pending)
            more = self.read(self._block)
        if pending and not self.interrupted:
            yield pending + b"\n", True

    def _refuse_endless(self, pending: bytes) -> None:
        """Stop at what is no log, before it fills the memory."""
        if len(pending) > _LONGEST_ROW:
            raise self._error(f"the row does not end within {_LONGEST_ROW >> 20} MB: is this a CSV log?")

    def _error(self, message: str) -> InputError:
        return InputError(message, file=self.name, line=self._line)

    def _row_error(self, why: str, row: int) -> InputError:
        return InputError(why, file=self.name, line=1 + self.dialect.has_header + row)


class ColumnTypes:
    """The types of a log's columns on its way to a format whose columns have types, or to means.

    Text has none, so the first block of rows decides: a column whose cells are all numbers there, or missing, is one of
    numbers. Numbers that would not come back as they were written, such as a serial number ``0042`` or more digits than
    a double holds, are text. The needed columns are numbers anyway, but for a time: in ISO 8601 it is a moment. Empty
    columns are text.
    """

    def __init__(self, dialect: Dialect, needed: Sequence[int], time: int | None, *, file: str) -> None:
        names = dialect.names
        if "" in names:
            raise InputError(
                f"column {names.index('') + 1} has no name, which Parquet and means need: name it in the header",
                file=file,
                line=1,
            )
        self._dialect, self._time, self._file = dialect, time, file
        self._needed = tuple(index for index in needed if index != time)
        self.others = tuple(index for index in range(len(names)) if index not in self._needed)
        self._types: dict[int, pl.DataType] = {}
        self._row = 0

    def typed(self, block: CsvBlock) -> CsvBlock:
        """Return a block with its columns as a frame."""
        import polars as pl

        columns = {name: self._column(block, index) for index, name in enumerate(self._dialect.names)}
        self._row += len(block)
        return replace(block, frame=pl.DataFrame(columns))

    def _type(self, block: CsvBlock, index: int) -> pl.DataType:
        """Return the type of a column, by the sound cells of the first block."""
        import polars as pl

        cells = block.texts[index].clone().scatter([*block.faults], None)
        values, wrong = numbers(self._dialect.with_points(cells))
        if wrong is not None:
            moments = index == self._time and np.isfinite(block.values[index][wrong]).any()
            return pl.Datetime("us", "UTC") if moments else pl.String()
        exact = np.isfinite(values).any() and not cells.str.contains(_LOSES_ITSELF).any()
        return pl.Float64() if exact else pl.String()

    def _column(self, block: CsvBlock, index: int) -> pl.Series:
        import polars as pl

        if index in self._needed:
            return pl.Series(block.values[index]).fill_nan(None)
        if index not in self._types:
            self._types[index] = self._type(block, index)
        kind, cells = self._types[index], block.texts[index]
        if isinstance(kind, pl.String):
            return cells
        if isinstance(kind, pl.Datetime):  # to the microsecond; what no calendar reaches is missing
            micros = pl.Series(np.rint(block.values[index] * 1e6)).fill_nan(None)
            return micros.cast(pl.Int64, strict=False).cast(kind)
        values, wrong = numbers(self._dialect.with_points(cells))
        column = pl.Series(values).fill_nan(None)
        for row in () if wrong is None else np.flatnonzero(wrong).tolist():
            if row not in block.faults:
                raise InputError(
                    f"row {self._row + row}: column {self._dialect.names[index]!r} holds {cells[row]!r}, and numbers "
                    "above it: Parquet and means need one type in a column; mend it, or write CSV without them",
                    file=self._file,
                )
        return column


class CsvWriter(LogWriter):
    """Writes the rows of a CSV log as they stand, in UTF-8, with columns behind their own.

    The rows of a log whose columns have types become text: numbers with the digits that bring them back, moments in
    ISO 8601, missing values as nothing.
    """

    @property
    def frames(self) -> bool:  # type: ignore[override]
        return not isinstance(self.log, CsvReader)

    def write(self, blocks: Iterable[tuple[LogBlock, Table]]) -> None:
        """Write each block while the next is read and compensated; a single thread keeps the order."""
        with ThreadPoolExecutor(max_workers=1) as thread:
            written: Future[object] | None = None
            for block, table in blocks:
                # Means of rows are no rows that could stay as they are.
                verbatim = isinstance(block, CsvBlock) and block.counts is None
                write = self._as_it_stands if verbatim else self._in_words
                frame = self._frame(block, table, verbatim=verbatim)
                if written is not None:
                    written.result()
                written = thread.submit(write, frame, first=written is None)
            if written is not None:
                written.result()

    def _frame(self, block: LogBlock, table: Table, *, verbatim: bool) -> pl.DataFrame:
        """Return the columns of a block; text is split here, and not in the thread that writes, the busiest one."""
        import polars as pl
        from polars import selectors

        if verbatim:
            return pl.DataFrame({"": cast("CsvBlock", block).lines, **table})
        moment = "%Y-%m-%dT%H:%M:%S%.f"
        words = block.framed().with_columns(
            selectors.duration().dt.to_string("iso"),
            selectors.datetime(time_zone=None).dt.to_string(moment),
            selectors.datetime(time_zone="*").dt.convert_time_zone("UTC").dt.to_string(moment + "Z"),
        )
        return words.hstack([pl.Series(name, column) for name, column in table.items()])

    def _as_it_stands(self, frame: pl.DataFrame, *, first: bool) -> None:
        log = cast("CsvReader", self.log)
        if first:
            added = "".join(f"{log.dialect.separator}{name}" for name in self.added)
            self.sink.write(log.header + added.encode() + log.line_end.encode())
            self.sink.flush()  # the engine writes to the file itself
        self._write_csv(frame, quote_style="never", line_terminator=log.line_end)

    def _in_words(self, frame: pl.DataFrame, *, first: bool) -> None:
        self._write_csv(frame, include_header=first)

    def _write_csv(self, frame: pl.DataFrame, **options: Any) -> None:
        if isinstance(self.log, CsvReader):
            options["separator"] = self.log.dialect.separator
            options["decimal_comma"] = self.log.dialect.decimal == ","
        with refusing("this log cannot become CSV", self.log.name):
            frame.write_csv(cast("Any", self.sink), **{"include_header": False} | options)
