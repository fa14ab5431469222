"""The turns of a stage: its angle followed, whole turns cut out of a stream, and where it stands or turns back.

A turn in which the stage stood or turned back, the stream had a gap or values were missing is not handed on: the online
estimators keep what they have, the stream says why, and goes on with the next whole turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import READINGS, moved, summed_products
from tiltcal.core.pair.model import FEWEST_TURNS
from tiltcal.errors import EstimateError

STANDSTILL = 0.05
"""Turns in a whole record below which the stage does not turn."""
_BACKLASH = 0.25
"""Turns that the angle of a record may fall behind its highest, by encoder noise and play."""
_BACKWARDS = 0.1875
"""Turns that the angle of a stream may fall behind before the stage runs backwards."""
_JUMP = 0.125
"""Turns."""
_ROUNDING = 1e-6
_PARTS = 8
"""Of a turn, each of which has rows."""
_STANDING = 4.0
"""Times the rows of a typical part after which the stage stands."""
_COMPLETE = 0.5

STANDS, GAP, BACKWARDS = "the stage stands still", "the stream has a gap", "the stage runs backwards"
COARSE = (
    "from one angle to the next are more than 45°, which is too coarse to be followed: more rows a turn, or a finer "
    "encoder; without --online they will do"
)


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
    if covered < FEWEST_TURNS - _ROUNDING:
        stated = floor(100.0 * covered) / 100.0
        raise EstimateError(f"the record has {stated:.2f} turns of the stage; at least {FEWEST_TURNS:g} are needed")


def turning(angle: Array) -> Mask:
    """Return the rows in which the stage turns on, neither standing nor turned back; angle in turns, shape (n,)."""
    if not len(angle):
        return np.zeros(0, dtype=bool)
    highest = np.maximum.accumulate(angle)
    part = np.unique(np.floor(highest * _PARTS), return_inverse=True)[1]
    rows = np.bincount(part)
    beside = np.maximum(np.append(0, rows[:-1]), np.append(rows[1:], 0))
    stands = (rows > _STANDING * beside) & (len(rows) > 1)
    return np.asarray((highest - angle <= _BACKWARDS) & ~stands[part])


@dataclass(frozen=True)
class Turn:
    """A whole turn: products of the columns of the regression, rows counted from its end; and the row behind it."""

    products: Array
    end: int


@dataclass(frozen=True)
class Notice:
    """The stream is held from a row on, counted from 0, or goes on where ``why`` is empty."""

    row: int
    why: str

    def __str__(self) -> str:
        return f"row {self.row}: held, {self.why}" if self.why else f"row {self.row}: goes on"


class TurnStream:
    """Cuts a stream into whole turns.

    Of its ``rows``, ``left_out`` are those of turns that were not handed on, or with a missing value; ``turns`` were
    handed on, and from the first angle to the last the stage has ``turned``. ``why`` is why the stream is held now.
    """

    def __init__(self, channels: int) -> None:
        self.rows = self.left_out = self.turns = 0
        self.turned = 0.0
        self.why = "the stage has not turned yet"
        self._size = READINGS + channels
        self._pilot: Array | None = None
        self._last: float | None = None
        self._typical = np.inf
        self._restart(-np.inf)

    def _restart(self, highest: float) -> None:
        self._highest, self._start = highest, np.nan
        self._open(-1, 0)

    def _open(self, number: int, row: int) -> None:
        """Begin a turn; number -1 is what the stream has before its first whole one."""
        self._number, self._row, self._used = number, row, 0
        self._products, self._parts = np.zeros((self._size, self._size)), np.zeros(_PARTS, dtype=np.int64)

    def push(self, theta: Array, readings: Array, whole: Mask | None = None) -> list[Turn | Notice]:
        """Take samples, and return the turns that they end, and where the stream is held and goes on.

        Angles, shape (n,), are in degrees, readings of shape (channels, n), both NaN where one is missing. Rows whose
        readings count are ``whole``, those that are finite where it is left out.
        """
        whole = np.asarray(np.isfinite(readings).all(axis=0)) if whole is None else whole
        there = np.flatnonzero(np.isfinite(theta))
        angle = follow(theta[there], self._last)
        if len(angle):
            self.turned += float(angle[-1]) - (float(angle[0]) if self._last is None else self._last)
            self._last = float(angle[-1])
        events: list[Turn | Notice] = []
        start = 0
        while start < len(there):
            start += self._forwards(angle[start:], there[start:], readings, whole, events)
        self.rows += len(theta)
        if self._number >= 0 and self._parts.max() > _STANDING * self._typical:
            self._hold(self._row, STANDS, events)
        return events

    def _forwards(
        self, angle: Array, place: NDArray[np.intp], readings: Array, whole: Mask, events: list[Turn | Notice]
    ) -> int:
        """Go on to the end, or to where the stage runs backwards; return the number of rows."""
        highest = np.maximum.accumulate(np.maximum(angle, self._highest))
        behind = np.flatnonzero(highest - angle > _BACKWARDS)
        end = int(behind[0]) if len(behind) else len(angle)
        if np.isnan(self._start):
            self._start = ceil(_PARTS * float(angle[0]) - _ROUNDING) / _PARTS
        turned = highest[:end] - self._start
        number = np.floor(turned).astype(np.int64)
        for a, b in pairwise([0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), end] if end else []):
            if int(number[a]) != self._number:
                row = self.rows + int(place[a])
                if self._number >= 0:
                    self._close(row, events)
                self._open(int(number[a]), row)
            if self._number >= 0:
                self._parts += np.bincount((turned[a:b] * _PARTS).astype(np.int64) % _PARTS, minlength=_PARTS)
                self._add(angle[a:b], place[a:b], readings, whole)
        self._highest = float(highest[-1])
        if len(behind):
            self._hold(self.rows + int(place[end]), BACKWARDS, events)
            self.left_out += int(self._parts.sum())
            self._restart(float(angle[end]))
        return end

    def _add(self, angle: Array, place: NDArray[np.intp], readings: Array, whole: Mask) -> None:
        good = whole[place]
        angle, place = angle[good], place[good]
        if not len(place):
            return
        values = readings[:, place]
        self._pilot = values[:, :1] if self._pilot is None else self._pilot
        row = (self.rows + place - self._row).astype(np.float64)
        ((_, products),) = summed_products(np.zeros(len(place)), angle, row, values - self._pilot)
        self._products += products
        self._used += len(place)

    def _close(self, end: int, events: list[Turn | Notice]) -> None:
        """Hand the turn on, or say why not."""
        rows, visited = int(self._parts.sum()), int(np.count_nonzero(self._parts))
        why = ""
        if visited < _PARTS:
            why = COARSE if 1 < visited > 0.75 * rows else GAP
        elif self._parts.max() > _STANDING * max(float(np.median(self._parts)), 1.0):
            why = STANDS
        elif self._used < _COMPLETE * rows:
            why = "values are missing"
        if why:
            self._hold(self._row, why, events)
            self.left_out += rows
            return
        if self.why and self.turns:
            events.append(Notice(self._row, ""))
        self.why = ""
        self.turns += 1
        self.left_out += rows - self._used
        self._typical = max(float(np.median(self._parts)), 1.0)
        events.append(Turn(moved(self._products, end - self._row), end))

    def _hold(self, row: int, why: str, events: list[Turn | Notice]) -> None:
        if why != self.why:
            events.append(Notice(row, why))
        self.why = why
