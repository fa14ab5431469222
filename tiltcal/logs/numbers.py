"""The number columns of a log as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from tempfile import TemporaryFile, gettempdir
from typing import IO

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import UsageError
from tiltcal.logs.columns import TIME, locate_readings, named_columns
from tiltcal.logs.log import LogReader

_MEMORY = 256 << 20
"""Keep the columns in memory up to so many bytes, and in temporary files beyond."""


@dataclass(frozen=True)
class RecordedColumns:
    """Columns of a log by role, each of shape (rows,), NaN where a value is missing: readings, °C, seconds.

    ``name`` is the log as the user named it, ``sha256`` that of the file, None of a frame; ``faulty`` counts the rows
    that could not be parsed.
    """

    by_role: Mapping[str, Array]
    name: str
    sha256: str | None
    faulty: int

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.by_role.values())))

    def of(self, roles: Sequence[str]) -> list[Array]:
        """Return some columns."""
        return [self.by_role[role] for role in roles]


def read_columns(log: LogReader, where: Mapping[str, int], *, needs_time: bool = False) -> RecordedColumns:
    """Read columns of a log to its end, by role; beyond 256 MB they are maps of temporary files, which go with them.

    ``needs_time``, and the InputError of the log, are those of :meth:`LogReader.rows`.
    """
    blocks: list[list[Array]] = [[] for _ in where]
    rows = faulty = 0
    with ExitStack() as opened:
        files: list[IO[bytes]] = []
        for block in log.rows(sorted(set(where.values())), where.get(TIME), needs_time=needs_time):
            rows, faulty = rows + len(block), faulty + len(block.faults)
            for column, kept in zip(where.values(), blocks, strict=True):
                kept.append(block.values[column])
            if files or 8 * rows * len(where) > _MEMORY:
                files = files or [opened.enter_context(TemporaryFile()) for _ in where]
                _to_files(blocks, files)
        columns = [np.asarray(np.memmap(file, dtype=np.float64, mode="r")) for file in files]  # a map outlives its file
    columns = columns or [np.concatenate([np.empty(0), *kept]) for kept in blocks]
    by_role = dict(zip(where, columns, strict=True))
    return RecordedColumns(by_role, log.name, log.sha256 if log.source.digest else None, faulty)


def read_readings(
    log: LogReader, channels: Sequence[str], columns: Mapping[str, str] | str, unit: str, others: Sequence[str] = ()
) -> RecordedColumns:
    """Read the readings of a log in a unit to its end, with temperature and time where it has them, and ``others``.

    ``columns`` names columns by role, as ``--columns`` does.
    """
    named = named_columns(columns, channels)
    needs_time = TIME in named or TIME in others
    where = locate_readings(log, channels, named, unit, (*others, TIME) if needs_time else others)
    if TIME not in where and log.has_times(TIME, where[channels[0]]):
        where[TIME] = log.names.index(TIME)
    return read_columns(log, where, needs_time=needs_time)


def _to_files(blocks: Sequence[list[Array]], files: Sequence[IO[bytes]]) -> None:
    """Move the blocks of each column behind those in its file."""
    try:
        for kept, file in zip(blocks, files, strict=True):
            file.writelines(np.ascontiguousarray(block, dtype=np.float64).data for block in kept)
            file.flush()
            kept.clear()
    except OSError as failure:
        raise UsageError(
            f"the rows of the log cannot be kept in {gettempdir()}: {failure.strerror}; make room there, or name "
            "another folder in TMPDIR"
        ) from failure
