"""Rows of a CSV log: our own rule on what a row is, in front of the engine that parses its numbers.

CSV readers differ in silence on short and long rows, on a row that a power cut tore, on blank lines and odd numbers. So
the grammar is our own, and the same for every row of every file:

- A line is a row, with as many fields as the header. Lines end in LF or CRLF.
- A field in double quotes may hold separators and doubled quotes, but no line end; elsewhere a quote is a character.
- A NUL byte, or a bare CR outside quotes, is damage.
- An empty line is a row that cannot be parsed.
- A last line that has no end is torn where it is short, or stops inside a number.
- :mod:`tiltcal.logs.text_to_numbers` defines what is a number, and what is a time.

There are two ways. Rows that are seen to break no rule are parsed by the engine, all at once. Of others, halves are
tried again; what is short is parsed line by line, which says what is wrong with which row. A row that breaks a rule is
kept as one quoted field, with empty ones behind it.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.logs.formats.csv_dialect import UTF8_BOM, Dialect
from tiltcal.logs.log import LogBlock
from tiltcal.logs.text_to_numbers import is_cut, number, numbers, seconds

if TYPE_CHECKING:
    import polars as pl

    from tiltcal.core.flags import Mask

_LF, _QUOTE, _POINT, _ZERO, _NINE = b'\n".09'
_BY_LINE = 1 << 16  # bytes up to which rows of which one is odd are parsed line by line
_PIECE = 1 << 16  # bytes: as many as stay in the cache with what is made of them
_TORN = "the last row is cut short"
_OF_NUMBERS = b"0123456789+-."
_UNUSED = "\x1f\x1e\x1d\x1c\x01\x02\x03\x04\x05\x06\x0e\x0f\x10\x11\x12\x13\x14\x15\x16\x17"


@dataclass(frozen=True, kw_only=True)
class CsvBlock(LogBlock):
    """Some rows of a CSV log, in order.

    Attributes
    ----------
    faults : dict of int to str
        What is wrong, by row.
    text : bytes
        The rows in UTF-8, each with a LF.
    encoding : str
        ``utf-8``, or ``latin-1`` where the bytes were no UTF-8: encode the text with it to have the bytes again.
    texts : mapping of int to polars.Series of String, length n
        The text columns that were asked for; null where a cell is empty.
    """

    faults: Mapping[int, str]
    text: bytes
    encoding: str = "utf-8"
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
    """What is read from the rows of a log.

    Attributes
    ----------
    columns : sequence of int
        Indices of the columns that hold needed numbers.
    time : int or None
        Of them, the one that may hold moments in ISO 8601; what is neither is missing there.
    texts : sequence of int
        Indices of the columns that are wanted as text.
    short : bool
        Parse line by line in any case, without the engine, whose import alone takes longer than a short log.
    """

    dialect: Dialect
    columns: Sequence[int]
    time: int | None = None
    texts: Sequence[int] = ()
    short: bool = False

    def parse(self, data: bytes, *, unended: bool = False) -> CsvBlock:
        """Parse whole lines, the last one with its line end; ``unended``: it had none in the file.

        Nothing is raised: what breaks a rule is in ``faults``.
        """
        encoding = "utf-8"
        if not data.isascii():
            try:
                data.decode()
            except UnicodeDecodeError:
                data, encoding = data.decode("latin-1").encode(), "latin-1"
        values, faults, text, texts = self._rows(data, unended)
        return CsvBlock(values=values, faults=faults, text=text, encoding=encoding, texts=texts)

    def _rows(self, data: bytes, unended: bool) -> _Rows:
        if not self.short:
            rows = None if unended else self._by_engine(data)
            if rows is not None:
                return rows
            cut = data.find(b"\n", len(data) // 2) + 1
            if _BY_LINE < len(data) > cut:
                return _joined(self._rows(data[:cut], False), self._rows(data[cut:], unended))
        return self._by_line(data, unended)

    # ------------------------------------------------------------------------------------------- sound rows, at once

    def _by_engine(self, data: bytes) -> _Rows | None:
        """Parse rows that break no rule, as is seen without a look at single rows; None where one might.

        The engine gives a short row null in its last field and leaves out what a long row has too much, without a word.
        Where no last field is null and the separators are as many as the rows need, no row is short or long.
        """
        fields, separator = len(self.dialect.names), ord(self.dialect.separator)
        if b"\r" in data:
            data = data.replace(b"\r\n", b"\n")
        quoted = b'"' in data
        if b"\r" in data or b"\0" in data:
            return None
        bare = _without_quoted(data, separator) if quoted else data
        if bare is None:
            return None
        rows = _count(bare, _LF)
        if _count(bare, separator) != rows * (fields - 1) or (quoted and _count(data, _LF) != rows):
            return None
        frame = self._typed_columns(data, '"' if quoted else None)
        if frame is None or len(frame) != rows:
            return None
        if frame.to_series(-1).null_count() and (fields == 1 or not _is_rectangular(bare, fields, separator)):
            return None
        values = {}
        for index in self.columns:
            column, wrong = self._values(frame[str(index)], index)
            if wrong is not None:
                return None
            values[index] = column
        return values, {}, data, {index: frame[str(index)].replace("", None) for index in self.texts}

    def _typed_columns(self, data: bytes, quote_char: str | None) -> pl.DataFrame | None:
        """Read needed columns as numbers, or as text where that fails, and the last column; None if both fail."""
        import polars as pl

        fields, others = len(self.dialect.names), [index for index in self.columns if index != self.time]
        wanted = sorted({*self.columns, *self.texts, fields - 1})
        tried: list[Sequence[int]] = [[]]
        if self.dialect.decimal == "." and not _has_open_points(data):
            # Moments are the one kind of text that is read as fast as numbers are; a time whose text is needed is text.
            timed = self.time is not None and self.time not in self.texts
            tried = [*([self.columns] if timed else []), others, []]
        for numeric in tried:
            schema = {str(index): pl.Float64 if index in numeric else pl.String for index in range(fields)}
            with suppress(pl.exceptions.PolarsError):
                return _engine(*(data, quote_char), separator=self.dialect.separator, schema=schema, columns=wanted)
        return None

    def _values(self, cells: pl.Series, index: int) -> tuple[Array, Mask | None]:
        """Return the numbers of a column that is read as numbers or as text, and which cells are none."""
        import polars as pl

        if cells.dtype != pl.String:
            return cells.to_numpy(), None
        cells = self.dialect.with_points(cells, moments=index == self.time)
        return (seconds(cells), None) if index == self.time else numbers(cells)

    # --------------------------------------------------------------------------------------------- others, by line

    def _by_line(self, data: bytes, unended: bool) -> _Rows:
        """Parse rows one by one, and say what is wrong with each."""
        dialect, faults = self.dialect, {}
        lines = [line.removesuffix("\r") for line in data.decode().split("\n")[:-1]]
        rows = []
        for place, line in enumerate(lines):
            cells, fault = self._cells(line)
            if unended and place == len(lines) - 1 and _is_torn(cells, fault, dialect):
                fault = _TORN
            if fault:
                faults[place], cells = fault, [""] * len(dialect.names)
            rows.append(cells)
        values = {index: self._column([row[index] for row in rows], index, faults) for index in self.columns}
        for place in faults:
            rows[place][0] = lines[place]
            lines[place] = '"' + lines[place].replace('"', '""') + '"' + dialect.separator * (len(dialect.names) - 1)
            for column in values.values():
                column[place] = np.nan
        texts = {index: _series([row[index] or None for row in rows]) for index in self.texts}
        return values, faults, "".join(f"{line}\n" for line in lines).encode(), texts

    def _cells(self, line: str) -> tuple[list[str], str]:
        """Return the fields of a row, and what is wrong with it."""
        separator, fields = self.dialect.separator, len(self.dialect.names)
        if "\0" in line:
            return line.split(separator), "the row holds a NUL byte"
        if '"' not in line:
            cells = line.split(separator)
            if "\r" in line:
                return cells, "the row holds a bare CR"
        else:
            try:
                cells = next(csv.reader([line], delimiter=separator, strict=True))
            except csv.Error as failure:
                if "unexpected end" in str(failure):
                    return [], "a quoted field does not end in its row: take the line end out of it"
                return [], f"the row cannot be parsed: {failure}"
        if not line:
            return cells, "the line is empty"
        if len(cells) != fields:
            return cells, f"the row has {len(cells)} field{'s' * (len(cells) != 1)}, the header {fields}"
        return cells, ""

    def _column(self, cells: list[str], index: int, faults: dict[int, str]) -> Array:
        """Return the numbers of a column; add cells that are no numbers to ``faults``."""
        if index == self.time:
            return seconds(self.dialect.with_points(_series(cells), moments=True))
        found = [number(self.dialect.with_point(cell)) for cell in cells]
        if None in found:
            for row, value in enumerate(found):
                if value is None:
                    faults.setdefault(row, f"column {self.dialect.names[index]!r}: {cells[row]!r} is no number")
        return np.array(found, float)


_Rows = tuple[dict[int, Array], dict[int, str], bytes, dict[int, "pl.Series"]]
"""Values by column, faults by row, text, and texts by column."""


def _joined(first: _Rows, second: _Rows) -> _Rows:
    import polars as pl

    rows = first[2].count(b"\n")
    return (
        {index: np.concatenate([column, second[0][index]]) for index, column in first[0].items()},
        first[1] | {rows + row: fault for row, fault in second[1].items()},
        first[2] + second[2],
        {index: pl.concat([column, second[3][index]]) for index, column in first[3].items()},
    )


def _is_torn(cells: list[str], fault: str, dialect: Dialect) -> bool:
    """Return whether a last row without a line end is short, or stops inside a number."""
    fields = len(dialect.names)
    return len(cells) < fields or (not fault and is_cut(dialect.with_point(cells[-1])))


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


def _without_quoted(data: bytes, separator: int) -> bytes | None:
    """Return the bytes with quotes in place of all that is inside quotes; None unless these enclose whole fields."""
    buffer = np.frombuffer(data, np.uint8)
    quotes = buffer == _QUOTE
    places = np.flatnonzero(quotes)
    if len(places) % 2 or np.diff(places).max() > csv.field_size_limit():
        return None
    # The first byte follows a line end, as the last one is a line end. A quote beside a quote is a doubled one.
    beside = np.concatenate([buffer[places[::2] - 1], buffer[places[1::2] + 1]])
    if not ((beside == separator) | (beside == _LF) | (beside == _QUOTE)).all():
        return None
    inside = np.bitwise_xor.accumulate(quotes.view(np.uint8)).view(bool)
    return np.where(inside, np.uint8(_QUOTE), buffer).tobytes()


def _engine(data: bytes, quote_char: str | None = None, **options: Any) -> pl.DataFrame:
    """Read rows.

    The engine takes bytes that begin as a compressed file does (a cell ``x`` and a control character will do) for one;
    behind an empty line, which is skipped, they are what they are. It also drops a byte order mark, which is one only
    at the beginning of the log: a second one in front of it is dropped in its place.
    """
    import polars as pl

    if data.startswith(UTF8_BOM):
        data = UTF8_BOM + data
    if data[0] in _OF_NUMBERS:
        return pl.read_csv(data, has_header=False, quote_char=quote_char, **options)
    return pl.read_csv(b"\n" + data, skip_lines=1, has_header=False, quote_char=quote_char, **options)


def _series(texts: Sequence[str | None]) -> pl.Series:
    import polars as pl

    return pl.Series("", texts, dtype=pl.String)
