"""The noise of a sensor at rest: averages, Allan deviation, kinds of noise, and the samples that a mean needs.

The Allan deviation σ(τ) is the standard deviation, over √2, of the difference between the means of two neighbouring
stretches of length τ: the standard uncertainty of a mean that took τ, of a reading whose zero wanders. It is the sum of
four kinds of noise that are independent of each other (IEEE Std 952-1997, annex C, with τ in seconds)::

    σ²(τ) = N²/τ + (2 ln 2 / π) B² + K² τ/3 + R² τ²/2

N is white noise, B flicker noise (bias instability), K random walk, R a steady drift. Rounding of a reading that is
noisy enough is white and part of N.

Sources: NIST Special Publication 1065, eq. 11 and table 5; *A Solid State Tilt Meter for Current Meter Attitude
Determination*, table I, for the averages.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, degrees, log, nan, pi, sqrt
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.samples import even_step, rounding_uncertainty
from tiltcal.core.uncertain import COVERAGE
from tiltcal.errors import EstimateError

Kind = Literal["white", "flicker", "walk"]  # its deviation falls with the root of τ, stays, or grows with it

Limit = Literal["target", "record", "rounding", "flicker", "walk", "drift", "unknown"]
"""What sets the number of samples: the target; the end of the record; or rounding, flicker noise, random walk, drift or
an unknown cause, because of which more samples do not help."""

FEWEST_SAMPLES = 64  # samples of a channel below which nothing is said of its noise
FLICKER = sqrt(2.0 * log(2.0) / pi)  # deviation of flicker noise over its coefficient B: 0.664
TERMS = ("N", "B", "K", "R")

_KINDS: tuple[Kind, ...] = ("white", "flicker", "walk", "walk")  # of the terms
_LIMITS: Mapping[str, Limit] = {"B": "flicker", "K": "walk", "R": "drift"}
_WIDTHS = (1, 2, 4, 8, 16, 32)  # stretches of a mean; of longer ones every start in 1/32 of the mean counts
_PRESENT = 0.5  # share of a stretch's samples from which on its mean is used
_FEWEST_STRETCHES = 4  # fewest stretches of the longest averaging time
_FEWEST_AVERAGES = 5  # fewest averages of a size that is listed
_FEWEST_OCTAVES = 6  # fewest octaves left when short ones are set aside
_SIZES = 12_000  # numbers of samples that are tried, evenly in their logarithm
_CHUNK = 1 << 16  # samples that are summed up at once
_MOST_DOF = 1000.0  # of an octave that count: four terms describe no deviation to better than 2 %
_WORTH = 8.0  # fall of the deviance that a kind of noise must bring; chance brings it once in two hundred records
_CREDIBLE = 1e-3  # accept the kinds of noise if chance makes a worse deviance more often than this
_GAIN = 0.1  # more samples help where twice as many lower the uncertainty by this share


@dataclass(frozen=True)
class Average:
    """The scatter of ``count`` averages of ``samples`` each, of one channel; mean, std and range in its unit."""

    samples: int
    count: int
    mean: float
    std: float
    range: float


@dataclass(frozen=True)
class AllanFit:
    """The kinds of noise that show in an Allan deviation."""

    value: Mapping[str, float]  # coefficients: N in unit √s, B in unit, K in unit/√s, R in unit/s
    first: int  # octave; before it samples are alike, or opposite, by a filter or an interference
    dof: Array  # (octaves,): degrees of freedom, by the kind that dominates there
    follows: bool  # whether the deviation follows the terms to within its uncertainty

    def parts(self, tau: Array) -> dict[str, Array]:
        """Return the deviation that each term would make alone, shape of ``tau`` (seconds)."""
        return {name: np.sqrt(_columns(tau)[:, TERMS.index(name)]) * value for name, value in self.value.items()}

    def variance(self, tau: Array) -> Array:
        """Allan variance that the terms make, shape of ``tau`` (seconds)."""
        return np.asarray(sum(part**2 for part in self.parts(tau).values()))


@dataclass(frozen=True)
class ChannelNoise:
    """The noise of one channel, in its unit."""

    mean: float
    count: int  # samples that are there
    step: float  # 0 where the reading is continuous
    averages: Sequence[Average]  # by rising size, from single samples on
    tau: Array  # (octaves,): averaging time, s
    deviation: Array  # (octaves,): Allan deviation
    low: Array  # its limits, 95 %
    high: Array
    terms: AllanFit

    @property
    def rounding(self) -> float:
        """What rounding leaves in a mean, however many samples it has, unit."""
        return rounding_uncertainty(float(self.deviation[0]), self.step)

    @property
    def lowest(self) -> tuple[float, float]:
        """Averaging time, seconds, and lowest deviation: of the kinds of noise that show, or as measured without."""
        tau, deviation = self.tau, self.deviation
        if self.terms.follows:
            tau = np.geomspace(self.tau[self.terms.first], self.tau[-1], 500)
            deviation = np.sqrt(self.terms.variance(tau))
        place = int(np.argmin(deviation))
        return float(tau[place]), float(deviation[place])

    @property
    def settled(self) -> bool:
        """Whether the deviation has stopped falling within the record."""
        return any(name != "N" for name in self.terms.value)

    def white(self, average: Average) -> float:
        """Return the standard deviation of averages of independent samples, unit."""
        return self.averages[0].std / sqrt(average.samples)

    def uncertainty(self, tau: Array) -> Array:
        """Return the standard uncertainty of a mean that takes ``tau`` seconds: of the kinds that show, or measured."""
        measured = np.exp(np.interp(np.log(tau), np.log(self.tau), np.log(self.deviation**2)))
        described = (tau >= self.tau[self.terms.first] * (1.0 - 1e-9)) & self.terms.follows
        return np.asarray(np.sqrt(np.where(described, self.terms.variance(tau), measured) + self.rounding**2))


@dataclass(frozen=True)
class NoiseScale:
    """The unit of readings, and by channel unit/g, which makes degrees of them, from a ``source``.

    The unit is None, and ``per_g`` empty, where nothing states them; under ``*`` it is unit/g of every channel.
    """

    unit: str | None
    per_g: Mapping[str, float]
    source: str = ""

    def of(self, channels: Sequence[str]) -> NoiseScale:
        """Return the scale of some channels, as far as it is stated."""
        per_g = {channel: abs(self.per_g[of]) for channel in channels for of in ("*", channel) if of in self.per_g}
        return NoiseScale(self.unit or "unit", per_g, self.source)

    def degrees(self, channel: str, value: float) -> float | None:
        """Return a small difference of readings as degrees of an axis near level; None without a scale."""
        return degrees(value / self.per_g[channel]) if channel in self.per_g else None


def characterise(samples: Array, interval: float) -> ChannelNoise:
    """Return the noise of one channel at rest, with averages of 1, 10, 100, ... samples.

    Samples, shape (n,), are ``interval`` seconds apart, NaN where a value is missing; an EstimateError refuses too few.
    """
    factor, variance = allan_variance(samples)
    if not len(factor):
        raise EstimateError("so much is missing that no two neighbouring averages are left")
    averages = [average(samples, 10**power) for power in range(8)]
    listed = [one for one in averages if one.count >= _FEWEST_AVERAGES]
    tau = np.asarray(factor * interval, dtype=np.float64)
    terms = kinds_of_noise(tau, variance, factor, len(samples))
    low, high = limits(variance, terms.dof)
    mean, count = averages[0].mean, averages[0].count
    return ChannelNoise(mean, count, even_step(samples), listed, tau, np.sqrt(variance), low, high, terms)


def average(samples: Array, size: int) -> Average:
    """Return the scatter of averages of ``size`` samples each, one behind the other; samples of shape (n,)."""
    sums, counts = _sums(samples, size)
    usable = sums[counts >= _PRESENT * size] / counts[counts >= _PRESENT * size]
    if len(usable) < 2:
        return Average(size, len(usable), float(usable.mean()) if len(usable) else nan, nan, nan)
    return Average(size, len(usable), float(usable.mean()), float(usable.std(ddof=1)), float(np.ptp(usable)))


def allan_variance(samples: Array) -> tuple[NDArray[np.int64], Array]:
    """Return samples per average by octaves, 1, 2, 4, ..., and the overlapping Allan variances above 0, unit²."""
    size, (sums, counts) = 1, _sums(samples, 1, zero=float(samples[np.argmax(np.isfinite(samples))]))
    variances = _variances(sums, counts, size, _WIDTHS, len(samples))
    while len(samples) >= _FEWEST_STRETCHES * 2 * size * _WIDTHS[-1]:
        even, size = len(sums) // 2 * 2, 2 * size
        sums, counts = (values[:even:2] + values[1:even:2] for values in (sums, counts))
        variances |= _variances(sums, counts, size, _WIDTHS[-1:], len(samples))
    usable = {factor: variance for factor, variance in variances.items() if variance > 0.0}
    return np.array(list(usable), dtype=np.int64), np.array(list(usable.values()))


def _sums(samples: Array, size: int, zero: float = 0.0) -> tuple[Array, Array]:
    """Return sums, about ``zero``, and numbers of the samples of stretches that follow each other, shape (m,) each."""
    stretches = (samples[: len(samples) // size * size] - zero).reshape(-1, size)
    there = np.isfinite(stretches)
    return np.sum(stretches, axis=1, where=there), there.sum(axis=1).astype(np.float64)


def _variances(sums: Array, counts: Array, size: int, widths: Sequence[int], samples: int) -> dict[int, float]:
    """Return the Allan variances of means over ``widths`` stretches of ``size`` samples, by samples; NaN of gaps."""
    widths = [width for width in widths if samples >= _FEWEST_STRETCHES * size * width]
    squares, pairs = np.zeros((2, len(widths)))
    for start in range(0, len(sums), _CHUNK):
        rows = slice(start, start + _CHUNK + 2 * widths[-1] - 1)
        total, there = (np.concatenate([[0.0], np.cumsum(one[rows])]) for one in (sums, counts))
        for place, width in enumerate(widths):
            last = min(_CHUNK, len(total) - 2 * width) + 2 * width
            ends, starts = slice(width, last), slice(max(last - width, 0))
            present = there[ends] - there[starts]
            mean = (total[ends] - total[starts]) / np.maximum(present, 1.0)
            usable = present >= _PRESENT * width * size
            change = (mean[width:] - mean[:-width])[usable[width:] & usable[:-width]]
            squares[place] += change @ change
            pairs[place] += len(change)
    variances = np.divide(squares, 2.0 * pairs, where=pairs > 0.0, out=np.full(len(widths), nan))
    return {width * size: float(variance) for width, variance in zip(widths, variances, strict=True)}


def degrees_of_freedom(kind: Kind, samples: float, factor: float) -> float:
    """Return the equivalent degrees of freedom of an overlapping Allan variance of ``factor`` samples per average.

    NIST Special Publication 1065, table 5; its N, the number of phases, is one more than that of the samples. For
    flicker noise and single samples N - 2 is squared here, as the scatter of simulated records demands; without the
    square, as allantools has it, there is less than one.
    """
    n, m = samples + 1.0, factor
    if kind == "white":
        dof = (3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    elif kind == "flicker":
        dof = 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9) if m < 2.0 else 5.0 * n**2 / (4.0 * m * (n + 3.0 * m))
    else:
        dof = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / (n - 3.0) ** 2
    return max(dof, 1.0)


def limits(variance: Array, dof: Array) -> tuple[Array, Array]:
    """Return the ends of the 95 % interval of the Allan deviation, from variances and their dof; shape (k,) each."""
    from scipy.special import chdtri

    tail = (1.0 - COVERAGE) / 2.0
    return np.sqrt(dof * variance / chdtri(dof, tail)), np.sqrt(dof * variance / chdtri(dof, 1.0 - tail))


def kinds_of_noise(tau: Array, variance: Array, factor: NDArray[np.int64], samples: int) -> AllanFit:
    """Return the fewest kinds of noise that make an Allan variance of a record of so many samples.

    Averaging times in seconds, variances and samples per average, shape (k,), rise by octaves. A term has to lower the
    deviance by its price. Short octaves that no terms describe are set aside one by one.
    """
    from scipy.special import chdtrc

    if not np.all(np.isfinite(variance)):
        raise EstimateError("the Allan variance is beyond any number: give the readings in another unit")
    table = np.array([[degrees_of_freedom(kind, samples, m) for kind in _KINDS] for m in factor.tolist()])
    fits: list[AllanFit] = []
    for first in range(max(1, len(tau) - _FEWEST_OCTAVES + 1)):
        octaves, terms = len(tau) - first, list(range(len(TERMS)))
        squares, dof, deviance = _squares(tau, variance, table, first, terms)
        while len(terms) > 1:
            left = [[term for term in terms if term != gone] for gone in terms]
            best, rest = min(
                ((_squares(tau, variance, table, first, rest), rest) for rest in left), key=lambda f: f[0][2]
            )
            if best[2] > deviance + _WORTH and len(terms) <= octaves:
                break
            terms, (squares, dof, deviance) = rest, best
        value = {TERMS[term]: sqrt(squares[term]) for term in terms if squares[term] > 0.0}
        free = octaves - len(terms)
        fits.append(AllanFit(value, first, dof, free <= 0 or float(chdtrc(free, deviance)) > _CREDIBLE))
        if fits[-1].follows:
            return fits[-1]
    return fits[0]


def _squares(tau: Array, variance: Array, table: Array, first: int, terms: Sequence[int]) -> tuple[Array, Array, float]:
    """Return the squares of all coefficients, the degrees of freedom of all octaves, and the deviance, by NNLS."""
    from scipy.optimize import nnls

    columns = _columns(tau)
    squares, made, dof = np.zeros(len(TERMS)), variance, table[:, terms[0]]
    for _ in range(8):
        root = np.sqrt(np.minimum(dof, _MOST_DOF)[first:]) / made[first:]
        weighted = columns[first:, terms] * root[:, None]
        scale = np.linalg.norm(weighted, axis=0)
        squares[terms] = nnls(weighted / scale, root * variance[first:])[0] / scale
        parts = columns * squares
        made = np.maximum(parts.sum(axis=1), 1e-3 * variance)
        dof = table[np.arange(len(table)), np.argmax(parts, axis=1)]
    ratio = (variance / made)[first:]
    return squares, dof, float(np.sum(np.minimum(dof, _MOST_DOF)[first:] * (ratio - 1.0 - np.log(ratio))))


def _columns(tau: Array) -> Array:
    """Return the variance of a unit of each term at each averaging time, shape (k, terms)."""
    return np.stack([1.0 / tau, np.full(len(tau), FLICKER**2), tau / 3.0, tau**2 / 2.0], axis=1)


def sample_size(noise: ChannelNoise, interval: float, target: float | None) -> tuple[int, Limit]:
    """Return the smallest number of samples whose mean is as good as a target, or from which on more do not help."""
    most = round(float(noise.tau[-1]) / interval)
    samples = np.unique(np.geomspace(1, most, _SIZES).round().astype(np.int64))
    u = noise.uncertainty(np.asarray(samples * interval, dtype=np.float64))
    if target is not None and np.any(u <= target):
        return int(samples[np.argmax(u <= target)]), "target"
    return _useful(noise, samples, u)


def sample_size_by_range(noise: ChannelNoise, target: float | None) -> int | None:
    """Return the number of samples whose averages lie within a target, or from which on more bring them no nearer.

    None where those of the longest averages do not. Between the sizes of the source's Table I it is interpolated.
    """
    sizes = [(average.samples, average.range) for average in noise.averages]
    if target is None:
        enough = (n for (n, width), (_, narrower) in pairwise(sizes) if narrower > (1.0 - _GAIN) * width)
        return next(enough, sizes[-1][0])
    if sizes[0][1] <= target:
        return 1
    for (n, width), (more, narrower) in pairwise(sizes):
        if narrower <= target:
            share = log(width / target) / log(width / narrower) if narrower else 1.0
            return ceil(float(n * (more / n) ** share))
    return None


def _useful(noise: ChannelNoise, samples: NDArray[np.int64], u: Array) -> tuple[int, Limit]:
    """Return the number of samples from which twice as many stop to help, or the longest, and the reason."""
    twice = np.interp(2.0 * samples, samples, u, right=nan)
    shorter = ~np.isnan(twice)
    # What falls again behind a hump, as after a vibration, must come below what there was before it.
    helps = np.flatnonzero(shorter & (twice <= (1.0 - _GAIN) * np.minimum.accumulate(u)))
    if not shorter.any() or (len(helps) and helps[-1] == np.flatnonzero(shorter)[-1]):
        return int(samples[-1]), "record"
    place = int(np.max(helps, initial=-1)) + 1
    if noise.rounding > float(u[place]) / sqrt(2.0):
        return int(samples[place]), "rounding"
    rest = {name: part[0] for name, part in noise.terms.parts(noise.tau[-1:]).items() if name in _LIMITS}
    limit = _LIMITS[max(rest, key=lambda name: rest[name])] if noise.terms.follows and rest else "unknown"
    return int(samples[place]), limit
