"""The rows of a log in a temporary file, for what has to go over them more than once; few of them stay in memory."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterator, Sequence
from itertools import pairwise
from tempfile import SpooledTemporaryFile, gettempdir
from types import TracebackType

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import UsageError

_MEMORY = 32 << 20
"""Bytes up to which there is no file."""


class StoredRows:
    """Rows of numbers; a slice reads some of them from the file.

    Parameters
    ----------
    columns : int
        Of a row.
    shown : int, optional
        The first of them, which slices have; all without it.
    """

    def __init__(self, columns: int, shown: int | None = None) -> None:
        self._file = SpooledTemporaryFile(_MEMORY)  # noqa: SIM115 (closed where the rows are left)
        self._columns, self._shown = columns, shown
        self._ends = [0]  # of the blocks, and behind them the rows

    def __enter__(self) -> StoredRows:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, raised: BaseException | None, at: TracebackType | None
    ) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._ends[-1]

    def append(self, values: Sequence[Array]) -> None:
        """Store the next rows, shape (n,) of each column; they are one block.

        UsageError: the folder of temporary files has no room for them.
        """
        try:
            self._file.seek(0, 2)
            for column in values:
                self._file.write(np.ascontiguousarray(column, dtype=np.float64).data)
        except OSError as failure:
            raise UsageError(
                f"the rows of the log cannot be kept in {gettempdir()}: {failure.strerror}; make room there, or name "
                "another folder in TMPDIR"
            ) from failure
        self._ends.append(self._ends[-1] + len(values[0]))

    def __getitem__(self, rows: slice) -> Array:
        """Return some rows, shape (n, shown), each column contiguous."""
        start, end, _ = rows.indices(len(self))
        found = np.empty((self._columns if self._shown is None else self._shown, max(end - start, 0)))
        block = bisect(self._ends, start)
        done = start
        while done < end:
            stop = min(end, self._ends[block])
            self._read(block, done, found[:, done - start : stop - start])
            block, done = block + 1, stop
        return found.T

    def blocks(self) -> Iterator[Sequence[Array]]:
        """Yield all rows, shape (n,) of each column, in the blocks in which they came."""
        for block, (first, end) in enumerate(pairwise(self._ends), start=1):
            found = np.empty((self._columns, end - first))
            self._read(block, first, found)
            yield list(found)

    def _read(self, block: int, start: int, found: Array) -> None:
        """Read the rows of a block from ``start`` on into the first columns, shape (columns, n)."""
        first, end = self._ends[block - 1], self._ends[block]
        for number, column in enumerate(found):
            self._file.seek(8 * (self._columns * first + number * (end - first) + start - first))
            self._file.readinto(column.data)
