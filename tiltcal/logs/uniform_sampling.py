"""Rows of a log as evenly spaced samples: what is not there is missing, and keeps its place in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import InputError

_LATE = 1.5
"""Rows are missing where the next one is late by so many intervals."""

_MILLISECOND = 1e-3
"""Times that are written to the millisecond may be off by as much, seconds."""

_LONGEST_GAP, _GAP_SHARE = 10_000_000, 100
"""Refuse a gap of more rows than this, and than so many times the rows before it."""


@dataclass(frozen=True)
class SamplingInterval:
    """The interval between the rows of a log in seconds, its rows, its gaps, and the rows that are lost in them."""

    interval: float
    rows: int
    gaps: int = 0
    lost: int = 0


def evenly_spaced(columns: Sequence[Array], times: Array, file: str) -> tuple[list[Array], SamplingInterval]:
    """Give each row its place in time.

    Parameters
    ----------
    columns : sequence of ndarray, shape (n,)
        NaN where a value is missing.
    times : ndarray, shape (n,)
        Seconds; a row without a time follows the one before it.

    Returns
    -------
    list of ndarray, shape (n + lost,)
        NaN where a row is lost.
    SamplingInterval

    Raises
    ------
    InputError
        Time stands still, goes back or leaps, as where a clock is set.
    """
    rows = np.flatnonzero(np.isfinite(times))
    if not len(rows):
        raise _unclear(file, "its times are neither seconds nor ISO 8601")
    steps = np.diff(times[rows] if len(rows) < len(times) else times)
    if len(steps) and steps.min() < 0.0:
        row = int(rows[1 + np.argmin(steps)])
        raise InputError(f"time goes back at row {row}: sort the log, or state --rate HZ", file=file)
    steps[np.diff(rows) != 1] = np.nan  # what lies between rows without a time is no step of one interval
    singles = steps[np.isfinite(steps)]
    if not len(singles):
        raise _unclear(file, "it has no two rows with a time")
    # Times that are written to the millisecond may stand still between rows that are taken faster.
    usual = float(np.median(singles)) or float(np.mean(singles))
    if usual <= 0.0:
        raise _unclear(file, "its times do not change")
    milliseconds = times[rows[:1000]] / _MILLISECOND
    slack = _MILLISECOND if np.all(np.abs(milliseconds - np.round(milliseconds)) < 1e-3) else 0.0
    late = np.flatnonzero(steps > _LATE * usual + slack)
    interval = float(np.mean(np.delete(steps, late), where=np.isfinite(np.delete(steps, late))))
    lost = np.maximum(np.round(steps[late] / usual), 2).astype(np.int64) - 1
    far = np.flatnonzero(lost > np.maximum(_LONGEST_GAP, _GAP_SHARE * rows[1 + late]))
    if len(far):
        raise InputError(
            f"the time leaps by {steps[late[far[0]]]:.6g} s at row {rows[1 + late[far[0]]]}: cut the log there, or "
            "state --rate HZ",
            file=file,
        )
    spacing = SamplingInterval(interval, len(times), len(late), int(lost.sum()))
    if not len(late):
        return list(columns), spacing
    return [np.insert(column, np.repeat(rows[1 + late], lost), np.nan) for column in columns], spacing


def _unclear(file: str, why: str) -> InputError:
    return InputError(f"its sample rate is unknown: {why}; state it with --rate HZ", file=file)
