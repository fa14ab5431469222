"""Demodulation: the components of readings at the stage's turning, by regression on the stage angle.

Every channel is fitted by the harmonics of the stage angle, an offset and a linear drift, all at once::

    I(θ, row) = sum_h (S_h sin hθ + C_h cos hθ) + offset + drift * row

Of the rows only the products of these columns are kept, block of turns by block of turns: ten hours of a record take no
more memory than a minute, and the scatter between the blocks shows how much noise there is at the turning itself, which
may be more than the white noise between the harmonics.

Where the noise does not reach half a step of the readings, rounding is the same error in each turn, which no scatter
between turns shows. Its share at the turning is that of as many independent roundings as a turn has: one for each place
that is sampled, and no more than the sine wave passes steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import pi

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.quantisation import common_step, rounding_uncertainty
from tiltcal.errors import EstimateError

HARMONICS = 4
MOST_BLOCKS = 512
_COARSE_BLOCKS = 10
_WHITE = 4
"""Degrees of freedom that count for white noise, whatever the blocks say."""
_SURPRISE = 0.005
"""How unlikely the scatter of coarse blocks must be, for what finer ones say, before it counts."""
_SINGULAR = 1e-9
_PLACES = 1e5
"""Places of a turn that count as different."""
_DRIFT_UNIT = 1e6
"""Rows; keeps the drift's column near the size of the others."""


def harmonic_columns(angle: Array, harmonics: int, out: Array | None = None) -> Array:
    """sin θ, cos θ, sin 2θ, cos 2θ, ... and 1, shape (2 harmonics + 1, n).

    Parameters
    ----------
    angle : ndarray, shape (n,)
        Turns.
    harmonics : int
        At least 1.
    out : ndarray, optional
        Where they are written.
    """
    columns = np.empty((2 * harmonics + 1, len(angle))) if out is None else out
    sine, cosine = columns[0], columns[1]
    # One tangent, of θ/2, takes a third of the time of a sine and a cosine.
    tangent = np.tan(pi * (angle - np.floor(angle)))
    share = 2.0 / (1.0 + np.square(tangent))
    np.multiply(tangent, share, out=sine)
    np.subtract(share, 1.0, out=cosine)
    twice = 2.0 * cosine
    for column in range(2, 2 * harmonics):
        # sin hθ = 2 cos θ sin (h - 1)θ - sin (h - 2)θ, and so for cos hθ; of h = 0 they are 0 and 1.
        np.multiply(twice, columns[column - 2], out=columns[column])
        columns[column] -= columns[column - 4] if column > 3 else column - 2
    columns[-1] = 1.0
    return columns


class Demodulator:
    """Takes the rows of a record and keeps what the regression needs of them."""

    def __init__(self, channels: Sequence[str]) -> None:
        self._channels = tuple(channels)
        self._size = 1.0
        self._blocks: dict[int, Array] = {}
        self._pilot: Array | None = None
        self._step, self._places = 0.0, 1
        self._row = 0

    def add(self, angle: Array, readings: Array, row: NDArray[np.int64] | None = None) -> None:
        """Take more rows.

        Parameters
        ----------
        angle : ndarray, shape (n,)
            Turns that do not wrap, see :class:`tiltcal.core.pair.encoder.AngleTracker`; finite.
        readings : ndarray, shape (n, channels)
            Finite.
        row : ndarray, shape (n,), optional
            Numbers of the rows, for the drift; counted on where left out.
        """
        if not len(angle):
            return
        if row is None:
            row = self._row + np.arange(len(angle))
            self._row += len(angle)
        if self._pilot is None:
            # A large offset would take the digits that the noise needs in the sums of squares.
            self._pilot = readings.mean(axis=0)
            self._step, self._places = common_step(readings), len(np.unique(np.round(angle % 1.0 * _PLACES)))
        columns = 2 * HARMONICS + 1
        table = np.empty((columns + 1 + len(self._channels), len(angle)))
        harmonic_columns(angle, HARMONICS, out=table[:columns])
        np.divide(row, _DRIFT_UNIT, out=table[columns])
        np.subtract(readings.T, self._pilot[:, None], out=table[columns + 1 :])
        block = np.floor(angle / self._size).astype(np.int64)
        if np.any(block[1:] < block[:-1]):
            block = np.maximum.accumulate(block)
        cuts = [0, *(np.flatnonzero(np.diff(block)) + 1).tolist(), len(block)]
        for start, end in pairwise(cuts):
            part = table[:, start:end]
            number = int(block[start])
            self._blocks[number] = self._blocks.get(number, 0.0) + part @ part.T
        while len(self._blocks) > MOST_BLOCKS:
            self._merge()

    def _merge(self) -> None:
        """Blocks of twice the turns."""
        self._size *= 2.0
        blocks, self._blocks = self._blocks, {}
        for number, products in blocks.items():
            self._blocks[number // 2] = self._blocks.get(number // 2, 0.0) + products

    def join(self, other: Demodulator) -> None:
        """Take the rows of another record of the same channels, whose angle may be off and whose offsets may differ.

        Its components are turned into the phase of these. An angle that is off for all channels alike multiplies all
        components by one and the same matrix, so neither p nor q of any pair depends on how well that is known. Its
        offsets and drifts are brought to these.

        Raises
        ------
        EstimateError
            One of both cannot determine its components; this one is left as it was.
        """
        mine, its = self.result(), other.result()
        transform = _brought(its, mine)
        while other._size < self._size:
            other._merge()
        while self._size < other._size:
            self._merge()
        behind = max(self._blocks) + 1 - min(other._blocks)
        self._blocks |= {number + behind: transform @ block @ transform.T for number, block in other._blocks.items()}
        while len(self._blocks) > MOST_BLOCKS:
            self._merge()

    def result(self) -> Demodulation:
        """Return the regression over all rows so far.

        Raises
        ------
        EstimateError
            The rows cannot determine the components.
        """
        if not self._blocks:
            raise EstimateError("no row of the record has an angle and all readings")
        blocks = np.stack([self._blocks[number] for number in sorted(self._blocks)])
        found = regress(blocks, self._channels, HARMONICS)
        return replace(found, rounding=self._rounding(found)) if self._step else found

    def _rounding(self, found: Demodulation) -> Array:
        """Return the variance that rounding leaves in a component of each channel, unit²."""
        deviations = np.sqrt(np.maximum(np.diag(found.residual), 0.0))
        passed = 4.0 * np.hypot(*found.coefficients[:2]) / self._step
        left = np.array([rounding_uncertainty(deviation, self._step) for deviation in deviations.tolist()])
        # A sine wave passes each step up and down: of places that mirror each other two share one rounding.
        return np.asarray(3.0 * left**2 / np.clip(passed, 1.0, self._places))


@dataclass(frozen=True)
class Demodulation:
    """The regression of all channels on the stage angle.

    Attributes
    ----------
    coefficients : ndarray, shape (columns, channels)
        Rows 0 and 1 are the sin θ and cos θ components, in the unit of the readings.
    residual : ndarray, shape (channels, channels)
        Covariance of what is left, unit².
    inverse : ndarray, shape (columns, columns)
        Of the products of the columns: times a variance it is the coefficients' covariance in white noise.
    scores : ndarray, shape (blocks, 2, channels)
        Products of sin θ and cos θ with what is left, per block of turns.
    weights : ndarray, shape (blocks, 2, 2)
        Products of sin θ and cos θ with each other, per block of turns.
    rounding : ndarray, shape (channels,)
        Variance of each component from the rounding of the readings, which all turns share, unit².
    """

    channels: tuple[str, ...]
    rows: int
    coefficients: Array
    residual: Array
    inverse: Array
    scores: Array
    weights: Array
    rounding: Array

    def mix(self, weights: dict[str, float]) -> Array:
        """Weights by name as a row for all channels, shape (channels,)."""
        return np.array([weights.get(channel, 0.0) for channel in self.channels])

    def components(self, mix: Array) -> Array:
        """sin and cos component of a mix of channels, shape (2,)."""
        return np.asarray(self.coefficients[:2] @ mix)

    def covariance(self, mix: Array) -> Array:
        """Covariance of :meth:`components`, shape (2, 2), unit².

        That of noise with the density that the blocks of turns scatter by, which is its density around the turning,
        and that of rounding.
        """
        # A record without noise leaves less than the rounding of its sums, which may be negative.
        variance = max(float(mix @ self.residual @ mix), 0.0)
        return np.asarray(variance * self.colour(mix) * self.inverse[:2, :2] + mix**2 @ self.rounding * np.eye(2))

    def colour(self, mix: Array) -> float:
        """Noise power at the turning over that of all frequencies, as a standard uncertainty needs it.

        Few turns show it badly. It is pooled with a few degrees of freedom of white noise, and widened as Student's
        distribution is (GUM Supplement 1, 6.4.9.4), so that 1.96 standard uncertainties are 95 %.
        """
        variance = float(mix @ self.residual @ mix)
        if variance <= 0.0 or len(self.scores) < 2:
            return 1.0
        scores = self.scores @ mix
        fine, dof = _scatter(scores, self._inverse_weights, variance)
        pooled = (_WHITE + dof * fine) / (_WHITE + dof)
        widened = pooled * _student(_WHITE + dof)
        if len(scores) < 4 * _COARSE_BLOCKS:
            return widened
        groups = np.array_split(np.arange(len(scores)), _COARSE_BLOCKS)
        coarse, coarse_dof = _scatter(
            np.stack([scores[group].sum(axis=0) for group in groups]),
            np.linalg.pinv(np.stack([self.weights[group].sum(axis=0) for group in groups])),
            variance,
        )
        # Slower than a turn: amplitudes that wander.
        return coarse * _student(coarse_dof) if _surprising(coarse / pooled, coarse_dof, dof) else widened

    @cached_property
    def _inverse_weights(self) -> Array:
        return np.asarray(np.linalg.pinv(self.weights))


def regress(blocks: Array, channels: Sequence[str], harmonics: int) -> Demodulation:
    """Return the regression from sums of products.

    Parameters
    ----------
    blocks : ndarray, shape (blocks, size, size)
        Products of the harmonics' columns, 1, the drift and the readings, summed over each block.
    harmonics : int
        As many as the columns have; fewer are fitted where the rows of a turn are too few for all.

    Raises
    ------
    EstimateError
        Not even the first harmonic is determined.
    """
    columns = 2 * harmonics + 2
    total = blocks.sum(axis=0)
    rows = round(float(total[columns - 2, columns - 2]))
    for used in range(harmonics, 0, -1):
        kept = [*range(2 * used), columns - 2, columns - 1]
        inverse = _inverse(total[np.ix_(kept, kept)])
        if inverse is not None and rows > 2 * len(kept):
            break
    else:
        raise EstimateError(
            f"{rows} rows do not determine the components at the turning: the angles must cover the whole turn, with "
            "more rows than that"
        )
    against = total[kept, columns:]
    coefficients = inverse @ against
    residual = (total[columns:, columns:] - coefficients.T @ against) / (rows - len(kept))
    with_readings = blocks[:, :2, columns:]
    scores = with_readings - blocks[:, :2][:, :, kept] @ coefficients
    turns, weights = _whole_turns(scores, blocks[:, :2, :2])
    return Demodulation(
        channels=tuple(channels),
        rows=rows,
        coefficients=coefficients,
        residual=residual,
        inverse=inverse,
        scores=turns,
        weights=weights,
        rounding=np.zeros(len(channels)),
    )


def _brought(its: Demodulation, mine: Demodulation) -> Array:
    """Return the map from the columns and readings of one record to phase, offsets and drifts of another."""
    signal, wanted = (found.coefficients[0] + 1j * found.coefficients[1] for found in (its, mine))
    # S sin (θ + φ) + C cos (θ + φ) has the components S + iC times exp iφ.
    off = float(np.angle(np.sum(signal * np.conj(wanted))))
    columns = 2 * HARMONICS + 2
    transform = np.eye(columns + len(mine.channels))
    for h in range(1, HARMONICS + 1):
        sine, cosine = np.sin(h * off), np.cos(h * off)
        transform[2 * h - 2 : 2 * h, 2 * h - 2 : 2 * h] = [[cosine, sine], [-sine, cosine]]
    transform[columns:, columns - 2 : columns] = (mine.coefficients[-2:] - its.coefficients[-2:]).T
    return transform


def _whole_turns(scores: Array, weights: Array) -> tuple[Array, Array]:
    """Return the first and the last block, which the record cuts, with their neighbours."""
    if len(scores) < 4:
        return scores, weights
    return tuple(  # type: ignore[return-value]
        np.concatenate([[table[0] + table[1]], table[2:-2], [table[-2] + table[-1]]]) for table in (scores, weights)
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


def _surprising(ratio: float, dof: int, other: int) -> bool:
    """Return whether a ratio of variances is larger than chance explains."""
    from scipy.special import fdtrc

    return bool(fdtrc(dof, other, ratio) < _SURPRISE)
