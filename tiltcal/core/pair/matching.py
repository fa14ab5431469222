"""Matching a pair offline: p and q from the components of a record, in closed form, with their uncertainty.

Where p or q drift during the record, one value of each describes no part of it well, and that is said.

A rotation may have breaks, after which the encoder may have lost its zero, and the electronics their offsets. An angle
that is off for all channels alike multiplies all components by one and the same matrix, so neither p nor q depends on
how well the spans between the breaks are brought to one phase.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, hypot, pi

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import COARSE_BLOCKS, Demodulation, demodulate
from tiltcal.core.pair.model import FEWEST_TURNS, Pair, sum_weights
from tiltcal.core.pair.stage import StageRecord, stage_record
from tiltcal.errors import EstimateError

STAGES = ("before", "after_p", "after_pq")
SUM = "sum"
TOO_FEW = f"at least {FEWEST_TURNS:g} are needed before it can stop"

_WEAKEST = 0.1  # amplitude over the first accelerometer's below which nothing can be trimmed with a channel
_LEAST_ANGLE = 0.1  # sine of the phase between first and orthogonal
_SMALLEST = 1e-140  # amplitude below which squares are lost in double precision
_CLEAREST = 5.0  # standard uncertainties that the common acceleration must have
_DRIFTS = 5.0  # standard uncertainties (8 dof) beyond which a drift counts; chance: one record in a thousand


@dataclass(frozen=True)
class Component:
    """The component of one channel at the spin frequency, in its unit, with standard uncertainties."""

    sin: float
    cos: float
    u_sin: float = 0.0
    u_cos: float = 0.0

    @property
    def amplitude(self) -> float:
        """The amplitude of sine and cosine together."""
        return hypot(self.sin, self.cos)

    @property
    def u_amplitude(self) -> float:
        """The amplitude that noise alone is to be expected to give."""
        return hypot(self.u_sin, self.u_cos)


@dataclass(frozen=True)
class PairCoefficients:
    """p and q, pure numbers, with their standard uncertainties (k = 1)."""

    p: float
    q: float
    u_p: float
    u_q: float


@dataclass(frozen=True)
class Matching(PairCoefficients):
    """The matching of a pair: p and q, and how far they suppress the common acceleration of a record.

    ``components`` has ``before``, ``after_p`` and ``after_pq``: the three channels, and their sum. After p the second
    channel is divided by 1 - p; after p and q the orthogonal one is added to it.
    """

    pair: Pair
    components: Mapping[str, Mapping[str, Component]]

    @property
    def suppression(self) -> dict[str, float]:
        """Common acceleration in the first channel over that in the sum or its noise, after p, after p and q."""
        common = self.components["before"][self.pair.first].amplitude
        left = {name: self.components[f"after_{name}"][SUM] for name in ("p", "pq")}
        return {name: common / max(of.amplitude, of.u_amplitude, 1e-300) for name, of in left.items()}

    @property
    def gradient_gain(self) -> float:
        """What the matched sum makes of a signal at twice the turning, over what two ideal accelerometers would."""
        before = self.components["before"]
        first, second, orthogonal = (before[channel].amplitude for channel in self.pair.channels)
        weights = sum_weights(self.p, self.q)
        return float((first + weights[1] * second - weights[2] * orthogonal) / (2.0 * first))


def match(record: Demodulation, pair: Pair, coefficients: PairCoefficients | None = None) -> Matching:
    """Match a pair, by :func:`solve` where its coefficients are left out, and return its effect on the record."""
    solved = coefficients or solve(record, pair)
    table: dict[str, dict[str, Component]] = {}
    for stage, p, q in zip(STAGES, (0.0, solved.p, solved.p), (0.0, 0.0, solved.q), strict=True):
        first, *trimmed = zip(pair.channels, sum_weights(p, q).tolist(), strict=True)
        mixes = [[first], trimmed, [(pair.orthogonal, 1.0)], [first, *trimmed]]
        table[stage] = {
            name: _component(record, dict(mix)) for name, mix in zip((*pair.channels, SUM), mixes, strict=True)
        }
    return Matching(solved.p, solved.q, solved.u_p, solved.u_q, pair, table)


def _component(record: Demodulation, weights: Mapping[str, float]) -> Component:
    u = np.sqrt(np.diag(record.covariance(weights)))
    return Component(*record.components(weights).tolist(), *u.tolist())


def solve(record: Demodulation, pair: Pair) -> PairCoefficients:
    """p and q in closed form; an EstimateError where a record cannot determine them, or p is too near to 1."""
    first, second, orthogonal = (record.components({channel: 1.0}) for channel in pair.channels)
    _require_signal(record, pair)
    inverse = np.linalg.inv(np.stack([first, orthogonal], axis=1))
    rest, q = (-inverse @ second).tolist()
    if rest < _WEAKEST:
        what = "is connected" if abs(rest) < _WEAKEST else f"sits opposite {pair.first} with the same polarity"
        raise EstimateError(
            f"p is {1.0 - rest:.4f}, too near to 1 or beyond it: {pair.second} answers with {rest:.3f} of what "
            f"{pair.first} has and cannot be matched to it; see that it {what}"
        )
    # The errors of the three components act as those of their mix in which nothing else is left.
    covariance = record.covariance(dict(zip(pair.channels, (rest, 1.0, q), strict=True)))
    u_p, u_q = np.sqrt(np.diag(inverse @ covariance @ inverse.T)).tolist()
    return PairCoefficients(1.0 - rest, q, u_p, u_q)


def drifts(record: Demodulation, matching: Matching) -> dict[str, float]:
    """Return by how much p and q change from the beginning of a record to its end, those that clearly do."""
    if len(record.scores) < 2 * COARSE_BLOCKS:
        return {}
    pair, weights = matching.pair, (1.0 - matching.p, 1.0, matching.q)
    first, orthogonal = (record.components({name: 1.0}) for name in (pair.first, pair.orthogonal))
    # What is left of each stretch, as what p and q of that stretch differ by.
    left = record.stretches(dict(zip(pair.channels, weights, strict=True)))
    away = left @ np.linalg.inv(np.stack([first, -orthogonal]))
    time = (np.arange(len(away)) + 0.5) / len(away) - 0.5
    slopes = time @ away / (time @ time)
    rest = away - away.mean(axis=0) - np.outer(time, slopes)
    uncertainty = np.sqrt(np.sum(rest**2, axis=0) / (len(away) - 2) / (time @ time))
    clear = zip("pq", slopes.tolist(), uncertainty.tolist(), strict=True)
    return {name: slope for name, slope, u in clear if abs(slope) > _DRIFTS * u}


def _require_signal(record: Demodulation, pair: Pair) -> None:
    first, across = (_component(record, {channel: 1.0}) for channel in (pair.first, pair.orthogonal))
    if first.amplitude < max(_CLEAREST * first.u_amplitude, _SMALLEST):
        raise EstimateError(
            f"{pair.first} has no clear signal at the spin frequency ({first.amplitude:.3g}, uncertain by "
            f"{first.u_amplitude:.2g}): incline the spin axis, and check that the accelerometer is connected"
        )
    if across.amplitude < _WEAKEST * first.amplitude:
        raise EstimateError(
            f"{pair.orthogonal} has {across.amplitude:.3g} at the spin frequency where {pair.first} has "
            f"{first.amplitude:.3g}: it cannot correct a misalignment; is it connected?"
        )
    turned = first.sin * across.cos - first.cos * across.sin
    if abs(turned) < _LEAST_ANGLE * first.amplitude * across.amplitude:
        raise EstimateError(
            f"{pair.orthogonal} is not orthogonal to {pair.first}: their phases are less than 6° apart or opposite; "
            "name the accelerometer a quarter turn away"
        )


# A rotation with breaks


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


def rotation_of(channels: Sequence[str], rows: Array) -> MatchedRotation:
    """Return what rows of seconds, degrees and readings give, (n, 2 + channels), with a row of NaN at a break."""
    kept, turned, counted, left_out = list[StageRecord](), 0, np.zeros(2), 0
    for part in split_at_breaks(rows):
        span = stage_record(channels, part[:, 1], part[:, 2:].T)
        follows = span.whole[1:] & span.whole[:-1]
        turns_and_seconds = np.array([np.diff(column)[follows].sum() for column in (span.angle, part[:, 0])])
        turned += turns_and_seconds[0]
        if turns_and_seconds[0] < FEWEST_TURNS:
            left_out += len(part)
            continue
        kept.append(span)
        counted += turns_and_seconds
        left_out += int(np.count_nonzero(~span.whole[np.argmax(span.whole) :]))
    if not kept:
        raise EstimateError(f"the stage has made {int(turned)} whole turns; {TOO_FEW}")
    whole = np.concatenate([span.whole for span in kept])
    angle, readings = (kept[0].angle, kept[0].readings) if len(kept) == 1 else _at_one_phase(channels, kept)
    turns, seconds = counted.tolist()
    stuck = tuple(line for span in kept for line in span.stuck)
    return MatchedRotation(
        demodulate(channels, angle, readings, whole), turns, seconds, int(whole.sum()), left_out, stuck
    )


def split_at_breaks(rows: Array) -> list[Array]:
    """Return the rows between breaks."""
    broken = np.isnan(rows[:, 0])
    parts = [part[~np.isnan(part[:, 0])] for part in np.split(rows, np.flatnonzero(broken))]
    return [part for part in parts if len(part)]


def _at_one_phase(channels: Sequence[str], spans: Sequence[StageRecord]) -> tuple[Array, Array]:
    """Return angles and readings of all spans, at the phase of the first, without offsets and drifts."""
    signal, end = None, 0.0
    angles, readings = [], []
    for span in spans:
        coefficients = demodulate(channels, span.angle, span.readings, span.whole).coefficients
        components = coefficients[0] + 1j * coefficients[1]
        signal = components if signal is None else signal
        # S sin (θ + φ) + C cos (θ + φ) has the components S + iC times exp iφ.
        off = float(np.angle(np.sum(components * np.conj(signal)))) / (2.0 * pi)
        angles.append(span.angle + off + ceil(end - off - float(np.nanmin(span.angle))))
        end = float(np.nanmax(angles[-1]))
        place = np.arange(len(span.angle)) / len(span.angle) - 0.5
        readings.append(span.readings - coefficients[-2][:, None] - np.outer(coefficients[-1], place))
    return np.concatenate(angles), np.concatenate(readings, axis=1)
