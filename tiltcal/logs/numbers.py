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
    """Read columns of a log to its end; beyond 256 MB they are maps of temporary files, which go with them.

    ``time`` and ``needs_time``, and the InputError of the log, are those of :meth:`LogReader.rows`.

    UsageError: the folder of temporary files has no room.
    """
    blocks: list[list[Array]] = [[] for _ in columns]
    files: list[IO[bytes]] = []
    rows = faulty = 0
    for block in log.rows(sorted(set(columns)), time, needs_time=needs_time):
        rows, faulty = rows + len(block), faulty + len(block.faults)
        for column, kept in zip(columns, blocks, strict=True):
            kept.append(block.values[column])
        if 8 * rows * len(columns) > _MEMORY:
            _to_files(blocks, files)
    if not files:
        return Numbers([np.concatenate([np.empty(0), *kept]) for kept in blocks], faulty)
    _to_files(blocks, files)
    return Numbers([np.memmap(file, dtype=np.float64, mode="r") for file in files], faulty)


def _to_files(blocks: Sequence[list[Array]], files: list[IO[bytes]]) -> None:
    """Move the blocks of each column behind those in its file, which has no name and is opened by the first call."""
    try:
        while len(files) < len(blocks):
            files.append(TemporaryFile())  # noqa: SIM115 (a map of it outlives this)
        for kept, file in zip(blocks, files, strict=True):
            file.writelines(np.ascontiguousarray(block, dtype=np.float64).data for block in kept)
            file.flush()
            kept.clear()
    except OSError as failure:
        raise UsageError(
            f"the rows of the log cannot be kept in {gettempdir()}: {failure.strerror}; make room there, or name "
            "another folder in TMPDIR"
        ) from failure
