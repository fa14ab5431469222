"""Matching a pair offline: p and q from the components of a record, in closed form, with their uncertainty.

Where p or q drift during the record, one value of each describes no part of it well, and that is said.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import COARSE_BLOCKS, Demodulation
from tiltcal.core.pair.model import Pair, sum_weights
from tiltcal.errors import EstimateError

STAGES = ("before", "after_p", "after_pq")
SUM = "sum"

_WEAKEST = 0.1
"""Amplitude over that of the pair's first accelerometer below which nothing can be trimmed with a channel."""
_LEAST_ANGLE = 0.1
"""Sine of the phase between first and orthogonal."""
_SMALLEST = 1e-140
"""Amplitude below which squares are lost in double precision."""
_CLEAREST = 5.0
"""How many standard uncertainties the common acceleration must have."""
_DRIFTS = 5.0
"""Drift over its standard uncertainty, of eight degrees of freedom, that chance makes once in a thousand records."""


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
class Matching:
    """The matching of a pair: p and q, and how far they suppress the common acceleration of a record.

    ``components`` has ``before``, ``after_p`` and ``after_pq``: the three channels, and their sum. After p the second
    channel is divided by 1 - p; after p and q the orthogonal one is added to it.
    """

    pair: Pair
    p: float
    q: float
    u_p: float
    u_q: float
    components: Mapping[str, Mapping[str, Component]]

    @property
    def suppression(self) -> dict[str, float]:
        """Common acceleration in the first channel over that in the sum, after p, and after p and q.

        Where less is left than noise alone would leave, it is the noise that counts.
        """
        common = self.components["before"][self.pair.first].amplitude
        left = {name: self.components[f"after_{name}"][SUM] for name in ("p", "pq")}
        return {
            name: common / max(component.amplitude, component.u_amplitude, 1e-300) for name, component in left.items()
        }

    @property
    def gradient_gain(self) -> float:
        """What the matched sum makes of a signal at twice the turning, over what two ideal accelerometers would.

        The orthogonal channel reads a gradient with the opposite sign, so its share takes from it.
        """
        before = self.components["before"]
        first, second, orthogonal = (before[channel].amplitude for channel in self.pair.channels)
        weights = sum_weights(self.p, self.q)
        return float((first + weights[1] * second - weights[2] * orthogonal) / (2.0 * first))


def match(demodulation: Demodulation, pair: Pair, coefficients: PairCoefficients | None = None) -> Matching:
    """Match a pair, by :func:`solve` where its coefficients are left out, and return its effect on the record."""
    solved = coefficients or solve(demodulation, pair)
    components = _components(demodulation.of(pair.channels), pair, solved.p, solved.q)
    return Matching(pair, solved.p, solved.q, solved.u_p, solved.u_q, components)


def solve(demodulation: Demodulation, pair: Pair) -> PairCoefficients:
    """p and q in closed form.

    Raises
    ------
    EstimateError
        The record cannot determine p and q, or p is so near to 1 that nothing is left to divide by.
    """
    record = demodulation.of(pair.channels)
    _require_signal(record, pair)
    first, second, orthogonal = record.coefficients[:2].T
    inverse = np.linalg.inv(np.stack([first, orthogonal], axis=1))
    rest, q = (-inverse @ second).tolist()
    if rest < _WEAKEST:
        raise EstimateError(_near_one(pair, 1.0 - rest))
    # The errors of the three components act as those of their mix in which nothing else is left.
    covariance = record.covariance(np.array([rest, 1.0, q]))
    u_p, u_q = np.sqrt(np.diag(inverse @ covariance @ inverse.T)).tolist()
    return PairCoefficients(1.0 - rest, q, u_p, u_q)


def drifts(demodulation: Demodulation, pair: Pair, coefficients: PairCoefficients) -> dict[str, float]:
    """Return by how much p and q change from the beginning of a record to its end, those that clearly do."""
    if len(demodulation.scores) < 2 * COARSE_BLOCKS:
        return {}
    record = demodulation.of(pair.channels)
    scores, products = record.coarse(np.array([1.0 - coefficients.p, 1.0, coefficients.q]))
    first, _, orthogonal = record.coefficients[:2].T
    # What is left of each stretch, as what p and q of that stretch differ by.
    away = np.linalg.solve(products, scores[..., None])[..., 0] @ np.linalg.inv(np.stack([first, -orthogonal]))
    time = (np.arange(len(away)) + 0.5) / len(away) - 0.5
    slopes = time @ away / (time @ time)
    rest = away - away.mean(axis=0) - np.outer(time, slopes)
    uncertainty = np.sqrt(np.sum(rest**2, axis=0) / (len(away) - 2) / (time @ time))
    clear = zip("pq", slopes.tolist(), uncertainty.tolist(), strict=True)
    return {name: slope for name, slope, u in clear if abs(slope) > _DRIFTS * u}


def _components(record: Demodulation, pair: Pair, p: float, q: float) -> Mapping[str, Mapping[str, Component]]:
    """Return the components of a pair before and after it is matched with some p and q (the source's Table 1)."""
    table = {}
    for stage, trimmed in zip(STAGES, ((0.0, 0.0), (p, 0.0), (p, q)), strict=True):
        weights = sum_weights(*trimmed)
        mixes = [[1.0, 0.0, 0.0], [0.0, *weights[1:]], [0.0, 0.0, 1.0], weights]
        table[stage] = {
            name: _component(record, np.array(mix)) for name, mix in zip((*pair.channels, SUM), mixes, strict=True)
        }
    return table


def _component(record: Demodulation, mix: Array) -> Component:
    sin, cos = record.components(mix).tolist()
    u_sin, u_cos = np.sqrt(np.diag(record.covariance(mix))).tolist()
    return Component(sin, cos, u_sin, u_cos)


def _require_signal(record: Demodulation, pair: Pair) -> None:
    (sine, _, sine_across), (cosine, _, cosine_across) = record.coefficients[:2].tolist()
    signal, across = hypot(sine, cosine), hypot(sine_across, cosine_across)
    noise = sqrt(float(np.trace(record.covariance(np.array([1.0, 0.0, 0.0])))))
    if signal < max(_CLEAREST * noise, _SMALLEST):
        raise EstimateError(
            f"{pair.first} has no clear signal at the spin frequency ({signal:.3g}, uncertain by {noise:.2g}): incline "
            "the spin axis, and check that the accelerometer is connected"
        )
    if across < _WEAKEST * signal:
        raise EstimateError(
            f"{pair.orthogonal} has {across:.3g} at the spin frequency where {pair.first} has {signal:.3g}: it cannot "
            "correct a misalignment; is it connected?"
        )
    if abs(sine * cosine_across - cosine * sine_across) < _LEAST_ANGLE * signal * across:
        raise EstimateError(
            f"{pair.orthogonal} is not orthogonal to {pair.first}: their phases are less than 6° apart or opposite; "
            "name the accelerometer a quarter turn away"
        )


def _near_one(pair: Pair, p: float) -> str:
    what = "is connected" if abs(1.0 - p) < _WEAKEST else f"sits opposite {pair.first} with the same polarity"
    return (
        f"p is {p:.4f}, too near to 1 or beyond it: {pair.second} answers with {1.0 - p:.3f} of what {pair.first} "
        f"has and cannot be matched to it; see that it {what}"
    )
