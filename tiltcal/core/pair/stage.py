"""The stage: its angle followed from row to row, where it stands or turns back, and the rows of a record that count.

A channel that keeps its value while the stage turns on is stuck, not still: a converter that stops, or an input that is
held at its rail, repeats a value that counts heavily. No channel that senses the turning keeps one for a quarter of a
turn, unless its steps are a third of its amplitude. Such values are left out as missing ones are, from the first to the
last.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import floor

import numpy as np

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.model import FEWEST_TURNS
from tiltcal.core.rows import run_bounds
from tiltcal.errors import EstimateError

STANDSTILL = 0.05
"""Turns in a whole record below which the stage does not turn."""

PARTS = 8
"""Of a turn, each of which must have rows."""

BACKWARDS = 0.1875
"""Turns that the angle of a stream may fall behind before the stage runs backwards."""

STANDING = 4.0
"""Times the rows of a typical part after which the stage stands."""

ROUNDING = 1e-6
"""Turns by which an angle may be rounded."""

_BACKLASH = 0.25  # turns that the angle of a record may fall behind its highest, by encoder noise and play
_JUMP = 0.125  # turns back from one row to the next from which on rows are missing
_STUCK = 0.25  # turns over which a value must stay the same to be stuck


def follow(theta: Array, last: float | None = None) -> Array:
    """Return angles in turns that do not wrap, shape (n,), from degrees, wrapped or not, and the turns before them.

    From one to the next it is less than an eighth of a turn back; more is taken for a gap in which the stage went on.
    """
    if not len(theta):
        return np.empty(0)
    angle = theta / 360.0
    steps = np.diff(angle, prepend=float(angle[0] % 1.0) if last is None else last)
    whole = np.rint(steps)
    # No stage is sampled so seldom that it turns back so far at once: rows are missing, and it went on meanwhile.
    whole -= steps - whole < -_JUMP
    # The angle itself and a count of turns: a sum of millions of steps would lose digits.
    return np.asarray(angle - np.cumsum(whole))


def require_turns(angle: Array) -> None:
    """Refuse a record whose stage stands, turns backwards, or turns less than twice; angle in turns, shape (n,)."""
    turns = float(angle[-1] - angle[0])
    highest = np.maximum.accumulate(angle)
    backlash = float(np.max(highest - angle))
    if max(highest[-1] - angle[0], backlash) < STANDSTILL:
        raise EstimateError(
            f"the stage is not turning: its angle changes by {360.0 * turns:.2f}° over {len(angle)} rows; is "
            "this the column of the stage angle, in degrees?"
        )
    if highest[-1] - angle[0] < STANDSTILL:
        raise EstimateError(
            f"the stage angle runs backwards, {-turns:.2f} turns in all: the encoder must count up in the "
            "direction in which the stage turns; swap its two tracks, or log the angle with the other sign"
        )
    if backlash > _BACKLASH:
        raise EstimateError(
            f"the stage angle runs backwards by {360.0 * backlash:.0f}° in the middle of the record: match a "
            "stretch in which the stage turns one way, and check the encoder"
        )
    # Each row stands for one step, the last one too.
    covered = turns * len(angle) / (len(angle) - 1)
    if covered < FEWEST_TURNS - ROUNDING:
        stated = floor(100.0 * covered) / 100.0
        raise EstimateError(f"the record has {stated:.2f} turns of the stage; at least {FEWEST_TURNS:g} are needed")


def turning(angle: Array) -> Mask:
    """Return the rows in which the stage turns on, neither standing nor turned back; angle in turns, shape (n,)."""
    if not len(angle):
        return np.zeros(0, dtype=bool)
    highest = np.maximum.accumulate(angle)
    part = np.unique(np.floor(highest * PARTS), return_inverse=True)[1]
    rows = np.bincount(part)
    beside = np.maximum(np.append(0, rows[:-1]), np.append(rows[1:], 0))
    stands = (rows > STANDING * beside) & (len(rows) > 1)
    return np.asarray((highest - angle <= BACKWARDS) & ~stands[part])


@dataclass(frozen=True)
class StageRecord:
    """The samples of a turning stage: its angle in degrees and in turns that do not wrap, and readings of channels.

    All are of shape (n,), NaN where a value is missing; in ``whole`` rows nothing is missing or stuck.
    """

    channels: tuple[str, ...]
    theta: Array
    angle: Array
    readings: Sequence[Array] | Array
    whole: Mask
    stuck: tuple[str, ...]


def stage_record(channels: Sequence[str], theta: Array, readings: Sequence[Array] | Array) -> StageRecord:
    """Return the record of a stage angle in degrees, shape (n,), and of readings, shape (n,) each."""
    there = np.isfinite(theta)
    angle = np.full(len(theta), np.nan)
    angle[there] = follow(theta[there])
    whole = there.copy()
    for column in readings:
        whole &= np.isfinite(column)
    stuck = []
    for name, column in zip(channels, readings, strict=True):
        for first, end in _stuck(angle, column):
            whole[first:end] = False
            why = f"{name} is stuck at {column[first]:.6g} while the stage turns; left out until it changes"
            stuck.append((first, f"row {first}: {why}"))
    return StageRecord(tuple(channels), theta, angle, readings, whole, tuple(line for _, line in sorted(stuck)))


def _stuck(angle: Array, column: Array) -> Iterator[tuple[int, int]]:
    """Yield the first row of each stuck value, and the row behind its last."""
    starts, ends = run_bounds(np.append(False, column[1:] == column[:-1]))
    if len(starts):
        # Where the angle is missing, it is the last one.
        angle = angle[np.maximum.accumulate(np.where(np.isfinite(angle), np.arange(len(angle)), 0))]
        stuck = np.abs(angle[ends - 1] - angle[starts - 1]) >= _STUCK
        yield from zip((starts[stuck] - 1).tolist(), ends[stuck].tolist(), strict=True)
