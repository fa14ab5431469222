"""Mean and uncertainty of a run of samples.

Sums are rounded once (:func:`math.fsum`), so a replayed session gives the same digits on every processor.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import fsum, inf, sqrt
from operator import mul

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.quantisation import rounding_left
from tiltcal.frozen import frozen

BLOCKS = 10
"""Number of blocks whose means show correlation that std/sqrt(n) does not see."""

_COLUMNS, _FEWEST_ROWS = 1024, 8
"""Of a long run of samples that is summed as a table: its columns, and the rows from which on it is one."""


@frozen
class SampleSummary:
    """What a run of samples of one channel says.

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
    values = np.asarray(samples, dtype=float)
    n = len(values)
    # Of samples that are all alike the mean would be rounded, and they would scatter about it in the last digit.
    mean = float(values[0]) if values.min() == values.max() else _sum(values) / n
    std = sqrt(_sum(np.square(values - mean)) / (n - 1)) if n > 1 else 0.0
    noise, dof, correlation = _type_a(values, std)
    step = rounding_left(std, resolution)
    return SampleSummary(mean, std, n, sqrt(noise**2 + step**2), step, dof, resolution, correlation)


def drift(times: Sequence[float], samples: Sequence[float]) -> tuple[float, float]:
    """Change over the span of ``times`` along the least-squares line, and its standard uncertainty.

    Parameters
    ----------
    times : sequence of float
        Seconds, not decreasing, at least three. Where all are one instant nothing can have changed.

    Returns
    -------
    change, uncertainty : float
        In the unit of the samples.
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


def _sum(values: NDArray[np.float64]) -> float:
    """Return the sum, rounded once; of many values column by column, with what each addition rounds away."""
    rows = len(values) // _COLUMNS
    if rows < _FEWEST_ROWS:
        return fsum(values.tolist())
    total, lost = np.zeros((2, _COLUMNS))
    for row in values[: rows * _COLUMNS].reshape(rows, _COLUMNS):
        # Knuth, The Art of Computer Programming, vol. 2, 4.2.2, theorem B: the error of a sum, exactly.
        longer = total + row
        added = longer - total
        lost += (total - (longer - added)) + (row - added)
        total = longer
    return fsum([*total.tolist(), *lost.tolist(), *values[rows * _COLUMNS :].tolist()])


def _type_a(samples: NDArray[np.float64], std: float) -> tuple[float, float, float | None]:
    """Return the mean's standard uncertainty from the samples' scatter, its dof, and the correlation of the blocks."""
    n = len(samples)
    size = n // BLOCKS
    if size < 2:
        return std / sqrt(n), float(max(n - 1, 1)), None
    means = [_sum(samples[k * size : (k + 1) * size]) / size for k in range(BLOCKS)]
    centre = fsum(means) / BLOCKS
    off = [mean - centre for mean in means]
    squares = fsum(value**2 for value in off)
    neighbours = fsum(value * other for value, other in pairwise(off))
    correlation = neighbours / squares if squares > 0.0 else None
    return sqrt(squares / (BLOCKS - 1) / BLOCKS), BLOCKS - 1.0, correlation
