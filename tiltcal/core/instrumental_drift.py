"""Instrumental drift: the random walk of a coefficient between its calibrations, estimated from earlier ones.

The model of a coefficient c of one sensor, with a Wiener process W whose variance grows by ``rate`` a day::

    c(t) = c0 + slope t + W(t)

A calibration measures c(t) with its own uncertainty. Between two of them the line that joins them is the best estimate,
and the walk deviates from it with the variance of a Brownian bridge; beyond the last one it deviates freely::

    rate (t - t0)(t1 - t) / (t1 - t0)        and        rate |t - t1|

Differences of successive calibrations, over the square root of the time between them, are the data. Without their part
along a steady slope, and diagonalised, they are independent with the variances ``rate + noise``. The posterior of the
rate under Jeffreys' prior gives its value and its degrees of freedom, so that the interval of a deviation has Student's
factor.

Sources: B. Øksendal, *Stochastic Differential Equations*, exercise 5.11 (bridge); H. Jeffreys, *Theory of
Probability*, 3.10 (prior of a variance).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from tiltcal.core.coverage_factor import COVERAGE
from tiltcal.core.model import Array

_GRID = 200
_REACH = 1e6  # of the grid of rates about the largest and the smallest that the data may mean


@dataclass(frozen=True)
class RandomWalk:
    """The random walk of a coefficient: how far it wanders.

    Attributes
    ----------
    rate : float
        The variance that a day adds, unit²/d.
    dof : float
        The degrees of freedom of the rate; infinite where it is stated.
    """

    rate: float
    dof: float = inf


@dataclass(frozen=True)
class WalkContrasts:
    """Independent differences of the calibrations of a coefficient.

    Attributes
    ----------
    value : ndarray, shape (k,)
        Unit/√d.
    noise : ndarray, shape (k,)
        The variance of each that the calibrations' own uncertainty makes, unit²/d.
    """

    value: Array
    noise: Array

    def __len__(self) -> int:
        """Return their number."""
        return len(self.value)

    @classmethod
    def joined(cls, parts: Sequence[WalkContrasts]) -> WalkContrasts:
        """Return the contrasts of several coefficients, such as the offsets of a fleet."""
        empty = [np.zeros(0)]
        return cls(
            np.concatenate(empty + [part.value for part in parts]),
            np.concatenate(empty + [part.noise for part in parts]),
        )


def walk_contrasts(days: Array, values: Array, u: Array, *, steady: bool) -> WalkContrasts:
    """Return the independent differences of a coefficient's calibrations.

    Parameters
    ----------
    days : ndarray, shape (n,)
        When they were made, ascending, d.
    values : ndarray, shape (n,)
        The coefficient, unit.
    u : ndarray, shape (n,)
        Its standard uncertainties, unit.
    steady : bool
        Leave out what a steady change explains: n - 2 contrasts are left, else n - 1.
    """
    steps = np.sqrt(np.diff(days))
    to_steps = np.diff(np.eye(len(days)), axis=0) / steps[:, None]
    if steady:
        to_steps = _across(steps) @ to_steps
    noise, axes = np.linalg.eigh(to_steps @ (to_steps * u**2).T)
    return WalkContrasts(axes.T @ (to_steps @ values), np.maximum(noise, 0.0))


def estimate_walk(contrasts: WalkContrasts) -> RandomWalk | None:
    """Estimate how far a coefficient wanders; None where there is no contrast.

    Returns
    -------
    RandomWalk
        Student's t with its degrees of freedom, scaled by the root of its rate, has the median and the 95 % half width
        of a deviation under the posterior of the rate. Degrees of freedom are 1 at least.
    """
    if not len(contrasts):
        return None
    from scipy.special import ndtr, stdtrit

    square = contrasts.value**2
    largest = max(float(np.max(square + contrasts.noise)), np.finfo(float).tiny * _REACH)
    rates = np.geomspace(largest / _REACH, largest * _REACH**0.5, _GRID)
    total = rates[:, None] + contrasts.noise + largest * 1e-12
    prior = np.log(np.sum(total**-2.0, axis=1)) / 2.0
    log_density = prior - np.sum(np.log(total) + square / total, axis=1) / 2.0 + np.log(rates)
    weight = np.exp(log_density - log_density.max())
    weight /= weight.sum()
    half = np.sqrt(largest) * np.geomspace(1e-3, 1e3, 600)
    beyond = 2.0 * ndtr(-half[:, None] / np.sqrt(rates)) @ weight
    median, widest = (float(np.interp(-share, -beyond, half)) for share in (0.5, 1.0 - COVERAGE))
    dof = np.geomspace(1.0, 1e4, 200)
    ratios = stdtrit(dof, 0.5 + COVERAGE / 2.0) / stdtrit(dof, 0.75)
    found = float(np.interp(-widest / median, -ratios, dof))
    return RandomWalk((widest / float(stdtrit(found, 0.5 + COVERAGE / 2.0))) ** 2, found)


def _across(direction: Array) -> Array:
    """Return orthonormal rows that are orthogonal to a direction, shape (n - 1, n)."""
    full = np.linalg.qr(np.column_stack([direction, np.eye(len(direction))]))[0]
    return np.asarray(full[:, 1:].T)
