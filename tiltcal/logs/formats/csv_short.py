"""Short CSV logs without the engine, whose import alone takes longer than they do.

Only rows in which the grammar of :mod:`tiltcal.logs.formats.csv_rows` finds nothing odd are parsed here: ASCII without
quotes, as many fields as the header, and in the needed columns numbers or missing values. For any other block the
engine is imported, and says what there is to say about its rows.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import isfinite

import numpy as np

from tiltcal.logs.formats.csv_rows import CsvBlock
from tiltcal.logs.log import Table
from tiltcal.logs.text_to_numbers import MISSING, is_cut

SHORT = 1 << 18
"""Largest size of a short log, bytes; some thousand rows take as long here as the engine takes to import."""

_NUMBER = re.compile(r"[+-]?(\d+|\d*\.\d+)([eE][+-]?\d+)?")
_ODD = ('"', "\r", "\0")


def short_rows(data: bytes, fields: int, columns: Sequence[int], *, unended: bool = False) -> CsvBlock | None:
    """Parse rows that are plain.

    Parameters
    ----------
    data : bytes
        Whole lines, the last one with its line end.
    fields : int
        Of the header.
    columns : sequence of int
        Indices of the columns that hold needed numbers.
    unended : bool
        The last line had no end in the file.

    Returns
    -------
    CsvBlock or None
        Its text is a list; None where anything about a row is odd.
    """
    if not data.isascii():
        return None
    text = data.decode("ascii").replace("\r\n", "\n")
    if any(mark in text for mark in _ODD):
        return None
    lines = text.removesuffix("\n").split("\n")
    rows = [line.split(",") for line in lines]
    if "" in lines or any(len(row) != fields for row in rows) or (unended and is_cut(rows[-1][-1])):
        return None
    values = {}
    for index in columns:
        numbers = [_number(row[index].strip(" \t")) for row in rows]
        if None in numbers:
            return None
        values[index] = np.array(numbers, np.float64)
    return CsvBlock(
        values=values,
        faults={},
        text=lines,
        starts=range(len(lines)),
        line_count=len(lines),
        encoding="utf-8",
        rest=b"",
    )


def short_text(lines: Sequence[str], table: Table, line_end: str) -> bytes:
    """Return rows with columns behind their own as the engine writes them."""
    columns = [[_text(value) for value in column.tolist()] for column in table.values()]
    return "".join(",".join(cells) + line_end for cells in zip(lines, *columns, strict=True)).encode()


def _number(cell: str) -> float | None:
    """Return the nearest double to a number, NaN for a missing value, and None for what is neither."""
    if _NUMBER.fullmatch(cell):
        value = float(cell)
        return value if isfinite(value) else None
    return np.nan if cell.casefold() in MISSING else None


def _text(value: float | int) -> str:
    """Return a value in the engine's notation: 0.00001 and 1e-6 where Python has 1e-05 and 1e-06."""
    text = repr(value)
    if text == "nan":
        return "NaN"
    number, _, exponent = text.partition("e-0")
    if not exponent:
        return text
    if exponent != "5":
        return f"{number}e-{exponent}"
    sign = "-" * number.startswith("-")
    return f"{sign}0.0000{number.removeprefix('-').replace('.', '')}"
