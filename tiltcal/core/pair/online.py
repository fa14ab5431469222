"""Matching a pair online: the two loops of the source, and a recursive estimator that needs fewer turns.

The loops demodulate the matched sum over the last turn and trim p until its component in phase with the first
accelerometer is gone, then q as well until the component in quadrature is. The first accelerometer itself is the
reference, so the zero of the stage angle does not matter.

The recursive estimator keeps the sums of products of all rows, older ones with less weight (least squares with
exponential forgetting), and solves for p and q in closed form once a turn.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, sqrt

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import regress
from tiltcal.core.pair.matching import solve
from tiltcal.core.pair.model import Pair, sum_weights
from tiltcal.core.pair.sectors import (
    DRIFT,
    HARMONICS,
    ONE,
    READINGS,
    SECTORS,
    Notice,
    Sector,
    SectorStream,
    moved,
)
from tiltcal.errors import EstimateError

MEMORY = 100.0
"""Turns after which a row counts 1/e."""
_SETTLED = 1e-3
"""In-phase residual, relative, below which the loop of p lets the loop of q begin."""
_SECTORS_TO_SETTLE = 20 * SECTORS
"""Sectors after which it begins anyway: noise may not let the residual be that small."""
_LOST = 1e-2
"""Residual, relative, above which a loop that had settled runs with its full gains again."""
_CALM = 7.0
"""Time constants with full gains after a loop has settled, in which the last of the error goes."""
_LOOP_MEMORY = 30.0
"""Most turns over which a loop that has settled averages; with more it would lag behind p and q that change."""
_DRIFT_MEMORY = 16 * SECTORS
"""Sectors over which the drift of the readings is averaged."""
_FARTHEST = 0.9
_LEAST_QUADRATURE = 0.1
_PROPORTIONAL, _INTEGRAL = 0.1, 0.9
"""Full gains of a loop, from error to correction, time in turns; the derivative has none."""
_STEP = 1.0 / SECTORS


class Controller:
    """A PID controller in its velocity form: what it gives is added to what it controls, once a sector."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._settled = 0.0

    def __call__(self, error: float) -> float:
        """Return the correction for one more error.

        Once the error is small the gains fall with one over the time since, so that the correction averages over all of
        it (H. Robbins, S. Monro, *A stochastic approximation method*, 1951), down to the loop's memory.
        """
        if abs(error) > _LOST:
            self._settled = 0.0
        elif self._settled or abs(error) < _SETTLED:
            self._settled += _STEP
        averaged = min(_INTEGRAL * self._settled - _CALM, _INTEGRAL * _LOOP_MEMORY - 1.0)
        correction = _INTEGRAL * _STEP * error
        if self._last is not None:
            correction += _PROPORTIONAL * (error - self._last)
        self._last = error
        return 1.0 / (1.0 + max(averaged, 0.0)) * correction

    def forget(self) -> None:
        """Drop the last error; called after a gap."""
        self._last = None


class TrimmingLoops:
    """The two loops of the source, on the channels of a stream: p first, then q.

    Attributes
    ----------
    in_phase, quadrature : float
        Components of the matched sum over the last turn, relative to the first accelerometer.

    Notes
    -----
    A single turn hardly separates a drift from a sine. The drift is averaged over many turns, and what
    it leaves is demodulated.
    """

    def __init__(self, pair: Pair, channels: Sequence[str]) -> None:
        self.p = self.q = 0.0
        self.in_phase = self.quadrature = float("nan")
        self._trims = Controller(), Controller()
        self._where = [READINGS + channels.index(channel) for channel in pair.channels]
        self._pair = pair
        self._turn: deque[tuple[Array, int, Array]] = deque(maxlen=SECTORS)
        self._slopes = np.zeros(3)
        self._settled: deque[bool] = deque(maxlen=SECTORS)
        self._sectors = 0
        self._trims_q = False

    def update(self, sector: Sector) -> None:
        """Go on by one sector.

        Raises
        ------
        EstimateError
            Nothing can be trimmed with these channels; p and q stay as they are.
        """
        if not sector.follows:
            self._turn.clear()
            for trim in self._trims:
                trim.forget()
        table = sector.products[:READINGS]
        readings = table[:, self._where]
        self._turn.append((np.hstack([table[:, :READINGS], readings]), sector.end, sum_weights(self.p, self.q)))
        if len(self._turn) == SECTORS:
            self._trim(sector.end)

    def _trim(self, end: int) -> None:
        solved = self._demodulated(end)
        total, first, orthogonal = (complex(sin, cos) for sin, cos in solved[:2, [0, 1, 3]].T)
        if abs(first) < 1e-300:
            raise EstimateError(f"{self._pair.first} has no signal at the spin frequency")
        quadrature = (orthogonal / first).imag
        if abs(quadrature) < _LEAST_QUADRATURE:
            raise EstimateError(f"{self._pair.orthogonal} has no signal in quadrature to {self._pair.first}")
        self.in_phase, self.quadrature = (total / first).real, (total / first).imag
        self._settled.append(abs(self.in_phase) < _SETTLED)
        rest = 1.0 - self.p
        p = self.p + rest * self._trims[0](self.in_phase)
        if not -_FARTHEST / (1.0 - _FARTHEST) < p < _FARTHEST:
            raise EstimateError(f"p runs to {p:.2f}: {self._pair.second} cannot be matched to {self._pair.first}")
        self.p = p
        self._trims_q |= (len(self._settled) == SECTORS and all(self._settled)) or self._sectors > _SECTORS_TO_SETTLE
        if self._trims_q:
            self.q -= rest / quadrature * self._trims[1](self.quadrature)

    def _demodulated(self, end: int) -> Array:
        """Coefficients of the trimmed sum and the three channels over the last turn, less their drift."""
        tables = moved(np.stack([table for table, _, _ in self._turn]), end - np.array([of for _, of, _ in self._turn]))
        whole = tables.sum(axis=0)
        columns, readings = whole[:, :READINGS], whole[:, READINGS:]
        line = np.linalg.solve(columns, readings)[[ONE, DRIFT]]
        now = sum_weights(self.p, self.q)
        # What the trimmed hardware would have put out, with p and q as they were in each sector; a change of them steps
        # the signal and not the offset that the readings may have.
        changes = np.stack([weights for _, _, weights in self._turn]) - now
        trimmed = readings @ now + np.einsum(
            "sij,sj->i", tables[..., READINGS:] - tables[..., [ONE, DRIFT]] @ line, changes
        )
        self._sectors += 1
        self._slopes = self._slopes + (line[1] - self._slopes) / min(self._sectors, _DRIFT_MEMORY)
        drifts = np.outer(columns[:, DRIFT], [self._slopes @ now, *self._slopes])
        against = np.column_stack([trimmed, readings]) - drifts
        return np.linalg.solve(columns[:DRIFT, :DRIFT], against[:DRIFT])


class Recursive:
    """Recursive least squares with exponential forgetting, on the channels of a stream."""

    def __init__(self, pair: Pair, channels: Sequence[str]) -> None:
        self.p = self.q = 0.0
        self._white = (float("inf"), float("inf"))
        self._pair = pair
        self._channels = tuple(channels)
        self._fade = exp(-1.0 / (SECTORS * MEMORY))
        self._products: Array | None = None
        self._end = 0
        self._sectors = 0
        self._squared_weights = 0.0
        self._turn: Array | None = None
        self._turns: deque[tuple[Array, int]] = deque(maxlen=round(2 * MEMORY))
        self._refusal: EstimateError | None = None

    def uncertainty(self) -> tuple[float, float]:
        """Return the standard uncertainties of p and q; infinite before the first estimate."""
        colour = sqrt(self._colour())
        return self._white[0] * colour, self._white[1] * colour

    def update(self, sector: Sector) -> None:
        """Go on by one sector, and solve for p and q at the end of a turn.

        Raises
        ------
        EstimateError
            At the end of the last turn the sums did not determine p and q, which stay as they were.
        """
        rows = float(sector.products[ONE, ONE])
        if self._products is None:
            self._products = sector.products.copy()
        else:
            self._products = self._fade * moved(self._products, sector.end - self._end) + sector.products
        self._squared_weights = self._fade**2 * self._squared_weights + rows
        self._remember(sector)
        self._end = sector.end
        self._sectors += 1
        if self._sectors % SECTORS == 0:
            self._refusal = None
            try:
                self.solve()
            except EstimateError as refusal:
                self._refusal = refusal
        if self._refusal is not None:
            raise self._refusal

    def solve(self) -> None:
        """Solve for p and q with all sectors so far, of which there must be those of a turn.

        Raises
        ------
        EstimateError
            The sums do not determine p and q, which stay as they were.
        """
        products = np.zeros((1, 0, 0)) if self._products is None else self._products[None]
        found = solve(regress(products, self._channels, HARMONICS), self._pair)
        # Faded rows carry less of the mean than whole ones would, and have less noise in it too.
        fading = sqrt(self._squared_weights / float(products[0, ONE, ONE]))
        self.p, self.q = found.p, found.q
        self._white = found.u_p * fading, found.u_q * fading

    def _remember(self, sector: Sector) -> None:
        """Keep the products of the latest turns: how they scatter shows how much noise there is at the turning."""
        before = self._turn
        self._turn = sector.products if before is None else moved(before, sector.end - self._end) + sector.products
        if self._sectors % SECTORS == SECTORS - 1:
            self._turns.append((self._turn, sector.end))
            self._turn = None

    def _colour(self) -> float:
        """Noise power at the turning over that of all frequencies."""
        if len(self._turns) < 2:
            return 1.0
        blocks = np.stack([products for products, _ in self._turns])
        recent = regress(
            moved(blocks, self._end - np.array([end for _, end in self._turns])), self._channels, HARMONICS
        )
        return recent.colour(recent.mix(dict(zip(self._pair.channels, (1.0 - self.p, 1.0, self.q), strict=True))))


@dataclass(frozen=True)
class OnlineHistory:
    """The estimates of p and q after each number of turns."""

    turns: float
    loops: tuple[float, float]
    recursive: tuple[float, float]


class Online:
    """Both estimators on one stream of some channels.

    Attributes
    ----------
    course : list of OnlineHistory
        One entry for each turn.
    refused : str
        Why the last sector could not be used by the estimators; empty where it could.
    """

    def __init__(self, pair: Pair, channels: Sequence[str]) -> None:
        self.stream = SectorStream(len(channels))
        self.loops = TrimmingLoops(pair, channels)
        self.recursive = Recursive(pair, channels)
        self.course: list[OnlineHistory] = []
        self.refused = ""
        self._sectors = 0

    def push(self, theta: Array, readings: Array) -> list[Notice]:
        """Take samples, one or many, and return where the estimators were held, and went on.

        Parameters
        ----------
        theta : ndarray, shape (n,)
            Degrees; NaN where it is missing.
        readings : ndarray, shape (n, channels)
            NaN where a value is missing.
        """
        notices = []
        for item in self.stream.push(theta, readings):
            if isinstance(item, Notice):
                notices.append(item)
            else:
                notices += self._update(item)
        return notices

    def _update(self, sector: Sector) -> list[Notice]:
        why = ""
        for estimator in (self.loops, self.recursive):
            try:
                estimator.update(sector)
            except EstimateError as refusal:
                why = str(refusal)
        self._sectors += 1
        if self._sectors % SECTORS == 0:
            turns = self._sectors / SECTORS
            self.course.append(OnlineHistory(turns, (self.loops.p, self.loops.q), (self.recursive.p, self.recursive.q)))
        changed, self.refused = why != self.refused, why
        return [Notice(sector.end, why)] if changed else []
