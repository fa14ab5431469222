"""The samples of a position: their mean and its uncertainty, from one position and from several.

Sums are rounded once (:func:`math.fsum`), so a replayed session gives the same digits everywhere.

Ten block means leave nine degrees of freedom: weights made of such variances would cost a fifth of what weighting can
give. Positions at one bench have much the same noise. Where their variances scatter no more than chance makes them, all
are one. Where they do, they are taken for scaled chi-squares about values that themselves scatter, as an inverse
chi-square with ``d0`` degrees of freedom, and each is drawn towards the common one in proportion.

Block means that are correlated show noise with a memory longer than a block: their scatter then understates the
uncertainty of the mean. Noise below half a step of the reading does not average the rounding out, and in a position
that happens to read one value all the time it does not show; over all positions it does.

Sources: G. K. Smyth, *Linear models and empirical Bayes methods*, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3, section 6;
B. Widrow, I. Kollár, *Quantization noise*, Cambridge (2008), chapter 9; J. R. Magnus, *The exact moments of a ratio of
quadratic forms in normal variables*, Annales d'Économie et de Statistique 4 (1986) 95, theorem 6.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from math import exp, fsum, hypot, inf, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike

from tiltcal.core.model import Array

BLOCKS = 10  # number of blocks whose means show correlated noise
_FLOOR = 1e-5  # variance given to a constant reading, as a fraction of the median
_COARSE = 0.5  # noise below this fraction of the step leaves a rounding error in a mean
_FEW_POSITIONS = 0.25  # relative standard deviations subtracted from the scatter of rounded readings
_SPREAD = 0.27  # standard deviation of the correlation of ten block means
_MARGIN = 0.5  # a correlation counts if it exceeds its mean by this many sigma
_CORRELATED_DOF = 2.0  # degrees of freedom of ten strongly correlated block means
_ENOUGH = 5.0  # shortest block, in correlation times
ARITHMETIC = 1e-12  # differences below this share of the values come from arithmetic, and are no step of the reading
_LOOKED_AT = 1 << 18  # number of first samples from which the step is found
_MOST_VALUES = 4096  # a reading of more different values is continuous
_WHOLE = 0.01  # largest distance of rounded readings from whole steps, in steps
_REPEATED = 4.0  # fewest samples per value of a rounded reading, on average
_EVEN = 0.02  # how far distances of values may be off whole steps, in steps: readings have so many digits
_SAME_NOISE = 0.01  # variances are one where chance scatters their logarithms as much with at least this probability
_CORRELATED = 4.0  # standard deviations above the correlation of white noise's block means from which it is no chance
_POSSIBLE = 1.5  # and from which it counts, without a remark: white noise shows as much in one session of fifteen

# Of noise with an exponential memory: its correlation time in blocks, the correlation that ten block means show of it
# on average (Magnus, theorem 6), and the true over the apparent uncertainty of their mean.
_TIMES = (0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0, 30.0)
_SHOWN = (-0.093, -0.064, -0.019, 0.030, 0.078, 0.122, 0.193, 0.267, 0.330, 0.384, 0.428, 0.464, 0.489, 0.505)
_FACTORS = (1.010, 1.055, 1.120, 1.193, 1.269, 1.345, 1.494, 1.707, 1.971, 2.329, 2.854, 3.722, 5.346, 9.400)


@dataclass(frozen=True)
class SampleSummary:
    """The mean of a run of samples of one channel, and its uncertainty, in the unit of the samples."""

    mean: float
    std: float  # sample standard deviation
    n: int
    u: float  # standard uncertainty of the mean, by noise (type A) and rounding
    quantisation: float = 0.0  # the part of u that rounding gives
    dof: float = inf  # degrees of freedom of the rest, the noise; infinite where it is known
    resolution: float = 0.0  # the step of the reading; 0 where it is continuous
    correlation: float | None = None
    """Of neighbouring block means, -1/10 on average without a memory; None without blocks, or where all are alike."""

    @property
    def noise(self) -> float:
        """The part of ``u`` that noise gives (type A), same unit."""
        return sqrt(max(self.u**2 - self.quantisation**2, 0.0))

    @property
    def noise_unknown(self) -> bool:
        """Whether nothing but its rounding is known of the mean, as in a table that states no uncertainties."""
        return self.dof == inf and 0.0 < self.u <= self.quantisation

    def with_resolution(self, resolution: float) -> SampleSummary:
        """Return the summary of the same samples where their step is known to be another one."""
        rounding = rounding_uncertainty(self.std, resolution)
        return replace(self, u=hypot(self.noise, rounding), quantisation=rounding, resolution=resolution)


def summarise(samples: Sequence[float] | Array, resolution: float = 0.0) -> SampleSummary:
    """Return mean, standard deviation and the mean's standard uncertainty of at least one sample, shape (n,).

    The uncertainty is what the scatter of ten block means says, because std/sqrt(n) does not see that samples of a real
    record are correlated; of fewer than twenty samples it is std/sqrt(n). Rounding is added.
    """
    values = np.asarray(samples, dtype=float)
    n, low = len(values), float(values.min())
    # Of samples that are all alike the mean would be rounded, and they would scatter about it in the last digit.
    mean = low if low == values.max() else fsum(values) / n
    std = sqrt(fsum(np.square(values - mean)) / (n - 1)) if n > 1 else 0.0
    noise, dof, correlation = std / sqrt(n), float(max(n - 1, 1)), None
    if n >= 2 * BLOCKS:
        size = n // BLOCKS
        means = [fsum(values[k * size : (k + 1) * size]) / size for k in range(BLOCKS)]
        centre = fsum(means) / BLOCKS
        off = [value - centre for value in means]
        squares = fsum(value**2 for value in off)
        noise, dof = sqrt(squares / (BLOCKS - 1) / BLOCKS), BLOCKS - 1.0
        correlation = fsum(value * other for value, other in pairwise(off)) / squares if squares > 0.0 else None
    step = rounding_uncertainty(std, resolution)
    return SampleSummary(mean, std, n, sqrt(noise**2 + step**2), step, dof, resolution, correlation)


def drift(times: ArrayLike, samples: ArrayLike) -> tuple[float, float]:
    """Return the change along the least-squares line through samples at some seconds, and its standard uncertainty."""
    at, values = np.asarray(times, float), np.asarray(samples, float)
    n = len(at)
    later, off = at - np.add.reduce(at) / n, values - np.add.reduce(values) / n  # mean() takes longer than all the rest
    spread = float(later @ later)
    if spread == 0.0:
        return 0.0, 0.0
    slope, span = float(later @ off) / spread, float(at[-1] - at[0])
    rest = off - slope * later
    return slope * span, sqrt(float(rest @ rest) / max(n - 2, 1) / spread) * span


# Rounding


def rounding_uncertainty(std: float, step: float) -> float:
    """Return u of the mean of many samples by rounding (Widrow, first harmonic), from their standard deviation."""
    if step == 0.0:
        return 0.0
    noise = sqrt(max(std**2 - step**2 / 12, 0.0))
    return step / sqrt(12) * exp(-2 * (pi * noise / step) ** 2)


def noise_under_rounding(scatter: float, step: float) -> float:
    """Return the noise before rounding, unit, from the mean variance of rounded readings in several positions."""
    noise, variance, _ = _rounded()
    return max(step * float(np.interp(scatter / step**2, variance, noise)), sqrt(max(scatter - step**2 / 12, 0.0)))


def rounding_of_means(scatter: float, step: float, positions: int) -> float:
    """Return u of the mean of a position by rounding, unit, from the scatter of a few positions."""
    _, variance, error = _rounded()
    return step * float(np.interp(scatter / step**2 * (1.0 - _FEW_POSITIONS / sqrt(positions)), variance, error))


@cache
def _rounded() -> tuple[Array, Array, Array]:
    """Return noise, the variance of readings that are rounded to 1, and the root mean square error of their mean."""
    noise, harmonic = np.linspace(0.0, 1.5, 301), np.arange(1, 1001)[:, None]
    squares = np.sum(np.exp(-((2.0 * pi * harmonic * noise) ** 2)) / (2.0 * (pi * harmonic) ** 2), axis=0)
    squares *= (1.0 / 12.0) / squares[0]  # what the harmonics beyond leave out
    return noise, noise**2 + 1.0 / 12.0 - squares, np.sqrt(squares)


# The noise of several positions


@dataclass(frozen=True)
class CorrelatedNoise:
    """Noise whose memory is longer than a block of samples."""

    factor: float  # of the uncertainty of a mean from its block means
    note: str  # remark on it, and what to do; empty where it may be chance


def correlated_noise(summaries: Sequence[SampleSummary]) -> CorrelatedNoise | None:
    """Estimate the correlation of block means over all positions and channels; None where none shows.

    Too short a memory costs more than too long a one: one somewhat above the mean counts, and before it is certain.
    """
    shown = [summary.correlation for summary in summaries if summary.correlation is not None]
    if not shown:
        return None
    mean, error = sum(shown) / len(shown), _SPREAD / sqrt(len(shown))
    above = (mean + 1.0 / BLOCKS) / error
    if above <= _POSSIBLE:
        return None
    time, factor = (float(np.interp(mean + _MARGIN * error, _SHOWN, column)) for column in (_TIMES, _FACTORS))
    note = (
        "the noise is correlated for longer than a tenth of a position: the uncertainty of each mean is multiplied by "
        f"{factor:.2g}; sample each position at least {max(_ENOUGH * time, 1.0):.2g} times as long"
    )
    return CorrelatedNoise(factor, note if above > _CORRELATED else "")


def noise_of_means(
    summaries: Sequence[SampleSummary], correlated: CorrelatedNoise | None = None
) -> tuple[Array, Array, Array]:
    """Return variance, degrees of freedom and rounding uncertainty of the means of positions, (positions,) each."""
    variance = np.array([summary.noise**2 for summary in summaries])
    dof = np.array([summary.dof for summary in summaries])
    rounding = np.array([summary.quantisation for summary in summaries])
    drawn = np.isfinite(dof)
    common = float(np.mean(variance[drawn])) if drawn.any() else 0.0
    coarse = None if correlated is not None and correlated.note else _coarse_rounding(summaries)
    if coarse is not None:
        return np.where(drawn, common, variance), np.where(drawn, float(np.sum(dof[drawn])), inf), coarse
    if correlated is not None:
        # Correlated block means scatter by chance in the ratio of ten: their logarithms are of no use.
        few = _CORRELATED_DOF * float(np.sum(drawn))
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
    if noise_under_rounding(scatter, step) >= _COARSE * step:
        return None
    # Positions that read the same within half a step share one rounding error: their mean is as uncertain as each.
    means = np.array([summary.mean for summary in summaries])
    alike = np.sum(np.abs(means[:, None] - means) < step / 2.0, axis=1)
    return np.asarray(rounding_of_means(scatter, step, int(np.count_nonzero(weight))) * np.sqrt(alike))


def pooled(variance: Array, dof: Array) -> tuple[Array, Array]:
    """Improve variances of means and their degrees of freedom, (n,), by pooling those that are not known (infinite)."""
    drawn = np.isfinite(dof)
    if np.sum(drawn) < 2 or not np.any(variance[drawn] > 0.0):
        return variance, dof
    own, degrees = variance[drawn], dof[drawn]
    common, prior = _common(own, degrees)
    better, freedom = variance.copy(), dof.copy()
    if prior == inf:
        better[drawn], freedom[drawn] = common, np.sum(degrees)
    else:
        better[drawn] = (prior * common + degrees * own) / (prior + degrees)
        freedom[drawn] = prior + degrees
    return better, freedom


def _common(variance: Array, dof: Array) -> tuple[float, float]:
    """Return the common variance, and the degrees of freedom that it counts for."""
    from scipy.optimize import brentq
    from scipy.special import chdtrc, digamma, polygamma

    usual = float(np.median(variance)) or float(np.max(variance))
    logs = np.log(np.maximum(variance, _FLOOR * usual)) - digamma(dof / 2.0) + np.log(dof / 2.0)
    by_chance, count = float(np.mean(polygamma(1, dof / 2.0))), len(logs)
    spread = float(np.var(logs, ddof=1))
    if chdtrc(count - 1, (count - 1) * spread / by_chance) > _SAME_NOISE:
        return float(np.sum(dof * variance) / np.sum(dof)), inf
    # The trigamma function of half the degrees of freedom, which is above 1 over its argument.
    more = spread - by_chance
    half = float(brentq(lambda y: float(polygamma(1, y)) - more, min(0.1, more**-0.5 / 2.0), 1.0 + 1.0 / more))
    return float(np.exp(np.mean(logs) + digamma(half) - np.log(half))), 2.0 * half


# The step of readings that are rounded


def resolution(channels: Iterable[Array]) -> float:
    """Return the step of a recorded reading, its unit, 0 where all values are alike.

    One converter reads all channels, (n,) each, NaN where a value is missing: the smallest difference in any counts.
    """
    steps = []
    for samples in channels:
        values = np.unique(_finite(samples))
        gaps = np.diff(values)
        largest = np.max(np.abs(values), initial=0.0)
        steps.append(float(np.min(gaps, initial=inf, where=gaps > ARITHMETIC * largest)))
    smallest = min(steps, default=inf)
    return smallest if smallest < inf else 0.0


def _finite(samples: Array) -> Array:
    begin = samples[:_LOOKED_AT]
    return np.asarray(begin[np.isfinite(begin)])


def even_step(samples: Array) -> float:
    """Return the step of a channel that takes few values at even distances, unit; 0 where it is continuous."""
    finite = _finite(samples)
    values = np.unique(finite)
    if not 1 < len(values) <= _MOST_VALUES or len(finite) < _REPEATED * len(values):
        return 0.0
    distances = np.diff(values)
    steps = distances / distances.min()
    whole = np.round(steps)
    return float(distances.sum() / whole.sum()) if np.all(np.abs(steps - whole) <= _EVEN * whole) else 0.0


def common_step(readings: Array) -> float:
    """Return the step that readings, (n, channels), are whole numbers of, apart from an offset; 0 if there is none."""
    step = resolution(readings.T)
    steps = (readings - readings[0]) / (step or 1.0)
    return step if np.max(np.abs(steps - np.round(steps))) < _WHOLE else 0.0


class ReadingStep:
    """The step of a sensor: the smallest that its readings take within a position, else the one that is stated."""

    def __init__(self) -> None:
        self._taken = self._stated = inf

    def add(self, samples: Iterable[Array], stated: float) -> None:
        """Take the samples of a position, shape (n,) of each channel, and the step they were written with, 0 if any."""
        self._taken = min(self._taken, resolution(samples) or inf)
        self._stated = min(self._stated, stated or inf)

    def step(self) -> float:
        """Return the step, unit; 0 where none is known."""
        step = self._taken if self._taken < inf else self._stated
        return step if step < inf else 0.0
