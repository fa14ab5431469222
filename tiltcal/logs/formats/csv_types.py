"""A CSV log on its way to a format whose columns have types, or to means.

Text has none, so the first block of rows decides: a column whose cells are all numbers there, or missing, is one of
numbers. Numbers that would not come back as they were written, such as a serial number ``0042`` or more digits than a
double holds, are text. The needed columns are numbers anyway, but for a time in ISO 8601, which is a moment. Empty
columns are text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import InputError
from tiltcal.logs.formats.csv_rows import CsvBlock
from tiltcal.logs.text_to_numbers import numbers

if TYPE_CHECKING:
    import polars as pl

_LOSES_ITSELF = r"^\s*[+-]?(?:0\d|\d{16})"
"""What a number begins with that a double would not give back as it stood."""


class ColumnTypes:
    """The types of a CSV log's columns, from its first block.

    Parameters
    ----------
    names : sequence of str
        The columns.
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

    Raises
    ------
    InputError
        A column has no name.
    """

    def __init__(self, names: Sequence[str], needed: Sequence[int], time: int | None, *, file: str) -> None:
        if "" in names:
            raise InputError(
                f"column {names.index('') + 1} has no name, which Parquet and means need: name it in the header",
                file=file,
                line=1,
            )
        self._names, self._time, self._file = tuple(names), time, file
        self._needed = tuple(index for index in needed if index != time)
        self.others = tuple(index for index in range(len(names)) if index not in self._needed)
        self._numeric: frozenset[int] | None = None

        self._row = 0

    def typed(self, block: CsvBlock) -> CsvBlock:
        """Return a block with its columns as a frame.

        Raises
        ------
        InputError
            A column of numbers goes on with something else.
        """
        import polars as pl

        if self._numeric is None:
            self._numeric = frozenset(index for index in self.others if _holds_numbers(block.texts[index], block))

        columns = {}
        for index, name in enumerate(self._names):
            if index in self._needed:
                columns[name] = pl.Series(block.values[index]).fill_nan(None)
            elif index in self._numeric:
                columns[name] = self._as_numbers(block, index)
            elif index == self._time:
                columns[name] = _moments(block.values[index])
            else:
                columns[name] = block.texts[index]
        self._row += len(block)
        return replace(block, frame=pl.DataFrame(columns))

    def _as_numbers(self, block: CsvBlock, index: int) -> pl.Series:
        import polars as pl

        values, wrong = numbers(block.texts[index])
        if wrong is not None:
            wrong[list(block.faults)] = False
            if wrong.any():
                found = int(np.flatnonzero(wrong)[0])
                raise InputError(
                    f"row {self._row + found}: column {self._names[index]!r} holds {block.texts[index][found]!r}, and "
                    "numbers above it: Parquet and means need one type in a column; mend it, or write CSV without them",
                    file=self._file,
                )
        return pl.Series(values).fill_nan(None)


def _moments(seconds: Array) -> pl.Series:
    """Convert seconds since 1970 to moments to the microsecond; what no calendar reaches is missing."""
    import polars as pl

    micros = pl.Series(np.rint(seconds * 1e6)).fill_nan(None).cast(pl.Int64, strict=False)
    return micros.cast(pl.Datetime("us", "UTC"))


def _holds_numbers(cells: pl.Series, block: CsvBlock) -> bool:
    """Return whether the sound cells of a column are numbers that come back as they were written."""
    values, wrong = numbers(cells)
    if wrong is not None:
        wrong[list(block.faults)] = False
    return bool(
        np.isfinite(values).any() and (wrong is None or not wrong.any()) and not cells.str.contains(_LOSES_ITSELF).any()
    )
