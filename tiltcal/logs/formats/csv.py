"""CSV and other text: a log read block by block, whatever its size, and written with columns behind its own.

:mod:`tiltcal.logs.formats.csv_text` reads its lines, :mod:`tiltcal.dialect` finds how they are written, and
:mod:`tiltcal.logs.formats.csv_rows` defines a row.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from tiltcal.dialect import Dialect, quoted, split
from tiltcal.errors import InputError
from tiltcal.files.moments import LEAST_SECONDS
from tiltcal.log_head import dialect_of
from tiltcal.logs.formats.csv_rows import UTF8_BOM, CsvBlock, RowGrammar
from tiltcal.logs.formats.csv_text import CsvText
from tiltcal.logs.log import LogBlock, LogReader, LogSource, LogWriter, Table
from tiltcal.logs.numbers_and_times import numbers
from tiltcal.logs.streams import refusing
from tiltcal.printable import counted

if TYPE_CHECKING:
    import polars as pl

_BLOCK = 6 << 20
_LATEST = 8_210_266_876_799_999  # ms since 1970 at the end of the year 262142, where the engine's calendar ends
_MOST_DROPPED = 1 << 16  # lines between rows whose places are kept, for the line of a row in a message
_LOSES_ITSELF = r"^\s*[+-]?(?:0\d|\d{16})"  # what a number begins with that a double would not give back as it stood
_NO_ROWS = {"empty": "empty", "comment": "comment", "header": "repeated header", "other": "other"}
"""Kinds of line between the rows that are none, in words."""


class CsvReader(LogReader):
    """A log in CSV, or in any other text that has a dialect, read by ``block`` bytes at a time.

    ``header`` is the line of names as it stands, byte-order mark and all, without its line end, or the names between
    separators where the log has no such line.
    """

    def __init__(self, source: LogSource, *, block: int = _BLOCK) -> None:
        super().__init__(source)
        self.reads_ahead = source.size is not None and source.size > block
        self.text = CsvText(source, block)
        self._between: Counter[str] = Counter()
        self._dropped: list[int] = []
        lines, marked = self.text.first, self.text.marked
        self.dialect = found = self._dialect(lines)
        self.header_line = 1 + (found.first if found.named is None else found.named)
        self.names = found.column_names
        if not found.has_header:
            kinds = zip(self.names, found.kinds, strict=True)
            self.unnamed = tuple(name for name, kind in kinds if kind == "number")
        header = "" if found.named is None or not found.is_plain else lines[found.named]
        if (
            not header
            or header.lstrip().startswith(found.comments)
            or len(split(header, found.separator)) != len(found.names)
        ):
            header, marked = found.separator.join(quoted(name, found.separator) for name in self.names), False
        self.header = UTF8_BOM * (marked and found.named == 0) + header.encode()
        before = [line for row, line in enumerate(found.head) if row != found.named and line.strip()]
        self.notes = {"header": "\n".join(before)} if before else {}
        self.text.skip(found.first)

    @property
    def sha256(self) -> str | None:
        return self.text.sha256 or super().sha256

    def unit(self, column: int) -> str | None:
        return self.dialect.units.get(self.dialect.names[column]) or super().unit(column)

    def _dialect(self, lines: Sequence[str]) -> Dialect:
        try:
            dialect = dialect_of(lines)
        except ValueError as failure:
            raise self.text.error(f"{failure}: is this a log?") from None
        twice = [name for name, times in Counter(filter(None, dialect.names)).items() if times > 1]
        if twice:
            why = f"the header names column {twice[0]!r} twice: rename one of them"
            raise InputError(why, file=self.name, line=1 + (dialect.named or 0))
        return dialect

    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]:
        if not frames:
            yield from self._parsed(RowGrammar(self.dialect, columns, time))
            return
        types = ColumnTypes(self.dialect, columns, time, file=self.name)
        for block in self._parsed(RowGrammar(self.dialect, columns, time, types.others)):
            yield types.typed(block)

    def _parsed(self, grammar: RowGrammar) -> Iterator[CsvBlock]:
        """Yield the rows, block after block."""
        rows = torn = 0
        for data, unended in self.text.lines():
            self.bytes_read = self.text.bytes_read
            block, places = self._rows_of(grammar, self.text.in_utf8(data), unended)
            for row in sorted(block.faults):
                line = self.text.line + (row if places is None else places[row])
                self._refuse_other_header(block, row, line)
                if row not in block.torn and not self.source.skip_bad_rows:
                    raise InputError(block.faults[row], file=self.name, line=line)
            lines = len(block) if places is None and block.values else data.count(b"\n")
            count = lines if places is None else len(places)
            if places is not None and len(self._dropped) < _MOST_DROPPED:
                behind = np.setdiff1d(np.arange(lines), places) - np.arange(lines - count)
                self._dropped += (rows + behind).tolist()
            rows, torn = rows + count, torn + len(block.torn)
            self.text.line += lines
            if count:
                yield block
        if not rows:
            raise self.text.error("the log has a header and no rows")
        self._remark(torn)

    def _rows_of(self, grammar: RowGrammar, data: bytes, unended: bool) -> tuple[CsvBlock, Sequence[int] | None]:
        """Return the rows among whole lines, and the places of these lines where some are no rows."""
        if not unended and not self._has_comments(data):
            fields = self.dialect.fields(data)
            if fields is not None and (block := grammar.at_once(fields)) is not None:
                return block, None
        lines = data.decode().split("\n")[:-1]
        kinds = [self.dialect.no_row(line) for line in lines]
        places = [place for place, kind in enumerate(kinds) if not kind]
        ends = [row for row, place in enumerate(places) if kinds[place + 1 : place + 2] == ["header"]]
        ends += [len(places) - 1] * (unended and not kinds[-1])
        if len(places) < len(lines):
            self._between.update(filter(None, kinds))
            lines = [lines[place] for place in places]
            fields = self.dialect.fields("".join(f"{line}\n" for line in lines).encode())
            if fields and not ends and (block := grammar.at_once(fields)) is not None:
                return block, places
        fields = "".join(f"{self.dialect.fields_of(line)}\n" for line in lines).encode()
        return grammar.by_line(fields, sorted({*ends})), places if len(places) < len(kinds) else None

    def _has_comments(self, data: bytes) -> bool:
        marks = [mark.encode() for mark in self.dialect.comments]
        # A search for one byte takes a tenth of one for two.
        return any(data.startswith(mark) or b"\n" + mark in data for mark in marks if mark[:1] in data)

    def _refuse_other_header(self, block: CsvBlock, row: int, line: int) -> None:
        """Refuse names inside the table that are not those of its columns: what follows has other columns."""
        text = str(block.lines[row]).rstrip(self.dialect.separator)
        text = text[1:-1].replace('""', '"') if text.startswith('"') else text
        if self.dialect.is_other_header(text):
            why = f"the columns change here: {text!r} behind {self.header.decode()!r}; cut the log in two at this line"
            raise InputError(why, file=self.name, line=line)

    def _remark(self, torn: int) -> None:
        """Say what was no row, or cannot be read."""
        if self._between:
            kinds = ", ".join(f"{count} {_NO_ROWS[kind]}" for kind, count in self._between.items())
            lines = counted(self._between.total(), "line")
            self.remarks.append(f"{lines} between the rows left out: {kinds}")
        if torn:
            self.remarks.append(f"{counted(torn, 'row')} cut short while it was written: kept as missing")
        if replaced := self.text.replaced:
            self.remarks.append(f"{counted(replaced, 'byte')} outside UTF-8: replaced by \ufffd")

    def _row_error(self, why: str, row: int) -> InputError:
        return InputError(why, file=self.name, line=1 + self.dialect.first + row + bisect_right(self._dropped, row))


class ColumnTypes:
    """The types of a log's columns on its way to a format whose columns have types, or to means.

    Text has none, so the first block of rows decides: a column whose cells are all numbers there, or missing, is one of
    numbers. Numbers that would not come back as they were written, such as a serial number ``0042`` or more digits than
    a double holds, are text. The needed columns are numbers anyway, but for a time: in ISO 8601 it is a moment. Empty
    columns are text.
    """

    def __init__(self, dialect: Dialect, needed: Sequence[int], time: int | None, *, file: str) -> None:
        names = self._names = dialect.column_names
        self._dialect, self._time, self._file = dialect, time, file
        self._needed = tuple(index for index in needed if index != time)
        self.others = tuple(index for index in range(len(names)) if index not in self._needed)
        self._types: dict[int, pl.DataType] = {}
        self._row = 0

    def typed(self, block: CsvBlock) -> CsvBlock:
        """Return a block with its columns as a frame."""
        import polars as pl

        columns = {name: self._column(block, index) for index, name in enumerate(self._names)}
        self._row += len(block)
        return replace(block, frame=pl.DataFrame(columns))

    def _type(self, block: CsvBlock, index: int) -> pl.DataType:
        """Return the type of a column, by the sound cells of the first block."""
        import polars as pl

        cells = block.texts[index].clone().scatter([*block.faults], None)
        values, wrong = numbers(self._dialect.with_points(cells))
        if wrong is not None:
            moments = index == self._time and (block.values[index][wrong] > LEAST_SECONDS).any()
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
                    f"row {self._row + row}: column {self._names[index]!r} holds {cells[row]!r}, and numbers "
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
        moment, frame = "%Y-%m-%dT%H:%M:%S%.f", block.framed()
        for column in frame.select(selectors.datetime() | selectors.date()):
            column = column.cast(pl.Datetime("ms")) if column.dtype == pl.Date else column
            if (column.dt.cast_time_unit("ms").to_physical().abs() > _LATEST).any():
                why = f"column {column.name!r} has a date after the year 262142, which has no text: write .parquet"
                raise InputError(why, file=self.log.name)
        words = frame.with_columns(
            selectors.duration().dt.to_string("iso"),
            selectors.datetime(time_zone=None).dt.to_string(moment),
            selectors.datetime(time_zone="*").dt.convert_time_zone("UTC").dt.to_string(moment + "Z"),
        )
        return words.hstack([pl.Series(name, column) for name, column in table.items()])

    def _as_it_stands(self, frame: pl.DataFrame, *, first: bool) -> None:
        log = cast("CsvReader", self.log)
        if first:
            added = "".join(f"{log.dialect.separator}{name}" for name in self.added)
            self.sink.write(log.header + added.encode() + log.text.line_end.encode())
            self.sink.flush()  # the engine writes to the file itself
        self._write_csv(frame, quote_style="never", line_terminator=log.text.line_end)

    def _in_words(self, frame: pl.DataFrame, *, first: bool) -> None:
        self._write_csv(frame, include_header=first)

    def _write_csv(self, frame: pl.DataFrame, **options: Any) -> None:
        if isinstance(self.log, CsvReader):
            options["separator"] = self.log.dialect.separator
            options["decimal_comma"] = self.log.dialect.decimal == ","
        with refusing("this log cannot become CSV", self.log.name):
            frame.write_csv(cast("Any", self.sink), **{"include_header": False} | options)
