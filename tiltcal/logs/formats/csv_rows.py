"""Rows of a CSV log: our own rule on what a row is, in front of the engine that parses its numbers.

CSV readers differ in silence on short and long rows, on a row that a power cut tore, on blank lines and odd numbers. So
the grammar is our own, and the same for every row of every file:

- A row has as many fields as the header.
- A field in double quotes may hold commas, doubled quotes and line ends; elsewhere a quote is a character.
- Lines end in LF or CRLF. A NUL byte, or a bare CR outside quotes, is damage.
- An empty line is a row that cannot be parsed.
- A last line that has no end is torn where it is short, or stops inside a number.
- :mod:`tiltcal.logs.cells` defines what is a number, and what is a time.

Rows that break a rule are kept with the text that they had: missing fields are added empty at the end, surplus fields
are joined into the last one, in quotes, and a bad row that has quotes already becomes one quoted field.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.logs.cells import is_cut, numbers, seconds
from tiltcal.logs.log import LogBlock

if TYPE_CHECKING:
    import polars as pl

Positions = NDArray[np.intp]

_LF, _COMMA, _CR, _NUL, _POINT, _ZERO, _NINE = b"\n,\r\0.09"
_TORN = "the last row is cut short"
_UNUSED = "\x1f\x1e\x1d\x1c\x01\x02\x03\x04\x05\x06\x0e\x0f\x10\x11\x12\x13\x14\x15\x16\x17"


@dataclass(frozen=True, kw_only=True)
class CsvBlock(LogBlock):
    """Some rows of a CSV log, in order.

    Attributes
    ----------
    faults : dict of int to str
        What is wrong, by row.
    lines : polars.Series of String, or list of str, length n
        Each row's text without its line end.
    starts : sequence of int
        On which line of the bytes each row starts, counted from 0.
    line_count : int
        Lines that these rows take.
    encoding : str
        ``utf-8``, or ``latin-1`` where the bytes were no UTF-8: encode ``lines`` with it to have the bytes again.
    rest : bytes
        A row at the end whose quoted field goes on behind these bytes.
    texts : mapping of int to polars.Series of String, length n
        The text columns that were asked for; null where a cell is empty.
    """

    faults: Mapping[int, str]
    lines: pl.Series | list[str]
    starts: Sequence[int]
    line_count: int
    encoding: str
    rest: bytes
    texts: Mapping[int, pl.Series] = field(default_factory=dict)


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
    starts: Sequence[int]
    if b'"' in data:
        wanted = [*columns, *texts]
        lines, cells, faults, starts, rest = _split_quoted(data.decode(), len(names), wanted, unended)
        series = _series(lines)
        values = _parse_cells({index: cells[index] for index in columns}, names, faults, time)
        words = {index: cells[index].replace("", None) for index in texts}
        line_count = data.count(b"\n") - rest.count("\n")
    else:
        if b"\r" in data:
            data = data.replace(b"\r\n", b"\n")
        faults = _plain_faults(data, len(names), unended)
        numeric = data
        if faults:
            data, numeric = _repaired(data, faults, len(names))
        series, values = _plain_lines(data), _plain_values(numeric, names, columns, faults, time)
        words = _plain_texts(numeric, names, texts)
        line_count, rest = len(series), ""
        starts = range(line_count)
    for column in values.values():
        column[list(faults)] = np.nan
    if words and faults:
        words = _with_bad_rows(words, series, faults)
    return CsvBlock(
        values=values,
        faults=faults,
        lines=series,
        starts=starts,
        line_count=line_count,
        encoding=encoding,
        rest=rest.encode(encoding),
        texts=words,
    )


def _as_utf8(data: bytes) -> tuple[bytes, str]:
    """Return the bytes as UTF-8; others are read as Latin-1, and written back as they were."""
    if data.isascii():
        return data, "utf-8"
    try:
        data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1").encode(), "latin-1"
    return data, "utf-8"


# ------------------------------------------------------------------------------------------------ rows without quotes


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


def _field_counts(commas: Positions, ends: Positions, fields: int) -> Positions | None:
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


def _plain_lines(data: bytes) -> pl.Series:
    """Return the rows as one text column, which the engine splits fastest: it sees no separator."""
    import polars as pl

    separator = next((mark for mark in _UNUSED if mark.encode() not in data), None)
    if separator is None:
        return _series(data.decode().split("\n")[:-1])
    return _engine(data, separator=separator, schema={"": pl.String})[""]


def _engine(data: bytes, **options: Any) -> pl.DataFrame:
    """Read rows without quotes.

    The engine takes bytes that begin as a compressed file does (a cell ``x`` and a control character will do) for one;
    behind an empty line, which is skipped, they are what they are.
    """
    import polars as pl

    return pl.read_csv(b"\n" + data, skip_lines=1, has_header=False, quote_char=None, **options)


def _plain_values(
    data: bytes, names: Sequence[str], columns: Sequence[int], faults: dict[int, str], time: int | None
) -> dict[int, Array]:
    """Numbers straight from the bytes; by way of their text where the engine's rule could differ from ours."""
    import polars as pl

    def read(numeric: Sequence[int]) -> pl.DataFrame:
        schema = {str(index): pl.Float64 if index in numeric else pl.String for index in range(len(names))}
        wanted = sorted(set(columns))
        return _engine(data, schema=schema, columns=wanted)

    # Moments are the one kind of text that is read as fast as numbers are.
    tries = [columns] if time is None else [columns, [index for index in columns if index != time]]
    for numeric in [] if _has_open_points(data) else tries:
        try:
            frame = read(numeric)
        except pl.exceptions.ComputeError:
            continue
        values = {index: frame[str(index)].fill_null(np.nan).to_numpy(writable=True) for index in numeric}
        if time is not None and time not in values:
            values[time] = seconds(frame[str(time)])
        return values
    texts = read([])
    return _parse_cells({index: texts[str(index)] for index in columns}, names, faults, time)


def _plain_texts(data: bytes, names: Sequence[str], texts: Sequence[int]) -> dict[int, pl.Series]:
    import polars as pl

    if not texts:
        return {}
    frame = _engine(data, schema={str(index): pl.String for index in range(len(names))}, columns=sorted(set(texts)))
    return {index: frame[str(index)] for index in texts}


def _has_open_points(data: bytes) -> bool:
    """Return whether a decimal point lacks a digit behind it, which the engine would take for a number."""
    buffer = np.frombuffer(data, np.uint8)
    behind = buffer[np.flatnonzero(buffer == _POINT) + 1]
    return bool(((behind < _ZERO) | (behind > _NINE)).any())


# --------------------------------------------------------------------------------------------------- rows with quotes


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
    """Numbers from text; adds what is none to ``faults``."""
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
    cells = [next(csv.reader([line])) if '"' in line else line.split(",") for line in lines.gather(rows)]
    return {
        index: column.scatter(rows, [row[index] if index < len(row) and row[index] else None for row in cells])
        for index, column in words.items()
    }


def _refitted(row: Sequence[str], line: str, fields: int) -> str:
    """Return the text of a bad row with as many fields as the header."""
    if len(row) == fields and line:
        return line
    if '"' in line or fields == 1:
        return ",".join([_in_quotes(line), *[""] * (fields - 1)])
    if len(row) < fields:
        return line + "," * (fields - len(row))
    return ",".join([*row[: fields - 1], _in_quotes(",".join(row[fields - 1 :]))])


def _in_quotes(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'


def _miscount(found: int, fields: int) -> str:
    return f"the row has {found} field{'s' * (found != 1)}, the header {fields}"


def _series(texts: Sequence[str]) -> pl.Series:
    import polars as pl

    return pl.Series("", texts, dtype=pl.String)
