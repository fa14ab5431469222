"""The kinds of noise that an Allan deviation is made of, fitted.

The model is the sum of four that are independent of each other (IEEE Std 952-1997, annex C, with τ in seconds)::

    σ²(τ) = N²/τ + (2 ln 2 / π) B² + K² τ/3 + R² τ²/2

N is white noise (velocity random walk, where the reading is an acceleration), B flicker noise (bias instability), K
random walk (of the bias), R a steady drift. Rounding of a reading that is noisy enough is white and part of N; the
standard's quantisation term, of integrating sensors, does not occur.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from math import log, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.noise.allan import Kind, degrees_of_freedom
from tiltcal.errors import EstimateError

TERMS = ("N", "B", "K", "R")

FLICKER = sqrt(2.0 * log(2.0) / pi)
"""Deviation of flicker noise over its coefficient B: 0.664."""

_KINDS: tuple[Kind, ...] = ("white", "flicker", "walk", "walk")

_FEWEST_OCTAVES = 6
"""Octaves that must be left when short ones are set aside."""

_CORRELATION: Mapping[Kind, Array] = {
    "white": np.array([1.0, 0.53, 0.19, 0.06, 0.02]),
    "flicker": np.array([1.0, 0.67, 0.30, 0.12, 0.05]),
    "walk": np.array([1.0, 0.87, 0.66, 0.47, 0.32]),
}
"""Of overlapping Allan variances that are 0, 1, ... octaves apart, from 1,500 simulated records; 0 beyond."""

_MOST_DOF = 1000.0
"""Of an octave's weight: a model of four terms is not trusted to better than 2 % of a deviation."""

_WORTH = 8.0
"""By how much a term must lower the deviance to be accepted; chance does it once in two hundred times."""

_DOUBTFUL = 1e-3
"""A fit that chance makes worse less often than this is none."""

_ROUNDS, _SETTLED = 25, 1e-9


@dataclass(frozen=True)
class AllanFit:
    """The kinds of noise that show.

    Attributes
    ----------
    value, u : mapping of str to float
        Coefficients of the terms that show, with their standard uncertainties: N in unit √s, B in unit, K in unit/√s,
        R in unit/s.
    first : int
        Index of the octave from which on they describe the deviation. Before it neighbouring samples are alike, or
        opposite, by a filter or an interference.
    dof : ndarray, shape (k,)
        Equivalent degrees of freedom of every octave, by the kind of noise that dominates there.
    follows : bool
        Whether the deviation follows them to within its uncertainty.
    """

    value: Mapping[str, float]
    u: Mapping[str, float]
    first: int
    dof: Array
    follows: bool

    def variance(self, tau: Array) -> Array:
        """Allan variance that the terms make, shape of ``tau`` (seconds)."""
        squares = np.array([self.value.get(name, 0.0) ** 2 for name in TERMS])
        return np.asarray(_columns(tau) @ squares)

    def parts(self, tau: Array) -> dict[str, Array]:
        """Return the deviation that each term would make alone, shape of ``tau`` (seconds)."""
        columns = _columns(tau)
        return {name: np.sqrt(columns[:, TERMS.index(name)]) * value for name, value in self.value.items()}


def terms_of(tau: Array, variance: Array, factor: NDArray[np.int64], samples: int) -> AllanFit:
    """Return the fewest kinds of noise that make an Allan variance.

    Parameters
    ----------
    tau : ndarray, shape (k,)
        Averaging times, seconds, rising by octaves.
    variance : ndarray, shape (k,)
        Overlapping Allan variance, above 0.
    factor : ndarray of int, shape (k,)
        Samples per average.
    samples : int
        In the record.

    Notes
    -----
    Maximum likelihood of variances that are chi-square distributed with their equivalent degrees of freedom, for each
    choice of terms; of the choices the one whose deviance, with a price for each term, is lowest. Short octaves that no
    choice describes are set aside one by one.
    """
    spectrum = _Spectrum(tau, variance, factor, samples)
    whole = None
    for first in range(max(1, len(tau) - _FEWEST_OCTAVES + 1)):
        terms = spectrum.fitted(first)
        whole = whole or terms
        if terms.follows:
            return terms
    return whole or spectrum.fitted(0)


@dataclass(frozen=True)
class _Spectrum:
    tau: Array
    variance: Array
    factor: NDArray[np.int64]
    samples: int

    def fitted(self, first: int) -> AllanFit:
        """Return the best terms from an octave on."""
        dof = self._dof(np.zeros(len(self.tau), dtype=np.intp))
        for _ in range(3):  # which kind dominates decides the weights, and they the fit
            chosen, squares = self._best(first, np.minimum(dof, _MOST_DOF))
            columns = _columns(self.tau)[:, chosen] * squares
            dominating = np.array(chosen)[np.argmax(columns, axis=1)]
            dof = self._dof(dominating)
        weights = np.minimum(dof, _MOST_DOF)[first:]
        made = columns[first:].sum(axis=1)
        parts = columns[first:] / made[:, None]
        solver = np.linalg.pinv(parts.T @ (parts * weights[:, None])) @ (parts * weights[:, None]).T
        # A steady drift of share s is no chance: the variance of (mean + error)² is that of error² times (1 - s²).
        chance = np.sqrt(1.0 - np.minimum(parts[:, np.array(chosen) == TERMS.index("R")].sum(axis=1), 1.0) ** 2)
        covariance = solver @ (_scatter(dof[first:], dominating[first:]) * np.outer(chance, chance)) @ solver.T
        relative = np.sqrt(np.diag(covariance)) / 2.0
        values = np.sqrt(squares)
        names = [TERMS[index] for index in chosen]
        return AllanFit(
            dict(zip(names, values.tolist(), strict=True)),
            dict(zip(names, (relative * values).tolist(), strict=True)),
            first,
            dof,
            self._follows(self.variance[first:] / made, weights, len(chosen)),
        )

    def _dof(self, dominating: NDArray[np.intp]) -> Array:
        return np.array(
            [
                degrees_of_freedom(_KINDS[kind], self.samples, factor)
                for kind, factor in zip(dominating.tolist(), self.factor.tolist(), strict=True)
            ]
        )

    def _best(self, first: int, dof: Array) -> tuple[list[int], Array]:
        columns, variance, weight = _columns(self.tau[first:]), self.variance[first:], dof[first:]
        choices = _choices(len(variance))
        squares = _likeliest(columns, variance, weight, choices)
        with np.errstate(divide="ignore", invalid="ignore"):
            deviance = _deviance(variance / (squares @ columns.T), weight)
        # A choice with a term that is nothing does no better than the one without it.
        price = np.where((squares > 0.0).sum(axis=1) == choices.sum(axis=1), deviance, np.inf)
        best = int(np.argmin(price + _WORTH * choices.sum(axis=1)))
        if not price[best] < np.inf:
            raise EstimateError("the Allan variance is zero or beyond any number: give the readings in another unit")
        chosen = np.flatnonzero(choices[best])
        return chosen.tolist(), squares[best, chosen]

    @staticmethod
    def _follows(ratio: Array, dof: Array, terms: int) -> bool:
        from scipy.special import chdtrc

        left = len(ratio) - terms
        return left <= 0 or float(chdtrc(left, _deviance(ratio, dof))) > _DOUBTFUL


def _scatter(dof: Array, dominating: NDArray[np.intp]) -> Array:
    """Return the covariance of the relative errors of the octaves, which share the readings, shape (k, k)."""
    octave = np.arange(len(dof))
    apart = np.abs(octave[:, None] - octave)
    longer = dominating[np.maximum(octave[:, None], octave)]
    table = np.stack([_CORRELATION[kind] for kind in _KINDS])
    alike = np.where(apart < table.shape[1], table[longer, np.minimum(apart, table.shape[1] - 1)], 0.0)
    return np.asarray(2.0 * alike / np.sqrt(np.outer(dof, dof)))


def _columns(tau: Array) -> Array:
    """Return the variance of a unit of each term at each averaging time, shape (k, terms)."""
    return np.stack([1.0 / tau, np.full(len(tau), FLICKER**2), tau / 3.0, tau**2 / 2.0], axis=1)


def _deviance(ratio: Array, dof: Array) -> Array:
    """Return the deviance of chi-square distributed variances from a model; ``ratio`` is along the last axis."""
    return np.asarray(np.sum(dof * (ratio - 1.0 - np.log(ratio)), axis=-1))


def _choices(most: int) -> NDArray[np.bool_]:
    """Return which terms each choice of at most so many takes, shape (choices, terms); few terms come first."""
    every = np.array(sorted(product((False, True), repeat=len(TERMS)), key=sum))
    count = every.sum(axis=1)
    return np.asarray(every[(count > 0) & (count <= most)])


def _likeliest(columns: Array, variance: Array, dof: Array, choices: NDArray[np.bool_]) -> Array:
    """Return the squares of the coefficients of each choice of terms, by least squares whose weights follow the model.

    A term that would be below zero is 0.
    """
    apart = np.eye(len(TERMS)) * ~choices[:, None, :]
    both = choices[:, :, None] & choices[:, None, :]
    made = np.broadcast_to(variance, (len(choices), len(variance)))
    squares = np.zeros(choices.shape)
    for _ in range(_ROUNDS):
        weights = dof / made**2
        normal = np.where(both, np.einsum("ck,ki,kj->cij", weights, columns, columns), apart)
        scale = np.sqrt(np.einsum("cii->ci", normal))
        right = choices * ((weights * variance) @ columns) / scale
        solved = np.linalg.solve(normal / (scale[:, :, None] * scale[:, None, :]), right[:, :, None])[:, :, 0]
        found = np.maximum(solved / scale, 0.0)
        settled = np.all(np.abs(found - squares) <= _SETTLED * squares)
        squares, made = found, found @ columns.T
        made = np.where(made > 0.0, made, variance)
        if settled:
            break
    return squares
