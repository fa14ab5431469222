"""Rows of a CSV log: our own rule on what a row is, in front of the engine that parses its numbers.

CSV readers differ in silence on short and long rows, on a row that a power cut tore, on blank lines and odd numbers. So
the grammar is our own, and the same for every row of every file:

- A row has as many fields as the header.
- A field in double quotes may hold commas, doubled quotes and line ends; elsewhere a quote is a character.
- Lines end in LF or CRLF. A NUL byte, or a bare CR outside quotes, is damage.
- An empty line is a row that cannot be parsed.
- A last line that has no end is torn where it is short, or stops inside a number.
- :mod:`tiltcal.logs.text_to_numbers` defines what is a number, and what is a time.

Rows that break a rule are kept with the text that they had: missing fields are added empty at the end, surplus fields
are joined into the last one, in quotes, and a bad row that has quotes already becomes one quoted field.
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
from tiltcal.logs.log import LogBlock
from tiltcal.logs.text_to_numbers import is_cut, numbers, seconds

if TYPE_CHECKING:
    import polars as pl

Offsets = NDArray[np.intp]

_LF, _COMMA, _QUOTE, _CR, _NUL, _POINT, _ZERO, _NINE = b'\n,"\r\0.09'
_PIECE = 1 << 16  # bytes: as many as stay in the cache with what is made of them
_TORN = "the last row is cut short"
_OF_NUMBERS = b"0123456789+-."
UTF8_BOM = b"\xef\xbb\xbf"
_UNUSED = "\x1f\x1e\x1d\x1c\x01\x02\x03\x04\x05\x06\x0e\x0f\x10\x11\x12\x13\x14\x15\x16\x17"


@dataclass(frozen=True, kw_only=True)
class CsvBlock(LogBlock):
    """Some rows of a CSV log, in order.

    Attributes
    ----------
    faults : dict of int to str
        What is wrong, by row.
    text : bytes, polars.Series of String, or list of str, length n
        Each row's text without its line end; as bytes in UTF-8, the rows as they follow each other, each with a LF.
    starts : sequence of int
        On which line of the bytes each row starts, counted from 0.
    line_count : int
        Lines that these rows take.
    encoding : str
        ``utf-8``, or ``latin-1`` where the bytes were no UTF-8: encode the text with it to have the bytes again.
    rest : bytes
        A row at the end whose quoted field goes on behind these bytes.
    texts : mapping of int to polars.Series of String, length n
        The text columns that were asked for; null where a cell is empty.
    """

    faults: Mapping[int, str]
    text: bytes | pl.Series | list[str]
    starts: Sequence[int]
    line_count: int
    encoding: str
    rest: bytes
    texts: Mapping[int, pl.Series] = field(default_factory=dict)

    @property
    def lines(self) -> pl.Series:
        """Each row's text; bytes are split at every call, and only what writes them as they stand needs that."""
        return _lines(self.text)


def parse_rows(
    data: bytes,
    names: Sequence[str],
    columns: Sequence[int],
    *,
    time: int | None = None,
    texts: Sequence[int] = (),
    unended: bool = False,
) -> CsvBlock:
    """Parse rows.

    Parameters
    ----------
    data : bytes
        Whole lines, the last one with its line end.
    names : sequence of str
        The header.
    columns : sequence of int
        Indices of the columns that hold needed numbers.
    time : int, optional
        Of them, the one that may hold moments in ISO 8601; what is neither is missing there.
    texts : sequence of int
        Indices of other columns that are wanted as text.
    unended : bool
        The last line had no end in the file.

    Returns
    -------
    CsvBlock
        Nothing is raised: what breaks a rule is in ``faults``.
    """
    data, encoding = _as_utf8(data)
    found = None if unended else _sound_rows(data, len(names), columns, time, texts)
    if found is None:
        found = (_rows_with_quotes if b'"' in data else _rows_without_quotes)(
            data, names, columns, time, texts, unended
        )
    faults = found.faults
    if faults:
        for column in found.values.values():
            column[list(faults)] = np.nan
    words = _with_bad_rows(found.texts, _lines(found.text), faults) if found.texts and faults else found.texts
    return CsvBlock(
        values=found.values,
        faults=faults,
        text=found.text,
        starts=found.starts,
        line_count=found.line_count,
        encoding=encoding,
        rest=found.rest.encode(encoding),
        texts=words,
    )


@dataclass(frozen=True)
class _Rows:
    """Rows that are parsed; see :class:`CsvBlock`."""

    text: bytes | pl.Series
    values: dict[int, Array]
    texts: Mapping[int, pl.Series]
    starts: Sequence[int]
    line_count: int
    faults: dict[int, str] = field(default_factory=dict)
    rest: str = ""


def _as_utf8(data: bytes) -> tuple[bytes, str]:
    """Return the bytes as UTF-8; others are read as Latin-1, and written back as they were."""
    if data.isascii():
        return data, "utf-8"
    try:
        data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1").encode(), "latin-1"
    return data, "utf-8"


# ------------------------------------------------------------------------------------------------------- sound rows


def _sound_rows(
    data: bytes, fields: int, columns: Sequence[int], time: int | None, texts: Sequence[int]
) -> _Rows | None:
    """Parse rows that break no rule, as is seen without a look at single rows; None where one might.

    The engine gives a short row null in its last field and leaves out what a long row has too much, without a word.
    Where no last field is null and the commas are as many as the rows need, no row is short or long.
    """
    import polars as pl

    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n")
    quoted = b'"' in data
    if b"\r" in data or b"\0" in data or _has_open_points(data):
        return None
    bare = _without_quoted(data) if quoted else data
    if bare is None:
        return None
    rows = _count(bare, _LF)
    if _count(bare, _COMMA) != rows * (fields - 1) or (quoted and _count(data, _LF) != rows):
        return None
    frame = _typed_columns(data, fields, columns, time, texts, '"' if quoted else None)
    if frame is None or len(frame) != rows:
        return None
    if frame.to_series(-1).null_count() and (fields == 1 or not _is_rectangular(bare, fields)):
        return None
    values = {
        index: seconds(column) if column.dtype == pl.String else column.to_numpy()
        for index, column in ((index, frame[str(index)]) for index in columns)
    }
    words = {index: frame[str(index)] for index in texts}
    if quoted:
        words = {index: column.replace("", None) for index, column in words.items()}
    return _Rows(data, values, words, range(rows), rows)


def _typed_columns(
    data: bytes, fields: int, columns: Sequence[int], time: int | None, texts: Sequence[int], quote_char: str | None
) -> pl.DataFrame | None:
    """Read the needed columns as numbers, the time as text if it is none, and the last one; None if that fails."""
    import polars as pl

    # Moments are the one kind of text that is read as fast as numbers are; a time whose text is needed stays text.
    others = [index for index in columns if index != time]
    for numeric in [columns] if time is None else [others] if time in texts else [columns, others]:
        schema = {str(index): pl.Float64 if index in numeric else pl.String for index in range(fields)}
        with suppress(pl.exceptions.PolarsError):
            return _engine(data, schema=schema, columns=sorted({*columns, *texts, fields - 1}), quote_char=quote_char)
    return None


def _is_rectangular(data: bytes, fields: int) -> bool:
    buffer = np.frombuffer(data, np.uint8)
    return _field_counts(np.flatnonzero(buffer == _COMMA), np.flatnonzero(buffer == _LF), fields) is None


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


def _without_quoted(data: bytes) -> bytes | None:
    """Return the bytes with quotes in place of all that is inside quotes; None unless these enclose whole fields."""
    buffer = np.frombuffer(data, np.uint8)
    quotes = buffer == _QUOTE
    places = np.flatnonzero(quotes)
    if len(places) % 2 or np.diff(places).max() > csv.field_size_limit():
        return None
    # The first byte follows a line end, as the last one is a line end. A quote beside a quote is a doubled one.
    beside = np.concatenate([buffer[places[::2] - 1], buffer[places[1::2] + 1]])
    if not ((beside == _COMMA) | (beside == _LF) | (beside == _QUOTE)).all():
        return None
    inside = np.bitwise_xor.accumulate(quotes.view(np.uint8)).view(bool)
    return np.where(inside, np.uint8(_QUOTE), buffer).tobytes()


# ------------------------------------------------------------------------------------------------ rows without quotes


def _rows_without_quotes(
    data: bytes, names: Sequence[str], columns: Sequence[int], time: int | None, texts: Sequence[int], unended: bool
) -> _Rows:
    import polars as pl

    data = data.replace(b"\r\n", b"\n")
    faults = _plain_faults(data, len(names), unended)
    numeric = data
    if faults:
        data, numeric = _repaired(data, faults, len(names))
    wanted = sorted({*columns, *texts})
    cells = _engine(numeric, schema={str(index): pl.String for index in range(len(names))}, columns=wanted)
    values = _parse_cells({index: cells[str(index)] for index in columns}, names, faults, time)
    rows = numeric.count(b"\n")
    return _Rows(data, values, {index: cells[str(index)] for index in texts}, range(rows), rows, faults)


def _plain_faults(data: bytes, fields: int, unended: bool) -> dict[int, str]:
    """Rows that are not what they should be, found on the bytes of all rows at once."""
    buffer = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(buffer == _LF)
    faults: dict[int, str] = {}
    counts = _field_counts(np.flatnonzero(buffer == _COMMA), ends, fields)
    if counts is not None:
        for row in np.flatnonzero(counts != fields).tolist():
            faults[row] = _miscount(int(counts[row]), fields)
    for row in np.flatnonzero(np.diff(ends, prepend=-1) == 1).tolist():
        faults[row] = "the line is empty"
    for code, what in ((_NUL, "a NUL byte"), (_CR, "a bare CR")):
        if code in data:
            for row in np.searchsorted(ends, np.flatnonzero(buffer == code)).tolist():
                faults[row] = f"the row holds {what}"
    if unended:
        last = data[data.rfind(b"\n", 0, -1) + 1 : -1].decode().split(",")
        if len(last) < fields or (len(last) == fields and is_cut(last[-1])):
            faults[len(ends) - 1] = _TORN
    return faults


def _field_counts(commas: Offsets, ends: Offsets, fields: int) -> Offsets | None:
    """Fields of each row; None where every row has ``fields``, which takes no search to see."""
    rows = len(ends)
    if len(commas) == rows * (fields - 1):
        if fields == 1:
            return None
        grid = commas.reshape(rows, fields - 1)
        if (grid[1:, 0] > ends[:-1]).all() and (grid[:, -1] < ends).all():
            return None
    return np.diff(np.searchsorted(commas, ends), prepend=0) + 1


def _repaired(data: bytes, faults: Mapping[int, str], fields: int) -> tuple[bytes, bytes]:
    """Return the rows with bad ones refitted, and again with bad ones blank, for the engine that parses the numbers."""
    lines = data.decode().split("\n")
    numeric = lines.copy()
    for row in faults:
        lines[row] = _refitted(lines[row].split(","), lines[row], fields)
        numeric[row] = ",".join(["NaN"] * fields)
    return "\n".join(lines).encode(), "\n".join(numeric).encode()


def _lines(text: bytes | pl.Series | list[str]) -> pl.Series:
    """Return the rows as one text column, which the engine splits fastest: it sees no separator."""
    import polars as pl

    if not isinstance(text, bytes):
        return pl.Series("", text, dtype=pl.String)
    separator = next((mark for mark in _UNUSED if mark.encode() not in text), None)
    if separator is None:
        return _series(text.decode().split("\n")[:-1])
    return _engine(text, separator=separator, schema={"": pl.String})[""]


def _engine(data: bytes, *, quote_char: str | None = None, **options: Any) -> pl.DataFrame:
    """Read rows without quotes.

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


# --------------------------------------------------------------------------------------------------- rows with quotes


def _rows_with_quotes(
    data: bytes, names: Sequence[str], columns: Sequence[int], time: int | None, texts: Sequence[int], unended: bool
) -> _Rows:
    lines, cells, faults, starts, rest = _split_quoted(data.decode(), len(names), [*columns, *texts], unended)
    values = _parse_cells({index: cells[index] for index in columns}, names, faults, time)
    words = {index: cells[index].replace("", None) for index in texts}
    return _Rows(_series(lines), values, words, starts, data.count(b"\n") - rest.count("\n"), faults, rest)


def _split_quoted(
    text: str, fields: int, columns: Sequence[int], unended: bool
) -> tuple[list[str], dict[int, pl.Series], dict[int, str], list[int], str]:
    """Lines, needed cells, faults, starts and rest of rows that may hold quoted fields, row by row."""
    lines: list[str] = []
    cells: dict[int, list[str]] = {index: [] for index in columns}
    faults: dict[int, str] = {}
    starts: list[int] = []
    rest = ""
    for start, line, row, fault in _records(text):
        if row is None:
            rest = line
            break
        fault = fault or (_miscount(len(row), fields) if len(row) != fields else "")
        if fault:
            faults[len(lines)] = fault
            line = _refitted(row, line, fields)
        lines.append(line)
        starts.append(start)
        for index, column in cells.items():
            column.append(row[index] if index < len(row) else "")
    if unended and not rest and (len(row or ()) < fields or (row and len(row) == fields and is_cut(row[-1]))):
        faults[len(lines) - 1] = _TORN
    return lines, {index: _series(column) for index, column in cells.items()}, faults, starts, rest


def _records(text: str) -> Iterator[tuple[int, str, list[str] | None, str]]:
    """Start, text, fields and fault of each row; fields are None for a row whose quoted field does not end."""
    taken: list[str] = []
    read = 0
    exhausted = False

    def feed() -> Iterator[str]:
        nonlocal read, exhausted
        for line in text.split("\n")[:-1]:
            read += 1
            taken.append(line)
            yield line + "\n"
        exhausted = True

    reader = csv.reader(feed(), strict=True)
    while True:
        taken.clear()
        start, fault = read, ""
        try:
            row: list[str] | None = next(reader, [])
        except csv.Error as failure:
            # A row that swallowed lines before its quotes went wrong cannot be distinguished from those lines.
            row = None if exhausted or len(taken) > 1 else []
            fault = f"the row cannot be parsed: {failure}"
        if not taken:
            return
        line = "\n".join(taken)
        if row is None:
            line = text.split("\n", start)[start]
        if "\0" in line:
            fault = "the row holds a NUL byte"
        yield (
            start,
            line if row is None else line.removesuffix("\r"),
            row,
            fault or ("" if row else "the line is empty"),
        )
        if row is None:
            return


# ------------------------------------------------------------------------------------------------------------- shared


def _parse_cells(
    cells: Mapping[int, pl.Series], names: Sequence[str], faults: dict[int, str], time: int | None
) -> dict[int, Array]:
    """Return numbers from text; add cells that are no numbers to ``faults``."""
    values: dict[int, Array] = {}
    for index, column in cells.items():
        if index == time:
            values[index] = seconds(column)
            continue
        values[index], wrong = numbers(column)
        if wrong is None:
            continue
        for row in np.flatnonzero(wrong).tolist():
            faults.setdefault(row, f"column {names[index]!r}: {column[row]!r} is no number")
    return values


def _with_bad_rows(words: Mapping[int, pl.Series], lines: pl.Series, faults: Mapping[int, str]) -> dict[int, pl.Series]:
    """Return the text columns with the cells of bad rows as these were refitted."""
    rows = sorted(faults)
    cells = [_refitted_cells(line) for line in lines.gather(rows)]
    return {
        index: column.scatter(rows, [row[index] if index < len(row) and row[index] else None for row in cells])
        for index, column in words.items()
    }


def _refitted_cells(line: str) -> list[str]:
    """Return the cells of a bad row that was refitted."""
    if '"' not in line:
        return line.split(",")
    try:
        return next(csv.reader([line]))
    except csv.Error:  # it is longer than a field that `csv` reads, and the whole row is one
        return [line.rstrip(",")[1:-1].replace('""', '"')]


def _refitted(row: Sequence[str], line: str, fields: int) -> str:
    """Return the text of a bad row with as many fields as the header."""
    if len(row) == fields and line:
        return line
    if '"' in line or fields == 1:
        return ",".join([_in_quotes(line), *[""] * (fields - 1)])
    if len(row) < fields:
        return line + "," * (fields - len(row))
    kept = [_in_quotes(cell) if "\r" in cell else cell for cell in row[: fields - 1]]
    return ",".join([*kept, _in_quotes(",".join(row[fields - 1 :]))])


def _in_quotes(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'


def _miscount(found: int, fields: int) -> str:
    return f"the row has {found} field{'s' * (found != 1)}, the header {fields}"


def _series(texts: Sequence[str]) -> pl.Series:
    import polars as pl

    return pl.Series("", texts, dtype=pl.String)
