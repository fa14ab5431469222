"""Text as numbers and as times: our own rule on what is a number, in front of the engine that parses it.

A number is ``[+-]digits[.digits][e[+-]digits]``; the digits before the point may be left out, those behind it may not
(``2.`` is what is left of a row that was cut). An empty cell and NaN, NA, N/A, null, None in any case are a missing
value, and so is an infinity. Blanks around a cell do not count. Everything else is an error. A time is a number of
seconds, or a moment in ISO 8601: a date, a time of day behind ``T`` or a blank, with or without seconds and zone. A
cell that is neither is missing where another one of its block, or of those before, is a time; else it is an error too.
"""

from __future__ import annotations

import re
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.model import Array

if TYPE_CHECKING:
    import polars as pl

    from tiltcal.core.flags import Mask

MISSING = frozenset({"", "nan", "+nan", "-nan", "na", "n/a", "null", "none"})

_CUT_NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)[eE][+-]?|\d*\.)?")
_NUMBER = re.compile(r"[+-]?((\d+|\d*\.\d+)([eE][+-]?\d+)?|inf|infinity)", re.ASCII | re.IGNORECASE)
_OPEN_POINT = r"\.([^0-9]|$)"
_MOMENT = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,6})?Z"
_DAY = r"^\s*\d{4}-\d"
_ISO = "%Y-%m-%dT%H:%M:%S%.fZ"
_EXAMPLE = "2026-05-01T12:00:00.5Z"
_PARTS = (
    r"^(?P<day>\d{4}-\d\d?-\d\d?)"
    r"(?:[T ](?P<minute>\d\d?:\d\d?)(?P<second>:\d\d?(?:\.\d*)?)? ?(?P<zone>Z|UTC|[+-]\d\d(?::?\d\d)?)?)?$"
)


def number(cell: str) -> float | None:
    """Return the nearest double to a number, NaN for a missing value, and None for what is neither."""
    cell = cell.strip(" \t")
    if _NUMBER.fullmatch(cell):
        return float(cell)
    return nan if cell.casefold() in MISSING else None


def numbers(cells: pl.Series) -> tuple[Array, Mask | None]:
    """Parse the cells of one column.

    Returns
    -------
    values : ndarray, shape (n,)
        The nearest double to each number; NaN where the value is missing or the cell is no number.
    wrong : ndarray of bool, shape (n,), or None
        The cells that are no number; None where there are none.
    """
    import polars as pl

    texts = cells.fill_null("").str.strip_chars(" \t")
    parsed = texts.cast(pl.Float64, strict=False)
    values = parsed.fill_null(np.nan).to_numpy(writable=True)
    doubtful = parsed.is_null() | texts.str.contains(_OPEN_POINT)
    distinct = texts.filter(doubtful).unique().to_list()
    no_numbers = [text for text in distinct if text.casefold() not in MISSING]
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
    """Parse the cells of a time column.

    Parameters
    ----------
    cells : polars.Series of String, length n
        Numbers, or moments such as ``2026-05-01T12:00:00.5Z`` and ``2026-05-01 12:00``; one without a zone is UTC.

    Returns
    -------
    ndarray, shape (n,)
        The numbers as they are; for moments seconds since 1970. NaN where a cell is neither.
    """
    import polars as pl

    recorded = _moments_of_recorder(cells)
    if recorded is not None:
        return recorded
    values, wrong = numbers(cells)
    if wrong is None:
        return values
    parts = cells.filter(pl.Series(wrong)).str.strip_chars().str.extract_groups(_PARTS).struct
    zones = parts.field("zone").replace(["Z", "UTC"], "+00:00").fill_null("+00:00")
    times = parts.field("minute").fill_null("00:00") + parts.field("second").fill_null(":00")
    texts = parts.field("day") + "T" + times + zones
    moments = texts.str.to_datetime("%Y-%m-%dT%H:%M:%S%.f%#z", time_unit="us", time_zone="UTC", strict=False)
    values[wrong] = (moments.dt.epoch("us") / 1e6).fill_null(float("nan")).to_numpy()
    return values


def texts_of_times(times: Array, like: pl.Series) -> pl.Series:
    """Return times as text: moments in ISO 8601 where some of the cells ``like`` are moments, else numbers."""
    import polars as pl

    found = pl.Series(times)
    if not like.str.contains(_DAY).any():
        return found.cast(pl.String)
    return (found.fill_nan(None) * 1e6).round().cast(pl.Int64).cast(pl.Datetime("us")).dt.strftime(_ISO)


def unread_time(cells: pl.Series, name: str) -> tuple[int, str] | None:
    """Return the first cell that is not missing in a column without a time, and what is wrong with it."""
    import polars as pl

    if cells.dtype == pl.Object:
        cells = pl.Series([str(cell) for cell in cells.to_list()], dtype=pl.String)
    texts = cells.cast(pl.String, strict=False).fill_null("").str.strip_chars()
    found = (~texts.str.to_lowercase().is_in([*MISSING])).arg_true()
    if found.is_empty():
        return None
    why = f"column {name!r} holds {texts[found[0]]!r}, neither seconds nor ISO 8601: write it as {_EXAMPLE}"
    return int(found[0]), why


def no_time_yet(rows: int, use: str) -> str:
    """Return what is wrong with a log that begins with ``rows`` rows without a time; ``use`` is what needs it."""
    return (
        f"none of the first rows ({rows}) has a time, which decides {use}: write it in seconds, or in ISO 8601 such as "
        f"{_EXAMPLE}"
    )


def _moments_of_recorder(cells: pl.Series) -> Array | None:
    """Parse moments such as ``2026-05-01T12:00:00.5Z``, each minute once; None where a cell is laid out otherwise."""
    import polars as pl

    first = cells.first()
    if not isinstance(first, str) or not re.fullmatch(_MOMENT, first) or not cells.str.contains(f"^{_MOMENT}$").all():
        return None
    minutes = cells.str.slice(0, 16).rle().struct.unnest()
    begun = minutes["value"].str.to_datetime("%Y-%m-%dT%H:%M", time_unit="us", strict=False).dt.epoch("us")
    within = cells.str.slice(17).str.strip_chars_end("Z").cast(pl.Float64)
    if begun.null_count() or cells.null_count() or not within.max() < 60.0:  # type: ignore[operator]
        return None
    micros = np.repeat(begun.to_numpy(), minutes["len"].to_numpy()) + np.rint(within.to_numpy() * 1e6)
    return np.asarray(micros / 1e6)
