"""A log on its way into a report: as `apply` wrote it, or raw and compensated on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from tiltcal.core.compensation import MISSING, NOT_A_NUMBER, Compensation
from tiltcal.core.model import Array
from tiltcal.core.overview import ColumnStatistics
from tiltcal.logs.columns import TEMPERATURE
from tiltcal.logs.csv_log import CsvLog
from tiltcal.logs.csv_rows import CsvBlock

FLAG, REASON = "flag", "reason"


_ABSENT = {FLAG: MISSING, REASON: NOT_A_NUMBER}


def is_compensated(log: CsvLog, compensation: Compensation) -> bool:
    """Whether a log has the columns that the compensation would add."""
    return set(compensation.angles) | {FLAG, REASON} <= set(log.names)


def look_over(
    log: CsvLog,
    compensation: Compensation,
    channels: Sequence[str],
    columns: Mapping[str, int],
    *,
    time: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> ColumnStatistics:
    """Compensate a raw log, and keep what a report shows of it.

    Parameters
    ----------
    log : CsvLog
    compensation : Compensation
    channels : sequence of str
        The readings, in the order of the calibration.
    columns : mapping of str to int
        Where each channel and, if there is one, the temperature stands in the log.
    time : int, optional
        Where the time stands, in seconds or ISO 8601; rows are counted where there is none.
    progress : callable, optional
        Told how many bytes of the log have been read.

    Raises
    ------
    InputError
        See :class:`CsvLog`.
    """
    overview = ColumnStatistics(compensation.angles)
    for rows, clock in _timed(log, columns.values(), time, overview):
        readings = np.stack([rows.values[columns[channel]] for channel in channels]).T
        readings[list(rows.faults)] = np.nan
        found = compensation(readings, rows.values[columns[TEMPERATURE]] if TEMPERATURE in columns else None)
        table = compensation.table(found)
        overview.add(clock, np.stack([table[angle] for angle in overview.angles], axis=1), found.flag, found.reason)
        if progress is not None:
            progress(log.bytes_read)
    return overview


def look_over_compensated(
    log: CsvLog, compensation: Compensation, *, time: int | None = None, progress: Callable[[int], None] | None = None
) -> ColumnStatistics:
    """Keep what a report shows of a log that was compensated before; see :func:`is_compensated`.

    Raises
    ------
    InputError
        See :class:`CsvLog`.
    """
    overview = ColumnStatistics(compensation.angles)
    where = {name: log.names.index(name) for name in (*overview.angles, FLAG, REASON)}
    for rows, clock in _timed(log, where.values(), time, overview):
        angles = np.stack([rows.values[where[angle]] for angle in overview.angles], axis=1)
        flag, reason = (_small(rows.values[where[name]], absent) for name, absent in _ABSENT.items())
        overview.add(clock, angles, flag, reason)
        if progress is not None:
            progress(log.bytes_read)
    return overview


def _small(column: Array, absent: int) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    """Flags or reasons as numbers of one byte; a cell that holds none counts as ``absent``."""
    fits = (column >= 0) & (column <= 255)
    return np.where(fits, column, absent).astype(np.uint8)


def _timed(
    log: CsvLog, columns: Iterable[int], time: int | None, overview: ColumnStatistics
) -> Iterator[tuple[CsvBlock, Array]]:
    """The log's rows with their time, or their number from 0 where the log has none."""
    wanted = {*columns, *(() if time is None else (time,))}
    for rows in log.rows(sorted(wanted), time):
        counted = overview.rows + np.arange(float(len(rows.lines)))
        yield rows, counted if time is None else rows.values[time]
