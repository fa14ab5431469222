"""The grammar of a CSV log: our own rule on what a row is, in front of the engine.

CSV readers differ in silence on short and long rows, on a row that a power cut tore, on blank lines and odd numbers. So
the grammar is our own, and the same for every row of every file:

- A line is a row, with as many fields as the header. Lines end in LF or CRLF.
- A field in double quotes may hold separators and doubled quotes, but no line end; elsewhere a quote is a character.
- A NUL byte, or a bare CR outside quotes, is damage.
- A last line that has no end is torn where it is short, or stops inside a number.
- :mod:`tiltcal.logs.numbers_and_times` defines what is a number, and what is a time.

There are two ways. Blocks that are seen to break no rule, and have no quotes, are parsed by the engine at once; all
others line by line, which says what is wrong with which row.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.dialect import Dialect, in_quotes
from tiltcal.logs.log import LogBlock
from tiltcal.logs.numbers_and_times import is_cut, numbers, seconds
from tiltcal.printable import counted

if TYPE_CHECKING:
    import polars as pl

_LF, _POINT, _ZERO, _NINE = b"\n.09"
_PIECE = 1 << 16  # bytes: as many as stay in the cache with what is made of them
_OF_NUMBERS = b"0123456789+-."
_UNUSED = "\x1f\x1e\x1d\x1c\x01\x02\x03\x04\x05\x06\x0e\x0f\x10\x11\x12\x13\x14\x15\x16\x17"
UTF8_BOM = b"\xef\xbb\xbf"


@dataclass(frozen=True, kw_only=True)
class CsvBlock(LogBlock):
    """Some rows of a CSV log, in order, with what is wrong with which row.

    ``text`` has the rows in UTF-8, each with a LF; ``texts`` are the text columns that were asked for, null where a
    cell is empty. ``torn`` are the faults of rows that were cut short while they were written.
    """

    faults: Mapping[int, str]
    text: bytes
    torn: Collection[int] = ()
    texts: Mapping[int, pl.Series] = field(default_factory=dict)

    @property
    def lines(self) -> pl.Series:
        """Each row's text; it is split at every call, which the engine does fastest where it sees no separator."""
        import polars as pl

        separator = next((mark for mark in _UNUSED if mark.encode() not in self.text), None)
        if separator is None:
            return pl.Series("", self.text.decode().split("\n")[:-1], dtype=pl.String)
        return _engine(self.text, separator=separator, schema={"": pl.String})[""]


@dataclass(frozen=True)
class RowGrammar:
    """What is read from the rows of a log: numbers, of which one column may be times, and columns of text."""

    dialect: Dialect
    columns: Sequence[int]
    time: int | None = None
    texts: Sequence[int] = ()

    def at_once(self, data: bytes) -> CsvBlock | None:
        """Parse rows that break no rule, as is seen without a look at single rows; None where one might.

        The engine gives a short row null in its last field and leaves out what a long row has too much, without a word.
        Where no last field is null and the separators are as many as the rows need, no row is short or long.
        """
        fields, separator, text = len(self.dialect.names), ord(self.dialect.separator), data
        if b"\r" in data or b"\0" in data:
            return None
        if b'"' in data:  # cells in quotes that hold neither separators nor quotes are what is between them
            data = self._quoted.sub(rb"\1\2", data)
            if b'"' in data:
                return None
        rows = _count(data, _LF)
        if _count(data, separator) != rows * (fields - 1):
            return None
        frame = self._columns_by_engine(data)
        if frame is None or len(frame) != rows:
            return None
        if frame.to_series(-1).null_count() and (fields == 1 or not _is_rectangular(data, fields, separator)):
            return None
        values = {}
        for index in self.columns:
            values[index], wrong = self._numbers(frame[str(index)], index)
            if wrong is not None:
                return None
        texts = {index: frame[str(index)].replace("", None) for index in self.texts}
        times = None if self.time is None else self.dialect.with_points(frame[str(self.time)], moments=True)
        return CsvBlock(values=values, faults={}, text=text, texts=texts, times=times)

    @cached_property
    def _quoted(self) -> re.Pattern[bytes]:
        mark = re.escape(self.dialect.separator.encode())
        return re.compile(rb'(^|%b)"([^"%b\n]*)"(?=%b|$)' % (mark, mark, mark), re.MULTILINE)

    def _columns_by_engine(self, data: bytes) -> pl.DataFrame | None:
        """Read needed columns as numbers, or as text where that fails, and the last column; None if both fail."""
        import polars as pl

        fields = len(self.dialect.names)
        wanted = sorted({*self.columns, *self.texts, fields - 1})
        tried: list[set[int]] = [set()]
        if self.dialect.decimal == "." and not _has_open_points(data):
            numeric = {*self.columns} - {*self.texts}
            tried = [numeric, numeric - {self.time}, set()]
        for numeric in tried:
            schema = {str(index): pl.Float64 if index in numeric else pl.String for index in range(fields)}
            with suppress(pl.exceptions.PolarsError):
                return _engine(data, separator=self.dialect.separator, schema=schema, columns=wanted)
        return None

    def _numbers(self, cells: pl.Series, index: int) -> tuple[Array, NDArray[np.bool_] | None]:
        """Return the numbers of a column that is read as numbers or as text, and which cells are none."""
        import polars as pl

        if cells.dtype != pl.String:
            return cells.to_numpy(), None
        cells = self.dialect.with_points(cells, moments=index == self.time)
        return (seconds(cells, self.dialect.dates), None) if index == self.time else numbers(cells)

    def by_line(self, data: bytes, last: Collection[int] = ()) -> CsvBlock:
        """Parse rows one by one, and say what is wrong with each; the ``last`` ones may have been torn."""
        import polars as pl

        names, separator = self.dialect.names, self.dialect.separator
        lines = pl.Series("", data.decode().split("\n")[:-1], dtype=pl.String)
        rows = lines.str.split(separator)
        counts = rows.list.len().to_numpy(writable=True)
        faults: dict[int, str] = {}
        odd: dict[int, list[str]] = {}  # rows that are more than fields between separators
        for row in lines.str.contains('["\r\0]').arg_true():
            odd[row], fault = _odd_row(lines[row], separator)
            counts[row] = len(odd[row])
            if fault:
                faults[row] = fault
        for row in np.flatnonzero((counts != len(names)) | (lines == "").to_numpy()).tolist():
            fault = f"the row has {counted(int(counts[row]), 'field')}, the header {len(names)}"
            faults.setdefault(row, fault if lines[row] else "the line is empty")
        torn = []
        for row in last:
            cell = (odd[row] if row in odd else rows[row].to_list())[-1:]
            short = counts[row] < len(names) or (row not in faults and is_cut(self.dialect.with_point(cell[0])))
            if short and "\0" not in lines[row]:
                faults[row] = "the row is cut short"
                torn.append(row)

        def cells_of(index: int) -> pl.Series:
            cells = rows.list.get(index, null_on_oob=True)
            if odd:
                cells = cells.scatter([*odd], [row[index] if index < len(row) else None for row in odd.values()])
            return cells.scatter([*faults], None)

        values, times = {}, None
        for index in self.columns:
            cells = cells_of(index)
            times = self.dialect.with_points(cells, moments=True) if index == self.time else times
            column, wrong = self._numbers(cells, index)
            values[index] = column.copy()  # that of a column of times may be read-only
            for row in () if wrong is None else np.flatnonzero(wrong).tolist():
                faults.setdefault(row, f"column {names[index]!r}: {cells[row]!r} is no number")
        for column in values.values():
            column[[*faults]] = np.nan
        texts = {index: cells_of(index).replace("", None) for index in self.texts}
        if faults:
            bad = [lines[row] for row in faults]
            if 0 in texts:
                texts[0] = texts[0].scatter([*faults], bad)
            quoted = [in_quotes(line) + separator * (len(names) - 1) for line in bad]
            data = "".join(f"{line}\n" for line in lines.scatter([*faults], quoted)).encode()
        return CsvBlock(values=values, faults=faults, text=data, texts=texts, times=times, torn=torn)


def _odd_row(line: str, separator: str) -> tuple[list[str], str]:
    """Return the fields of a row with quotes, NUL or CR in it, and what is wrong with it."""
    if "\0" in line or '"' not in line:
        return line.split(separator), "the row holds a NUL byte or a bare CR"
    try:
        return next(csv.reader([line], delimiter=separator, strict=True)), ""
    except csv.Error as failure:
        return [], f"the row cannot be parsed, a line end inside quotes being none of it: {failure}"


def _is_rectangular(data: bytes, fields: int, separator: int) -> bool:
    """Return whether every row has its separators, where there are as many as all rows need."""
    buffer = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(buffer == _LF)
    grid = np.flatnonzero(buffer == separator).reshape(len(ends), fields - 1)
    return bool((grid[1:, 0] > ends[:-1]).all() and (grid[:, -1] < ends).all())


def _pieces(data: bytes) -> Iterator[NDArray[np.uint8]]:
    """Yield the bytes in pieces that stay in the cache, each with the first byte of the next one behind it."""
    buffer = np.frombuffer(data, np.uint8)
    return (buffer[start : start + _PIECE + 1] for start in range(0, len(data), _PIECE))


def _count(data: bytes, code: int) -> int:
    return sum(int(np.count_nonzero(piece[:_PIECE] == code)) for piece in _pieces(data))


def _has_open_points(data: bytes) -> bool:
    """Return whether a decimal point is followed by no digit, which the engine would take for a number."""
    return any(
        bool(((piece[:-1] == _POINT) & ((piece[1:] - np.uint8(_ZERO)) > _NINE - _ZERO)).any())
        for piece in _pieces(data)
    )


def _engine(data: bytes, **options: Any) -> pl.DataFrame:
    """Read rows.

    The engine takes bytes that begin as a compressed file does (a cell ``x`` and a control character will do) for one;
    behind an empty line, which is skipped, they are what they are. It also drops a byte order mark, which is one only
    at the beginning of the log: a second one in front of it is dropped in its place.
    """
    import polars as pl

    if data.startswith(UTF8_BOM):
        data = UTF8_BOM + data
    if data[0] in _OF_NUMBERS:
        return pl.read_csv(data, has_header=False, quote_char=None, **options)
    return pl.read_csv(b"\n" + data, skip_lines=1, has_header=False, quote_char=None, **options)
