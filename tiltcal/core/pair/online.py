"""Matching a pair online: a stream cut into whole turns, and two estimators that take one turn after another.

The two loops of the source demodulate the turn and trim p towards the value that takes the matched sum's component in
phase with the first accelerometer away, then q as well, by the component in quadrature. The first accelerometer itself
is the reference, so the zero of the stage angle does not matter. The recursive estimator needs fewer turns: it keeps
the sums of products of all rows, older ones with less weight (least squares with exponential forgetting), and solves
for p and q in closed form.

A turn in which the stage stood or turned back, the stream had a gap or values were missing is not handed on: the
estimators keep what they have, the stream says why, and goes on with the next whole turn.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil, hypot, inf

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import DRIFT, ONE, READINGS, bounds_of, regress, regression_columns
from tiltcal.core.pair.matching import PairCoefficients, solve
from tiltcal.core.pair.model import FEWEST_TURNS, Pair
from tiltcal.core.pair.stage import BACKWARDS, PARTS, ROUNDING, STANDING, follow
from tiltcal.errors import EstimateError

MEMORY = 100.0  # turns after which a row counts 1/e
REMEMBERED = 4.0  # times the memory after which a turn does not count at all
COARSE = (
    "from one angle to the next are more than 45°, which is too coarse to be followed: more rows a turn, or a finer "
    "encoder; without --online they will do"
)

_COMPLETE = 0.5  # fraction of a turn's rows that must have all values
_FIRST_HARMONICS = [0, 1, 2, 3, ONE, DRIFT]
_ALONE = 2  # turns in which p is trimmed alone: a hundredth of its error is left then
_LOST = 1e-2  # error of p or q above which a loop runs with its full gain again
_FULL, _LEAST = 0.9, 0.03  # gains of a loop: at first, and when it has averaged for long
_CALM = 8  # turns with full gain, in which the error goes
_FARTHEST = 0.9  # p at which a loop gives up
_LEAST_QUADRATURE = 0.1  # smallest ratio of the orthogonal amplitude to the first
_FEWEST_ESTIMATES, _LATE = 6, 200  # turns whose scatter is the uncertainty of a loop, at least and at most
_GROUPS = 10  # number of groups of turns whose means show noise slower than a turn


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
    """Cuts a stream into whole turns."""

    def __init__(self, channels: int) -> None:
        self.rows = 0
        self.left_out = 0  # of them, by turns that were not handed on, or with a missing value
        self.turns = 0  # handed on
        self.turned = 0.0  # turns from the first angle to the last
        self.why = "the stage has not turned yet"  # why the stream is held now
        self._notices: list[Notice] = []
        self._last: float | None = None
        self._pilot: Array | None = None
        self._typical = inf  # rows of a part of a turn
        self._start = np.nan
        # The rows of the turn in progress: number of the row, angle in turns, readings (NaN where they do not count).
        self._table = np.empty((2 + channels, 0))

    def push(self, theta: Array, readings: Array, whole: Mask | None = None) -> list[Notice]:
        """Take angles, (n,), degrees, and readings, (channels, n), NaN where missing; return what happened."""
        there = np.flatnonzero(np.isfinite(theta))
        angle = follow(theta[there], self._last)
        if len(angle):
            self.turned += float(angle[-1]) - (float(angle[0]) if self._last is None else self._last)
            self._last = float(angle[-1])
        values = readings if whole is None else np.where(whole, readings, np.nan)
        rows = np.concatenate([(self.rows + there)[None], angle[None], values[:, there]])
        self._table = np.concatenate([self._table, rows], axis=1)
        self.rows += len(theta)
        self._notices = []
        while self._table.shape[1] and self._cut():
            pass
        return self._notices

    def take(self, turn: Turn) -> None:
        """Take a whole turn; a stream by itself counts it."""
        self.turns += 1

    def _cut(self) -> bool:
        """Close the turns that have ended; return whether the stage ran backwards, with rows behind that."""
        angle = self._table[1]
        if np.isnan(self._start):
            self._start = ceil(PARTS * float(angle[0]) - ROUNDING) / PARTS
        highest = np.maximum.accumulate(angle)
        behind = np.flatnonzero(highest - angle > BACKWARDS)
        end = int(behind[0]) if len(behind) else len(angle)
        turned = highest[:end] - self._start
        number, part = np.floor(turned), np.floor(turned * PARTS).astype(np.int64) % PARTS
        *bounds, _ = bounds_of(number)
        for first, last in pairwise(bounds):
            if number[first] >= 0.0:
                self._close(self._table[:, first:last], part[first:last], int(self._table[0, last]))
        begun, begins = bounds[-1], number[bounds[-1]] >= 0.0
        if not len(behind):
            if begins and np.bincount(part[begun:]).max() > STANDING * self._typical:
                self._hold(self._table[0, begun], "the stage stands still")
            self._table = self._table[:, begun:]
            return False
        self.left_out += end - begun if begins else 0
        self._hold(self._table[0, end], "the stage runs backwards")
        self._table, self._start = self._table[:, end:], np.nan
        return True

    def _close(self, table: Array, part: NDArray[np.int64], end: int) -> None:
        """Hand a turn on, whose rows belong to parts of the turn, or say why not."""
        whole = np.asarray(np.isfinite(table).all(axis=0))
        by_part = np.bincount(part, minlength=PARTS)
        count, used, visited = len(whole), int(np.count_nonzero(whole)), int(np.count_nonzero(by_part))
        typical = max(float(np.median(by_part)), 1.0)
        why = ""
        if visited < PARTS:
            why = COARSE if 1 < visited > 0.75 * count else "the stream has a gap"
        elif by_part.max() > STANDING * typical:
            why = "the stage stands still"
        elif used < _COMPLETE * count:
            why = "values are missing"
        self.left_out += count if why else count - used
        if why:
            self._hold(table[0, 0], why)
            return
        if self.why and self.turns:
            self._notices.append(Notice(int(table[0, 0]), ""))
        self.why, self._typical = "", typical
        row, angle, values = table[0, whole], table[1, whole], table[2:, whole]
        # A large offset would take the digits that the noise needs in the sums of squares.
        self._pilot = values[:, :1] if self._pilot is None else self._pilot
        columns = regression_columns(angle, row - end, values - self._pilot)
        self.take(Turn(columns @ columns.T, end))

    def _hold(self, row: float, why: str) -> None:
        if why != self.why:
            self._notices.append(Notice(int(row), why))
        self.why = why


class TrimmingLoops:
    """The two loops of the source, on the channels of a stream: integral controllers that trim p first, then q as well.

    Their gain is full until the error has gone, then falls so that they average (Robbins and Monro, 1951).
    """

    def __init__(self, pair: Pair, channels: Sequence[str]) -> None:
        self._pair, self._p, self._q = pair, 0.0, 0.0
        self._where = [READINGS + channels.index(channel) for channel in pair.channels]
        self._turns = 0
        self._squares = 1.0  # of the weights of single turns
        self._latest = deque([(inf, inf)], maxlen=4)  # corrections of p and q
        self._estimates: deque[tuple[float, float]] = deque(maxlen=_LATE)  # of single turns

    def coefficients(self) -> PairCoefficients:
        """p and q as they are trimmed now, with the scatter of single turns, or of longer stretches, as it is averaged.

        Before they have settled these are the latest corrections; infinite before the first.
        """
        count = len(self._estimates)
        if count < _FEWEST_ESTIMATES:
            return PairCoefficients(self._p, self._q, *np.max(np.abs(self._latest), axis=0).tolist())
        estimates = np.array(self._estimates)
        variance = estimates.var(axis=0, ddof=1) * (count - 1) / (count - 3)
        if count >= 4 * _GROUPS:
            size = count // _GROUPS
            means = estimates[-size * _GROUPS :].reshape(_GROUPS, size, 2).mean(axis=1)
            slow = size * means.var(axis=0, ddof=1)
            # Chance makes that of ten groups twice as large once in thirty records; widened as Student's distribution.
            variance = np.where(slow > 2.0 * variance, slow * (_GROUPS - 1) / (_GROUPS - 3), variance)
        return PairCoefficients(self._p, self._q, *np.sqrt(self._squares * variance).tolist())

    def update(self, turn: Turn) -> None:
        """Go on by one turn; an EstimateError, and p and q as they are, where nothing can be trimmed."""
        columns, against = (turn.products[np.ix_(_FIRST_HARMONICS, to)] for to in (_FIRST_HARMONICS, self._where))
        sines, cosines = np.linalg.lstsq(columns, against, rcond=None)[0][:2]
        phasors = sines + 1j * cosines
        with np.errstate(all="ignore"):  # of a first accelerometer without a signal
            _, second, orthogonal = phasors / phasors[0]
            p, q = 1.0 + float((second + self._q * orthogonal).real), -float(second.imag / orthogonal.imag)
        if not abs(orthogonal.imag) > _LEAST_QUADRATURE:
            raise EstimateError(f"{self._pair.orthogonal} has no signal in quadrature to {self._pair.first}")
        if not -_FARTHEST / (1.0 - _FARTHEST) < p < _FARTHEST:
            raise EstimateError(f"p runs to {p:.2f}: {self._pair.second} cannot be matched to {self._pair.first}")
        self._turns += 1
        by_p, by_q = p - self._p, q - self._q if self._turns > _ALONE else inf
        if _LOST < max(abs(by_p), abs(by_q)) < inf:
            self._turns = _ALONE + 1
            self._estimates.clear()
        gain = max(1.0 / (1.0 / _FULL + max(self._turns - _ALONE - _CALM, 0)), _LEAST)
        self._latest.append((by_p, by_q))
        if self._turns > _ALONE + _CALM // 2:
            self._estimates.append((p, q))
        self._squares = (1.0 - gain) ** 2 * self._squares + gain**2
        self._p += gain * by_p
        self._q += gain * by_q if by_q < inf else 0.0


class Recursive:
    """Least squares with exponential forgetting over the turns of a stream."""

    def __init__(self, pair: Pair, channels: Sequence[str]) -> None:
        self._pair, self._channels = pair, tuple(channels)
        self._turns: deque[Turn] = deque(maxlen=round(REMEMBERED * MEMORY))
        self._solved = PairCoefficients(0.0, 0.0, inf, inf)

    def coefficients(self) -> PairCoefficients:
        """p and q as they are now; the uncertainties are infinite before the first estimate."""
        return self._solved

    def update(self, turn: Turn) -> None:
        """Go on by one turn, and solve for p and q; an EstimateError where they stay as they were."""
        self._turns.append(turn)
        blocks = np.stack([one.products for one in self._turns])
        # Rows are counted from the end of the last turn.
        back = np.array([[turn.end - one.end] for one in self._turns], dtype=float)
        blocks[:, DRIFT] -= back * blocks[:, ONE]
        blocks[:, :, DRIFT] -= back * blocks[:, :, ONE]
        weights = np.exp((np.arange(len(blocks)) + 1.0 - len(blocks)) / MEMORY)[:, None, None]
        faded, whole = (regress(some, self._channels) for some in (weights * blocks, blocks))
        # Faded rows carry less of the mean than whole ones would, and have less noise in it too.
        rows = blocks[:, ONE, ONE]
        fading = float(weights[:, 0, 0] ** 2 @ rows / (weights[:, 0, 0] @ rows))
        # How all of these turns scatter shows how much noise there is at the turning.
        combined = replace(faded, inverse=fading * faded.inverse, scores=whole.scores, weights=whole.weights)
        self._solved = solve(combined, self._pair)


class Online(TurnStream):
    """Both estimators of a pair, at the turns of a stream."""

    def __init__(self, pair: Pair, channels: Sequence[str]) -> None:
        super().__init__(len(channels))
        self.loops, self.recursive = TrimmingLoops(pair, channels), Recursive(pair, channels)
        self.course: list[tuple[float, float, float, float]] = []  # p and q of both after each turn
        self.refused = ""  # why they could not take the last one

    def take(self, turn: Turn) -> None:
        """Go on by a turn, and note where the estimators cannot take it, and where they can again."""
        super().take(turn)
        why = ""
        for estimator in (self.loops, self.recursive):
            try:
                estimator.update(turn)
            except EstimateError as refusal:
                why = str(refusal)
        loops, recursive = self.loops.coefficients(), self.recursive.coefficients()
        self.course.append((loops.p, loops.q, recursive.p, recursive.q))
        if why != self.refused:
            self._notices.append(Notice(turn.end, why))
        self.refused = why

    def coefficients(self, *, loops: bool) -> PairCoefficients:
        """Return what the loops or the recursive estimator ended with; an EstimateError where it has no estimate."""
        if self.turns < FEWEST_TURNS:
            why = self.why or "the record is too short"
            raise EstimateError(f"the online estimators had {self.turns} whole turns and need {FEWEST_TURNS:g}: {why}")
        if self.refused:
            raise EstimateError(self.refused)
        ended = (self.loops if loops else self.recursive).coefficients()
        if not hypot(ended.u_p, ended.u_q) < inf:
            raise EstimateError(f"the loops have not settled in {self.turns} turns: let the stage turn for longer")
        return ended
