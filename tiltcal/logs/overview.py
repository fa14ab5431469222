"""The overview of a log for a report: written by `apply`, or raw and compensated while it is read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tiltcal.core.column_statistics import ColumnStatistics
from tiltcal.core.flags import MISSING, NOT_A_NUMBER
from tiltcal.core.model import Array
from tiltcal.logs.apply import CompensatedLog
from tiltcal.logs.log import LogReader

FLAG, REASON = "flag", "reason"

_ABSENT = {FLAG: MISSING, REASON: NOT_A_NUMBER}


def is_compensated(log: LogReader, angles: Sequence[str]) -> bool:
    """Return whether a log has the columns that a calibration would add."""
    return {*angles, FLAG, REASON} <= set(log.names)


def look_over(log: CompensatedLog, angles: Sequence[str], time: int | None = None) -> ColumnStatistics:
    """Compensate a raw log, and keep what a report shows of it.

    Parameters
    ----------
    angles : sequence of str
        The columns that are angles.
    time : int, optional
        Where the time stands, in seconds or ISO 8601; rows are counted where there is none.

    Raises
    ------
    InputError
        A row cannot be parsed, or the log is damaged.
    """
    overview = ColumnStatistics(angles)
    for block, table in log.blocks(time):
        shown = np.stack([np.asarray(table[angle], float) for angle in angles], axis=1)
        flag, reason = (np.asarray(table[name], np.uint8) for name in (FLAG, REASON))
        overview.add(_clock(overview, len(flag), None if time is None else block.values[time]), shown, flag, reason)
    return overview


def look_over_compensated(log: LogReader, angles: Sequence[str], time: int | None = None) -> ColumnStatistics:
    """Keep what a report shows of a log that was compensated before; see :func:`is_compensated`."""
    overview = ColumnStatistics(angles)
    where = {name: log.names.index(name) for name in (*angles, FLAG, REASON)}
    for block in log.rows(sorted({*where.values(), *(() if time is None else (time,))}), time, needs_time=True):
        shown = np.stack([block.values[where[angle]] for angle in angles], axis=1)
        flag, reason = (_small(block.values[where[name]], absent) for name, absent in _ABSENT.items())
        overview.add(_clock(overview, len(flag), None if time is None else block.values[time]), shown, flag, reason)
    return overview


def _small(column: Array, absent: int) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    """Flags or reasons as numbers of one byte; a cell that holds none counts as ``absent``."""
    fits = (column >= 0) & (column <= 255)
    return np.where(fits, column, absent).astype(np.uint8)


def _clock(overview: ColumnStatistics, rows: int, times: Array | None) -> Array:
    """Return the times of some rows, or their numbers from 0 where the log has none."""
    return overview.rows + np.arange(float(rows)) if times is None else times
