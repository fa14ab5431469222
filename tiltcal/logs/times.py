"""Cells of a time column: seconds as a number, or a moment in ISO 8601 as the recorder writes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.core.model import Array
from tiltcal.logs.cells import numbers

if TYPE_CHECKING:
    import polars as pl

_ZONE = r"T.*(?:Z|[+-]\d\d:?\d\d)$"


def seconds(cells: pl.Series) -> Array:
    """Parse the cells of a time column.

    Parameters
    ----------
    cells : polars.Series of String, length n
        Numbers, or moments such as ``2026-05-01T12:00:00.5Z``; one without a zone is UTC.

    Returns
    -------
    ndarray, shape (n,)
        The numbers as they are; for moments seconds since 1970. NaN where a cell is neither.
    """
    import polars as pl

    values, wrong = numbers(cells)
    if wrong is None:
        return values
    texts = cells.filter(pl.Series(wrong)).str.strip_chars().str.replace(" ", "T", literal=True)
    zoned = texts.to_frame("text").select(
        pl.when(pl.col("text").str.contains(_ZONE))
        .then("text")
        .otherwise(pl.col("text") + "Z")
        .str.replace("Z$", "+00:00")
    )
    moments = zoned["text"].str.to_datetime("%Y-%m-%dT%H:%M:%S%.f%#z", time_unit="us", time_zone="UTC", strict=False)
    values[wrong] = (moments.dt.epoch("us") / 1e6).fill_null(float("nan")).to_numpy()
    return values
