"""The samples of a turning stage, summed up as they come.

Every sample goes to two estimators. The recursive ones estimate p and q so far; the regression over all that
counts gives the result. What cannot be used (the stage stands or turns back, a gap, missing values) is held from both.

An interruption begins a new span: the encoder may have lost its zero meanwhile, and the electronics their offsets.
The spans are brought to one phase when they are used as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulator
from tiltcal.core.pair.encoder import FEWEST_TURNS, STANDSTILL, AngleTracker
from tiltcal.core.pair.matching import PairCoefficients, solve
from tiltcal.core.pair.model import Pair
from tiltcal.core.pair.online import Recursive
from tiltcal.core.pair.sectors import Notice, Rows, Sector, SectorStream
from tiltcal.errors import EstimateError

TOO_FEW = f"at least {FEWEST_TURNS:g} are needed before it can stop"


@dataclass
class SampleBlock:
    """Samples that came one after the other.

    Attributes
    ----------
    times : list of int
        Nanoseconds since the session began.
    theta : list of float
        Degrees.
    """

    times: list[int] = field(default_factory=list)
    theta: list[float] = field(default_factory=list)
    readings: list[list[float]] = field(default_factory=list)


class SampleSpan:
    """The samples between two interruptions that are used.

    Attributes
    ----------
    turns, seconds : float
        Gaps are not counted.
    """

    def __init__(self, channels: Sequence[str]) -> None:
        self.samples = 0
        self.turns = self.seconds = 0.0
        self.demodulator = Demodulator(channels)
        self._stage = AngleTracker()
        self._last: tuple[float, int] | None = None

    def add(self, theta: Array, readings: Array, times: Rows) -> None:
        """Add samples, all complete; after a call without any, the next samples do not continue the ones before."""
        if not len(theta):
            self._last = None
            return
        angle = self._stage.follow(theta)
        # The drift is one of time, in ms: it goes on while samples are held.
        self.demodulator.add(angle, readings, times // 1_000_000)
        first = self._last or (float(angle[0]), int(times[0]))
        self._last = float(angle[-1]), int(times[-1])
        self.samples += len(theta)
        self.turns += self._last[0] - first[0]
        self.seconds += (self._last[1] - first[1]) / 1e9

    def with_more(self, later: SampleSpan) -> SampleSpan:
        """Return this span and a later one as one; both stay as they are.

        Raises
        ------
        EstimateError
            They determine nothing.
        """
        both, more = deepcopy(self), deepcopy(later)
        both.demodulator.join(more.demodulator)
        both.samples += more.samples
        both.turns += more.turns
        both.seconds += more.seconds
        return both


class RotationSamples:
    """The samples of a turning stage so far, in memory that does not grow with the turns.

    Parameters
    ----------
    channels : sequence of str
        Of the readings, in their order.

    Attributes
    ----------
    left_out : int
        Samples that were held since the stage began to turn.
    unknown : dict of str to str
        Why the recursive estimators cannot go on with pairs, by their names.
    """

    def __init__(self, pairs: Sequence[Pair], channels: Sequence[str]) -> None:
        self.left_out = 0
        self.unknown: dict[str, str] = {}
        self._pairs, self._channels = tuple(pairs), tuple(channels)
        self._stream = SectorStream(len(channels))
        self._before: SampleSpan | None = None
        self._kept = 0.0
        self._begin()

    def _begin(self) -> None:
        self._now, self._seen = SampleSpan(self._channels), AngleTracker()
        self._online = {pair: Recursive(pair, self._channels) for pair in self._pairs}
        self._began = self._stream.turns

    @property
    def turns(self) -> float:
        """The whole turns that count."""
        return self._kept + self._stream.turns - self._began

    @property
    def holds(self) -> str:
        """The reason why samples are held now; empty where they count, or before the stage turns."""
        return self._stream.why if self._stream.turns else ""

    @property
    def idle(self) -> str:
        """The reason why waiting is of no use; empty where samples count since the start or the last interruption."""
        turned = self._seen.turns
        if self._stream.turns > self._began or STANDSTILL <= turned < 1.0:
            return ""
        if turned >= 1.0:
            return f"the stage turns, but no sample can be used: {self._stream.why}"
        if turned <= -STANDSTILL:
            return "the stage turns backwards: its angle is to count up; swap the tracks of the encoder"
        return "the stage does not turn: start it, and check that the encoder counts"

    def take(self, block: SampleBlock) -> list[str]:
        """Take a block.

        Returns
        -------
        list of str
            Why samples are held from here on, in order; empty text where they go on.
        """
        if not block.times:
            return []
        theta, readings, times = np.array(block.theta), np.array(block.readings), np.array(block.times, np.int64)
        self._seen.follow(theta[np.isfinite(theta)])
        remarks = []
        for item in self._stream.push(theta, readings):
            if isinstance(item, Notice):
                remarks.append(item.why)
            else:
                self._update(item)
        used = np.isfinite(theta) & np.isfinite(readings).all(axis=1) & (not self._stream.why)
        self._now.add(theta[used], readings[used], times[used])
        self.left_out += int(np.count_nonzero(~used)) if self._stream.turns else 0
        return remarks

    def interrupt(self) -> int:
        """Begin a new span: after an interruption the zero of the angle and the offsets may be others.

        What was collected since the last time is kept where it has turns enough to show its phase.

        Returns
        -------
        int
            Samples that are not kept.
        """
        whole, lost = self._whole(), 0
        if whole is self._before:
            lost = self._now.samples
        else:
            self._kept += self._stream.turns - self._began
        self.left_out += lost
        self._before = whole
        self._begin()
        return lost

    def online(self) -> dict[str, PairCoefficients]:
        """Return p and q so far, by the name of the pair; pairs without an estimate are left out."""
        found = {
            pair.name: PairCoefficients(estimator.p, estimator.q, *estimator.uncertainty())
            for pair, estimator in self._online.items()
        }
        return {
            name: coefficients
            for name, coefficients in found.items()
            if isfinite(coefficients.u_p) and isfinite(coefficients.u_q)
        }

    def known_to(self, uncertainty: float) -> bool:
        """Return whether p and q of every pair are known with this standard uncertainty.

        The recursive estimators propose it, unless they had to begin anew; the regression has to agree, by how the
        turns scatter and by the noise within them.
        """
        online = self.online()
        proposed = len(online) == len(self._pairs) and all(
            _within(coefficients, uncertainty) for coefficients in online.values()
        )
        if not proposed and self._before is None:
            return False
        try:
            whole = self.whole().demodulator.result()
            # A few turns scatter less than their noise allows by chance, so the noise has to agree as well.
            white = replace(whole, scores=whole.scores[:0], weights=whole.weights[:0])
            return all(
                _within(solve(components, pair), uncertainty) for components in (whole, white) for pair in self._pairs
            )
        except EstimateError:
            return False

    def whole(self) -> SampleSpan:
        """Return all spans that count, as one.

        Raises
        ------
        EstimateError
            Too little to determine anything.
        """
        whole = self._whole()
        if whole is None:
            raise EstimateError(f"the stage has made {self.turns:.2f} whole turns; {TOO_FEW}")
        return whole

    def _whole(self) -> SampleSpan | None:
        if self._stream.turns - self._began < FEWEST_TURNS:
            return self._before
        return self._now if self._before is None else self._before.with_more(self._now)

    def _update(self, sector: Sector) -> None:
        for pair, estimator in self._online.items():
            try:
                estimator.update(sector)
            except EstimateError as refusal:
                self.unknown[pair.name] = str(refusal)
            else:
                self.unknown.pop(pair.name, None)


def _within(found: PairCoefficients, uncertainty: float) -> bool:
    return max(found.u_p, found.u_q) <= uncertainty
