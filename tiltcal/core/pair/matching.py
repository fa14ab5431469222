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
    known = coefficients or solve(demodulation, pair)
    components = _components(demodulation, pair, known.p, known.q)
    return Matching(pair, known.p, known.q, known.u_p, known.u_q, components)


def solve(demodulation: Demodulation, pair: Pair) -> PairCoefficients:
    """p and q in closed form.

    Raises
    ------
    EstimateError
        The record cannot determine p and q, or p is so near to 1 that nothing is left to divide by.
    """
    vectors = [demodulation.components(demodulation.mix({channel: 1.0})) for channel in pair.channels]
    _require_signal(demodulation, pair, vectors)
    system = np.stack([vectors[0], vectors[2]], axis=1)
    rest, q = (float(value) for value in np.linalg.solve(system, -vectors[1]))
    if rest < _WEAKEST:
        raise EstimateError(_near_one(pair, 1.0 - rest))
    # The errors of the three components act as those of their mix in which nothing else is left.
    mix = demodulation.mix(dict(zip(pair.channels, (rest, 1.0, q), strict=True)))
    inverse = np.linalg.inv(system)
    u_p, u_q = np.sqrt(np.diag(inverse @ demodulation.covariance(mix) @ inverse.T)).tolist()
    return PairCoefficients(1.0 - rest, q, u_p, u_q)


def drifts(demodulation: Demodulation, pair: Pair, coefficients: PairCoefficients) -> dict[str, float]:
    """Return by how much p and q change from the beginning of a record to its end, those that clearly do."""
    if len(demodulation.scores) < 2 * COARSE_BLOCKS:
        return {}
    weights = dict(zip(pair.channels, (1.0 - coefficients.p, 1.0, coefficients.q), strict=True))
    scores, products = demodulation.coarse(demodulation.mix(weights))
    vectors = [demodulation.components(demodulation.mix({name: 1.0})) for name in (pair.first, pair.orthogonal)]
    # What is left of each stretch, as what p and q of that stretch differ by.
    away = np.linalg.solve(products, scores[..., None])[..., 0] @ np.linalg.inv(np.stack([vectors[0], -vectors[1]]))
    time = (np.arange(len(away)) + 0.5) / len(away) - 0.5
    slopes = time @ away / (time @ time)
    rest = away - away.mean(axis=0) - np.outer(time, slopes)
    uncertainty = np.sqrt(np.sum(rest**2, axis=0) / (len(away) - 2) / (time @ time))
    clear = zip("pq", slopes.tolist(), uncertainty.tolist(), strict=True)
    return {name: slope for name, slope, u in clear if abs(slope) > _DRIFTS * u}


def _components(demodulation: Demodulation, pair: Pair, p: float, q: float) -> Mapping[str, Mapping[str, Component]]:
    """Return the components of a pair before and after it is matched with some p and q (the source's Table 1)."""
    table = {}
    for stage, (trim_p, trim_q) in zip(STAGES, ((0.0, 0.0), (p, 0.0), (p, q)), strict=True):
        weights = sum_weights(trim_p, trim_q)
        trimmed = {pair.second: weights[1], pair.orthogonal: weights[2]}
        mixes = {
            pair.first: {pair.first: 1.0},
            pair.second: trimmed,
            pair.orthogonal: {pair.orthogonal: 1.0},
            SUM: {pair.first: 1.0, **trimmed},
        }
        table[stage] = {name: _component(demodulation, demodulation.mix(mix)) for name, mix in mixes.items()}
    return table


def _component(demodulation: Demodulation, mix: Array) -> Component:
    sin, cos = demodulation.components(mix).tolist()
    u_sin, u_cos = np.sqrt(np.diag(demodulation.covariance(mix))).tolist()
    return Component(sin, cos, u_sin, u_cos)


def _require_signal(demodulation: Demodulation, pair: Pair, vectors: list[Array]) -> None:
    amplitudes = [float(np.hypot(*vector)) for vector in vectors]
    mix = demodulation.mix({pair.first: 1.0})
    noise = sqrt(float(np.trace(demodulation.covariance(mix))))
    if amplitudes[0] < max(_CLEAREST * noise, _SMALLEST):
        raise EstimateError(
            f"{pair.first} has no clear signal at the spin frequency ({amplitudes[0]:.3g}, uncertain by "
            f"{noise:.2g}): incline the spin axis, and check that the accelerometer is connected"
        )
    if amplitudes[2] < _WEAKEST * amplitudes[0]:
        raise EstimateError(
            f"{pair.orthogonal} has {amplitudes[2]:.3g} at the spin frequency where {pair.first} has "
            f"{amplitudes[0]:.3g}: it cannot correct a misalignment; is it connected?"
        )
    sine = float(vectors[0][0] * vectors[2][1] - vectors[0][1] * vectors[2][0]) / (amplitudes[0] * amplitudes[2])
    if abs(sine) < _LEAST_ANGLE:
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
