"""A CSV log on its way to a format whose columns have types.

Text has none, so the first block of rows decides: a column whose cells are all numbers there, or missing, is one of
numbers. Numbers that would not come back as they were written, such as a serial number ``0042`` or more digits than a
double holds, are text. The needed columns are numbers anyway. Empty columns are text.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.errors import InputError
from tiltcal.logs.cells import numbers
from tiltcal.logs.csv_log import CsvLog
from tiltcal.logs.csv_rows import CsvBlock
from tiltcal.logs.log import FrameBlock

if TYPE_CHECKING:
    import polars as pl

_LOSES_ITSELF = r"^\s*[+-]?(?:0\d|\d{16})"
"""What a number begins with that a double would not give back as it stood."""


class TypedCsvLog:
    """A CSV log with typed columns.

    Parameters
    ----------
    log : CsvLog
        Not read yet.
    needed : sequence of int
        Indices of the columns that hold readings.
    name : str
        The log as the user named it, for messages.

    Attributes
    ----------
    names : tuple of str
    header_line : int
    bytes_read : int
    notes : mapping of str to str
        Nothing: CSV has no place for them.

    Raises
    ------
    InputError
        A row of the first block cannot be parsed, or a column has no name.
    """

    def __init__(self, log: CsvLog, needed: Sequence[int], *, name: str) -> None:
        self._log = log
        self.notes: Mapping[str, str] = {}
        self._name = name
        self._needed = tuple(needed)
        self.names = log.names
        self.header_line = log.header_line
        if "" in self.names:
            raise InputError(
                f"column {self.names.index('') + 1} has no name: Parquet needs one; name it in the header",
                file=name,
                line=log.header_line,
            )
        others = [index for index in range(len(self.names)) if index not in self._needed]
        self._blocks = log.rows(self._needed, texts=others)
        self._first: CsvBlock | None = next(self._blocks)
        self._numeric = frozenset(index for index in others if _holds_numbers(self._first.texts[index], self._first))

    @property
    def bytes_read(self) -> int:
        """So far."""
        return self._log.bytes_read

    def schema(self) -> Mapping[str, pl.DataType]:
        """Type by column: numbers or text."""
        import polars as pl

        return {
            name: pl.Float64() if index in self._numeric or index in self._needed else pl.String()
            for index, name in enumerate(self.names)
        }

    def rows(self, columns: Sequence[int], time: int | None = None) -> Iterator[FrameBlock]:
        """The rows, block after block; see :meth:`CsvLog.rows`.

        Raises
        ------
        InputError
            A row cannot be parsed, or a column of numbers goes on with something else.
        """
        row = 0
        while (block := self._first or next(self._blocks, None)) is not None:
            self._first = None
            yield self._typed(block, row)
            row += len(block.lines)

    def _typed(self, block: CsvBlock, row: int) -> FrameBlock:
        import polars as pl

        columns = {}
        for index, name in enumerate(self.names):
            if index in self._needed:
                columns[name] = pl.Series(block.values[index]).fill_nan(None)
            elif index in self._numeric:
                columns[name] = self._as_numbers(block, index, row)
            else:
                columns[name] = block.texts[index]
        return FrameBlock(pl.DataFrame(columns), block.values, block.faults)

    def _as_numbers(self, block: CsvBlock, index: int, row: int) -> pl.Series:
        import polars as pl

        values, wrong = numbers(block.texts[index])
        if wrong is not None:
            wrong[list(block.faults)] = False
            if wrong.any():
                found = int(np.flatnonzero(wrong)[0])
                raise InputError(
                    f"row {row + found}: column {self.names[index]!r} holds {block.texts[index][found]!r}, and numbers "
                    "above it: a Parquet column has one type; write CSV, or mend the column",
                    file=self._name,
                )
        return pl.Series(values).fill_nan(None)


def _holds_numbers(cells: pl.Series, block: CsvBlock) -> bool:
    """Whether the sound cells of a column are numbers that come back as they were written."""
    values, wrong = numbers(cells)
    if wrong is not None:
        wrong[list(block.faults)] = False
    return bool(
        np.isfinite(values).any() and (wrong is None or not wrong.any()) and not cells.str.contains(_LOSES_ITSELF).any()
    )
