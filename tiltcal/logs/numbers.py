"""The number columns of a log as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile, gettempdir
from typing import IO

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import UsageError
from tiltcal.logs.columns import TEMPERATURE, TIME, locate_readings
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import LogReader, Progress

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
    return Numbers([np.asarray(np.memmap(file, dtype=np.float64, mode="r")) for file in files], faulty)


@dataclass(frozen=True)
class RecordedReadings:
    """The readings of a log by channel, NaN where a value is missing; °C and seconds where it has them.

    ``name`` is the log as the user named it, ``sha256`` that of the file; None of a frame.
    """

    name: str
    channels: tuple[str, ...]
    columns: Sequence[Array]
    temperature: Array | None = None
    time: Array | None = None
    sha256: str | None = None

    def __len__(self) -> int:
        return len(self.columns[0])


def read_readings(
    log: object, channels: Sequence[str], named: Mapping[str, str], unit: str, progress: Progress | None = None
) -> RecordedReadings:
    """Read the readings of a log in a unit to its end; ``named`` are column names by role, from ``--columns``.

    InputError: a column is missing or in another unit, or a row cannot be parsed.
    """
    is_file = isinstance(log, str | Path)
    with open_log(log, digest=is_file, progress=progress) as reader:
        needs_time = TIME in named
        where = locate_readings(reader, channels, named, unit, (TIME,) if needs_time else ())
        if TIME not in where and reader.has_times(TIME, where[channels[0]]):
            where[TIME] = reader.names.index(TIME)
        roles = [role for role in (*channels, TEMPERATURE, TIME) if role in where]
        numbers = read_columns(reader, [where[role] for role in roles], where.get(TIME), needs_time=needs_time)
        column = dict(zip(roles, numbers.columns, strict=True))
        return RecordedReadings(
            reader.name,
            tuple(channels),
            [column[channel] for channel in channels],
            column.get(TEMPERATURE),
            column.get(TIME),
            reader.sha256 if is_file else None,
        )


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
