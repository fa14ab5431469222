"""The demodulation of a recorded log of accelerometer pairs, block by block."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulation, Demodulator
from tiltcal.core.pair.encoder import AngleTracker
from tiltcal.core.pair.spin import Spin, estimate_spin, followed_spin
from tiltcal.errors import EstimateError, InputError
from tiltcal.logs.columns import TIME, locate_columns, require_degrees
from tiltcal.logs.log import LogReader
from tiltcal.logs.pair_rows import PairBlock, StuckValues
from tiltcal.logs.streams import read_ahead

ROWS_FOR_SPIN = 1 << 20
"""Rows from whose beginning the spin is estimated where there is no encoder; they are what is kept in memory."""

LARGEST = 1e140
"""Reading whose squares can be summed up in double precision."""


@dataclass
class Demodulated:
    """The demodulated components of a log of pairs.

    Attributes
    ----------
    turns : float
        Of the stage.
    rows : int
        That were used.
    missing : int
        That were left out because a value is missing.
    seconds : float or None
        From the first row used to the last; None without time.
    spin : Spin or None
        Where it was estimated.
    """

    demodulation: Demodulation
    turns: float
    rows: int
    missing: int
    seconds: float | None
    spin: Spin | None = None

    @property
    def frequency(self) -> float | None:
        """The frequency of the spin, Hz; None where the log has no time."""
        return self.turns / self.seconds if self.seconds else None

    @property
    def rate(self) -> float | None:
        """Rows per second; None where the log has no time."""
        return (self.rows + self.missing - 1) / self.seconds if self.seconds else None


def demodulate_log(
    log: LogReader,
    channels: Sequence[str],
    phase: str | None,
    *,
    observers: Sequence[Callable[[PairBlock], None]] = (),
    say: Callable[[str], None] = lambda line: None,
    live: bool = False,
) -> Demodulated:
    """Demodulate the readings of a log, read once from its beginning to its end.

    Parameters
    ----------
    phase : str or None
        The column of the stage angle in degrees; None where there is no encoder and the spin is to be estimated, from
        the column ``time`` or, without one, from the number of the row.
    observers : sequence of callable
        Shown every block as it is read, rows with missing values and all; stuck ones are among them.
    say : callable
        Told which channel is stuck, and from which row on.
    live : bool
        The log is taken for a stream: a stage that turns too little, or backwards, is left to the observers.

    Raises
    ------
    InputError
        A column is missing or has no values, or a row cannot be parsed.
    EstimateError
        The stage does not turn as it must.
    """
    stage, demodulator, tally = AngleTracker(), Demodulator(channels), _Tally(len(channels))
    angles, rows = _EstimatedAngles(), _blocks(log, channels, phase)
    rows = tally.counted(angles.with_angle(rows) if phase is None else rows)
    blocks = StuckValues(channels, say).cleaned(rows)
    for block in blocks if live else read_ahead(blocks):
        theta, readings, numbers = block.complete()
        demodulator.add(stage.follow(theta), readings, numbers)
        for observe in observers:
            observe(block)
    for name, present in zip((*channels, str(phase)), tally.present.tolist(), strict=True):
        if not present:
            raise InputError(f"column {name!r} has no value in any row: is {name} connected?", file=log.name)
    if not live or not stage.moved:
        stage.require_turns()
    missing = tally.rows - stage.rows
    return Demodulated(demodulator.result(), stage.turns, stage.rows, missing, tally.seconds, angles.spin)


class _Tally:
    """Counts the values of a log, and keeps when it begins and ends."""

    def __init__(self, channels: int) -> None:
        self.rows = 0
        self.present = np.zeros(channels + 1, dtype=np.int64)
        self._begin: float | None = None
        self._end = 0.0

    def counted(self, blocks: Iterator[PairBlock]) -> Iterator[PairBlock]:
        """Yield the blocks, and count their rows."""
        for block in blocks:
            self.rows += len(block.theta)
            self.present += [*np.isfinite(block.readings).sum(axis=0), np.isfinite(block.theta).sum()]
            timed = np.empty(0) if block.time is None else block.time[np.isfinite(block.time)]
            if len(timed):
                self._begin = float(timed[0]) if self._begin is None else self._begin
                self._end = float(timed[-1])
            yield block

    @property
    def seconds(self) -> float | None:
        """The seconds from the first row with a time to the last; None where the log has no time."""
        return None if self._begin is None or self._end <= self._begin else self._end - self._begin


class _EstimatedAngles:
    """The stage angle of a log's rows, estimated where it was not measured."""

    spin: Spin | None = None

    def with_angle(self, blocks: Iterator[PairBlock]) -> Iterator[PairBlock]:
        """Yield the blocks with their stage angle."""
        held: deque[PairBlock] = deque()
        rows = 0
        for block in blocks:
            held.append(block)
            rows += len(block.theta)
            if rows >= ROWS_FOR_SPIN:
                break
        self.spin = _spin_of(held)
        for block in chain((held.popleft() for _ in range(len(held))), blocks):
            self.spin = followed_spin(self.spin, *_timed(block))
            yield PairBlock(self.spin.theta(_clock(block)), block.readings, block.time, block.first)


def _blocks(log: LogReader, channels: Sequence[str], phase: str | None) -> Iterator[PairBlock]:
    """Yield the log's rows."""
    where = locate_columns(log, channels, {}, option="--pair or --orthogonal ")
    if phase is not None:
        where |= locate_columns(log, (phase,), {}, option="--phase ")
        require_degrees(log, where[phase], "stage angles")
    if TIME in log.names:
        where[TIME] = log.names.index(TIME)
    first = 0
    for rows in log.rows(sorted(set(where.values())), where.get(TIME)):
        readings = rows.readings([where[channel] for channel in channels])
        for channel, largest in zip(channels, np.fmax.reduce(np.abs(readings), initial=0.0).tolist(), strict=True):
            if LARGEST < largest < np.inf:
                raise InputError(
                    f"column {channel!r} has a reading of {largest:.3g}, which is no measurement", file=log.name
                )
        theta = np.full(len(readings), np.nan) if phase is None else rows.values[where[phase]]
        yield PairBlock(theta, readings, rows.values[where[TIME]] if TIME in where else None, first)
        first += len(readings)


def _clock(block: PairBlock) -> Array:
    """Seconds, or numbers of rows where there are none."""
    return block.time if block.time is not None else block.first + np.arange(float(len(block.theta)))


def _spin_of(held: Collection[PairBlock]) -> Spin:
    if not any(np.isfinite(_clock(block)).any() for block in held):
        raise EstimateError("no row has a time: write it in seconds, or in ISO 8601 such as 2026-05-01T12:00:00.5Z")
    time, readings = map(np.concatenate, zip(*map(_timed, held), strict=True))
    if not len(time):
        raise EstimateError("no row of the record has all readings: is every accelerometer connected?")
    return estimate_spin(time[:ROWS_FOR_SPIN], readings[:ROWS_FOR_SPIN])


def _timed(block: PairBlock) -> tuple[Array, Array]:
    """Return times and readings of the rows that have all of them."""
    time = _clock(block)
    good = np.isfinite(time) & np.isfinite(block.readings).all(axis=1)
    return (time, block.readings) if good.all() else (time[good], block.readings[good])
