"""The overview of a log for a report: written by `apply`, or raw and compensated while it is read."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.column_statistics import ColumnStatistics
from tiltcal.core.flags import MISSING, NOT_A_NUMBER
from tiltcal.logs.apply import CompensatedLog
from tiltcal.logs.kernel import PreparedCalibration
from tiltcal.logs.log import LogBlock, LogReader, Table
from tiltcal.logs.options import ApplyOptions
from tiltcal.logs.streams import read_ahead

_ABSENT = {"flag": MISSING, "reason": NOT_A_NUMBER}
"""What a cell counts as that holds no flag or no reason."""


def look_over(
    log: LogReader, prepared: PreparedCalibration, options: ApplyOptions, time: int | None = None
) -> tuple[ColumnStatistics, bool]:
    """Return what a report shows of a log, and whether it has the columns that the calibration would add.

    Parameters
    ----------
    options : ApplyOptions
        How the calibration is applied to a raw log.
    time : int, optional
        Where the time stands, in seconds or ISO 8601; rows are counted where there is none.

    InputError: a row cannot be parsed, or the log is damaged.
    """
    wanted = (*prepared.angles, *_ABSENT)
    compensated = set(wanted) <= set(log.names)
    tables: Iterable[tuple[LogBlock, Table]]
    if compensated:
        where = {name: log.names.index(name) for name in wanted}
        blocks = log.rows(sorted({*where.values(), *(() if time is None else (time,))}), time, needs_time=True)
        tables = ((block, {name: block.values[index] for name, index in where.items()}) for block in blocks)
    else:
        tables = CompensatedLog(log, prepared, options).blocks(time)
    overview = ColumnStatistics(prepared.angles)
    for block, table in read_ahead(iter(tables)):
        shown = np.stack([np.asarray(table[angle], float) for angle in prepared.angles]).T
        flag, reason = (_small(np.asarray(table[name]), absent) for name, absent in _ABSENT.items())
        times = overview.rows + np.arange(float(len(flag))) if time is None else block.values[time]
        overview.add(times, shown, flag, reason)
    return overview, compensated


def _small(column: NDArray[Any], absent: int) -> NDArray[Any]:
    """Return flags or reasons as whole numbers."""
    return np.where((column >= 0) & (column <= 65535), column, absent).astype(np.uint16)
