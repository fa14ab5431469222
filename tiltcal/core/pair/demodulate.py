"""Demodulation: the components of readings at the stage's turning, by one regression on the stage angle.

Every channel is fitted by the harmonics of the stage angle, an offset and a linear drift, all at once::

    I(θ, row) = sum_h (S_h sin hθ + C_h cos hθ) + offset + drift * row

The scatter between blocks of turns shows how much noise there is at the turning itself, which may be more than the
white noise between the harmonics.

Where the noise does not reach half a step of the readings, rounding is the same error in each turn, which no scatter
between turns shows. Its share at the turning is that of as many independent roundings as a turn has: one for each place
that is sampled, and no more than the sine wave passes steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise, repeat
from math import ceil
from operator import mul

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.samples import common_step, rounding_uncertainty
from tiltcal.errors import EstimateError

HARMONICS = 4
ONE, DRIFT, READINGS = 2 * HARMONICS, 2 * HARMONICS + 1, 2 * HARMONICS + 2  # where they stand among the columns
COARSE_BLOCKS = 10
CHUNK = 1 << 16

_MOST_BLOCKS = 512
_WHITE = 4  # degrees of freedom that count for white noise, whatever the blocks say
_SINGULAR = 1e-9
_SMALLEST = 1e-300  # a sum of squares below this is none
_PLACES = 1e5  # resolution of the angle, in parts of a turn
_SURPRISE = 0.005  # coarse blocks count where chance makes their scatter, for what finer ones say, less often than this


def regression_columns(angle: Array, row: Array, readings: Array) -> Array:
    """Return sin θ, cos θ, sin 2θ, ..., 1, row and readings, (READINGS + channels, n), of angles in turns, (n,)."""
    wave = np.exp(2j * np.pi * (angle - np.floor(angle)))
    powers = accumulate(repeat(wave, HARMONICS), mul)
    waves = np.stack([part for power in powers for part in (power.imag, power.real)])
    return np.concatenate([waves, np.ones((1, len(angle))), row[None, :], readings])


def bounds_of(number: NDArray[np.float64]) -> list[int]:
    """Return where a number, shape (n,), begins to be another one: 0 first, n last."""
    return [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]


@dataclass(frozen=True)
class Demodulation:
    """The regression of all channels on the stage angle; a mix is a weight for each channel.

    ``inverse`` times a variance is the covariance of the coefficients in white noise.
    """

    channels: tuple[str, ...]
    rows: int
    coefficients: Array  # (columns, channels): sin θ, cos θ, ..., offset in the middle, drift over the record, unit
    residual: Array  # (channels, channels): covariance of what is left, unit²
    inverse: Array  # (columns, columns)
    scores: Array  # (blocks, 2, channels): products of sin θ and cos θ with what is left, per block of turns
    weights: Array  # (blocks, 2, 2): and with each other
    rounding: Array  # (channels,): variance of a component by rounding, which all turns share, unit²

    def components(self, weights: Mapping[str, float]) -> Array:
        """sin and cos component of a mix, shape (2,)."""
        return np.asarray(self.coefficients[:2] @ self._mix(weights))

    def covariance(self, weights: Mapping[str, float]) -> Array:
        """Covariance of :meth:`components`, shape (2, 2), unit²: of the noise around the turning, and of rounding."""
        mix = self._mix(weights)
        # A record without noise leaves less than the rounding of its sums, which may be negative.
        variance = max(float(mix @ self.residual @ mix), 0.0)
        noise = variance * self._colour(mix, variance) * self.inverse[:2, :2]
        return np.asarray(noise + mix**2 @ self.rounding * np.eye(2))

    def _colour(self, mix: Array, variance: float) -> float:
        """Noise power at the turning over that of all frequencies, as a standard uncertainty needs it.

        Few turns show it badly. It is pooled with a few degrees of freedom of white noise, and widened as Student's
        distribution is (GUM Supplement 1, 6.4.9.4), so that 1.96 standard uncertainties are 95 %.
        """
        from scipy.special import fdtrc

        if variance <= 0.0 or len(self.scores) < 2:
            return 1.0

        def scatter(scores: Array, inverse: Array) -> tuple[float, int]:
            squares = np.einsum("bi,bij,bj->b", scores, inverse, scores)
            dof = max(2 * len(scores) - 2, 1)
            return float(squares.sum()) / variance / dof, dof

        fine, dof = scatter(self.scores @ mix, self._inverse_weights)
        power, freedom = (_WHITE + dof * fine) / (_WHITE + dof), _WHITE + dof
        if len(self.scores) >= 4 * COARSE_BLOCKS:
            scores, _, inverse = self._coarse
            coarse, coarse_dof = scatter(scores @ mix, inverse)
            if fdtrc(coarse_dof, dof, coarse / power) < _SURPRISE:  # slower than a turn: amplitudes that wander
                power, freedom = coarse, coarse_dof
        return power * freedom / (freedom - 2.0)

    def stretches(self, weights: Mapping[str, float]) -> Array:
        """Components of what is left of a mix in each of :data:`COARSE_BLOCKS` stretches, shape (stretches, 2)."""
        scores, products, _ = self._coarse
        return np.asarray(np.linalg.solve(products, (scores @ self._mix(weights))[..., None])[..., 0])

    def _mix(self, weights: Mapping[str, float]) -> Array:
        return np.array([weights.get(channel, 0.0) for channel in self.channels])

    @cached_property
    def _inverse_weights(self) -> Array:
        return np.asarray(np.linalg.pinv(self.weights))

    @cached_property
    def _coarse(self) -> tuple[Array, Array, Array]:
        """Scores, shape (groups, 2, channels), weights, (groups, 2, 2), and their inverses of groups of blocks."""
        groups = np.array_split(np.arange(len(self.scores)), COARSE_BLOCKS)
        scores, weights = (np.stack([of[group].sum(axis=0) for group in groups]) for of in (self.scores, self.weights))
        return scores, weights, np.linalg.pinv(weights)


def demodulate(channels: Sequence[str], angle: Array, readings: Sequence[Array] | Array, whole: Mask) -> Demodulation:
    """Return the regression over the whole rows of a record, with angles in turns, (n,), and readings, (n,) each."""
    places = np.flatnonzero(whole)
    if not len(places):
        raise EstimateError("no row of the record has an angle and all readings")
    size = ceil(max(float(angle[places[-1]] - angle[places[0]]), 1.0) / (_MOST_BLOCKS - 1))
    beginning = places[:CHUNK]
    values = np.stack([column[beginning] for column in readings])
    # A large offset would take the digits that the noise needs in the sums of squares.
    pilot, step = values.mean(axis=1), common_step(values.T)
    blocks: dict[float, Array] = {}
    for start in range(0, len(places), CHUNK):
        rows = places[start : start + CHUNK]
        values = np.stack([column[rows] for column in readings]) - pilot[:, None]
        table = regression_columns(angle[rows], rows / len(angle) - 0.5, values)
        block = np.maximum.accumulate(np.floor(angle[rows] / size))
        for first, end in pairwise(bounds_of(block)):
            part, number = table[:, first:end], float(block[first])
            blocks[number] = blocks.get(number, 0.0) + part @ part.T
    result = regress(np.stack([blocks[number] for number in sorted(blocks)]), channels)
    result.coefficients[-2] += pilot
    if not step:
        return result
    noise = np.sqrt(np.maximum(np.diag(result.residual), 0.0))
    of_means = np.array([rounding_uncertainty(deviation, step) for deviation in noise.tolist()])
    passed = 4.0 * np.hypot(*result.coefficients[:2]) / step
    # A sine wave passes each step up and down: of places that mirror each other two share one rounding.
    different = len(np.unique(np.round(angle[beginning] % 1.0 * _PLACES)))
    return replace(result, rounding=np.asarray(3.0 * of_means**2 / np.clip(passed, 1.0, different)))


def regress(blocks: Array, channels: Sequence[str]) -> Demodulation:
    """Return the regression from products of shape (blocks, size, size), with fewer harmonics where rows are few."""
    total = blocks.sum(axis=0)
    rows = round(float(total[ONE, ONE]))
    for used in range(HARMONICS, 0, -1):
        kept = [*range(2 * used), ONE, DRIFT]
        inverse = _inverse(total[np.ix_(kept, kept)])
        if inverse is not None and rows > 2 * len(kept):
            break
    else:
        raise EstimateError(
            f"{rows} rows do not determine the components at the turning: the angles must cover the whole turn, with "
            "more rows than that"
        )
    against = total[kept, READINGS:]
    coefficients = inverse @ against
    residual = (total[READINGS:, READINGS:] - coefficients.T @ against) / (rows - len(kept))
    scores, weights = blocks[:, :2, READINGS:] - blocks[:, :2][:, :, kept] @ coefficients, blocks[:, :2, :2]
    if len(blocks) >= 4:
        # The first and the last block, which the record cuts, go with their neighbours.
        scores, weights = (np.concatenate([[of[0] + of[1]], of[2:-2], [of[-2] + of[-1]]]) for of in (scores, weights))
    rounding = np.zeros(len(channels))
    return Demodulation(tuple(channels), rows, coefficients, residual, inverse, scores, weights, rounding)


def _inverse(products: Array) -> Array | None:
    """Of a matrix of products, its columns brought to one size; None where it has none."""
    size = np.sqrt(np.maximum(np.diag(products), _SMALLEST))
    scaled = products / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < _SINGULAR:
        return None
    return np.asarray(np.linalg.inv(scaled) / np.outer(size, size))
