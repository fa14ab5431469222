"""A recorded log as evenly spaced samples: what is not there is missing, and keeps its place in time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import InputError
from tiltcal.logs.columns import TIME, locate_columns
from tiltcal.logs.log import LogReader

_LATE = 1.5
"""Intervals after which the next row is late by so much that rows must be missing between."""

_MILLISECOND = 1e-3
"""Times that are written to the millisecond may be off by as much."""

_PIECE = 1 << 16
"""Rows that a gap is filled with at a time."""

_LONGEST_GAP = 10_000_000
"""Rows that may be missing in any gap."""

_GAP_SHARE = 100
"""Times the rows before a gap that may be missing in it, where these are more."""


@dataclass
class SamplingInterval:
    """The interval between the rows of a log: seconds from row to row, gaps, and the rows that are lost in them.

    Faulty rows are those that could not be parsed.
    """

    interval: float = 0.0
    rows: int = 0
    gaps: int = 0
    lost: int = 0
    faulty: int = 0


class UniformLog:
    """The readings of a log, evenly spaced.

    Parameters
    ----------
    named : mapping of str to str
        Column name by role, from ``--columns``.
    rate : float or None
        Rows per second, of a log whose time is not to be asked; None where the column of the time says it, as seconds
        or as ISO 8601.

    Attributes
    ----------
    name : str
        The log as the user named it.
    pace : SamplingInterval
        Of the rows so far; whole once all of them were read.

    Raises
    ------
    InputError
        A column is not there, or nothing says how fast the rows follow each other.
    """

    def __init__(self, log: LogReader, channels: Sequence[str], named: Mapping[str, str], rate: float | None) -> None:
        self._log, self._channels, self.name = log, channels, log.name
        self._where = locate_columns(log, channels, named)
        self._time: int | None = None
        self.pace = SamplingInterval(0.0 if rate is None else 1.0 / rate)
        if rate is None:
            name = named.get(TIME, TIME)
            if name not in log.names:
                raise InputError(
                    "its sample rate is unknown: there is no column 'time'; name it with --columns "
                    "time=NAME, or state --rate HZ",
                    file=log.name,
                    line=log.header_line,
                )
            self._time = log.names.index(name)
        self._last = np.nan
        self._slack = 0.0
        self._regular, self._regular_span = 0, 0.0

    def samples(self) -> Iterator[Array]:
        """Yield the readings, block after block, shape (n, channels); NaN where a value is missing.

        Raises
        ------
        InputError
            A row cannot be parsed, or time stands still, goes back or leaps, as where a clock is set.
        """
        columns = {self._where[channel] for channel in self._channels}
        if self._time is not None:
            columns.add(self._time)
        for rows in self._log.rows(sorted(columns), self._time):
            readings = rows.readings([self._where[channel] for channel in self._channels])
            if self._time is None:
                yield readings
            else:
                yield from self._spaced(readings, rows.values[self._time])
            self.pace.rows += len(readings)
            self.pace.faulty += len(rows.faults)
        if self._time is not None:
            if self._regular == 0:
                raise self._unclear("it has no two rows with a time")
            self.pace.interval = self._regular_span / self._regular

    def _spaced(self, readings: Array, times: Array) -> Iterator[Array]:
        """Yield the readings with missing rows where time leaps; a row without a time follows the one before it."""
        finite = np.isfinite(times)
        whole = bool(finite.all())
        known = np.arange(len(times)) if whole else np.flatnonzero(finite)
        if not len(known) and self.pace.interval:
            self._last = np.nan
            yield readings
            return
        if not len(known):
            raise self._unclear(f"its times from row {self.pace.rows} on are neither seconds nor ISO 8601")
        moments = times if whole else times[known]
        # A first row, and one behind rows without a time, has no step of one interval.
        steps = np.diff(moments, prepend=self._last)
        if not whole:
            steps[np.diff(known, prepend=-1) != 1] = np.nan
        if np.fmin.reduce(steps, initial=0.0) < 0.0:
            row = self.pace.rows + int(known[np.nanargmin(steps)])
            raise InputError(f"time goes back at row {row}: sort the log, or state --rate HZ", file=self.name)
        self._last = float(times[-1])
        if not self.pace.interval and np.isfinite(steps).any():
            self.pace.interval = self._first_interval(steps[np.isfinite(steps)])
            milliseconds = moments / _MILLISECOND
            self._slack = _MILLISECOND if np.all(np.abs(milliseconds - np.round(milliseconds)) < 1e-3) else 0.0
        late = np.asarray((steps > _LATE * self.pace.interval + self._slack) & (self.pace.interval > 0.0))
        usual = np.isfinite(steps) & ~late
        self._regular += int(usual.sum())
        self._regular_span += float(np.sum(steps, where=usual))
        done = 0
        for row, step in zip(known[late].tolist(), steps[late].tolist(), strict=True):
            yield readings[done:row]
            lost = max(1, round(step / self.pace.interval) - 1)
            place = self.pace.rows + row
            if lost > max(_LONGEST_GAP, _GAP_SHARE * place):
                raise InputError(
                    f"the time leaps by {step:.6g} s at row {place}: cut the log there, or state --rate HZ",
                    file=self.name,
                )
            self.pace.gaps += 1
            self.pace.lost += lost
            for start in range(0, lost, _PIECE):
                yield np.full((min(_PIECE, lost - start), readings.shape[1]), np.nan)
            done = row
        yield readings[done:]

    def _first_interval(self, steps: Array) -> float:
        # Times that are written to the millisecond may stand still between rows that are taken faster.
        interval = float(np.median(steps)) or float(np.mean(steps))
        if interval <= 0.0:
            raise self._unclear("its times do not change")
        return interval

    def _unclear(self, why: str) -> InputError:
        return InputError(f"its sample rate is unknown: {why}; state it with --rate HZ", file=self.name)
