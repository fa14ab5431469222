"""Allan deviation of readings, by octaves, from a record of any length.

The Allan deviation σ(τ) is the standard deviation, over √2, of the difference between the means of two neighbouring
stretches of length τ. So it is the standard uncertainty of a mean that took τ, of a reading whose zero wanders: what
lies further back than the stretch before is left out. Its square for averages of m samples is

    σ²(m) = 1/2 <(mean of samples k+m ... k+2m-1  -  mean of samples k ... k+m-1)²>

averaged over all k (the overlapping Allan variance, NIST Special Publication 1065, eq. 11). Stretches that start a
thirty-second of their length apart show as much as those that start at every sample, so each octave from the sixth on
is worked out from the means of the octave five below: the memory needed is some blocks of each octave.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.coverage_factor import COVERAGE
from tiltcal.core.flags import Mask
from tiltcal.core.model import Array

Kind = Literal["white", "flicker", "walk"]
"""Noise whose deviation falls with the root of τ, does not change, or grows with the root of τ."""

STARTS = 32
"""Starts of overlapping stretches in the length of one."""

PRESENT = 0.5
"""Share of its samples that a stretch must have for its mean to count."""

FEWEST_STRETCHES = 4
"""How many times an averaging time must fit into the record."""


@dataclass(frozen=True)
class AllanVariance:
    """Allan variance by octaves.

    Attributes
    ----------
    factor : ndarray of int, shape (k,)
        Samples per average: 1, 2, 4, ...
    variance : ndarray, shape (k, channels)
        Unit²; NaN where the gaps leave no pair of stretches.
    """

    factor: NDArray[np.int64]
    variance: Array


class Octaves:
    """Collects the Allan variance of some channels along their samples."""

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._levels: list[_Level] = []
        self._rows = 0

    def add(self, samples: Array, present: Mask | None) -> None:
        """Take more samples, evenly spaced behind the last ones.

        Parameters
        ----------
        samples : ndarray, shape (n, channels)
            Zero where they are missing, and better not far from it elsewhere.
        present : ndarray of bool, shape (n, channels), or None
            None where no sample is missing.
        """
        self._rows += len(samples)
        sums = np.ascontiguousarray(samples.T)
        counts = np.ones_like(sums) if present is None else present.T.astype(np.float64, order="C")
        depth = 0
        while sums.shape[1]:
            if depth == len(self._levels):
                self._levels.append(_Level(self._channels, depth))
            sums, counts = self._levels[depth].add(sums, counts)
            depth += 1

    def result(self) -> AllanVariance:
        """Return the variances so far, for averages that fit :data:`FEWEST_STRETCHES` times into the samples."""
        found = {
            width << level.depth: level.variance(place)
            for level in self._levels
            for place, width in enumerate(level.widths)
            if FEWEST_STRETCHES * (width << level.depth) <= self._rows
        }
        factors = np.array(sorted(found), dtype=np.int64)
        variance = np.array([found[factor] for factor in factors.tolist()]).reshape(-1, self._channels)
        return AllanVariance(factors, variance)


class _Level:
    """Blocks of 2**depth samples, and the differences between the means of ``widths`` of them."""

    def __init__(self, channels: int, depth: int) -> None:
        self.depth = depth
        self.widths = (1, 2, 4, 8, 16, STARTS) if depth == 0 else (STARTS,)
        empty = np.empty((channels, 0))
        self._tail, self._tail_counts = empty, empty
        self._odd, self._odd_counts = empty, empty
        self._squares = np.zeros((len(self.widths), channels))
        self._pairs = np.zeros((len(self.widths), channels))

    def add(self, sums: Array, counts: Array) -> tuple[Array, Array]:
        """Take more blocks, shape (channels, n); return those of the level above that are whole by now."""
        held, held_counts = _joined(self._tail, sums), _joined(self._tail_counts, counts)
        known = self._tail.shape[1]
        total = _running(held)
        total_counts = None if held_counts.min() == 1 << self.depth else _running(held_counts)
        for place, width in enumerate(self.widths):
            # Only the pairs whose last block is new.
            start = max(0, known - 2 * width + 1)
            if total_counts is None:
                self._count_whole_pairs(place, width, total[:, start:])
            else:
                self._count_pairs(place, width, total[:, start:], total_counts[:, start:])
        kept = 2 * self.widths[-1] - 1
        self._tail, self._tail_counts = held[:, -kept:].copy(), held_counts[:, -kept:].copy()
        return self._halved(sums, counts)

    def variance(self, place: int) -> Array:
        """Return the Allan variance of one width, shape (channels,)."""
        pairs = self._pairs[place]
        return np.asarray(self._squares[place] / (2.0 * np.where(pairs > 0, pairs, np.nan)))

    def _count_whole_pairs(self, place: int, width: int, total: Array) -> None:
        """Count the pairs of stretches in which no sample is missing."""
        pairs = total.shape[1] - 2 * width
        if pairs <= 0:
            return
        stretch = total[:, width:] - total[:, :-width]
        change = stretch[:, width:] - stretch[:, :-width]
        self._squares[place] += np.einsum("ij,ij->i", change, change) / float(width << self.depth) ** 2
        self._pairs[place] += pairs

    def _count_pairs(self, place: int, width: int, total: Array, counts: Array) -> None:
        if total.shape[1] <= 2 * width:
            return
        stretch, filled = total[:, width:] - total[:, :-width], counts[:, width:] - counts[:, :-width]
        whole = filled >= PRESENT * (width << self.depth)
        mean = np.divide(stretch, filled, out=np.zeros_like(stretch), where=whole)
        both = whole[:, width:] & whole[:, :-width]
        self._squares[place] += np.sum(np.where(both, mean[:, width:] - mean[:, :-width], 0.0) ** 2, axis=1)
        self._pairs[place] += both.sum(axis=1)

    def _halved(self, sums: Array, counts: Array) -> tuple[Array, Array]:
        sums, counts = _joined(self._odd, sums), _joined(self._odd_counts, counts)
        even = sums.shape[1] // 2 * 2
        self._odd, self._odd_counts = sums[:, even:].copy(), counts[:, even:].copy()
        return sums[:, 0:even:2] + sums[:, 1:even:2], counts[:, 0:even:2] + counts[:, 1:even:2]


def _joined(earlier: Array, later: Array) -> Array:
    return np.concatenate([earlier, later], axis=1)


def _running(values: Array) -> Array:
    """Return the sums of the first 0, 1, 2, ... values of each channel."""
    total = np.zeros((len(values), values.shape[1] + 1))
    np.cumsum(values, axis=1, out=total[:, 1:])
    return total


def degrees_of_freedom(kind: Kind, samples: float, factor: float) -> float:
    """Equivalent degrees of freedom of an overlapping Allan variance.

    Parameters
    ----------
    kind : str
        The noise that dominates at this averaging time.
    samples : float
        In the record.
    factor : float
        Samples per average.

    Notes
    -----
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
    """Return the ends of the interval that holds the true Allan deviation with a probability of 95 %, shape (k,) each.

    Parameters
    ----------
    variance, dof : ndarray, shape (k,)
        Allan variance and its equivalent degrees of freedom.
    """
    from scipy.special import chdtri

    tail = (1.0 - COVERAGE) / 2.0
    return np.sqrt(dof * variance / chdtri(dof, tail)), np.sqrt(dof * variance / chdtri(dof, 1.0 - tail))
