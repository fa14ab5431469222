"""A CSV log on its way to a format whose columns have types, or to means.

Text has none, so the first block of rows decides: a column whose cells are all numbers there, or missing, is one of
numbers. Numbers that would not come back as they were written, such as a serial number ``0042`` or more digits than a
double holds, are text. The needed columns are numbers anyway, but for a time: in ISO 8601 it is a moment, whole numbers
of many digits stay whole, and what is neither is text. Empty columns are text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.errors import InputError
from tiltcal.logs.formats.csv_dialect import Dialect
from tiltcal.logs.formats.csv_rows import CsvBlock
from tiltcal.logs.text_to_numbers import numbers

if TYPE_CHECKING:
    import polars as pl

_LOSES_ITSELF = r"^\s*[+-]?(?:0\d|\d{16})"
"""What a number begins with that a double would not give back as it stood."""


class ColumnTypes:
    """The types of a CSV log's columns, from its first block; ``needed`` ones are numbers, ``others`` decide theirs.

    InputError: a column has no name.
    """

    def __init__(self, dialect: Dialect, needed: Sequence[int], time: int | None, *, file: str) -> None:
        names = dialect.names
        if "" in names:
            raise InputError(
                f"column {names.index('') + 1} has no name, which Parquet and means need: name it in the header",
                file=file,
                line=1,
            )
        self._dialect, self._time, self._file = dialect, time, file
        self._needed = tuple(index for index in needed if index != time)
        self.others = tuple(index for index in range(len(names)) if index not in self._needed)
        self._types: dict[int, pl.DataType] = {}
        self._row = 0

    def typed(self, block: CsvBlock) -> CsvBlock:
        """Return a block with its columns as a frame.

        InputError: a column of numbers goes on with something else.
        """
        import polars as pl

        columns = {name: self._column(block, index) for index, name in enumerate(self._dialect.names)}
        self._row += len(block)
        return replace(block, frame=pl.DataFrame(columns))

    def _type(self, block: CsvBlock, index: int) -> pl.DataType:
        """Return the type of a column, by the sound cells of the first block."""
        import polars as pl

        cells = block.texts[index].clone().scatter([*block.faults], None)
        values, wrong = numbers(self._dialect.with_points(cells))
        if wrong is not None:
            moments = index == self._time and np.isfinite(block.values[index][wrong]).any()
            return pl.Datetime("us", "UTC") if moments else pl.String()
        if not np.isfinite(values).any():
            return pl.String()
        if not cells.str.contains(_LOSES_ITSELF).any():
            return pl.Float64()
        if index != self._time:
            return pl.String()
        whole = cells.str.strip_chars().cast(pl.Int64, strict=False)
        return pl.Int64() if (whole.is_null().to_numpy() == np.isnan(values)).all() else pl.Float64()

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
        rows = set() if wrong is None else {*np.flatnonzero(wrong).tolist()}
        if isinstance(kind, pl.Int64):
            column = cells.str.strip_chars().cast(kind, strict=False)
            rows |= {*np.flatnonzero(np.isfinite(values) & column.is_null().to_numpy()).tolist()}
        if refused := sorted(rows - {*block.faults}):
            raise InputError(
                f"row {self._row + refused[0]}: column {self._dialect.names[index]!r} holds {cells[refused[0]]!r}, and "
                "numbers above it: Parquet and means need one type in a column; mend it, or write CSV without them",
                file=self._file,
            )
        return column
