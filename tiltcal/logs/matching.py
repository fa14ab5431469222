"""A recorded log on its way through the demodulation of accelerometer pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulation, Demodulator
from tiltcal.core.pair.spin import Spin, estimate_spin
from tiltcal.core.pair.stage import Stage
from tiltcal.errors import EstimateError, InputError
from tiltcal.logs.columns import TIME, locate_columns
from tiltcal.logs.csv_log import CsvLog

ROWS_FOR_SPIN = 1 << 20
"""Rows from whose beginning the spin is estimated where there is no encoder; they are what is kept in memory."""


@dataclass(frozen=True)
class Stretch:
    """Some rows of a log, in order.

    Attributes
    ----------
    theta : ndarray, shape (n,)
        Stage angle, degrees; NaN where it is missing.
    readings : ndarray, shape (n, channels)
        NaN where a value is missing.
    time : ndarray, shape (n,), or None
        Seconds; None where the log has no such column.
    first : int
        Number of the first row, counted from 0.
    """

    theta: Array
    readings: Array
    time: Array | None
    first: int

    def complete(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """Angle, readings and number of the rows in which no value is missing."""
        rows = self.first + np.arange(len(self.theta), dtype=np.int64)
        good = np.isfinite(self.theta) & np.isfinite(self.readings).all(axis=1)
        if good.all():
            return self.theta, self.readings, rows
        return self.theta[good], self.readings[good], rows[good]


@dataclass
class Demodulated:
    """What came out of a log.

    Attributes
    ----------
    demodulation : Demodulation
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
    spin: Spin | None = field(default=None)

    @property
    def frequency(self) -> float | None:
        """Of the spin, Hz; None where the log has no time."""
        return self.turns / self.seconds if self.seconds else None

    @property
    def rate(self) -> float | None:
        """Rows per second; None where the log has no time."""
        return (self.rows + self.missing - 1) / self.seconds if self.seconds else None


def demodulate_log(
    log: CsvLog,
    channels: Sequence[str],
    phase: str | None,
    *,
    file: str,
    witness: Sequence[Callable[[Stretch], None]] = (),
    live: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Demodulated:
    """Demodulate the readings of a log, read once from its beginning to its end.

    Parameters
    ----------
    log : CsvLog
    channels : sequence of str
        The columns of the readings.
    phase : str or None
        The column of the stage angle in degrees; None where there is no encoder and the spin is to be estimated, from
        the column ``time`` or, without one, from the number of the row.
    file : str
        The log as the user named it.
    witness : sequence of callable
        Shown every stretch as it is read, rows with missing values and all.
    live : bool
        The log is taken for a stream: a stage that turns too little, or backwards, is left to the witnesses.
    progress : callable, optional
        Told how many bytes of the log have been read.

    Raises
    ------
    InputError
        A column is missing or has no values, or a row cannot be parsed.
    EstimateError
        The stage does not turn as it must.
    """
    stage, demodulator, tally = Stage(), Demodulator(channels), _Tally(len(channels))
    spin: Spin | None = None
    for stretch, estimated in _stretches(log, channels, phase, file):
        spin = estimated
        theta, readings, numbers = stretch.complete()
        demodulator.add(stage.follow(theta), readings, numbers)
        tally.count(stretch)
        for look in witness:
            look(stretch)
        if progress is not None:
            progress(log.bytes_read)
    for name, present in zip((*channels, str(phase)), tally.present.tolist(), strict=True):
        if not present:
            raise InputError(f"column {name!r} has no value in any row: is {name} connected?", file=file)
    if not live or not stage.moved:
        stage.require_turns()
    missing = tally.rows - stage.rows
    return Demodulated(demodulator.result(), stage.turns, stage.rows, missing, tally.seconds, spin)


class _Tally:
    """Counts the values of a log, and keeps when it begins and ends."""

    def __init__(self, channels: int) -> None:
        self.rows = 0
        self.present = np.zeros(channels + 1, dtype=np.int64)
        self._begin: float | None = None
        self._end = 0.0

    def count(self, stretch: Stretch) -> None:
        self.rows += len(stretch.theta)
        self.present += [*np.isfinite(stretch.readings).sum(axis=0), np.isfinite(stretch.theta).sum()]
        timed = np.empty(0) if stretch.time is None else stretch.time[np.isfinite(stretch.time)]
        if len(timed):
            self._begin = float(timed[0]) if self._begin is None else self._begin
            self._end = float(timed[-1])

    @property
    def seconds(self) -> float | None:
        """From the first row with a time to the last; None without time."""
        return None if self._begin is None or self._end <= self._begin else self._end - self._begin


def _stretches(
    log: CsvLog, channels: Sequence[str], phase: str | None, file: str
) -> Iterator[tuple[Stretch, Spin | None]]:
    """The log's rows with their stage angle, measured or estimated."""
    needed = (*channels, phase) if phase is not None else tuple(channels)
    where = locate_columns(log.names, needed, {}, file=file)
    if TIME in log.names:
        where[TIME] = log.names.index(TIME)
    blocks = _blocks(log, where, channels, phase)
    if phase is not None:
        yield from ((stretch, None) for stretch in blocks)
        return
    held: list[Stretch] = []
    spin: Spin | None = None
    for stretch in blocks:
        if spin is None:
            held.append(stretch)
            if sum(len(one.theta) for one in held) < ROWS_FOR_SPIN:
                continue
            spin = _spin_of(held)
            yield from ((_turned(one, spin), spin) for one in held)
        else:
            yield _turned(stretch, spin), spin
    if spin is None:
        spin = _spin_of(held)
        yield from ((_turned(one, spin), spin) for one in held)


def _blocks(log: CsvLog, where: dict[str, int], channels: Sequence[str], phase: str | None) -> Iterator[Stretch]:
    first = 0
    for rows in log.rows(sorted(set(where.values()))):
        readings = np.stack([rows.values[where[channel]] for channel in channels], axis=1)
        theta = np.full(len(readings), np.nan) if phase is None else rows.values[where[phase]]
        yield Stretch(theta, readings, rows.values[where[TIME]] if TIME in where else None, first)
        first += len(readings)


def _clock(stretch: Stretch) -> Array:
    """Seconds, or numbers of rows where there are none."""
    return stretch.time if stretch.time is not None else stretch.first + np.arange(float(len(stretch.theta)))


def _spin_of(held: Sequence[Stretch]) -> Spin:
    time = np.concatenate([_clock(stretch) for stretch in held])
    readings = np.concatenate([stretch.readings for stretch in held])
    good = np.isfinite(time) & np.isfinite(readings).all(axis=1)
    if not good.any():
        raise EstimateError("no row of the record has all readings: is every accelerometer connected?")
    return estimate_spin(time[good], readings[good])


def _turned(stretch: Stretch, spin: Spin) -> Stretch:
    return Stretch(spin.theta(_clock(stretch)), stretch.readings, stretch.time, stretch.first)
