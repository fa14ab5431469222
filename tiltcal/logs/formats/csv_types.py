"""A CSV log on its way to a format whose columns have types, or to means.

Text has none, so the first block of rows decides: a column whose cells are all numbers there, or missing, is one of
numbers. Numbers that would not come back as they were written, such as a serial number ``0042`` or more digits than a
double holds, are text. The needed columns are numbers anyway, but for a time: in ISO 8601 it is a moment, whole numbers
of many digits stay whole, and what is neither is text. Empty columns are text.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.errors import InputError
from tiltcal.logs.formats.csv_dialect import Dialect
from tiltcal.logs.formats.csv_rows import CsvBlock
from tiltcal.logs.text_to_numbers import numbers

if TYPE_CHECKING:
    import polars as pl

    from tiltcal.core.flags import Mask

_LOSES_ITSELF = r"^\s*[+-]?(?:0\d|\d{16})"
"""What a number begins with that a double would not give back as it stood."""


class ColumnTypes:
    """The types of a CSV log's columns, from its first block.

    Parameters
    ----------
    needed : sequence of int
        Indices of the columns that hold numbers.
    time : int or None
        The one of them that holds times.
    file : str
        The log as the user named it, for messages.

    Attributes
    ----------
    others : tuple of int
        Indices of the columns whose text is needed.

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
        self._names, self._time, self._file = names, time, file
        self._points = dialect.with_points
        self._needed = tuple(index for index in needed if index != time)
        self.others = tuple(index for index in range(len(names)) if index not in self._needed)
        self._types: dict[int, Callable[[CsvBlock, int], pl.Series]] = {}
        self._row = 0

    def typed(self, block: CsvBlock) -> CsvBlock:
        """Return a block with its columns as a frame.

        InputError: a column of numbers goes on with something else.
        """
        import polars as pl

        columns = {}
        for index, name in enumerate(self._names):
            if index in self._needed:
                columns[name] = pl.Series(block.values[index]).fill_nan(None)
                continue
            if index not in self._types:
                self._types[index] = self._type(block, index)
            columns[name] = self._types[index](block, index)
        self._row += len(block)
        return replace(block, frame=pl.DataFrame(columns))

    def _type(self, block: CsvBlock, index: int) -> Callable[[CsvBlock, int], pl.Series]:
        """Return how a column is typed, by the sound cells of the first block."""
        cells = block.texts[index].clone().scatter([*block.faults], None)
        values, wrong = numbers(self._points(cells))
        if wrong is not None:
            return _as_moments if index == self._time and np.isfinite(block.values[index][wrong]).any() else _as_text
        if not np.isfinite(values).any():
            return _as_text
        if not cells.str.contains(_LOSES_ITSELF).any():
            return self._as_numbers
        if index != self._time:
            return _as_text
        return self._as_whole_numbers if _are_whole(cells) else self._as_numbers

    def _as_numbers(self, block: CsvBlock, index: int) -> pl.Series:
        import polars as pl

        values, wrong = numbers(self._points(block.texts[index]))
        self._refuse(block, index, wrong)
        return pl.Series(values).fill_nan(None)

    def _as_whole_numbers(self, block: CsvBlock, index: int) -> pl.Series:
        import polars as pl

        cells = block.texts[index]
        values, wrong = numbers(cells)
        whole = cells.str.strip_chars().cast(pl.Int64, strict=False)
        self._refuse(block, index, wrong, np.isfinite(values) & whole.is_null().to_numpy())
        return whole

    def _refuse(self, block: CsvBlock, index: int, *wrong: Mask | None) -> None:
        """Refuse sound rows that are marked."""
        found = [row for marked in wrong if marked is not None for row in np.flatnonzero(marked).tolist()]
        rows = sorted({*found} - {*block.faults})
        if rows:
            raise InputError(
                f"row {self._row + rows[0]}: column {self._names[index]!r} holds {block.texts[index][rows[0]]!r}, and "
                "numbers above it: Parquet and means need one type in a column; mend it, or write CSV without them",
                file=self._file,
            )


def _as_text(block: CsvBlock, index: int) -> pl.Series:
    return block.texts[index]


def _as_moments(block: CsvBlock, index: int) -> pl.Series:
    """Return seconds since 1970 as moments to the microsecond; what no calendar reaches is missing."""
    import polars as pl

    micros = pl.Series(np.rint(block.values[index] * 1e6)).fill_nan(None).cast(pl.Int64, strict=False)
    return micros.cast(pl.Datetime("us", "UTC"))


def _are_whole(cells: pl.Series) -> bool:
    """Return whether the numbers of a column, other cells being missing, are whole and fit into 64 bits."""
    import polars as pl

    texts = cells.str.strip_chars()
    return bool((texts.cast(pl.Int64, strict=False).is_null() == texts.cast(pl.Float64, strict=False).is_null()).all())
