"""Rows of a log, put into means before they are compensated: so many rows each, or so much time each.

A mean is over the rows in which a sensor's readings are all there; they are counted, for each sensor of a log of
several. What these share has its mean over the rows that count for at least one. Columns of numbers and of moments get
their mean, a heading that of its direction, every other column the value of the first row. Headings that point apart
have no mean worth the name: the row is flagged. Groups of a time begin at whole multiples of it on the clock of the
log; a row without a time belongs to the group of the row before it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.earth_frame import FIELD_TOLERANCE, full_circle
from tiltcal.core.flags import FAIL, GRAVITY_LENGTH, NO_DIRECTION, RAIL, SUSPECT, Bytes, Mask, Reasons, mark_columns
from tiltcal.core.model import Array
from tiltcal.errors import InputError
from tiltcal.logs.cf_attributes import COUNT
from tiltcal.logs.kernel import PreparedSensor
from tiltcal.logs.log import LogBlock, LogReader, Table
from tiltcal.logs.numbers_and_times import clock_breaks, no_time_yet, texts_of_times
from tiltcal.logs.options import GroupSize

if TYPE_CHECKING:
    import polars as pl

_FROM_TILT = ("tilt_", "pitch", "roll", "inclination", "heading", "v_", "u_", "U95_")  # columns begin so
_GROUP = "\0group"


@dataclass(frozen=True, kw_only=True)
class BlockOfMeans(LogBlock):
    """Some means of rows of a log, in order.

    In ``rows`` rows, shape (n,), at least one sensor has all its readings; ``flags`` and ``reasons``, (n, sensors), are
    the worst of readings at the rail or of a length of gravity that is not 1 g; where ``apart``, (n,), the headings
    differ so much that the mean of their directions is 5 % shorter than they are.
    """

    sensors: Sequence[PreparedSensor]
    rows: NDArray[np.int64]
    flags: Bytes
    reasons: Reasons
    apart: Mask

    def marked(self, table: Table) -> Table:
        """Return the columns of these means: the count, and the flags of readings and of headings apart too."""
        marked = dict(table)
        for sensor, flags, reasons in zip(self.sensors, self.flags.T, self.reasons.T, strict=True):
            judged = {name: table[name] for name in (f"{sensor.lead}flag", f"{sensor.lead}reason")}
            marked |= mark_columns(judged, reasons > 0, flags, reasons)
            lost = (flags == FAIL) & (reasons & GRAVITY_LENGTH > 0)
            for name in table if lost.any() else ():
                if name.startswith(tuple(sensor.lead + kind for kind in _FROM_TILT)):
                    marked[name] = np.where(lost, np.nan, table[name])
        return {COUNT: self.rows, **mark_columns(marked, self.apart, SUSPECT, NO_DIRECTION)}


@dataclass(frozen=True)
class Means:
    """Puts the rows of a log into means; ``judged`` compensates readings of ``sensors`` one by one."""

    size: GroupSize
    log: LogReader
    sensors: Sequence[PreparedSensor]
    judged: Callable[[LogBlock], Table]
    time: int | None = None
    heading: int | None = None
    temperature: int | None = None

    def blocks(self, blocks: Iterable[LogBlock]) -> Iterator[BlockOfMeans]:
        """Yield the means of the rows of blocks with types; the last mean may be of fewer rows."""
        pending: LogBlock | None = None
        bad = done = 0
        for block in blocks:
            bad += len(block.faults)
            whole = block if pending is None else _joined(pending, block)
            groups = self._groups(whole, done)
            cut = int(np.searchsorted(groups, groups[-1]))  # the last group may go on
            if cut:
                yield self._means(_part(whole, 0, cut), groups[:cut], bad)
                bad = 0
            done += cut
            pending = _part(whole, cut, len(whole))
        if pending is not None:
            yield self._means(pending, self._groups(pending, done), bad)

    def _groups(self, block: LogBlock, done: int) -> NDArray[np.int64]:
        """Return the number of each row's group, ascending; ``done`` rows are before these."""
        if self.size.rows is not None:
            return (done + np.arange(len(block))) // self.size.rows
        time = block.values[cast(int, self.time)]
        timed = np.isfinite(time)
        if not timed.any() and any(np.isfinite(block.readings(sensor.columns)).any() for sensor in self.sensors):
            raise InputError(no_time_yet(len(time), "to which mean they belong"), file=self.log.name)
        place = np.maximum.accumulate(np.where(timed, np.arange(len(time)), 0))
        # Whole microseconds are exact where seconds are not; a border within half of one is where the row is.
        micros = np.rint(np.where(timed, time, time[place]) * 1e6) + 0.5
        step = np.floor(micros / (cast(float, self.size.seconds) * 1e6))
        # NaN differs from NaN: rows before the first time are one group.
        changed = (step[1:] != step[:-1]) & (np.isfinite(step[1:]) | np.isfinite(step[:-1]))
        changed[clock_breaks(time)[0] - 1] = True
        return np.concatenate([[0], np.cumsum(changed)])

    def _means(self, block: LogBlock, groups: NDArray[np.int64], bad: int) -> BlockOfMeans:
        starts = np.flatnonzero(np.diff(groups, prepend=groups[0] - 1))
        complete = np.array([np.isfinite(block.readings(sensor.columns)).all(axis=1) for sensor in self.sensors])
        shared, rows = _counted(np.logical_or.reduce(complete), starts)
        counts = np.empty((len(starts), len(self.sensors)), np.int64)
        flags, reasons = np.empty(counts.shape, np.uint8), np.empty(counts.shape, np.uint16)
        judged = self.judged(block)
        used_for: dict[int | None, Mask] = {}
        for number, sensor in enumerate(self.sensors):
            used, counts[:, number] = _counted(complete[number], starts)
            reason = np.where(used, judged[f"{sensor.lead}reason"], 0).astype(np.uint16) & (RAIL | GRAVITY_LENGTH)
            reasons[:, number] = np.bitwise_or.reduceat(reason, starts)
            flags[:, number] = np.maximum.reduceat(np.where(reason, judged[f"{sensor.lead}flag"], 0), starts)
            used_for |= dict.fromkeys((*sensor.columns, sensor.thermometer), used)
        values = {index: _mean(column, used_for.get(index, shared), starts) for index, column in block.values.items()}
        apart = np.zeros(len(starts), bool)
        if self.heading is not None:
            headings = np.radians(block.values[self.heading])
            east, north = _mean(np.sin(headings), shared, starts), _mean(np.cos(headings), shared, starts)
            values[self.heading] = full_circle(np.degrees(np.arctan2(east, north)), 360.0)
            apart = np.hypot(east, north) < 1.0 - FIELD_TOLERANCE
        for number, sensor in enumerate(self.sensors):
            for index in sensor.columns:
                values[index][counts[:, number] == 0] = np.nan
        return BlockOfMeans(
            values=values,
            frame=self._frame(block.framed(), groups, shared, values),
            counts=counts,
            bad_rows=bad,
            sensors=self.sensors,
            rows=rows,
            flags=flags,
            reasons=reasons,
            apart=apart,
        )

    def _frame(
        self, frame: pl.DataFrame, groups: NDArray[np.int64], used: Mask, values: dict[int, Array]
    ) -> pl.DataFrame:
        """Return the columns of the means, with their types; whole numbers become decimal."""
        import polars as pl

        kinds = frame.schema
        expressions = [
            (pl.col(name).fill_nan(None) if kind.is_float() else pl.col(name)).mean()
            if kind.is_numeric() or isinstance(kind, pl.Datetime | pl.Duration)
            else pl.col(name).first()
            for name, kind in kinds.items()
        ]
        taken = frame.with_columns(pl.Series(_GROUP, groups)).filter(pl.Series(used))
        means = taken.group_by(_GROUP, maintain_order=True).agg(expressions).drop(_GROUP)
        warm = {sensor.thermometer for sensor in self.sensors} | {self.temperature}
        exact = {
            self.log.names[index]: pl.Series(column).fill_nan(None)
            for index, column in values.items()
            if not (index in warm and self.log.converts(index))
        }
        if self.time is not None:  # it has a unit and a moment of its own
            name, times = self.log.names[self.time], values[self.time]
            del exact[name]
            if kinds.get(name) == pl.String:
                exact[name] = texts_of_times(times, frame[name]).zip_with(pl.Series(np.isfinite(times)), means[name])
        return means.with_columns(**exact)


def _counted(complete: Mask, starts: NDArray[np.intp]) -> tuple[Mask, NDArray[np.int64]]:
    """Return which rows belong into the mean of each group, and how many of them count.

    Of a group without a row that counts, all rows are taken: its readings are missing, and its time is there.
    """
    counts = np.add.reduceat(complete.astype(np.int64), starts)
    return complete | np.repeat(counts == 0, np.diff(starts, append=len(complete))), counts


def _mean(column: Array, used: Mask, starts: NDArray[np.intp]) -> Array:
    """Return the mean of each group without what is missing."""
    taken = used & np.isfinite(column)
    total = np.add.reduceat(np.where(taken, column, 0.0), starts)
    number = np.add.reduceat(taken.astype(np.int64), starts)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(total / number)


def _joined(first: LogBlock, second: LogBlock) -> LogBlock:
    values = {index: np.concatenate([column, second.values[index]]) for index, column in first.values.items()}
    return LogBlock(values, frame=first.framed().vstack(second.framed()))


def _part(block: LogBlock, start: int, end: int) -> LogBlock:
    values = {index: column[start:end] for index, column in block.values.items()}
    return LogBlock(values, frame=block.framed()[start:end])
