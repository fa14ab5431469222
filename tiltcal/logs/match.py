"""Matching accelerometer pairs by a recorded log."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np

import tiltcal
from tiltcal.core.pair.demodulate import CHUNK, Demodulation
from tiltcal.core.pair.matching import PairCoefficients, drifts, solve
from tiltcal.core.pair.matching import match as match_demodulated
from tiltcal.core.pair.model import Pair
from tiltcal.core.pair.online import Online, OnlineHistory
from tiltcal.core.pair.record import StageRecord
from tiltcal.errors import EstimateError, InputError, Stopped, UsageError
from tiltcal.files.pair import PairRecord, SpinRecord
from tiltcal.files.results import LogRecord, PairProvenance
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import LogReader, Progress
from tiltcal.logs.pair_log import PairLog, read_pair_log
from tiltcal.logs.streams import imported_meanwhile
from tiltcal.stated_arguments import require_boolean, require_text_or_none


@dataclass(frozen=True)
class MatchedLog:
    """A matching with the data that a figure of it shows: the log, and the course of the first pair's estimates."""

    calibration: PairRecord
    log: PairLog
    course: Sequence[OnlineHistory]


def pairs_of(pairs: Sequence[tuple[str, str, str]]) -> list[Pair]:
    """Return pairs from their columns.

    Raises
    ------
    UsageError
        There is none or more than two, one is there twice, or its columns are not three different ones.
    """
    if not isinstance(pairs, Sequence) or not pairs:
        raise UsageError("name a pair")
    found = []
    for pair in pairs:
        if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 3 or not all(map(_is_text, pair)):
            raise UsageError(f"a pair is three columns, the first, the second and the orthogonal one; not {pair!r}")
        first, second, orthogonal = pair
        if len({first, second, orthogonal}) < 3:
            raise UsageError(
                f"--pair {first},{second} --orthogonal {orthogonal}: these must be three different columns"
            )
        found.append(Pair(first, second, orthogonal))
    if len(found) > 2:
        raise UsageError("at most two pairs can be matched at once: those of one stage")
    if len({pair.name for pair in found}) < len(found):
        raise UsageError(f"--pair {found[0].first},{found[0].second} is given twice")
    return found


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def match_log(
    data: Any,
    pairs: Sequence[Pair],
    *,
    phase: str | None,
    online: bool = False,
    loops: bool = False,
    skip_bad_rows: bool = False,
    say: Callable[[str], None] = lambda line: None,
    progress: Progress | None = None,
) -> MatchedLog:
    """Match pairs, and keep what a figure shows; the arguments are those of :func:`tiltcal.match`.

    Raises
    ------
    Stopped
        Ctrl-C ended a stream before there was a result.
    """
    require_text_or_none("--phase", phase)
    require_boolean("--online", online)
    require_boolean("--loops", loops)
    if loops and not online:
        raise UsageError("--loops needs --online")
    if online and phase is None:
        raise UsageError("--online needs --phase: without an encoder, p and q are matched from the whole record")
    channels = tuple(dict.fromkeys(channel for pair in pairs for channel in pair.channels))
    is_file = isinstance(data, str | Path)
    with (
        open_log(data, skip_bad_rows=skip_bad_rows, digest=is_file, live=online, progress=progress) as log,
        _explained(log, phase),
        imported_meanwhile("scipy.special"),
    ):
        read = read_pair_log(log, channels, phase, say=say, online=online)
        estimators = [Online(pair, channels) for pair in pairs] if online else []
        for line in _pushed(estimators, read.record):
            say(line)
        demodulation = read.demodulation
        if online:
            estimates = [
                _with_rounding(each.coefficients(loops=loops), demodulation, pair)
                for pair, each in zip(pairs, estimators, strict=True)
            ]
        else:
            estimates = [solve(demodulation, pair) for pair in pairs]
        matchings = tuple(match_demodulated(demodulation, *each) for each in zip(pairs, estimates, strict=True))
    if not online:
        for pair, estimate in zip(pairs, estimates, strict=True):
            changes = [f"{name} by {change:.2g}" for name, change in drifts(demodulation, pair, estimate).items()]
            if changes:
                say(
                    f"{pair.first} and {pair.second} drift, {' and '.join(changes)} over the record, and the result is "
                    "the mean; match shorter parts of it, or find with --online what it is at the end"
                )
    rows = read.rows + read.missing
    if read.missing:
        say(f"{read.missing} of {rows} rows have a missing value and are left out")
    provenance = PairProvenance(
        made_by="match of a recorded log",
        software=f"tiltcal {tiltcal.__version__}",
        log=LogRecord(name=Path(log.name).name, sha256=log.sha256, rows=rows, missing=read.missing)
        if is_file
        else None,
        stage_angle=None if phase else "estimated from the readings",
    )
    record = PairRecord(
        spin=SpinRecord(turns=read.turns, frequency=read.frequency, phase=phase),
        online=online,
        matchings=matchings,
        provenance=provenance,
    )
    return MatchedLog(record, read, estimators[0].course if online else ())


def _with_rounding(estimate: PairCoefficients, demodulation: Demodulation, pair: Pair) -> PairCoefficients:
    """Return an online estimate whose uncertainty counts what all turns share by the rounding of the readings."""
    if not demodulation.rounding.any():
        return estimate
    alone = solve(replace(demodulation, residual=np.zeros_like(demodulation.residual)), pair)
    return replace(estimate, u_p=hypot(estimate.u_p, alone.u_p), u_q=hypot(estimate.u_q, alone.u_q))


def _pushed(estimators: Sequence[Online], record: StageRecord) -> Iterator[str]:
    """Push a record to the estimators; yield where they are held and go on, once what holds all pairs."""
    for start in range(0, len(record.theta) if estimators else 0, CHUNK):
        rows = slice(start, start + CHUNK)
        readings = np.stack([column[rows] for column in record.readings])
        notices = [each.push(record.theta[rows], readings, record.whole[rows]) for each in estimators]
        yield from dict.fromkeys(str(notice) for of_pair in notices for notice in of_pair)


@contextmanager
def _explained(log: LogReader, phase: str | None) -> Iterator[None]:
    """Put the log's name in front of why it cannot be matched, and behind it what else to do."""
    try:
        yield
    except (EstimateError, InputError) as refusal:
        why = str(refusal) if isinstance(refusal, InputError) else f"{log.name}: {refusal}"
        if log.interrupted:
            raise Stopped(f"interrupted, and nothing is written: {why}; let the stream run for longer") from None
        if isinstance(refusal, EstimateError):
            steady = "" if phase else "; without --phase the stage must turn at one speed"
            raise EstimateError(why + steady) from refusal
        raise
