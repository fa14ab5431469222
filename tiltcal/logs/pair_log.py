"""A recorded log of accelerometer pairs: its columns as one record, demodulated, and its spectra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, log2

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulation, demodulate
from tiltcal.core.pair.matching import Matching
from tiltcal.core.pair.model import sum_weights
from tiltcal.core.pair.spin import estimated_angle
from tiltcal.core.pair.stage import STANDSTILL, StageRecord, require_turns, stage_record
from tiltcal.errors import EstimateError, InputError
from tiltcal.logs.columns import TIME, locate_columns, require_degrees
from tiltcal.logs.log import LogReader
from tiltcal.logs.numbers import read_columns

_LARGEST = 1e140
"""Reading whose squares can be summed up in double precision."""
_TURNS_OF_SEGMENT = 8
_LONGEST_SEGMENT = 1 << 18


@dataclass(frozen=True)
class PairLog:
    """A log of pairs, demodulated.

    Attributes
    ----------
    turns : float
        Of the stage.
    rows, missing : int
        Those that were used, and those that were left out because a value is missing.
    seconds : float or None
        From the first row to the last; None without time.
    """

    record: StageRecord
    demodulation: Demodulation
    turns: float
    rows: int
    missing: int
    seconds: float | None

    @property
    def frequency(self) -> float | None:
        """The frequency of the spin, Hz; None where the log has no time."""
        return self.turns / self.seconds if self.seconds else None

    @property
    def rate(self) -> float | None:
        """Rows per second; None where the log has no time."""
        return (self.rows + self.missing - 1) / self.seconds if self.seconds else None

    def densities(self, matching: Matching) -> tuple[Array, dict[str, Array]]:
        """Return frequencies, and the densities of the source's figure 6 by Welch's method; unit²/Hz.

        Raises
        ------
        EstimateError
            The record is shorter than a segment.
        """
        segment = 1 << ceil(log2(max(_TURNS_OF_SEGMENT * self.rows / self.turns, 64)))
        segment = min(segment, _LONGEST_SEGMENT)
        if self.rows < segment:
            raise EstimateError(f"the record is too short for a spectrum; {2 * _TURNS_OF_SEGMENT} turns will do")
        pair, places = matching.pair, np.flatnonzero(self.record.whole)
        columns = [self.record.readings[self.record.channels.index(channel)] for channel in pair.channels]
        mixes = np.array([[1.0, 0.0, 0.0], sum_weights(matching.p, 0.0), sum_weights(matching.p, matching.q)])
        # The periodic Hann window, as Welch's method takes it.
        window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(segment) / segment)
        starts = range(0, len(places) - segment + 1, segment // 2)
        power = np.zeros((3, segment // 2 + 1))
        for start in starts:
            part = mixes @ np.stack([column[places[start : start + segment]] for column in columns])
            power += np.abs(np.fft.rfft((part - part.mean(axis=1, keepdims=True)) * window)) ** 2
        power[:, 1:-1] *= 2.0
        rate = self.rate or 1.0
        density = power / (len(starts) * rate * float(window @ window))
        names = (pair.first, "sum after p", "sum after p and q")
        return np.arange(segment // 2 + 1) * rate / segment, dict(zip(names, density, strict=True))


def read_pair_log(
    log: LogReader,
    channels: Sequence[str],
    phase: str | None,
    *,
    say: Callable[[str], None] = lambda line: None,
    online: bool = False,
) -> PairLog:
    """Read a log to its end, and demodulate its readings.

    Parameters
    ----------
    phase : str or None
        The column of the stage angle in degrees; None where there is no encoder and the spin is to be estimated, from
        the column ``time`` or, without one, from the number of the row.
    say : callable
        Told which channel is stuck, and from which row on.
    online : bool
        A stage that turns too little, or backwards, is left to the online estimators.

    Raises
    ------
    InputError
        A column is missing or has no values, or a row cannot be parsed.
    EstimateError
        The stage does not turn as it must.
    """
    where = locate_columns(log, channels, {}, option="--pair or --orthogonal ")
    columns = [where[channel] for channel in channels]
    if phase is not None:
        columns.append(locate_columns(log, (phase,), {}, option="--phase ")[phase])
        require_degrees(log, columns[-1], "stage angles")
    index = log.names.index(TIME) if TIME in log.names else None
    numbers = read_columns(log, columns if index is None else [*columns, index], index)
    readings = numbers.columns[: len(channels)]
    for name, column in zip((*channels, str(phase)), numbers.columns[: len(columns)], strict=False):
        finite = np.isfinite(column)
        if not finite.any():
            raise InputError(f"column {name!r} has no value in any row: is {name} connected?", file=log.name)
        largest = max(np.max(column, initial=0.0, where=finite), -np.min(column, initial=0.0, where=finite))
        if name in channels and largest > _LARGEST:
            raise InputError(f"column {name!r} has a reading of {largest:.3g}, which is no measurement", file=log.name)
    time = np.arange(float(len(numbers))) if index is None else numbers.columns[-1]
    record = stage_record(
        channels, estimated_angle(time, readings) if phase is None else numbers.columns[len(channels)], readings
    )
    for line in record.stuck:
        say(line)
    angle = record.angle[record.whole]
    if len(angle) and (not online or np.ptp(angle) < STANDSTILL):
        require_turns(angle)
    demodulation = demodulate(channels, record.angle, readings, record.whole)
    timed = np.flatnonzero(np.isfinite(time))
    seconds = float(time[timed[-1]] - time[timed[0]]) if index is not None and len(timed) else 0.0
    turns, missing = float(angle[-1] - angle[0]), len(numbers) - len(angle)
    return PairLog(record, demodulation, turns, len(angle), missing, seconds if seconds > 0.0 else None)
