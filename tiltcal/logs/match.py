"""Matching accelerometer pairs by a recorded log.

The log of a turning stage is read to its end, as one record, and demodulated; its spectra are those of the source.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import ceil, hypot, log2
from pathlib import Path
from typing import Any

import numpy as np

import tiltcal
from tiltcal.column_names import TIME
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import CHUNK, Demodulation, demodulate
from tiltcal.core.pair.matching import Matching, PairCoefficients, drifts, match, solve
from tiltcal.core.pair.model import Pair, matched_sum
from tiltcal.core.pair.online import Online
from tiltcal.core.pair.stage import StageRecord, estimated_angle, stage_record
from tiltcal.errors import Argument, EstimateError, InputError, Stopped, UsageError
from tiltcal.files.pair import PairRecord, SpinRecord
from tiltcal.files.results import LogRecord, PairProvenance
from tiltcal.logs.columns import locate_columns, read_columns, require_units
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import LogReader, Progress
from tiltcal.stated_arguments import require_boolean, require_text_or_none
from tiltcal.units import DEGREE

Course = Sequence[tuple[float, float, float, float]]  # the estimates of a pair turn by turn, as a figure shows them
_TURNS_OF_SEGMENT, _LONGEST_SEGMENT = 8, 1 << 18  # turns and, at the most, rows of a segment of the spectra


@dataclass(frozen=True)
class PairLog:
    """A log of pairs, demodulated: so many ``turns`` of the stage in ``rows``, others being left out (``missing``).

    ``frequency`` is that of the spin, Hz, and ``rate`` that of the rows; both per row where there is no time (``timed``
    is False).
    """

    record: StageRecord
    demodulation: Demodulation
    turns: float
    rows: int
    missing: int
    frequency: float
    rate: float
    timed: bool

    def densities(self, matching: Matching) -> tuple[Array, dict[str, Array]]:
        """Return frequencies, and the densities of the source's figure 6 by Welch's method; unit²/Hz.

        An EstimateError where the record is shorter than a segment.
        """
        segment = 1 << ceil(log2(max(_TURNS_OF_SEGMENT * self.rows / self.turns, 64)))
        segment = min(segment, _LONGEST_SEGMENT)
        if self.rows < segment:
            raise EstimateError(f"the record is too short for a spectrum; {2 * _TURNS_OF_SEGMENT} turns will do")
        from scipy.signal import welch

        pair, whole = matching.pair, self.record.whole
        first, second, orthogonal = (self.record.readings[self.record.channels.index(name)] for name in pair.channels)
        alone, densities = first[whole], {}
        frequency, densities[pair.first] = welch(alone, self.rate, nperseg=segment)
        for name, q in (("sum after p", 0.0), ("sum after p and q", matching.q)):
            matched = matched_sum(alone, second[whole], orthogonal[whole], matching.p, q)
            densities[name] = welch(matched, self.rate, nperseg=segment)[1]
        return frequency, densities


def pairs_of(pairs: Sequence[tuple[str, str, str]]) -> list[Pair]:
    """Return pairs from their columns; a UsageError where these make no pairs of one stage."""
    wanted = []
    for pair in pairs if isinstance(pairs, Sequence) else ():
        if isinstance(pair, str) or not isinstance(pair, Sequence) or [type(name) for name in pair] != [str] * 3:
            raise UsageError(f"a pair is three columns, the first, the second and the orthogonal one; not {pair!r}")
        if len(set(pair)) < 3:
            raise UsageError(
                f"{pair[0]} and {pair[1]} with the orthogonal {pair[2]}: a pair is of three different columns"
            )
        wanted.append(Pair(*pair))
    if len({pair.name for pair in wanted}) != len(wanted) or len(wanted) not in (1, 2):
        raise UsageError("name a pair, or the two different pairs of one stage")
    return wanted


def match_log(
    data: Any,
    pairs: Sequence[Pair],
    *,
    phase: str | None,
    online: bool,
    loops: bool,
    skip_bad_rows: bool,
    say: Callable[[str], None],
    progress: Progress | None = None,
) -> tuple[PairRecord, PairLog, Course]:
    """Match pairs, and keep what a figure shows; the arguments are those of :func:`tiltcal.match`.

    Returned are the matching, the log, and the course of the first pair's estimates.
    """
    require_text_or_none("phase", phase)
    require_boolean("online", online)
    require_boolean("loops", loops)
    if loops and not online:
        raise UsageError(option="loops", why=("needs ", Argument("online")))
    if online and phase is None:
        raise UsageError(
            option="online",
            why=("needs ", Argument("phase"), ": without an encoder, p and q are matched from the whole record"),
            advice=("name the column of the stage angle, or record the log and leave ", Argument("online"), " out"),
        )
    channels = tuple(dict.fromkeys(channel for pair in pairs for channel in pair.channels))
    with open_log(data, skip_bad_rows=skip_bad_rows, live=online, progress=progress) as log, _explained(log, phase):
        read = read_pair_log(log, channels, phase, say=say)
        whole, course = read.demodulation, list[tuple[float, float, float, float]]()
        if online:
            estimators = _estimators(pairs, read.record, say)
            estimates = [
                _with_rounding(estimator.coefficients(loops=loops), whole, pair)
                for estimator, pair in zip(estimators, pairs, strict=True)
            ]
            course = estimators[0].course
        else:
            estimates = [solve(whole, pair) for pair in pairs]
        matchings = tuple(match(whole, pair, estimate) for pair, estimate in zip(pairs, estimates, strict=True))
    for matching in () if online else matchings:
        if changes := drifts(whole, matching):
            clear = " and ".join(f"{name} by {change:.2g}" for name, change in changes.items())
            say(
                f"{matching.pair.first} and {matching.pair.second} drift, {clear} over the record, and the result is "
                "the mean; match shorter parts of it, or find with --online what it is at the end"
            )
    rows = read.rows + read.missing
    if read.missing:
        say(f"{read.missing} of {rows} rows are left out: a value is missing, or the stage does not turn on")
    name = Path(log.name).name
    provenance = PairProvenance(
        made_by="match of a recorded log",
        software=f"tiltcal {tiltcal.__version__}",
        log=LogRecord(name=name, sha256=sha, rows=rows, missing=read.missing) if (sha := log.sha256) else None,
        stage_angle=None if phase else "estimated from the readings",
    )
    spin = SpinRecord(turns=read.turns, frequency=read.frequency if read.timed else None, phase=phase)
    return PairRecord(spin=spin, online=online, matchings=matchings, provenance=provenance), read, course


def _estimators(pairs: Sequence[Pair], record: StageRecord, say: Callable[[str], None]) -> list[Online]:
    """Return the estimators of each pair at the end of a record; say where they are held, once what holds all."""
    estimators = [Online(pair, record.channels) for pair in pairs]
    for start in range(0, len(record.theta), CHUNK):
        rows = slice(start, start + CHUNK)
        readings = np.stack([column[rows] for column in record.readings])
        notices = [each.push(record.theta[rows], readings, record.whole[rows]) for each in estimators]
        for line in dict.fromkeys(str(notice) for of_pair in notices for notice in of_pair):
            say(line)
    return estimators


def _with_rounding(estimate: PairCoefficients, demodulation: Demodulation, pair: Pair) -> PairCoefficients:
    """Return an online estimate whose uncertainty counts what all turns share by the rounding of the readings."""
    if not demodulation.rounding.any():
        return estimate
    alone = solve(replace(demodulation, residual=np.zeros_like(demodulation.residual)), pair)
    return replace(estimate, u_p=hypot(estimate.u_p, alone.u_p), u_q=hypot(estimate.u_q, alone.u_q))


def read_pair_log(
    log: LogReader, channels: Sequence[str], phase: str | None, *, say: Callable[[str], None] = lambda line: None
) -> PairLog:
    """Read a log to its end, and demodulate its readings; say which channel is stuck, and from which row on.

    ``phase`` is the column of the stage angle in degrees; without an encoder the spin is estimated, from the column
    ``time`` or, without one, from the number of the row.
    """
    located = locate_columns(log, channels, {}, option="pairs")
    where = {channel: located[channel] for channel in channels}
    if phase is not None:
        where[phase] = locate_columns(log, (phase,), {}, option="phase")[phase]
        require_units(log, {phase: where[phase]}, {phase: DEGREE}, "stage angles")
    timed = TIME in log.names
    numbers = read_columns(log, where | ({TIME: log.names.index(TIME)} if timed else {}))
    readings = numbers.of(channels)
    for name in where:
        column = numbers.by_role[name]
        if not np.isfinite(column).any():
            raise InputError(f"column {name!r} has no value in any row: is {name} connected?", file=log.name)
    time = numbers.by_role[TIME] if timed else np.arange(float(len(numbers)))
    theta = estimated_angle(time, readings) if phase is None else numbers.by_role[phase]
    record = stage_record(channels, theta, readings)
    for line in record.stuck:
        say(line)
    turns, rows = record.turns, int(np.count_nonzero(record.whole))
    demodulation = demodulate(channels, record.angle, readings, record.whole)
    known = time[np.isfinite(time)]
    if not (timed and len(known) and (extent := float(known[-1] - known[0])) > 0.0):
        timed, extent = False, len(numbers) - 1.0
    rate = (len(numbers) - 1.0) / extent
    return PairLog(record, demodulation, turns, rows, len(numbers) - rows, turns / extent, rate, timed)


@contextmanager
def _explained(log: LogReader, phase: str | None) -> Iterator[None]:
    """Put the log's name in front of why it cannot be matched, and behind it what else to do."""
    try:
        yield
    except (EstimateError, InputError) as refusal:
        why = refusal.words if isinstance(refusal, InputError) else (f"{log.name}: ", *refusal.words)
        if log.source.interrupted:
            after = "; let the stream run for longer"
            raise Stopped(("interrupted, and nothing is written: ", *why, after)) from None
        if isinstance(refusal, EstimateError):
            speed = () if phase else ("; without ", Argument("phase"), " the stage must turn at one speed")
            raise EstimateError((*why, *speed)) from None
        raise
