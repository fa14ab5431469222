"""The rows of a log in a temporary file, for what has to go over them more than once; few of them stay in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from tempfile import SpooledTemporaryFile, gettempdir
from types import TracebackType

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import UsageError

_MEMORY = 32 << 20
"""Bytes up to which there is no file."""

_ROWS = 1 << 16
"""Of a block."""


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
        self._rows = 0

    def __enter__(self) -> StoredRows:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, raised: BaseException | None, at: TracebackType | None
    ) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._rows

    def append(self, values: Sequence[Array]) -> None:
        """Store the next rows, shape (n,) of each column.

        Raises
        ------
        UsageError
            The folder of temporary files has no room for them.
        """
        try:
            self._file.seek(0, 2)
            self._file.write(np.stack(values, axis=1).tobytes())
        except OSError as failure:
            raise UsageError(
                f"the rows of the log cannot be kept in {gettempdir()}: {failure.strerror}; make room there, or name "
                "another folder in TMPDIR"
            ) from failure
        self._rows += len(values[0])

    def __getitem__(self, rows: slice) -> Array:
        """Return some rows, shape (n, shown), each column contiguous."""
        return np.asfortranarray(self._read(*rows.indices(self._rows)[:2])[:, : self._shown])

    def blocks(self) -> Iterator[Sequence[Array]]:
        """Yield all rows, shape (n,) of each column."""
        for start in range(0, self._rows, _ROWS):
            yield list(np.ascontiguousarray(self._read(start, min(start + _ROWS, self._rows)).T))

    def _read(self, start: int, end: int) -> Array:
        size = 8 * self._columns
        self._file.seek(start * size)
        return np.frombuffer(self._file.read(max(end - start, 0) * size)).reshape(-1, self._columns)
