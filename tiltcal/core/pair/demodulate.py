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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import ceil, pi

import numpy as np

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.quantisation import common_step
from tiltcal.core.samples import rounding_uncertainty
from tiltcal.errors import EstimateError

HARMONICS = 4
ONE, DRIFT, READINGS = 2 * HARMONICS, 2 * HARMONICS + 1, 2 * HARMONICS + 2
"""Where they stand among the columns."""
MOST_BLOCKS = 512
COARSE_BLOCKS = 10
CHUNK = 1 << 16
_WHITE = 4
"""Degrees of freedom that count for white noise, whatever the blocks say."""
_SURPRISE = 0.005
"""How unlikely the scatter of coarse blocks must be, for what finer ones say, before it counts."""
_SINGULAR = 1e-9
_PLACES = 1e5
"""Places of a turn that count as different."""


def harmonic_columns(angle: Array, harmonics: int) -> Array:
    """sin θ, cos θ, sin 2θ, cos 2θ, ... and 1, shape (2 harmonics + 1, n); angle in turns, shape (n,)."""
    columns = np.ones((2 * harmonics + 1, len(angle)))
    phase = 2.0 * pi * (angle - np.floor(angle))
    np.sin(phase, out=columns[0])
    np.cos(phase, out=columns[1])
    for column in range(2, 2 * harmonics):
        # sin hθ = 2 cos θ sin (h - 1)θ - sin (h - 2)θ, and so for cos hθ; of h = 0 they are 0 and 1.
        np.multiply(2.0 * columns[1], columns[column - 2], out=columns[column])
        columns[column] -= columns[column - 4] if column > 3 else column - 2
    return columns


def regression_columns(angle: Array, row: Array, readings: Array) -> Array:
    """Return the columns of the regression and the readings behind them, shape (READINGS + channels, n)."""
    return np.concatenate([harmonic_columns(angle, HARMONICS), row[None, :], readings])


def moved(products: Array, rows: Array | int) -> Array:
    """Return products of shape (..., n, n) in which rows are counted from a row that is so many later, shape (...)."""
    changed, back = products.copy(), np.asarray(rows, float)[..., None]
    changed[..., DRIFT, :] -= back * changed[..., ONE, :]
    changed[..., :, DRIFT] -= back * changed[..., :, ONE]
    return changed


def demodulate(
    channels: Sequence[str], angle: Array, readings: Sequence[Array] | Array, whole: Mask | None = None
) -> Demodulation:
    """Return the regression over the rows of a record that are whole, all of them where these are left out.

    The angle, shape (n,), is in turns that do not wrap; readings are of shape (n,) for each channel.

    Raises
    ------
    EstimateError
        The rows cannot determine the components.
    """
    places = np.arange(len(angle)) if whole is None else np.flatnonzero(whole)
    if not len(places):
        raise EstimateError("no row of the record has an angle and all readings")
    size = ceil(max(float(angle[places[-1]] - angle[places[0]]), 1.0) / (MOST_BLOCKS - 1))
    beginning = places[:CHUNK]
    values = np.stack([column[beginning] for column in readings])
    # A large offset would take the digits that the noise needs in the sums of squares.
    pilot, step = values.mean(axis=1), common_step(values.T)
    blocks: dict[int, Array] = {}
    for start in range(0, len(places), CHUNK):
        rows = places[start : start + CHUNK]
        values = np.stack([column[rows] for column in readings]) - pilot[:, None]
        table = regression_columns(angle[rows], rows / len(angle) - 0.5, values)
        block = np.maximum.accumulate(np.floor(angle[rows] / size)).astype(np.int64)
        for first, end in pairwise([0, *(np.flatnonzero(np.diff(block)) + 1).tolist(), len(block)]):
            part, number = table[:, first:end], int(block[first])
            blocks[number] = blocks.get(number, 0.0) + part @ part.T
    result = regress(np.stack([blocks[number] for number in sorted(blocks)]), channels)
    result.coefficients[-2] += pilot
    return replace(result, rounding=_rounding(result, step, angle[beginning])) if step else result


def _rounding(demodulation: Demodulation, step: float, angle: Array) -> Array:
    """Return the variance that rounding leaves in a component of each channel, unit²."""
    deviations = np.sqrt(np.maximum(np.diag(demodulation.residual), 0.0))
    passed = 4.0 * np.hypot(*demodulation.coefficients[:2]) / step
    of_means = np.array([rounding_uncertainty(deviation, step) for deviation in deviations.tolist()])
    # A sine wave passes each step up and down: of places that mirror each other two share one rounding.
    return np.asarray(3.0 * of_means**2 / np.clip(passed, 1.0, len(np.unique(np.round(angle % 1.0 * _PLACES)))))


@dataclass(frozen=True)
class Demodulation:
    """The regression of all channels on the stage angle.

    The first two ``coefficients`` are the sin θ and cos θ components, the last two the offset in the middle of the
    record and the drift over all of it, in the unit of the readings. ``inverse`` times a variance is their covariance
    in white noise; ``residual`` is the covariance of what is left, and ``rounding`` the variance of each component
    from the rounding of the readings, which all turns share, unit². ``scores`` are products of sin θ and cos θ with
    what is left, and ``weights`` with each other, per block of turns. A mix is a weight for each channel.
    """

    channels: tuple[str, ...]
    rows: int
    coefficients: Array  # (columns, channels)
    residual: Array  # (channels, channels)
    inverse: Array  # (columns, columns)
    scores: Array  # (blocks, 2, channels)
    weights: Array  # (blocks, 2, 2)
    rounding: Array  # (channels,)

    def of(self, channels: Sequence[str]) -> Demodulation:
        """Return the regression of some of the channels, in this order."""
        chosen = [self.channels.index(channel) for channel in channels]
        return replace(
            self,
            channels=tuple(channels),
            coefficients=self.coefficients[:, chosen],
            residual=self.residual[np.ix_(chosen, chosen)],
            scores=self.scores[..., chosen],
            rounding=self.rounding[chosen],
        )

    def components(self, mix: Array) -> Array:
        """sin and cos component of a mix, shape (2,)."""
        return np.asarray(self.coefficients[:2] @ mix)

    def covariance(self, mix: Array) -> Array:
        """Covariance of :meth:`components`, shape (2, 2), unit²: of the noise around the turning, and of rounding."""
        # A record without noise leaves less than the rounding of its sums, which may be negative.
        variance = max(float(mix @ self.residual @ mix), 0.0)
        return np.asarray(variance * self.colour(mix) * self.inverse[:2, :2] + mix**2 @ self.rounding * np.eye(2))

    def colour(self, mix: Array) -> float:
        """Noise power at the turning over that of all frequencies, as a standard uncertainty needs it.

        Few turns show it badly. It is pooled with a few degrees of freedom of white noise, and widened as Student's
        distribution is (GUM Supplement 1, 6.4.9.4), so that 1.96 standard uncertainties are 95 %.
        """
        from scipy.special import fdtrc

        variance = float(mix @ self.residual @ mix)
        if variance <= 0.0 or len(self.scores) < 2:
            return 1.0
        fine, dof = _scatter(self.scores @ mix, self._inverse_weights, variance)
        pooled = (_WHITE + dof * fine) / (_WHITE + dof)
        if len(self.scores) >= 4 * COARSE_BLOCKS:
            scores, weights = self.coarse(mix)
            coarse, coarse_dof = _scatter(scores, np.asarray(np.linalg.pinv(weights)), variance)
            if fdtrc(coarse_dof, dof, coarse / pooled) < _SURPRISE:
                return coarse * _student(coarse_dof)  # slower than a turn: amplitudes that wander
        return pooled * _student(_WHITE + dof)

    def coarse(self, mix: Array) -> tuple[Array, Array]:
        """Scores of a mix, shape (groups, 2), and weights, shape (groups, 2, 2), of groups of blocks."""
        groups = np.array_split(np.arange(len(self.scores)), COARSE_BLOCKS)
        sums = (np.stack([table[group].sum(axis=0) for group in groups]) for table in (self.scores, self.weights))
        scores, weights = sums
        return scores @ mix, weights

    @cached_property
    def _inverse_weights(self) -> Array:
        return np.asarray(np.linalg.pinv(self.weights))


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
    scores = blocks[:, :2, READINGS:] - blocks[:, :2][:, :, kept] @ coefficients
    weights = blocks[:, :2, :2]
    if len(blocks) >= 4:
        # The first and the last block, which the record cuts, go with their neighbours.
        scores, weights = (
            np.concatenate([[table[0] + table[1]], table[2:-2], [table[-2] + table[-1]]]) for table in (scores, weights)
        )
    return Demodulation(
        tuple(channels), rows, coefficients, residual, inverse, scores, weights, np.zeros(len(channels))
    )


def _inverse(products: Array) -> Array | None:
    """Of a matrix of products, its columns brought to one size; None where it has none."""
    size = np.sqrt(np.diag(products))
    if not np.all(size > 0.0):
        return None
    scaled = products / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < _SINGULAR:
        return None
    return np.asarray(np.linalg.inv(scaled) / np.outer(size, size))


def _scatter(scores: Array, inverse_weights: Array, variance: float) -> tuple[float, int]:
    """Mean square of the blocks' scores over what white noise gives, and its degrees of freedom."""
    squares = np.einsum("bi,bij,bj->b", scores, inverse_weights, scores)
    dof = max(2 * len(scores) - 2, 1)
    return float(squares.sum()) / variance / dof, dof


def _student(dof: int) -> float:
    """Variance of Student's distribution."""
    return dof / (dof - 2.0)
