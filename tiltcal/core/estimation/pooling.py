"""The noise of several positions, each known from a few block means, pooled; and what correlation and rounding add.

Ten block means leave nine degrees of freedom: weights made of such variances would cost a fifth of what weighting can
give, and what is computed from them would look better known than it is. Positions at one bench have much the same
noise. Where the variances scatter no more than chance makes them, all are one. Where they do, they are taken for scaled
chi-squares about values that themselves scatter, as an inverse chi-square with ``d0`` degrees of freedom, and each is
drawn towards the common one in proportion.

Block means that are correlated show noise with a memory longer than a block: their scatter then understates the
uncertainty of the mean. Noise below half a step of the reading does not average the rounding out, and in a position
that happens to read one value all the time it does not show; over all positions it does.

Sources: G. K. Smyth, *Linear models and empirical Bayes methods*, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3, section 6;
B. Widrow, I. Kollár, *Quantization noise*, Cambridge (2008), chapter 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import inf, sqrt

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.quantisation import noise_under_rounding, rounding_left
from tiltcal.core.statistics import BLOCKS, SampleSummary

STEPS = 50
"""Most Newton steps of the inverse of the trigamma function, which takes about five."""

CHANCE = 0.01
"""Probability of a scatter of the variances' logarithms below which it is no chance."""

FLOOR = 1e-5
"""A variance below this share of the median counts as that: a reading that never changed has no logarithm."""


CORRELATED = 4.0
"""Standard deviations above the correlation of white noise's block means from which a correlation is no chance."""

POSSIBLE = 1.5
"""The same from which it counts, without a remark: white noise shows as much in one session of fifteen."""

MARGIN = 0.5
"""Standard deviations of the correlation by which the correlation time may be longer than the most probable one."""

SPREAD = 0.27
"""Standard deviation of the correlation of ten block means of white noise."""

CORRELATED_DOF = 2.0
"""Degrees of freedom of a position's ten block means that are strongly correlated."""

TIMES = np.geomspace(0.02, 30.0, 400)
"""Correlation times that are distinguished, in blocks; longer ones show the same correlation within a position."""

ENOUGH = 5.0
"""Correlation times that a block should have."""

LOGARITHMS = np.linspace(-15.0, 25.0, 161)
"""Of the variable of integration for the mean of a ratio: the integrand is smooth in it, and nothing is beyond."""

COARSE = 0.5
"""Noise below this share of the reading's step leaves a rounding error in a mean."""


@dataclass(frozen=True)
class CorrelatedNoise:
    """Noise whose memory is longer than a block of samples.

    Attributes
    ----------
    factor : float
        By what the uncertainty of a mean from its block means is to be multiplied.
    longer : float
        By what the time of a position is to be multiplied for blocks that are not correlated.
    certain : bool
        False where it may be chance.
    """

    factor: float
    longer: float
    certain: bool = True

    @property
    def note(self) -> str:
        """Remark on the correlation, and what to do."""
        return (
            "the noise is correlated for longer than a tenth of a position: the uncertainty of each mean is multiplied "
            f"by {self.factor:.2g}; sample each position at least {self.longer:.2g} times as long"
        )


def correlated_noise(summaries: Sequence[SampleSummary]) -> CorrelatedNoise | None:
    """Estimate the correlation of block means over all positions and channels; None where none shows.

    Notes
    -----
    The noise is taken for one with an exponential memory. The factor is that of a correlation time half a standard
    deviation above the one whose mean correlation was found, because too short a time costs more than too long a one. A
    memory of a third of a block hardly shows in twelve positions and takes a fifth off the uncertainty: it counts
    before it is certain.
    """
    found = [summary.correlation for summary in summaries if summary.correlation is not None]
    if not found:
        return None
    mean, error = sum(found) / len(found), SPREAD / sqrt(len(found))
    above = (mean + 1.0 / BLOCKS) / error
    if above <= POSSIBLE:
        return None
    certain = above > CORRELATED
    shown, factors = _by_correlation_time()
    place = min(int(np.searchsorted(shown, mean + MARGIN * error)), len(TIMES) - 1)
    return CorrelatedNoise(float(factors[place]), max(ENOUGH * float(TIMES[place]), 1.0), certain)


@cache
def _by_correlation_time() -> tuple[Array, Array]:
    """Return, for each of :data:`TIMES`, the mean correlation of block means, and true over apparent uncertainty.

    Notes
    -----
    Both are of means about their own mean, so that the correlation is a ratio of two quadratic forms of normal numbers.
    With the eigenvalues l of the means' covariance and the diagonal a of the numerator in its eigenvectors, times l,
    its expectation is the integral of ``sum_i a_i / (1 + 2 t l_i) / prod_j sqrt(1 + 2 t l_j)`` over t from 0 up.

    Source: J. R. Magnus, *The exact moments of a ratio of quadratic forms in normal variables*, Annales d'Économie et
    de Statistique 4 (1986) 95, theorem 6.
    """
    time = TIMES[:, None]
    lag = np.arange(1, BLOCKS)
    inner = 2.0 * time**2 * (1.0 / time - 1.0 + np.exp(-1.0 / time))
    outer = time**2 * np.exp(-(lag - 1.0) / time) * (1.0 - np.exp(-1.0 / time)) ** 2
    k = np.arange(BLOCKS)
    covariance = np.hstack([inner, outer])[:, np.abs(k[:, None] - k)]
    centred = np.eye(BLOCKS) - 1.0 / BLOCKS
    about_mean = centred @ covariance @ centred
    scatter = np.trace(about_mean, axis1=1, axis2=2)
    factors = np.sqrt(covariance.mean(axis=(1, 2)) * BLOCKS * (BLOCKS - 1) / scatter)
    size, vectors = np.linalg.eigh(about_mean / scatter[:, None, None])
    neighbours = np.sum(vectors[:, :-1] * vectors[:, 1:], axis=1) * size
    t = np.exp(LOGARITHMS)
    grown = 1.0 + 2.0 * size[:, :, None] * t
    summed = np.sum(neighbours[:, :, None] / grown, axis=1) / np.sqrt(np.prod(grown, axis=1))
    return np.asarray(summed @ t * (LOGARITHMS[1] - LOGARITHMS[0])), factors


def noise_of_means(
    summaries: Sequence[SampleSummary], correlated: CorrelatedNoise | None = None
) -> tuple[Array, Array, Array]:
    """Return the noise of the means of one channel's positions: variance, degrees of freedom, rounding uncertainty.

    Each has the shape (positions,).

    Parameters
    ----------
    summaries : sequence of SampleSummary
        One a position.
    """
    variance = np.array([summary.noise**2 for summary in summaries])
    dof = np.array([summary.dof for summary in summaries])
    rounding = np.array([summary.quantisation for summary in summaries])
    drawn = np.isfinite(dof)
    common = float(np.mean(variance[drawn])) if drawn.any() else 0.0
    certain = correlated is not None and correlated.certain
    coarse = _coarse_rounding(summaries) if drawn.any() and not certain else None
    if coarse is not None:
        return np.where(drawn, common, variance), np.where(drawn, float(np.sum(dof[drawn])), inf), coarse
    if correlated is not None:
        # Correlated block means scatter by chance in the ratio of ten: their logarithms are of no use.
        few = CORRELATED_DOF * float(np.sum(drawn))
        variance = correlated.factor**2 * np.where(drawn, common, variance)
        return variance, np.where(drawn, few, inf), rounding
    return (*pooled(variance, dof), rounding)


def _coarse_rounding(summaries: Sequence[SampleSummary]) -> Array | None:
    """Return the rounding uncertainty of each mean where the noise is below half a step; None where it is not."""
    weight = np.array([float(summary.n - 1) for summary in summaries])
    step = max(summary.resolution for summary in summaries)
    if step == 0.0 or weight.sum() == 0.0:
        return None
    scatter = float(weight @ np.array([summary.std**2 for summary in summaries]) / weight.sum())
    if noise_under_rounding(scatter, step) >= COARSE * step:
        return None
    drawn = weight[weight > 0.0]
    left = rounding_left(scatter, step, len(drawn), float(drawn.mean()) + 1.0)
    return np.asarray(left * np.sqrt(_alike(summaries, step)))


def _alike(summaries: Sequence[SampleSummary], step: float) -> Array:
    """Count the positions that read the same within half a step: they share one rounding error.

    The root of the count makes the mean of positions that are alike as uncertain as one of them.
    """
    means = np.array([summary.mean for summary in summaries])
    return np.asarray(np.sum(np.abs(means[:, None] - means) < step / 2.0, axis=1), dtype=np.float64)


def pooled(variance: Array, dof: Array) -> tuple[Array, Array]:
    """Improve variances of several positions, and their degrees of freedom, by pooling; shape (n,) each.

    Parameters
    ----------
    variance : ndarray, shape (n,)
        Of each position's mean, from its own samples.
    dof : ndarray, shape (n,)
        Degrees of freedom of each; infinite ones are known, and stay as they are.
    """
    drawn = np.isfinite(dof)
    if np.sum(drawn) < 2 or not np.any(variance[drawn] > 0.0):
        return variance, dof
    own, degrees = variance[drawn], dof[drawn]
    common, prior = _common(own, degrees)
    better, freedom = variance.copy(), dof.copy()
    if np.isinf(prior):
        better[drawn], freedom[drawn] = common, np.sum(degrees)
    else:
        better[drawn] = (prior * common + degrees * own) / (prior + degrees)
        freedom[drawn] = prior + degrees
    return better, freedom


def _common(variance: Array, dof: Array) -> tuple[float, float]:
    """Return the common variance, and the degrees of freedom that it counts for."""
    from scipy.special import chdtrc, digamma, polygamma

    usual = float(np.median(variance)) or float(np.max(variance))
    logs = np.log(np.maximum(variance, FLOOR * usual)) - digamma(dof / 2.0) + np.log(dof / 2.0)
    by_chance, count = float(np.mean(polygamma(1, dof / 2.0))), len(logs)
    spread = float(np.var(logs, ddof=1))
    if chdtrc(count - 1, (count - 1) * spread / by_chance) > CHANCE:
        return float(np.sum(dof * variance) / np.sum(dof)), np.inf
    prior = 2.0 * _inverse_trigamma(spread - by_chance)
    return float(np.exp(np.mean(logs) + digamma(prior / 2.0) - np.log(prior / 2.0))), prior


def _inverse_trigamma(value: float) -> float:
    """Invert the trigamma function, by Newton's steps on its reciprocal, which is nearly linear."""
    from scipy.special import polygamma

    y = 0.5 + 1.0 / value
    for _ in range(STEPS):
        trigamma = float(polygamma(1, y))
        step = trigamma * (1.0 - trigamma / value) / float(polygamma(2, y))
        y += step
        if abs(step) <= 1e-10 * y:
            break
    return y
