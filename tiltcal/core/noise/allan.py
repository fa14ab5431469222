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
        counts = None if present is None else present.T.astype(np.float64, order="C")
        stretches = _Stretches(1, np.ascontiguousarray(samples.T), counts)
        depth = 0
        while stretches.number:
            if depth == len(self._levels):
                self._levels.append(_Level(self._channels, depth))
            stretches = self._levels[depth].add(stretches)
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


@dataclass(frozen=True)
class _Stretches:
    """Sums of the samples of stretches, shape (channels, number), and the numbers of samples that are there.

    Attributes
    ----------
    size : int
        Samples of a stretch.
    counts : ndarray, shape (channels, number), or None
        None where no sample is missing.
    """

    size: int
    sums: Array
    counts: Array | None

    @property
    def number(self) -> int:
        return len(self.sums[0])

    def behind(self, earlier: _Stretches) -> _Stretches:
        """Return the stretches with earlier ones before them."""
        counts = None
        if self.counts is not None or earlier.counts is not None:
            counts = np.concatenate([earlier.known_counts(), self.known_counts()], axis=1)
        return _Stretches(self.size, np.concatenate([earlier.sums, self.sums], axis=1), counts)

    def known_counts(self) -> Array:
        return np.full(self.sums.shape, float(self.size)) if self.counts is None else self.counts

    def part(self, start: int, end: int | None = None) -> _Stretches:
        counts = None if self.counts is None else self.counts[:, start:end]
        return _Stretches(self.size, self.sums[:, start:end], counts)

    def copy(self) -> _Stretches:
        """Return them in memory of their own, which a part has not."""
        whole = self.counts is None or self.counts.min(initial=self.size) == self.size
        return _Stretches(self.size, self.sums.copy(), None if whole else self.known_counts().copy())

    def joined(self, lag: int) -> _Stretches:
        """Return each stretch together with the one ``lag`` places behind it."""
        counts = None if self.counts is None else self.counts[:, :-lag] + self.counts[:, lag:]
        return _Stretches(2 * self.size, self.sums[:, :-lag] + self.sums[:, lag:], counts)

    def halved(self) -> _Stretches:
        """Return the stretches by twos, an even number of them."""
        counts = None if self.counts is None else self.counts[:, ::2] + self.counts[:, 1::2]
        return _Stretches(2 * self.size, self.sums[:, ::2] + self.sums[:, 1::2], counts)

    def differences(self, lag: int) -> tuple[Array, Array]:
        """Return the sums of squared differences to the mean ``lag`` places behind, and how many there are.

        Both have the shape (channels,). A mean counts if :data:`PRESENT` of its samples are there.
        """
        if self.counts is None:
            change = self.sums[:, lag:] - self.sums[:, :-lag]
            return np.einsum("ij,ij->i", change, change) / float(self.size) ** 2, np.full(len(change), change.shape[1])
        enough = self.counts >= PRESENT * self.size
        mean = np.divide(self.sums, self.counts, out=np.zeros_like(self.sums), where=enough)
        both = enough[:, lag:] & enough[:, :-lag]
        change = np.where(both, mean[:, lag:] - mean[:, :-lag], 0.0)
        return np.einsum("ij,ij->i", change, change), both.sum(axis=1)


class _Level:
    """The stretches of 2**depth samples, one behind the other, and the differences between means of several of them."""

    def __init__(self, channels: int, depth: int) -> None:
        self.depth = depth
        self.widths = (1, 2, 4, 8, 16, STARTS) if depth == 0 else (STARTS,)
        self._last = self._odd = _Stretches(1 << depth, np.empty((channels, 0)), None)
        self._squares = np.zeros((len(self.widths), channels))
        self._pairs = np.zeros((len(self.widths), channels))

    def add(self, new: _Stretches) -> _Stretches:
        """Take more stretches; return those of the level above that are whole by now."""
        known = self._last.number
        held = longer = new.behind(self._last)
        self._last = held.part(max(0, held.number - 2 * STARTS + 1)).copy()
        width = 1
        while longer.number > width:
            if width in self.widths:
                # Only the pairs whose last stretch is new.
                squares, pairs = longer.part(max(0, known - 2 * width + 1)).differences(width)
                place = self.widths.index(width)
                self._squares[place] += squares
                self._pairs[place] += pairs
            if width == STARTS:
                break
            longer, width = longer.joined(width), 2 * width
        return self._halved(new)

    def variance(self, place: int) -> Array:
        """Return the Allan variance of one width, shape (channels,)."""
        pairs = self._pairs[place]
        return np.asarray(self._squares[place] / (2.0 * np.where(pairs > 0, pairs, np.nan)))

    def _halved(self, new: _Stretches) -> _Stretches:
        held = new.behind(self._odd)
        even = held.number // 2 * 2
        self._odd = held.part(even).copy()
        return held.part(0, even).halved()


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
