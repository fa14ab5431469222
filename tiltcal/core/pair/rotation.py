"""A rotation with breaks: the spans between them brought to one phase, and its pairs matched.

After a break the encoder may have lost its zero, and the electronics their offsets. An angle that is off for all
channels alike multiplies all components by one and the same matrix, so neither p nor q of any pair depends on how well
that is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi

import numpy as np

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulation, demodulate
from tiltcal.core.pair.matching import Matching, match
from tiltcal.core.pair.model import FEWEST_TURNS, Pair
from tiltcal.core.pair.stage import stage_record, turning
from tiltcal.errors import EstimateError

TOO_FEW = f"at least {FEWEST_TURNS:g} are needed before it can stop"


@dataclass(frozen=True)
class MatchedRotation:
    """All samples in which the stage turns, demodulated; ``left_out`` are the others since it began to turn."""

    demodulation: Demodulation
    turns: float
    seconds: float
    samples: int
    left_out: int
    stuck: tuple[str, ...]

    @property
    def frequency(self) -> float | None:
        """The frequency of the spin, Hz; None where no time passes."""
        return self.turns / self.seconds if self.seconds > 0.0 else None

    def matched(self, pairs: Sequence[Pair]) -> tuple[tuple[Matching, ...], tuple[str, ...]]:
        """Return the pairs that can be matched, and why others cannot be; an EstimateError where not one can."""
        matchings, unmatched = [], []
        for pair in pairs:
            try:
                matchings.append(match(self.demodulation, pair))
            except EstimateError as refusal:
                unmatched.append(f"{pair.first} and {pair.second}: {refusal}")
        if not matchings:
            raise EstimateError("; ".join(unmatched))
        return tuple(matchings), tuple(unmatched)


@dataclass(frozen=True)
class _Span:
    """The samples between two breaks: angles in turns, readings of shape (channels, n), which of them count."""

    angle: Array
    readings: Array
    counts: Mask
    turns: float
    seconds: float
    stuck: tuple[str, ...]


def rotation_of(channels: Sequence[str], rows: Array) -> MatchedRotation:
    """Return what the samples of a stage give: rows of seconds, angle in degrees and readings, shape (n, 2 + channels).

    A row of NaN is a break; a span of too few turns to show its phase is left out.

    EstimateError: the stage has not turned enough.
    """
    spans = [_span(channels, part) for part in split_at_breaks(rows)]
    kept = [span for span in spans if span.turns >= FEWEST_TURNS]
    if not kept:
        raise EstimateError(f"the stage has made {int(sum(span.turns for span in spans))} whole turns; {TOO_FEW}")
    lost = sum(len(span.counts) for span in spans if span.turns < FEWEST_TURNS)
    counts = np.concatenate([span.counts for span in kept])
    angle, readings = (kept[0].angle, kept[0].readings) if len(kept) == 1 else _at_one_phase(channels, kept)
    return MatchedRotation(
        demodulate(channels, angle, readings, counts),
        sum(span.turns for span in kept),
        sum(span.seconds for span in kept),
        int(counts.sum()),
        lost + sum(int(np.count_nonzero(~span.counts[np.argmax(span.counts) :])) for span in kept),
        tuple(line for span in kept for line in span.stuck),
    )


def split_at_breaks(rows: Array) -> list[Array]:
    """Return the rows between breaks."""
    broken = np.isnan(rows[:, 0])
    parts = [part[~np.isnan(part[:, 0])] for part in np.split(rows, np.flatnonzero(broken))]
    return [part for part in parts if len(part)]


def _span(channels: Sequence[str], rows: Array) -> _Span:
    """Return a span of sample rows, shape (n, 2 + channels)."""
    record = stage_record(channels, rows[:, 1], rows[:, 2:].T)
    counts = record.whole.copy()
    counts[counts] = turning(record.angle[counts])
    follows = counts[1:] & counts[:-1]
    turns, seconds = (float(np.diff(column)[follows].sum()) for column in (record.angle, rows[:, 0]))
    return _Span(record.angle, rows[:, 2:].T, counts, turns, seconds, record.stuck)


def _at_one_phase(channels: Sequence[str], spans: Sequence[_Span]) -> tuple[Array, Array]:
    """Return angles and readings of all spans, at the phase of the first, without offsets and drifts."""
    signal, end = None, 0.0
    angles, readings = [], []
    for span in spans:
        coefficients = demodulate(channels, span.angle, span.readings, span.counts).coefficients
        components = coefficients[0] + 1j * coefficients[1]
        signal = components if signal is None else signal
        # S sin (θ + φ) + C cos (θ + φ) has the components S + iC times exp iφ.
        off = float(np.angle(np.sum(components * np.conj(signal)))) / (2.0 * pi)
        angles.append(span.angle + off + ceil(end - off - float(np.nanmin(span.angle))))
        end = float(np.nanmax(angles[-1]))
        place = np.arange(len(span.angle)) / len(span.angle) - 0.5
        readings.append(span.readings - coefficients[-2][:, None] - np.outer(coefficients[-1], place))
    return np.concatenate(angles), np.concatenate(readings, axis=1)
