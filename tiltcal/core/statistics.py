"""Mean and uncertainty of a run of samples.

Sums of up to some thousand samples are rounded once (:func:`math.fsum`), and longer ones are made in an order that does
not depend on the processor, so a replayed session gives the same digits everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from math import fsum, hypot, inf, sqrt
from operator import mul

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.quantisation import rounding_uncertainty

BLOCKS = 10
"""Number of blocks whose means show correlation that std/sqrt(n) does not see."""

_FEW, _MANY = 4096, 1 << 14
"""Samples up to which a sum is rounded once, and those that are summed up together, within the processor's cache."""


@dataclass(frozen=True)
class SampleSummary:
    """The mean of a run of samples of one channel, and its uncertainty.

    Attributes
    ----------
    mean, std : float
        Arithmetic mean and sample standard deviation, in the unit of the samples.
    n : int
        Number of samples.
    u : float
        Standard uncertainty of the mean (type A, and quantisation), same unit.
    quantisation : float
        The part of ``u`` that quantisation gives, same unit.
    dof : float
        Degrees of freedom of the rest, the noise; infinite where it is known.
    resolution : float
        The step of the reading, same unit; 0 where it is continuous.
    correlation : float or None
        Correlation of neighbouring block means, -1/10 on average where there is none; None where there are no blocks,
        or where they are all alike.
    """

    mean: float
    std: float
    n: int
    u: float
    quantisation: float = 0.0
    dof: float = inf
    resolution: float = 0.0
    correlation: float | None = None

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


def summarise(samples: Sequence[float] | NDArray[np.float64], resolution: float = 0.0) -> SampleSummary:
    """Mean, standard deviation and the mean's standard uncertainty.

    The uncertainty is what the scatter of ten block means says, because samples of a real record are correlated and
    std/sqrt(n) does not see it; fewer than twenty samples have no blocks, and std/sqrt(n) it is. Quantisation is added:
    noise of half a step or more averages it out, a reading that never changes is uncertain by step/sqrt(12).

    Parameters
    ----------
    samples : sequence of float, or ndarray of shape (n,)
        At least one.
    resolution : float
        The step of the reading; 0 where it is continuous.
    """
    return summary_of([moments_of(np.asarray(samples, dtype=float))], resolution)


@dataclass(frozen=True)
class Moments:
    """The sums of some samples of a channel, from which the summary of many more follows.

    Attributes
    ----------
    n : int
    total : float
        Sum of the samples.
    mean : float
    squares : float
        Sum of the squares about the mean.
    low, high : float
        The smallest sample and the largest.
    first : int
        Number of the first block.
    blocks : sequence of (float, int)
        Sum and number of the samples of each block, as far as they are among these.
    """

    n: int
    total: float
    mean: float
    squares: float
    low: float
    high: float
    first: int
    blocks: Sequence[tuple[float, int]]


def moments_of(values: NDArray[np.float64], first: int = 0, edges: Sequence[int] = ()) -> Moments:
    """Sum up some samples.

    Parameters
    ----------
    values : ndarray, shape (n,)
        At least one.
    first : int
        Number of the first block.
    edges : sequence of int
        Where blocks begin among the samples, and the end of the last; ten equal ones without.
    """
    n, size = len(values), len(values) // BLOCKS
    edges = edges or range(0, BLOCKS * size + 1, max(size, 1))
    runs, low, high = list(pairwise((0, *edges, n))), float(values.min()), float(values.max())
    summands = _summands(values, runs)
    total = fsum(chain.from_iterable(summands))
    # Of samples that are all alike the mean would be rounded, and they would scatter about it in the last digit.
    mean = low if low == high else total / n
    blocks = [(fsum(run), end - start) for run, (start, end) in zip(summands, runs, strict=True)]
    (squares,) = _summands(values, [(0, n)], mean)
    return Moments(n, total, mean, fsum(squares), low, high, first, blocks[1:-1])


def summary_of(parts: Sequence[Moments], resolution: float = 0.0) -> SampleSummary:
    """Return what :func:`summarise` returns of the samples of all parts, in order."""
    n = sum(part.n for part in parts)
    alike = min(part.low for part in parts) == max(part.high for part in parts)
    mean = parts[0].low if alike else fsum(part.total for part in parts) / n
    squares = fsum(part.squares + part.n * (part.mean - mean) ** 2 for part in parts)
    std = sqrt(squares / (n - 1)) if n > 1 else 0.0
    noise, dof, correlation = _type_a(_block_means(parts) if n >= 2 * BLOCKS else [], n, std)
    step = rounding_uncertainty(std, resolution)
    return SampleSummary(mean, std, n, sqrt(noise**2 + step**2), step, dof, resolution, correlation)


def _block_means(parts: Sequence[Moments]) -> list[float]:
    """Return the means of ten blocks, each of as many of the parts' blocks."""
    count = max(part.first + len(part.blocks) for part in parts)
    sums, counts = [0.0] * count, [0] * count
    for part in parts:
        for number, (total, size) in enumerate(part.blocks, start=part.first):
            sums[number] += total
            counts[number] += size
    each = count // BLOCKS
    groups = [slice(each * group, each * (group + 1)) for group in range(BLOCKS)]
    return [fsum(sums[group]) / sum(counts[group]) for group in groups]


def drift(times: Sequence[float], samples: Sequence[float]) -> tuple[float, float]:
    """Change over ``times`` along the least-squares line, and its standard uncertainty, in the unit of the samples.

    Parameters
    ----------
    times : sequence of float
        Seconds, not decreasing, at least three. Where all are one instant nothing can have changed.
    """
    n = len(samples)
    middle, mean = fsum(times) / n, fsum(samples) / n
    later, off = [time - middle for time in times], [sample - mean for sample in samples]
    spread = fsum(map(mul, later, later))
    if spread == 0.0:
        return 0.0, 0.0
    slope = fsum(map(mul, later, off)) / spread
    rest = fsum([(value - slope * time) ** 2 for time, value in zip(later, off, strict=True)])
    span = times[-1] - times[0]
    return slope * span, sqrt(rest / max(n - 2, 1) / spread) * span


def _summands(
    values: NDArray[np.float64], runs: Sequence[tuple[int, int]], mean: float | None = None
) -> list[list[float]]:
    """Return numbers that have the sum of each run: of few values these, of many the pairwise sums of some each.

    Parameters
    ----------
    values : ndarray, shape (n,)
    mean : float, optional
        Sum up the squares of the distances from it in place of the values.
    """
    parts: list[list[float]] = [[] for _ in runs]
    for begin in range(0, len(values), _MANY):
        some = values[begin : begin + _MANY]
        some = some if mean is None else np.square(some - mean)
        for part, (start, end) in zip(parts, runs, strict=True):
            if start < begin + _MANY and begin < end:
                run = some[max(start - begin, 0) : end - begin]
                part.extend(run.tolist() if len(values) <= _FEW else [float(run.sum())])
    return parts


def _type_a(means: Sequence[float], n: int, std: float) -> tuple[float, float, float | None]:
    """Return the mean's standard uncertainty from the scatter of block means, its dof, and the blocks' correlation."""
    if not means:
        return std / sqrt(n), float(max(n - 1, 1)), None
    centre = fsum(means) / BLOCKS
    off = [mean - centre for mean in means]
    squares = fsum(value**2 for value in off)
    neighbours = fsum(value * other for value, other in pairwise(off))
    correlation = neighbours / squares if squares > 0.0 else None
    return sqrt(squares / (BLOCKS - 1) / BLOCKS), BLOCKS - 1.0, correlation
