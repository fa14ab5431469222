"""The samples of a turning stage, kept as they come.

While they come, the recursive estimators show p and q turn by turn; what the stage's standing or turning back, a gap or
missing values make useless is held from them. The result is that of ``match`` on all samples in which the stage turns.

An interruption begins a new span: the encoder may have lost its zero meanwhile, and the electronics their offsets.
The spans are brought to one phase when they are used as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, pi

import numpy as np

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulation, demodulate
from tiltcal.core.pair.matching import PairCoefficients, solve
from tiltcal.core.pair.model import FEWEST_TURNS, Pair
from tiltcal.core.pair.online import Notice, Recursive, TurnStream
from tiltcal.core.pair.stage import STANDSTILL, stage_record, turning
from tiltcal.errors import EstimateError

TOO_FEW = f"at least {FEWEST_TURNS:g} are needed before it can stop"
_TO_SHOW = 2.25
"""Turns after which a whole one must have been among them."""

SampleRow = list[float]
"""Seconds since the session began, stage angle in degrees, readings."""


@dataclass(frozen=True)
class WholeRotation:
    """All samples that count, demodulated; ``left_out`` are those that do not, since the stage began to turn."""

    demodulation: Demodulation
    turns: float
    seconds: float
    samples: int
    left_out: int
    stuck: tuple[str, ...]


class RotationSamples:
    """The samples of a turning stage so far; ``unknown`` is why estimators cannot go on with pairs, by their names."""

    def __init__(self, pairs: Sequence[Pair], channels: Sequence[str]) -> None:
        self.unknown: dict[str, str] = {}
        self._pairs, self._channels = tuple(pairs), tuple(channels)
        self._spans: list[list[Array]] = []
        self._kept = self._lost = self._held = 0
        self._begin()

    def _begin(self) -> None:
        self._now: list[Array] = []
        self._stream = TurnStream(len(self._channels))
        self._online = {pair: Recursive(pair, self._channels) for pair in self._pairs}

    @property
    def turns(self) -> int:
        """The whole turns that count."""
        return self._kept + self._stream.turns

    @property
    def left_out(self) -> int:
        """Samples that the recursive estimators were not given since the stage began to turn."""
        return self._lost + self._held + self._stream.left_out

    @property
    def holds(self) -> str:
        """The reason why samples are held now; empty where they count, or before the stage turns."""
        return self._stream.why if self._stream.turns else ""

    @property
    def idle(self) -> str:
        """The reason why waiting is of no use; empty where samples count since the start or the last interruption."""
        turned = self._stream.turned
        if self._stream.turns or STANDSTILL <= turned < _TO_SHOW:
            return ""
        if turned >= _TO_SHOW:
            return f"the stage turns, but no sample can be used: {self._stream.why}"
        if turned <= -STANDSTILL:
            return "the stage turns backwards: its angle is to count up; swap the tracks of the encoder"
        return "the stage does not turn: start it, and check that the encoder counts"

    def take(self, block: Sequence[SampleRow]) -> list[str]:
        """Take a block; return why samples are held from here on, in order, empty where they go on."""
        if not block:
            return []
        self._now.append(np.array(block))
        remarks = []
        for item in self._stream.push(self._now[-1][:, 1], self._now[-1][:, 2:].T):
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
        """Begin a new span, and keep the one so far where its turns show its phase; return the samples not kept."""
        lost = 0
        if self._stream.turns < FEWEST_TURNS:
            lost = sum(map(len, self._now))
        else:
            self._spans.append(self._now)
            self._kept += self._stream.turns
            self._held += self._stream.left_out
        self._lost += lost
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
        kept = [*self._spans, self._now] if self._stream.turns >= FEWEST_TURNS else self._spans
        if not kept:
            raise EstimateError(f"the stage has made {self.turns} whole turns; {TOO_FEW}")
        spans = [_span(self._channels, np.concatenate(rows)) for rows in kept]
        angle, readings, counts = (
            (spans[0].angle, spans[0].readings, spans[0].counts) if len(spans) == 1 else _brought(self._channels, spans)
        )
        return WholeRotation(
            demodulate(self._channels, angle, readings, counts),
            sum(span.turns for span in spans),
            sum(span.seconds for span in spans),
            int(counts.sum()),
            self._lost + sum(int(np.count_nonzero(~span.counts[np.argmax(span.counts) :])) for span in spans),
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
    stuck: tuple[str, ...]


def _span(channels: Sequence[str], rows: Array) -> _Span:
    """Return a span of sample rows, shape (n, 2 + channels)."""
    record = stage_record(channels, rows[:, 1], rows[:, 2:].T)
    counts = record.whole.copy()
    counts[counts] = turning(record.angle[counts])
    follows = counts[1:] & counts[:-1]
    turns, seconds = (float(np.diff(column)[follows].sum()) for column in (record.angle, rows[:, 0]))
    return _Span(record.angle, rows[:, 2:].T, counts, turns, seconds, record.stuck)


def _brought(channels: Sequence[str], spans: Sequence[_Span]) -> tuple[Array, Array, Mask]:
    """Return angles, readings and what counts of all spans, at the phase of the first, without offsets and drifts.

    An angle that is off for all channels alike multiplies all components by one and the same matrix, so neither p nor q
    of any pair depends on how well that is known.
    """
    signal, end = None, 0.0
    angles, readings = [], []
    for span in spans:
        coefficients = demodulate(channels, span.angle, span.readings, span.counts).coefficients
        its = coefficients[0] + 1j * coefficients[1]
        signal = its if signal is None else signal
        # S sin (θ + φ) + C cos (θ + φ) has the components S + iC times exp iφ.
        off = float(np.angle(np.sum(its * np.conj(signal)))) / (2.0 * pi)
        angles.append(span.angle + off + ceil(end - off - float(np.nanmin(span.angle))))
        end = float(np.nanmax(angles[-1]))
        place = np.arange(len(span.angle)) / len(span.angle) - 0.5
        readings.append(span.readings - coefficients[-2][:, None] - np.outer(coefficients[-1], place))
    return np.concatenate(angles), np.concatenate(readings, axis=1), np.concatenate([span.counts for span in spans])


def _within(estimate: PairCoefficients, uncertainty: float) -> bool:
    return max(estimate.u_p, estimate.u_q) <= uncertainty
