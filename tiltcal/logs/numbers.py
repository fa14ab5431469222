"""The number columns of a log as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from tempfile import TemporaryFile, gettempdir
from typing import IO

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import UsageError
from tiltcal.logs.log import LogReader

_MEMORY = 256 << 20
"""Keep the columns in memory up to so many bytes, and in temporary files beyond."""


@dataclass(frozen=True)
class Numbers:
    """Columns of a log, each of shape (rows,), NaN where a value is missing; and how many rows could not be parsed."""

    columns: Sequence[Array]
    faulty: int

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.columns[0])


def read_columns(
    log: LogReader, columns: Sequence[int], time: int | None = None, *, needs_time: bool = False
) -> Numbers:
    """Read columns of a log to its end.

    Parameters
    ----------
    columns : sequence of int
        Indices of the columns.
    time : int, optional
        The one of them that may hold moments, which become seconds.
    needs_time : bool
        Refuse a column of times that begins with what is none; without it, these are missing.

    Returns
    -------
    Numbers
        Beyond 256 MB the arrays are maps of temporary files, which go with them.

    Raises
    ------
    InputError
        A row cannot be parsed, a column holds no numbers, or the file is damaged.
    UsageError
        The folder of temporary files has no room.
    """
    stores = [_Column() for _ in columns]
    rows = faulty = 0
    for block in log.rows(sorted(set(columns)), time, needs_time=needs_time):
        rows, faulty = rows + len(block), faulty + len(block.faults)
        for column, store in zip(columns, stores, strict=True):
            store.append(block.values[column])
        if 8 * rows * len(stores) > _MEMORY:
            for store in stores:
                store.to_file()
    return Numbers([store.array() for store in stores], faulty)


class _Column:
    """The values of one column: blocks in memory, until they go to a file that has no name."""

    def __init__(self) -> None:
        self._blocks: list[Array] = []
        self._file: IO[bytes] | None = None

    def append(self, values: Array) -> None:
        self._blocks.append(values)

    def to_file(self) -> None:
        try:
            if self._file is None:
                self._file = TemporaryFile()  # noqa: SIM115 (a map of it outlives this)
            self._file.writelines(np.ascontiguousarray(block, dtype=np.float64).data for block in self._blocks)
            self._file.flush()
        except OSError as failure:
            raise UsageError(
                f"the rows of the log cannot be kept in {gettempdir()}: {failure.strerror}; make room there, or name "
                "another folder in TMPDIR"
            ) from failure
        self._blocks.clear()

    def array(self) -> Array:
        if self._file is None:
            return np.concatenate([np.empty(0), *self._blocks])
        self.to_file()
        return np.memmap(self._file, dtype=np.float64, mode="r")
