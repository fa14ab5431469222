"""The readings of a recorded log, block by block, by the roles of their columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from tiltcal.core.model import Array
from tiltcal.logs.columns import TEMPERATURE, TIME, locate_readings
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import Progress
from tiltcal.logs.stored_rows import StoredRows


class RecordedReadings:
    """The number columns of a log: the channels and, behind them, the temperature and the time where these are read.

    Parameters
    ----------
    blocks : iterable of sequence of ndarray, shape (rows,)
        Of each column; NaN where a value is missing.

    Attributes
    ----------
    name : str
        The log as the user named it.
    thermometer, timed : bool
        Whether there are temperatures, and times.
    rows : int
        Number of rows, once they are read.
    sha256 : str or None
        Of the file, once it is read; None of a frame.
    """

    def __init__(
        self,
        name: str,
        channels: Sequence[str],
        blocks: Iterable[Sequence[Array]],
        *,
        thermometer: bool,
        timed: bool = False,
    ) -> None:
        self.name, self.channels = name, tuple(channels)
        self.thermometer, self.timed = thermometer, timed
        self.rows = 0
        self.sha256: str | None = None
        self._blocks = blocks

    def blocks(self) -> Iterator[tuple[int, Sequence[Array]]]:
        """Yield the first row of each block, and the values of each column."""
        self.rows = 0
        for values in self._blocks:
            self.rows += len(values[0])
            yield self.rows - len(values[0]), values

    @contextmanager
    def stored(self) -> Iterator[StoredRows]:
        """Read all rows into a temporary file, whose slices have the channels; :meth:`blocks` then reads them there."""
        with StoredRows(len(self.channels) + self.thermometer + self.timed, len(self.channels)) as rows:
            for _, values in self.blocks():
                rows.append(values)
            self._blocks = rows.blocks()
            yield rows


@contextmanager
def recorded_readings(
    log: object,
    channels: Sequence[str],
    named: Mapping[str, str],
    unit: str,
    progress: Progress | None = None,
) -> Iterator[RecordedReadings]:
    """Open a log for its readings.

    Parameters
    ----------
    named : mapping of str to str
        Column name by role, from ``--columns``.
    unit : str
        Of the readings.
    progress : callable, optional
        Called with the bytes that have been read, after each block.

    Raises
    ------
    InputError
        A column is missing or in another unit, or a row cannot be parsed.
    """
    is_file = isinstance(log, str | Path)
    with open_log(log, digest=is_file, progress=progress) as reader:
        needs_time = TIME in named
        where = locate_readings(reader, channels, named, unit, (TIME,) if needs_time else ())
        if TIME not in where and reader.has_times(TIME, where[channels[0]]):
            where[TIME] = reader.names.index(TIME)
        columns = [where[role] for role in (*channels, TEMPERATURE, TIME) if role in where]
        blocks = (
            [block.values[index] for index in columns]
            for block in reader.rows(sorted(set(columns)), where.get(TIME), needs_time=needs_time)
        )
        record = RecordedReadings(reader.name, channels, blocks, thermometer=TEMPERATURE in where, timed=TIME in where)
        yield record
        record.sha256 = reader.sha256 if is_file else None
