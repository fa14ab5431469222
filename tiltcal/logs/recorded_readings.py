"""The readings of a recorded log as arrays, by the roles of their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiltcal.core.model import Array
from tiltcal.logs.columns import TEMPERATURE, TIME, locate_readings
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import Progress
from tiltcal.logs.numbers import read_columns


@dataclass(frozen=True)
class RecordedReadings:
    """The number columns of a log, NaN where a value is missing; a slice gives its readings, shape (n, channels).

    Attributes
    ----------
    name : str
        The log as the user named it.
    columns : sequence of ndarray, shape (rows,)
        Of each channel.
    temperature, time : ndarray, shape (rows,), or None
        °C and seconds, where the log has them.
    sha256 : str or None
        Of the file; None of a frame.
    """

    name: str
    channels: tuple[str, ...]
    columns: Sequence[Array]
    temperature: Array | None = None
    time: Array | None = None
    sha256: str | None = None

    def __len__(self) -> int:
        return len(self.columns[0])

    def __getitem__(self, rows: slice) -> Array:
        return np.stack([column[rows] for column in self.columns]).T


def read_readings(
    log: object, channels: Sequence[str], named: Mapping[str, str], unit: str, progress: Progress | None = None
) -> RecordedReadings:
    """Read the readings of a log to its end.

    Parameters
    ----------
    named : mapping of str to str
        Column name by role, from ``--columns``.
    unit : str
        Of the readings.
    progress : callable, optional
        Called with the bytes that have been read, after each block.

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
