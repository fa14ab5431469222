"""The readings of a recorded log, whole in memory, by the roles of their columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.quantisation import DifferentValues
from tiltcal.errors import InputError
from tiltcal.logs.columns import TEMPERATURE, TIME, locate_readings
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import Progress


@dataclass(frozen=True)
class RecordedReadings:
    """The number columns of a log, whole.

    Attributes
    ----------
    name : str
        The log as the user named it.
    roles : sequence of str
        The channels and, behind them, the time and the temperature where these are read.
    values : ndarray, shape (roles, rows)
        NaN where a value is missing.
    different : sequence of ndarray
        The values of each channel, most of them once where they repeat.
    sha256 : str or None
        Of the file; None of a frame.
    """

    name: str
    roles: Sequence[str]
    values: Array
    different: Sequence[Array]
    sha256: str | None

    @property
    def columns(self) -> Mapping[str, Array]:
        """The columns by role, each of shape (rows,)."""
        return dict(zip(self.roles, self.values, strict=True))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.readings)

    @property
    def readings(self) -> Array:
        """The channels side by side, shape (rows, channels)."""
        return self.values[: len(self.roles) - len({TEMPERATURE, TIME}.intersection(self.roles))].T


def timed_readings(
    log: object,
    channels: Sequence[str],
    named: Mapping[str, str],
    unit: str,
    progress: Progress | None = None,
) -> RecordedReadings:
    """Read the readings of a log with its times, where it has any, by the arguments of :func:`recorded_readings`."""
    try:
        return recorded_readings(log, channels, named, unit, progress, (TIME,))
    except InputError:
        if TIME in named:
            raise
        return recorded_readings(log, channels, named, unit, progress)


def recorded_readings(
    log: object,
    channels: Sequence[str],
    named: Mapping[str, str],
    unit: str,
    progress: Progress | None = None,
    others: Sequence[str] = (),
) -> RecordedReadings:
    """Read the readings of a log.

    Parameters
    ----------
    named : mapping of str to str
        Column name by role, from ``--columns``.
    unit : str
        Of the readings.
    progress : callable, optional
        Called with the bytes that have been read, after each block.
    others : sequence of str
        Further roles that are needed, such as time.

    Raises
    ------
    InputError
        A column is missing or in another unit, or a row cannot be parsed.
    """
    is_file = isinstance(log, str | Path)
    with open_log(log, digest=is_file, progress=progress) as reader:
        where = locate_readings(reader, channels, named, unit, others)
        rows = reader.rows(sorted(set(where.values())), where.get(TIME))
        values, end = np.empty((len(where), 0)), 0
        different = [DifferentValues() for _ in channels]
        for block in rows:
            start, end = end, end + len(block)
            if end > values.shape[1]:
                longer = np.empty((len(where), 2 * end))  # what stays empty takes no memory
                longer[:, :start] = values[:, :start]
                values = longer
            np.stack([block.values[index] for index in where.values()], out=values[:, start:end])
            for channel, found in zip(values, different, strict=False):
                found.add(channel[start:end])
        return RecordedReadings(
            reader.name,
            tuple(where),
            values[:, :end],
            [found.of(channel[:end]) for found, channel in zip(different, values, strict=False)],
            reader.sha256 if is_file else None,
        )
