"""Matching a pair online: the two loops of the source, and a recursive estimator that needs fewer turns.

Both are fed once a turn. The loops demodulate the turn and trim p until the matched sum's component in phase with the
first accelerometer is gone, then q as well until the component in quadrature is. The first accelerometer itself is the
reference, so the zero of the stage angle does not matter. The recursive estimator keeps the sums of products of all
rows, older ones with less weight (least squares with exponential forgetting), and solves for p and q in closed form.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, hypot, inf, sqrt

import numpy as np

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import DRIFT, ONE, READINGS, moved, regress
from tiltcal.core.pair.matching import PairCoefficients, solve
from tiltcal.core.pair.model import FEWEST_TURNS, Pair, sum_weights
from tiltcal.core.pair.turns import Notice, Turn, TurnStream
from tiltcal.errors import EstimateError

MEMORY = 100.0
"""Turns after which a row counts 1/e."""
_SETTLED = 1e-3
"""In-phase residual, relative, below which the loop of p lets the loop of q begin."""
_TURNS_TO_SETTLE = 20
"""Turns after which it begins anyway: noise may not let the residual be that small."""
_LOST = 1e-2
"""Residual, relative, above which a loop runs with its full gain again."""
_FULL, _LEAST = 0.9, 0.03
"""Gains of a loop: at first, and when it has averaged for long."""
_CALM = 8
"""Turns with full gain, in which the error goes."""
_FARTHEST = 0.9
_LEAST_QUADRATURE = 0.1
_FIRST_HARMONICS = [0, 1, 2, 3, ONE, DRIFT]
_LATE = 200
"""Turns whose scatter is the uncertainty of a loop."""
_GROUPS = 10


class TrimmingLoop:
    """An integral controller that averages once it has settled (Robbins and Monro, 1951): ``value`` is trimmed."""

    def __init__(self) -> None:
        self.value, self._squares = 0.0, 1.0
        self._latest: deque[float] = deque([inf], maxlen=4)
        self.restart()

    def restart(self) -> None:
        """Run with full gain again."""
        self._turns = 0
        self._each: deque[float] = deque(maxlen=_LATE)

    def trim(self, residual: float, correction: float) -> None:
        """Go on by one turn, whose own estimate differs by ``correction``; ``residual`` is its relative error."""
        if abs(residual) > _LOST:
            self.restart()
        self._turns += 1
        self._latest.append(correction)
        if self._turns > _CALM // 2:
            self._each.append(self.value + correction)
        gain = max(1.0 / (1.0 / _FULL + max(self._turns - _CALM, 0)), _LEAST)
        self.value += gain * correction
        self._squares = (1.0 - gain) ** 2 * self._squares + gain**2

    def uncertainty(self) -> float:
        """Return the standard uncertainty: the scatter of single turns, or of longer stretches, as they are averaged.

        Before it has settled, the latest corrections; infinite before the first.
        """
        count = len(self._each)
        if count < 6:
            return max(abs(correction) for correction in self._latest)
        each = np.array(self._each)
        variance, dof = float(each.var(ddof=1)), count - 1
        if count >= 4 * _GROUPS:
            size = count // _GROUPS
            slow = size * float(each[-size * _GROUPS :].reshape(_GROUPS, size).mean(axis=1).var(ddof=1))
            # Chance makes that of ten groups twice as large once in thirty records.
            variance, dof = (slow, _GROUPS - 1) if slow > 2.0 * variance else (variance, dof)
        return sqrt(self._squares * variance * dof / (dof - 2.0))


class TrimmingLoops:
    """The two loops of the source, on the channels of a stream: p first, then q."""

    def __init__(self, pair: Pair, channels: Sequence[str]) -> None:
        self._pair, self._p, self._q = pair, TrimmingLoop(), TrimmingLoop()
        self._where = [READINGS + channels.index(channel) for channel in pair.channels]
        self._turns = self._settled = 0
        self._trims_q = False

    @property
    def p(self) -> float:
        return self._p.value

    @property
    def q(self) -> float:
        return self._q.value

    def coefficients(self) -> PairCoefficients:
        """p and q as they are trimmed now; the uncertainties are infinite before the first turn that trims them."""
        return PairCoefficients(self.p, self.q, self._p.uncertainty(), self._q.uncertainty())

    def update(self, turn: Turn) -> None:
        """Go on by one turn.

        Raises
        ------
        EstimateError
            Nothing can be trimmed with these channels; p and q stay as they are.
        """
        columns, against = (turn.products[np.ix_(_FIRST_HARMONICS, to)] for to in (_FIRST_HARMONICS, self._where))
        sines, cosines = np.linalg.lstsq(columns, against, rcond=None)[0][:2]
        total, first, orthogonal = ((sines + 1j * cosines) @ mix for mix in (sum_weights(self.p, self.q), *_ENDS))
        if abs(first) < 1e-300:
            raise EstimateError(f"{self._pair.first} has no signal at the spin frequency")
        residual, quadrature = total / first, (orthogonal / first).imag
        if abs(quadrature) < _LEAST_QUADRATURE:
            raise EstimateError(f"{self._pair.orthogonal} has no signal in quadrature to {self._pair.first}")
        rest = 1.0 - self.p
        p = self.p + rest * residual.real
        if not -_FARTHEST / (1.0 - _FARTHEST) < p < _FARTHEST:
            raise EstimateError(f"p runs to {p:.2f}: {self._pair.second} cannot be matched to {self._pair.first}")
        self._p.trim(float(residual.real), float(rest * residual.real))
        self._turns += 1
        self._settled = self._settled + 1 if abs(residual.real) < _SETTLED else 0
        if not self._trims_q and (self._settled > 1 or self._turns > _TURNS_TO_SETTLE):
            self._trims_q = True
            self._p.restart()  # what q was off has been part of its residual
        if self._trims_q:
            self._q.trim(float(residual.imag), float(-rest / quadrature * residual.imag))


_ENDS = np.eye(3)[[0, 2]]
"""The first and the orthogonal accelerometer alone."""


class Recursive:
    """Recursive least squares with exponential forgetting, on the channels of a stream."""

    def __init__(self, pair: Pair, channels: Sequence[str]) -> None:
        self.p = self.q = 0.0
        self._white = (inf, inf)
        self._pair, self._channels = pair, tuple(channels)
        self._fade = exp(-1.0 / MEMORY)
        self._products: Array | None = None
        self._squared_weights = 0.0
        self._latest: deque[Turn] = deque(maxlen=round(2 * MEMORY))

    def coefficients(self) -> PairCoefficients:
        """p and q as they are now; the uncertainties are infinite before the first estimate."""
        if not self._latest:
            return PairCoefficients(0.0, 0.0, inf, inf)
        # How the latest turns scatter shows how much noise there is at the turning.
        since = self._latest[-1].end - np.array([turn.end for turn in self._latest])
        recent = regress(moved(np.stack([turn.products for turn in self._latest]), since), self._channels)
        mix = recent.mix(dict(zip(self._pair.channels, (1.0 - self.p, 1.0, self.q), strict=True)))
        colour = sqrt(recent.colour(mix))
        return PairCoefficients(self.p, self.q, self._white[0] * colour, self._white[1] * colour)

    def update(self, turn: Turn) -> None:
        """Go on by one turn, and solve for p and q.

        Raises
        ------
        EstimateError
            The sums do not determine p and q, which stay as they were.
        """
        products, rows = turn.products, float(turn.products[ONE, ONE])
        if self._products is not None:
            products = self._fade * moved(self._products, turn.end - self._latest[-1].end) + products
        self._products = products
        self._squared_weights = self._fade**2 * self._squared_weights + rows
        self._latest.append(turn)
        solved = solve(regress(products[None], self._channels), self._pair)
        # Faded rows carry less of the mean than whole ones would, and have less noise in it too.
        fading = sqrt(self._squared_weights / float(products[ONE, ONE]))
        self.p, self.q, self._white = solved.p, solved.q, (solved.u_p * fading, solved.u_q * fading)


@dataclass(frozen=True)
class OnlineHistory:
    """The estimates of p and q after each number of turns."""

    turns: float
    loops: tuple[float, float]
    recursive: tuple[float, float]


class Online:
    """Both estimators of a pair; the course of each turn, and why the last one was refused, empty where it was not."""

    def __init__(self, pair: Pair, channels: Sequence[str]) -> None:
        self.stream = TurnStream(len(channels))
        self.loops, self.recursive = TrimmingLoops(pair, channels), Recursive(pair, channels)
        self.course: list[OnlineHistory] = []
        self.refused = ""

    def push(self, theta: Array, readings: Array, whole: Mask | None = None) -> list[Notice]:
        """Take samples as :meth:`TurnStream.push` does; return where the estimators were held, and went on."""
        notices: list[Notice] = []
        for item in self.stream.push(theta, readings, whole):
            if isinstance(item, Notice):
                notices.append(item)
                continue
            why = ""
            for estimator in (self.loops, self.recursive):
                try:
                    estimator.update(item)
                except EstimateError as refusal:
                    why = str(refusal)
            estimates = ((one.p, one.q) for one in (self.loops, self.recursive))
            self.course.append(OnlineHistory(len(self.course) + 1.0, *estimates))
            if why != self.refused:
                notices.append(Notice(item.end, why))
            self.refused = why
        return notices

    def coefficients(self, *, loops: bool) -> PairCoefficients:
        """Return what an estimator ended with: the source's two loops, or the recursive one.

        Raises
        ------
        EstimateError
            It was held for so long that it has no estimate.
        """
        turns = self.stream.turns
        if turns < FEWEST_TURNS:
            why = self.stream.why or "the record is too short"
            raise EstimateError(f"the online estimators had {turns} whole turns and need {FEWEST_TURNS:g}: {why}")
        if self.refused:
            raise EstimateError(self.refused)
        ended = (self.loops if loops else self.recursive).coefficients()
        if not hypot(ended.u_p, ended.u_q) < inf:
            raise EstimateError(f"the loops have not settled in {turns} turns: let the stage turn for longer")
        return ended
