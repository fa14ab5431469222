"""Cells as numbers and as times: our own rule on text, in front of the engine that parses it, and typed columns.

A number is ``[+-]digits[.digits][e[+-]digits]``; the digits before the point may be left out, those behind it may not
(``2.`` is what is left of a row that was cut). An empty cell and NaN, NA, N/A, null, None in any case are a missing
value, and so is an infinity. Blanks around a cell do not count. Everything else is an error. A time is a number of
seconds, or a moment in ISO 8601: a date, a time of day behind ``T`` or a blank, with or without seconds and zone. A
cell that is neither is missing where another one of its block, or of those before, is a time; else it is an error too.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.model import Array

if TYPE_CHECKING:
    import polars as pl

    from tiltcal.core.flags import Mask

MISSING = frozenset({"", "nan", "+nan", "-nan", "na", "n/a", "null", "none"})

EPOCH = (1e9, 2e10)  # seconds since 1970 between which a number is a time since then
PACE = (1e-6, 86400.0)  # seconds between rows that show that such a number is none of a counter

_CUT_NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)[eE][+-]?|\d*\.)?")
_OPEN_POINT = r"\.([^0-9]|$)"
_DAY = r"^\s*\d{4}-\d"
_ISO = "%Y-%m-%dT%H:%M:%S%.fZ"
_EXAMPLE = "2026-05-01T12:00:00.5Z"
_PARTS = (
    r"^(?P<day>\d{4}-\d\d?-\d\d?)"
    r"(?:[T ](?P<minute>\d\d?:\d\d?)(?P<second>:\d\d?(?:\.\d*)?)? ?(?P<zone>Z|UTC|[+-]\d\d(?::?\d\d)?)?)?$"
)


def numbers(cells: pl.Series) -> tuple[Array, Mask | None]:
    """Return the numbers of text cells, shape (n,), NaN where there is none, and which cells are wrong, if any."""
    import polars as pl

    texts = cells.fill_null("").str.strip_chars(" \t")
    parsed = texts.cast(pl.Float64, strict=False)
    values = parsed.fill_null(np.nan).to_numpy(writable=True)
    doubtful = parsed.is_null() | texts.str.contains(_OPEN_POINT)
    no_numbers = [text for text in texts.filter(doubtful).unique().to_list() if text.casefold() not in MISSING]
    if not no_numbers:
        return values, None
    wrong = (doubtful & texts.is_in(no_numbers)).to_numpy(writable=True)
    values[wrong] = np.nan
    return values, wrong


def is_cut(cell: str) -> bool:
    """Return whether the last cell of a file that does not end its last line looks like the beginning of a number.

    ``2.``, ``1e``, ``-`` and the empty cell do; ``2``, ``2.5`` and ``done`` do not: nothing shows that they are.
    """
    return _CUT_NUMBER.fullmatch(cell.strip()) is not None


def seconds(cells: pl.Series) -> Array:
    """Return the times of text cells, shape (n,): numbers as they are, moments since 1970; NaN where a cell is neither.

    A moment without a zone is UTC.
    """
    import polars as pl

    # The layout of recorders and of this program is read ten times as fast as any other.
    moments = cells.str.to_datetime(_ISO, time_unit="us", strict=False)
    if not moments.null_count():
        return np.asarray((moments.dt.epoch("us") / 1e6).to_numpy())
    values, wrong = numbers(cells)
    if wrong is None:
        return values
    parts = cells.filter(pl.Series(wrong)).str.strip_chars().str.extract_groups(_PARTS).struct
    zones = parts.field("zone").replace(["Z", "UTC"], "+00:00").fill_null("+00:00")
    times = parts.field("minute").fill_null("00:00") + parts.field("second").fill_null(":00")
    texts = parts.field("day") + "T" + times + zones
    moments = texts.str.to_datetime("%Y-%m-%dT%H:%M:%S%.f%#z", time_unit="us", time_zone="UTC", strict=False)
    values[wrong] = (moments.dt.epoch("us") / 1e6).fill_null(np.nan).to_numpy()
    return values


def are_moments(cells: pl.Series | None) -> bool:
    """Return whether the cells of a time are moments, not numbers, as far as the first that is there shows."""
    import polars as pl

    if cells is None or cells.dtype.is_numeric():
        return False
    if cells.dtype != pl.String:
        return cells.dtype.is_temporal()
    texts = cells.head(1000).drop_nulls().str.strip_chars()
    return numbers(texts.filter(~texts.str.to_lowercase().is_in([*MISSING])).head(1))[1] is not None


def unit_since_epoch(times: Array) -> str | None:
    """Return the unit of times since 1970 of which nothing states one, by their size and their step; else None."""
    known = times[np.isfinite(times)]
    steps = np.diff(known)
    steps = steps[steps > 0.0]
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if len(known) and EPOCH[0] * factor <= known[0] <= EPOCH[1] * factor:
            usual = float(np.median(steps)) / factor if len(steps) else 1.0
            return unit if PACE[0] <= usual <= PACE[1] else None
    return None


def column_numbers(column: pl.Series) -> Array | None:
    """Return a column that has a type as numbers, shape (n,); None where the type is none of numbers."""
    import polars as pl

    if not (column.dtype.is_numeric() or column.dtype == pl.Null):
        return None
    return (column if column.dtype == pl.Float64 else column.cast(pl.Float64)).to_numpy()


def column_seconds(column: pl.Series) -> Array:
    """Return a column that has a type as times, shape (n,), s: moments since 1970, a date is its midnight."""
    import polars as pl

    if isinstance(column.dtype, pl.Date | pl.Datetime):  # a double has no nanoseconds since 1970
        column = column.cast(pl.Datetime("us"))
    kind = column.dtype
    if isinstance(kind, pl.Datetime | pl.Duration):
        counts = column.to_physical().cast(pl.Float64).to_numpy()
        return np.asarray(counts / {"ms": 1e3, "us": 1e6, "ns": 1e9}[kind.time_unit])
    values = column_numbers(column)
    return seconds(column.cast(pl.String, strict=False)) if values is None else values


def texts_of_times(times: Array, like: pl.Series) -> pl.Series:
    """Return times as text: moments in ISO 8601 where some of the cells ``like`` are moments, else numbers."""
    import polars as pl

    column = pl.Series(times)
    if not like.str.contains(_DAY).any():
        return column.cast(pl.String)
    return (column.fill_nan(None) * 1e6).round().cast(pl.Int64).cast(pl.Datetime("us")).dt.strftime(_ISO)


def unread_time(cells: pl.Series, name: str) -> tuple[int, str] | None:
    """Return the first cell that is not missing in a column without a time, and what is wrong with it."""
    import polars as pl

    if cells.dtype == pl.Object:
        cells = pl.Series([str(cell) for cell in cells.to_list()], dtype=pl.String)
    texts = cells.cast(pl.String, strict=False).fill_null("").str.strip_chars()
    present = (~texts.str.to_lowercase().is_in([*MISSING])).arg_true()
    if present.is_empty():
        return None
    why = f"column {name!r} holds {texts[present[0]]!r}, neither seconds nor ISO 8601: write it as {_EXAMPLE}"
    return int(present[0]), why


def no_time_yet(rows: int, use: str) -> str:
    """Return what is wrong with a log that begins with ``rows`` rows without a time; ``use`` is what needs it."""
    how = f"write it in seconds, or in ISO 8601 such as {_EXAMPLE}"
    return f"none of the first rows ({rows}) has a time, which decides {use}: {how}"
