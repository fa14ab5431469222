"""The samples of a turning stage, kept as they come.

While they come, the recursive estimators show p and q turn by turn; what the stage's standing or turning back, a gap or
missing values make useless is held from them. The result is that of ``match`` on all samples in which the stage turns
on.

An interruption begins a new span: the encoder may have lost its zero meanwhile, and the electronics their offsets.
The spans are brought to one phase when they are used as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil, inf, pi

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulation, demodulate
from tiltcal.core.pair.matching import PairCoefficients, solve
from tiltcal.core.pair.model import FEWEST_TURNS, Pair
from tiltcal.core.pair.online import Recursive
from tiltcal.core.pair.record import stage_record
from tiltcal.core.pair.turns import STANDSTILL, Notice, TurnStream, turning
from tiltcal.errors import EstimateError

TOO_FEW = f"at least {FEWEST_TURNS:g} are needed before it can stop"
_SHOWN = 2.25
"""Turns after which a whole one must have been among them."""


_Arrays = tuple[NDArray[np.int64], Array, Array]
"""Times, angles, and readings of shape (n, channels)."""


@dataclass
class SampleBlock:
    """Samples that came one after the other: times in ns since the session began, stage angles in degrees, readings."""

    times: list[int] = field(default_factory=list)
    theta: list[float] = field(default_factory=list)
    readings: list[list[float]] = field(default_factory=list)


@dataclass(frozen=True)
class WholeRotation:
    """All samples that count, demodulated.

    Attributes
    ----------
    turns, seconds, samples : float, float, int
        Those that count.
    left_out : int
        Samples that do not, since the stage began to turn.
    stuck : tuple of str
        Channels whose values are stuck, and from which sample on.
    """

    demodulation: Demodulation
    turns: float
    seconds: float
    samples: int
    left_out: int
    stuck: tuple[str, ...]


class RotationSamples:
    """The samples of a turning stage so far.

    Parameters
    ----------
    channels : sequence of str
        Of the readings, in their order.

    Attributes
    ----------
    unknown : dict of str to str
        Why the recursive estimators cannot go on with pairs, by their names.
    """

    def __init__(self, pairs: Sequence[Pair], channels: Sequence[str]) -> None:
        self.unknown: dict[str, str] = {}
        self._pairs, self._channels = tuple(pairs), tuple(channels)
        self._spans: list[list[_Arrays]] = []
        self._kept = self._lost = 0
        self._begin()

    def _begin(self) -> None:
        self._now: list[_Arrays] = []
        self._stream = TurnStream(len(self._channels))
        self._online = {pair: Recursive(pair, self._channels) for pair in self._pairs}

    @property
    def turns(self) -> int:
        """The whole turns that count."""
        return self._kept + self._stream.turns

    @property
    def left_out(self) -> int:
        """Samples that the recursive estimators were not given since the stage began to turn."""
        return self._lost + self._stream.left_out

    @property
    def holds(self) -> str:
        """The reason why samples are held now; empty where they count, or before the stage turns."""
        return self._stream.why if self._stream.turns else ""

    @property
    def idle(self) -> str:
        """The reason why waiting is of no use; empty where samples count since the start or the last interruption."""
        turned = self._stream.turned
        if self._stream.turns or STANDSTILL <= turned < _SHOWN:
            return ""
        if turned >= _SHOWN:
            return f"the stage turns, but no sample can be used: {self._stream.why}"
        if turned <= -STANDSTILL:
            return "the stage turns backwards: its angle is to count up; swap the tracks of the encoder"
        return "the stage does not turn: start it, and check that the encoder counts"

    def take(self, block: SampleBlock) -> list[str]:
        """Take a block; return why samples are held from here on, in order, empty where they go on."""
        if not block.times:
            return []
        times, theta, readings = np.array(block.times), np.array(block.theta), np.array(block.readings)
        self._now.append((times, theta, readings))
        remarks = []
        for item in self._stream.push(theta, readings.T):
            if isinstance(item, Notice):
                remarks.append(item.why)
                continue
            for pair, estimator in self._online.items():
                self.unknown.pop(pair.name, None)
                try:
                    estimator.update(item)
                except EstimateError as refusal:
                    self.unknown[pair.name] = str(refusal)
        return remarks

    def interrupt(self) -> int:
        """Begin a new span, and keep the one so far where it has turns enough to show its phase.

        Returns
        -------
        int
            Samples that are not kept.
        """
        lost = 0
        if self._stream.turns < FEWEST_TURNS:
            lost = sum(len(times) for times, _, _ in self._now)
        else:
            self._spans.append(self._now)
            self._kept += self._stream.turns
        self._lost += lost or self._stream.left_out
        self._begin()
        return lost

    def online(self) -> dict[str, PairCoefficients]:
        """Return p and q so far, by the name of the pair; pairs without an estimate are left out."""
        estimates = {pair.name: estimator.coefficients() for pair, estimator in self._online.items()}
        return {name: estimate for name, estimate in estimates.items() if max(estimate.u_p, estimate.u_q) < inf}

    def known_to(self, uncertainty: float) -> bool:
        """Return whether p and q of every pair are known with this standard uncertainty.

        The recursive estimators propose it, unless they had to begin anew; the regression has to agree, by how the
        turns scatter and by the noise within them.
        """
        online = self.online().values()
        proposed = len(online) == len(self._pairs) and all(_within(estimate, uncertainty) for estimate in online)
        if not proposed and not self._spans:
            return False
        try:
            whole = self.whole().demodulation
            # A few turns scatter less than their noise allows by chance, so the noise has to agree as well.
            white = replace(whole, scores=whole.scores[:0], weights=whole.weights[:0])
            return all(
                _within(solve(components, pair), uncertainty) for components in (whole, white) for pair in self._pairs
            )
        except EstimateError:
            return False

    def whole(self) -> WholeRotation:
        """Demodulate all spans that count as one.

        Raises
        ------
        EstimateError
            Too little to determine anything.
        """
        spans = [_Span.of(self._channels, blocks) for blocks in self._spans]
        if self._stream.turns >= FEWEST_TURNS:
            spans.append(_Span.of(self._channels, self._now))
        if not spans:
            raise EstimateError(f"the stage has made {self.turns} whole turns; {TOO_FEW}")
        if len(spans) > 1:
            signal, end = None, 0.0
            for place, span in enumerate(spans):
                spans[place], signal = span.brought(self._channels, signal, end)
                end = float(np.nanmax(spans[place].angle))
        angle = np.concatenate([span.angle for span in spans])
        readings = np.concatenate([span.readings for span in spans], axis=1)
        counts = np.concatenate([span.counts for span in spans])
        return WholeRotation(
            demodulate(self._channels, angle, readings, counts),
            sum(span.turns for span in spans),
            sum(span.seconds for span in spans),
            int(counts.sum()),
            self._lost + sum(span.left_out for span in spans),
            tuple(line for span in spans for line in span.stuck),
        )


@dataclass(frozen=True)
class _Span:
    """The samples between two interruptions: angles in turns, readings of shape (channels, n), which of them count."""

    angle: Array
    readings: Array
    counts: Mask
    turns: float
    seconds: float
    left_out: int
    stuck: tuple[str, ...]

    @classmethod
    def of(cls, channels: Sequence[str], blocks: Sequence[_Arrays]) -> _Span:
        times, theta, readings = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        record = stage_record(channels, theta, readings.T)
        counts = record.whole.copy()
        counts[counts] = turning(record.angle[counts])
        follows = counts[1:] & counts[:-1]
        return cls(
            record.angle,
            readings.T,
            counts,
            float(np.diff(record.angle)[follows].sum()),
            float(np.diff(times)[follows].sum()) / 1e9,
            int(np.count_nonzero(~counts[np.argmax(counts) :])),
            record.stuck,
        )

    def brought(self, channels: Sequence[str], signal: Array | None, end: float) -> tuple[_Span, Array]:
        """Return this span at the phase of a signal, its own where that is None, and behind so many turns.

        An angle that is off for all channels alike multiplies all components by one and the same matrix, so neither p
        nor q of any pair depends on how well that is known. Its offsets and drifts are taken out.
        """
        demodulation = demodulate(channels, self.angle, self.readings, self.counts)
        mine = demodulation.coefficients[0] + 1j * demodulation.coefficients[1]
        signal = mine if signal is None else signal
        # S sin (θ + φ) + C cos (θ + φ) has the components S + iC times exp iφ.
        off = float(np.angle(np.sum(mine * np.conj(signal)))) / (2.0 * pi)
        off += ceil(end - off - float(np.nanmin(self.angle)))
        line = np.outer(demodulation.coefficients[-1], np.arange(len(self.angle)) / len(self.angle) - 0.5)
        levelled = self.readings - line - demodulation.coefficients[-2][:, None]
        return replace(self, angle=self.angle + off, readings=levelled), signal


def _within(estimate: PairCoefficients, uncertainty: float) -> bool:
    return max(estimate.u_p, estimate.u_q) <= uncertainty
