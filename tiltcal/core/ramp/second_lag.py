"""The polynomials of a ramp averaged over one thermal lag and pairs of lags, by their likelihood.

An element that is two lags behind its thermometer, one after the other or side by side, has the temperature::

    E = a F(T; τ1) + (1 - a) F(T; τ2)

with a from 0 to 1 where they are side by side, and a = τ1 / (τ1 - τ2) where one follows the other. Where the
thermometer is later, by τ2 < 0, the element has a lag τ1 > 0 of its own, or the thermometer a second one, τ1 < 0::

    E = a F(T; τ1) + (1 - a) F(F(T; τ1); τ2)

One lag follows the turns of two badly, and the polynomial takes on what it leaves. So the polynomials of many pairs
count, each with the weight of its likelihood, beside that of one lag, which has half of the prior weight. The file has
one lag all the same: a second one is rarely distinguished from the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import log, pi, sqrt
from operator import attrgetter

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.ramp.means import FittedMeans, slopes_of
from tiltcal.core.ramp.noise import joint_least_squares, whitener

_SPACING, _CLOSEST = 1.36, 1.002
"""Ratio of neighbouring lags of the pairs; its root about the likeliest pair, and again, down to the second."""

_ENOUGH = 3.0
"""Pairs that share the weight where they are close enough."""

_APART = 1.05
"""Ratio of the lags of a pair, below which it is none."""

_PARTS = tuple(_SPACING**power for power in range(-7, 5))
"""Lags of the pairs, as parts of the one that was found: from 0.12 to 3.4."""

_STEPS = 3


@dataclass(frozen=True)
class OverLags:
    """What one lag and pairs of lags give on the mean.

    Attributes
    ----------
    coefficients : ndarray, shape (channels, order + 1)
    covariance : ndarray, shape (channels (order + 1),) twice
    elements : ndarray, shape (k, parts)
        Temperatures of the element from the reference by one lag and by each pair, °C.
    weights : ndarray, shape (k,)
        Of these.
    whiteners : sequence of ndarray, shape (means, means)
        What whitens the noise of each channel, which is what the likeliest pair leaves.
    """

    coefficients: Array
    covariance: Array
    elements: Array
    weights: Array
    whiteners: Sequence[Array]

    @property
    def element(self) -> Array:
        """The mean temperature of the element, °C from the reference, shape (parts,)."""
        return np.asarray(self.weights @ self.elements)

    def distance(self, element: Array) -> float:
        """Return how far the temperature of the element is from another one, root mean square, °C."""
        return float(np.sqrt(self.weights @ np.mean((self.elements - element) ** 2, axis=1)))


def over_lags(means: FittedMeans, lag: float, polynomials: Array, covariance: Array) -> OverLags:
    """Return the mean over one lag and pairs of lags.

    Parameters
    ----------
    lag : float
        The one that was found, s.
    polynomials : ndarray, shape (channels, order + 1)
        Their coefficients with that lag.
    covariance : ndarray, shape (channels (order + 1),) twice
    """
    y = means.readings
    alone = [
        np.column_stack([means.powers(lag, polynomials.shape[1] - 1), slope])
        for slope in means.by_lag(lag, polynomials.T).T
    ]
    best = likeliest_pair(means, lag, polynomials)
    whiteners = [whitener(means, design, y[:, c]) for c, design in enumerate(best.designs)]
    pairs, volume = _close_pairs(means, lag, polynomials, whiteners)
    single = _solve((0.0, lag), means.element.at(lag), alone, y, whiteners, abs(lag))
    evidence = np.array([single.evidence, *(pair.evidence + log(volume) for pair in pairs)])
    weights = np.exp(evidence - evidence.max())
    weights /= weights.sum()
    coefficients = np.stack([polynomials.ravel(), *(pair.coefficients for pair in pairs)])
    mean = weights @ coefficients
    within = np.einsum("k,kij->ij", weights, np.stack([covariance, *(pair.covariance for pair in pairs)]))
    apart = coefficients - mean
    return OverLags(
        mean.reshape(polynomials.shape),
        within + (weights[:, None] * apart).T @ apart,
        np.stack([found.element for found in (single, *pairs)]),
        weights,
        whiteners,
    )


@dataclass(frozen=True)
class LagPairFit:
    """Coefficients channel by channel, their covariance, what the last unknown changes by, and the log evidence.

    The element has the temperatures of the parts of the means, °C from the reference.
    """

    lags: tuple[float, float]
    element: Array
    designs: Sequence[Array]
    coefficients: Array
    covariance: Array
    change: float
    evidence: float

    def error(self, means: FittedMeans, scale: Array) -> float:
        """Return the sum of squares that is left, over the variance ``scale`` squared."""
        coefficients = self.coefficients.reshape(means.readings.shape[1], -1)
        left = means.readings - means.powers_of(self.element, coefficients.shape[1] - 1) @ coefficients.T
        return float(np.sum((left / scale) ** 2))


def likeliest_pair(means: FittedMeans, lag: float, polynomials: Array) -> LagPairFit:
    """Return the likeliest pair under white noise, near one lag and its polynomials of shape (channels, order + 1)."""
    left = means.readings - means.powers(lag, polynomials.shape[1] - 1) @ polynomials.T
    whiteners = [np.full(len(left), 1.0 / np.std(column)) for column in left.T]
    return max(_close_pairs(means, lag, polynomials, whiteners)[0], key=attrgetter("evidence"))


def _close_pairs(
    means: FittedMeans, lag: float, polynomials: Array, whiteners: Sequence[Array]
) -> tuple[list[LagPairFit], float]:
    """Fit pairs that are so close that several count, and return the part of the prior weight that each has."""
    grid, spacing = _pairs(means, lag), _SPACING
    volume = 1.0 / len(grid)
    while True:
        pairs = [_of_pair(means, pair, lag, polynomials, whiteners) for pair in grid]
        best = max(pairs, key=attrgetter("evidence"))
        weights = np.exp([pair.evidence - best.evidence for pair in pairs])
        spacing = sqrt(spacing)
        grid = _near(best.lags, spacing)
        enough = np.sum(weights) ** 2 > _ENOUGH * np.sum(weights**2)
        if enough or spacing < _CLOSEST or len(grid) == 1:
            return pairs, volume
        volume /= 2.0 if best.lags[0] == 0.0 or lag < 0.0 else 4.0


def _pairs(means: FittedMeans, lag: float) -> list[tuple[float, float]]:
    if means.noisy:
        return [(0.0, lag)]
    if lag < 0.0:
        return [(part * lag, lag) for part in (*_PARTS, *(-part for part in _PARTS)) if part <= 1.0]
    return list(combinations([0.0, *(part * lag for part in _PARTS)], 2))


def _near(lags: tuple[float, float], spacing: float) -> list[tuple[float, float]]:
    """Return the pairs around one that are so close; the lag of a thermometer that is later varies with the share."""
    steps = (spacing ** np.arange(-3.0, 4.0)).tolist()
    pairs = {(lags[0] * a, lags[1] * (b if lags[1] > 0.0 else 1.0)) for a in steps for b in steps}
    return sorted(pair for pair in pairs if pair[1] < 0.0 or pair[1] > _APART * pair[0])


def _of_pair(
    means: FittedMeans, lags: tuple[float, float], whole: float, polynomials: Array, whiteners: Sequence[Array]
) -> LagPairFit:
    """Fit polynomials and the share of the first lag, which starts where both are ``whole`` on the mean."""
    coefficients = polynomials
    first, second = means.element.of_pair(lags)
    of_second = lags[1] if lags[1] > 0.0 else lags[0] + lags[1]
    share = (of_second - whole) / (of_second - lags[0])
    for _ in range(_STEPS):
        element = share * first + (1.0 - share) * second
        slopes = means.averaged(slopes_of(element, coefficients) * (first - second)[:, None])
        powers = means.powers_of(element, polynomials.shape[1] - 1)
        designs = [np.column_stack([powers, column]) for column in slopes.T]
        found = _solve(lags, element, designs, means.readings, whiteners, 1.0)
        coefficients, share = found.coefficients.reshape(polynomials.shape), share + found.change
    return found


def _solve(
    lags: tuple[float, float],
    element: Array,
    designs: Sequence[Array],
    y: Array,
    whiteners: Sequence[Array],
    typical: float,
) -> LagPairFit:
    """Solve for polynomials and a change that all channels share, whose prior is as wide as twice a typical value."""
    solution, covariance, square = joint_least_squares(whiteners, designs, y)
    evidence = 0.5 * (log(2.0 * pi * covariance[-1, -1]) - square) - log(2.0 * typical)
    return LagPairFit(lags, element, designs, solution[:-1], covariance[:-1, :-1], float(solution[-1]), evidence)
