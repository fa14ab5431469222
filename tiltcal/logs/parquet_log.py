"""The Parquet door: a recorded log whose columns have types, read some thousand rows at a time.

A reading is a column of whole or decimal numbers; null and NaN are a missing value. All other columns pass through,
whatever they hold.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import InputError
from tiltcal.logs.log import FrameBlock
from tiltcal.logs.times import seconds

if TYPE_CHECKING:
    import polars as pl

_ROWS = 1 << 16
"""Of a block: as many as stay in the cache on their way through the kernel, twice over."""

_OF_THE_ENGINE = "ARROW:schema"
"""The key under which a writer keeps its own word on the types; the next one writes its own."""


class ParquetLog:
    """A log in Parquet.

    Parameters
    ----------
    path : str or Path
        As the user named it.

    Attributes
    ----------
    names : tuple of str
        The columns.
    header_line : None
        There are no lines.
    bytes_read : int
        So far: of the file's size, the share that the rows so far are of all rows.
    notes : dict of str to str
        What the file says of itself, its key-value metadata.

    Raises
    ------
    InputError
        The file is no Parquet file, or damaged.
    """

    header_line: None = None

    def __init__(self, path: str | Path) -> None:
        import polars as pl

        self._name = str(path)
        with self._told():
            self._size = os.stat(path).st_size
            self._scan = pl.scan_parquet(Path(path), glob=False, hive_partitioning=False)
            self._schema = self._scan.collect_schema()
            self.notes = pl.read_parquet_metadata(path)
            self._rows = self._scan.select(pl.len()).collect().item()
        self.notes.pop(_OF_THE_ENGINE, None)
        self.names = tuple(self._schema)
        self.bytes_read = 0
        if not self._rows:
            raise InputError("the log has columns and no rows", file=self._name)

    def schema(self) -> Mapping[str, pl.DataType]:
        """Type by column."""
        return self._schema

    def rows(self, columns: Sequence[int], time: int | None = None) -> Iterator[FrameBlock]:
        """The rows, block after block.

        Parameters
        ----------
        columns : sequence of int
            Indices of the columns that hold needed numbers.
        time : int, optional
            Of them, the one that may hold moments, which become seconds.

        Yields
        ------
        FrameBlock

        Raises
        ------
        InputError
            A needed column holds something else than numbers, or the file is damaged.
        """
        for index in columns:
            if index != time:
                self._require_numbers(self.names[index])
        done = 0
        with self._told():
            for frame in self._scan.collect_batches(chunk_size=_ROWS, maintain_order=True):
                done += len(frame)
                self.bytes_read = self._size * done // self._rows
                yield FrameBlock(
                    frame,
                    {index: (_moments if index == time else _numbers)(frame.to_series(index)) for index in columns},
                )
        if done != self._rows:
            # The engine ends in silence where one of its threads fails on a damaged page.
            raise InputError(f"the file is damaged: it gives {done} of {self._rows} rows", file=self._name)

    def _require_numbers(self, name: str) -> None:
        import polars as pl

        kind = self._schema[name]
        if not (kind.is_numeric() or kind == pl.Null):
            raise InputError(
                f"column {name!r} holds {kind}, not numbers: name another, or make numbers of it",
                file=self._name,
            )

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Put the engine's complaints as ours."""
        import polars as pl

        try:
            yield
        except (pl.exceptions.PolarsError, OSError) as failure:
            raise InputError(f"this is no Parquet file, or a damaged one: {failure}", file=self._name) from failure


def _numbers(column: pl.Series) -> Array:
    import polars as pl

    return column.cast(pl.Float64).fill_null(np.nan).to_numpy()


def _moments(column: pl.Series) -> Array:
    """Seconds: numbers as they are, moments since 1970, durations, or text that says one of these."""
    import polars as pl

    kind = column.dtype
    if isinstance(kind, pl.Datetime | pl.Duration):
        return _numbers(column.to_physical()) / {"ms": 1e3, "us": 1e6, "ns": 1e9}[kind.time_unit]
    if kind.is_numeric() or kind == pl.Null:
        return _numbers(column)
    return seconds(column.cast(pl.String, strict=False))
