"""Cells as numbers and as times: our own rule on text, in front of the engine that parses it, and typed columns.

A number is ``[+-]digits[.digits][e[+-]digits]``; the digits before the point may be left out, those behind it may not
(``2.`` is what is left of a row that was cut). An empty cell and NaN, NA, N/A, null, None in any case are a missing
value, and so is an infinity. Blanks around a cell do not count. Everything else is an error. A time is a number of
seconds, or a moment: a date (year first; day first with points or the name of the month; as the log shows it with
strokes), a time of day behind ``T`` or a blank, with or without seconds and zone; or a time of day alone. A cell that
is neither is missing where another one of its block, or of those before, is a time; else it is an error too.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.dialect import MISSING
from tiltcal.log_head import OPEN_DATE

if TYPE_CHECKING:
    import polars as pl

    from tiltcal.core.flags import Mask


FOLLOWING = 5  # rows that stay behind where a clock starts again
EPOCH = (1e9, 2e10)  # seconds since 1970 between which a number is a time since then
PACE = (1e-6, 86400.0)  # seconds between rows that show that such a number is none of a counter
_CUT_NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)[eE][+-]?|\d*\.)?")
_OPEN_POINT = r"\.([^0-9]|$)"
_DAY = r"^\s*\d{4}-\d"
_ISO = "%Y-%m-%dT%H:%M:%S%.fZ"
_EXAMPLE = "2026-05-01T12:00:00.5Z"
_TIME_OF_DAY = r"(?P<hour>\d\d?)[:.](?P<minute>\d\d?)(?:[:.](?P<second>\d\d?)(?:[.,:](?P<part>\d*))?)?"
_PARTS = (
    r"^(?:(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?)"
    r"|(?P<first>\d\d?)(?P<mark>[-/.])(?P<other>\d\d?|[A-Za-z]{3})[-/.](?P<late>\d{4}|\d\d))"
    rf"(?:[T ,]+{_TIME_OF_DAY} ?(?P<half>[AaPp][Mm])? ?(?P<zone>Z|UTC|[+-]\d\d(?::?\d\d)?)?)?$"
)
_ALONE = rf"^{_TIME_OF_DAY} ?(?P<half>[AaPp][Mm])?$"
_MONTHS = {name: str(k) for k, name in enumerate(re.findall("...", "janfebmaraprmayjunjulaugsepoctnovdec"), 1)}


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


def seconds(cells: pl.Series, dates: str = "") -> Array:
    """Return the times of text cells, shape (n,): numbers as they are, moments since 1970; NaN where a cell is neither.

    A moment without a zone is UTC; a time of day without a date is seconds since midnight. ``dates`` is that of
    :class:`tiltcal.dialect.Dialect`.
    """
    import polars as pl

    # The layouts of most recorders and of this program are read ten times as fast as any other.
    for layout in (_ISO, _ISO[:-1], "%Y-%m-%d %H:%M:%S%.f"):
        moments = cells.head(1).str.to_datetime(layout, time_unit="us", strict=False)
        moments = moments if moments.null_count() else cells.str.to_datetime(layout, time_unit="us", strict=False)
        if not moments.null_count():
            return np.asarray((moments.dt.epoch("us") / 1e6).to_numpy())
    values, wrong = numbers(cells)
    if wrong is None:
        return values
    texts = cells.filter(pl.Series(wrong)).str.strip_chars()
    parts = texts.str.extract_groups(_PARTS).struct.unnest()
    alone = texts.str.extract_groups(_ALONE).struct.unnest()
    other, is_day = pl.col("other").str.to_lowercase().replace(_MONTHS), pl.lit(dates != "month")
    named = pl.col("other").str.contains("[A-Za-z]") | (pl.col("mark") == ".")
    open_date = pl.lit(dates in ("", "open")) & ~named
    century = pl.when(pl.col("late").str.len_chars() == 2).then(pl.lit("20")).otherwise(pl.lit(""))
    year = pl.col("year").fill_null(century + pl.col("late"))
    month = pl.col("month").fill_null(pl.when(named | is_day).then(other).otherwise("first"))
    day = pl.col("day").fill_null(pl.when(named | is_day).then("first").otherwise("other"))
    zone = pl.col("zone").replace(["Z", "UTC"], "+00:00").fill_null("+00:00")
    date = pl.when(open_date & pl.col("year").is_null()).then(None).otherwise(year + "-" + month + "-" + day)
    since = pl.when(pl.col("hour").is_null()).then(0.0).otherwise(_since_midnight())
    made = parts.select(date=date + "T00:00:00" + zone, since=since)
    days = made["date"].str.to_datetime("%Y-%m-%dT%H:%M:%S%#z", time_unit="us", time_zone="UTC", strict=False)
    of_day = alone.select(_since_midnight()).to_series()
    found = days.dt.epoch("us").cast(pl.Float64) / 1e6 + made["since"]
    values[wrong] = found.fill_null(of_day).fill_null(np.nan).to_numpy()
    return values


def _since_midnight() -> pl.Expr:
    """Return the seconds since midnight of the parts of a time of day."""
    import polars as pl

    parts = pl.col("hour"), pl.col("minute"), pl.col("second").fill_null("0")
    hour, minute, second = (part.cast(pl.Float64) for part in parts)
    afternoon = pl.col("half").str.to_lowercase().replace_strict({"am": 0.0, "pm": 12.0}, default=None)
    hour = pl.when(afternoon.is_null()).then(hour).otherwise(hour % 12.0 + afternoon)
    part = ("0." + pl.col("part").fill_null("0") + "0").cast(pl.Float64)
    sound = (hour < 25.0) & (minute < 60.0) & (second < 61.0)
    return pl.when(sound).then(hour * 3600.0 + minute * 60.0 + second + part)


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
    """Return the unit of times since 1970 of which nothing states one, by their size and step; None of seconds too."""
    known = times[np.isfinite(times)]
    steps = np.diff(known)
    steps = steps[steps > 0.0]
    for unit, factor in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if len(known) and EPOCH[0] * factor <= known[0] <= EPOCH[1] * factor:
            usual = float(np.median(steps)) / factor if len(steps) else PACE[0]
            return unit if PACE[0] <= usual <= PACE[1] else None
    return None


def clock_breaks(times: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows at which a clock starts again, and those that are out of order, of times in s, NaN where missing.

    Where a time is before the one of the row before, and stays so for some rows, the clock has started again.
    """
    rows = np.flatnonzero(np.isfinite(times))
    known = times[rows]
    back = np.flatnonzero(np.diff(known) < 0.0) + 1
    following = {row: known[row : row + FOLLOWING] for row in back.tolist()}
    again = [
        row for row, some in following.items() if some.max() < known[row - 1] and len(some) > 1 and some[1] >= some[0]
    ]
    return rows[np.array(again, np.intp)], rows[np.setdiff1d(back, again)]


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
    if kind == pl.Time:  # of which no date is known
        return np.full(len(column), np.nan)
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
    text = texts[present[0]]
    what = (
        "and nothing shows whether the day or the month is first"
        if OPEN_DATE.match(text)
        else "neither seconds nor ISO 8601"
    )
    return int(present[0]), f"column {name!r} holds {text!r}, {what}: write it as {_EXAMPLE}"


def no_time_yet(rows: int, use: str) -> str:
    """Return what is wrong with a log that begins with ``rows`` rows without a time; ``use`` is what needs it."""
    how = f"write it in seconds, or in ISO 8601 such as {_EXAMPLE}"
    return f"none of the first rows ({rows}) has a time, which decides {use}: {how}"
