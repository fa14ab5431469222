"""The jig's uncertainty where it was not stated: the residuals show it.

The errors of the readings are noise and what else is known, with the covariance N, and the errors of the attitude
angles a, whose variance q is not known::

    residual = M (n + A a),    cov = V = N + q A Aᵀ

M takes away what the coefficients can follow, and A holds the readings' sensitivities to the angles. ``q`` is found by
restricted maximum likelihood (REML): in the space that M leaves, whitened by N, the singular directions of A are
independent with variances 1 + q d². A q below zero is kept, as far as V stays positive: the residuals are then smaller
than the noise by chance, and as much smaller the coefficients that depend on the attitudes scatter. For one channel
whose positions all depend on it alike this is the textbook's standard deviation of the residuals with Student's t.

Where no attitude shows in the residuals, they show the size of the noise instead. Where nothing is stated of the noise,
their variances are f + q d² with f unknown.

Sources: H. D. Patterson, R. Thompson, *Recovery of inter-block information*, Biometrika 58 (1971) 545; M. G. Kenward,
J. H. Roger, *Small sample inference for fixed effects from REML*, Biometrics 53 (1997) 983; G. E. P. Box, G. C. Tiao,
*Bayesian Inference in Statistical Analysis* (1973), 5.2 for f.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.coverage_factor import degrees_of_freedom, half_width
from tiltcal.core.model import Array

IMPROBABLE = 0.01
"""Probability below which what is left, when the attitudes are taken out, is more than the noise that was measured."""

BISECTIONS = 200

POSITIVE = 0.9
"""How much of the noise a negative q may take away, where it takes away most."""

INSENSITIVE = 1e-9
"""A direction with less than this share of the whole sensitivity to the attitudes has none."""

VARIANCES, JIGS = 100, 40
"""Variances of the noise and of the jig that are distinguished, evenly in their logarithm."""

FAR = 1e4
"""The largest variance of the noise, over the largest square that the residuals have."""

IMPOSSIBLE = 1e-8
"""Probability over the largest one below which a variance is left out."""


@dataclass(frozen=True)
class VarianceComponents:
    """Variances of jig and noise, as the residuals show them.

    Attributes
    ----------
    jig : float
        Variance of an attitude angle, rad²; below zero where the residuals are smaller than the noise.
    information : float
        Half of it is the Fisher information of ``jig``: a variance x ``jig`` has ``(x jig)² information / x²`` degrees
        of freedom. Infinite where the residuals hold nothing of it.
    by_noise : float
        Derivative of minus q by the noise's variance: the residuals show their sum.
    noise : float
        Factor of the noise's variance.
    noise_dof : float
        Degrees of freedom of that; infinite where the noise stands as it was measured.
    detectable : bool
        False where no attitude shows in the residuals.
    exceeds : bool
        True where more is left than noise and attitudes explain.
    """

    jig: float
    information: float
    by_noise: float
    noise: float
    noise_dof: float
    detectable: bool = True
    exceeds: bool = False

    @property
    def angle(self) -> float:
        """Standard deviation of an attitude angle, radians; 0 where none shows."""
        return sqrt(max(self.jig, 0.0))


@dataclass(frozen=True)
class NoiseVariance:
    """Variance of the readings where nothing is stated of their noise.

    Attributes
    ----------
    factor : float
        What it is over the variance that the residuals were whitened by.
    jig : float
        Standard deviation of an attitude angle, radians, as it is stated or as they show it.
    ratios, jig_ratios, probability : ndarray, shape (m,)
        The variances that both may be, over these, and how probable each pair is.
    """

    factor: float
    jig: float
    ratios: Array
    jig_ratios: Array
    probability: Array

    def dof(self, shares: Array, of_jig: Array) -> Array:
        """Return the degrees of freedom of sums of variances, with which Student's t has their 95 % interval.

        Parameters
        ----------
        shares, of_jig : ndarray, shape (k,)
            The parts of each sum that go with the variances of noise and jig; the rest is known.
        """
        spread = np.sqrt(1.0 + shares[:, None] * (self.ratios - 1.0) + of_jig[:, None] * (self.jig_ratios - 1.0))
        return degrees_of_freedom(half_width(spread, self.probability))

    @property
    def own_dof(self) -> float:
        """Degrees of freedom of the noise's own variance."""
        return float(self.dof(np.ones(1), np.zeros(1))[0])


@dataclass(frozen=True)
class ProjectedResiduals:
    """Residuals in the space that M leaves, whitened by N.

    Attributes
    ----------
    singular : ndarray, shape (angles,)
        d, the singular values of A there.
    projected : ndarray, shape (angles,)
        The residuals along their left singular vectors.
    squares : float
        The sum of squares of the residuals beside these.
    dof : int
        The dimension of that space, above 0.
    largest : float
        The largest singular value of A, whitened by the noise alone.
    """

    singular: Array
    projected: Array
    squares: float
    dof: int
    largest: float

    @property
    def parts(self) -> tuple[Array, Array, float, int]:
        """Return d² and z² where the attitudes show; the sum of squares elsewhere, and in how many directions."""
        sensitive = self.singular > INSENSITIVE * max(self.largest, 1e-300)
        d2, z2 = self.singular[sensitive] ** 2, self.projected[sensitive] ** 2
        return d2, z2, self.squares + float(np.sum(self.projected[~sensitive] ** 2)), self.dof - len(d2)


def noise_variance(residuals: ProjectedResiduals, jig: float | None, lowest: float) -> NoiseVariance:
    """Find the variance f of the noise from residuals, and that of the attitude angles where it is not stated.

    Parameters
    ----------
    jig : float or None
        Stated standard deviation of an attitude angle, radians.
    lowest : float
        What f is at least: the share of rounding in the variance that the residuals were whitened by.

    Notes
    -----
    The probability of f is its restricted likelihood times the root of its Fisher information (the prior of Jeffreys);
    so is that of q, independently. The factor is the harmonic mean: without a jig it is the textbook's variance of the
    residuals, and the interval that of Student's t; beside a jig that hides the noise it stays above zero. Of q it is
    the geometric mean.
    """
    d2, z2, left, more = residuals.parts
    if jig is None and not len(d2):
        jig = 0.0
    range_f = np.log([lowest, FAR * max(float(np.max(z2, initial=left)), lowest)])
    range_q = range_f - np.log(np.max(d2, initial=1e-300))
    for _ in range(2):
        log_f = np.linspace(range_f[0], range_f[1], VARIANCES)[:, None]
        log_q = np.linspace(range_q[0], range_q[1], JIGS)
        f, q = np.exp(log_f), np.exp(log_q) if jig is None else np.array([jig**2])
        s = f[..., None] + q[:, None] * d2
        likelihood = np.sum(np.log(s) + z2 / s, axis=2) + more * log_f + left / f
        weight = (np.log(np.sum(1.0 / s**2, axis=2) + more / f**2) - likelihood) / 2.0 + log_f
        if jig is None:
            weight += np.log(np.sum((d2 / s) ** 2, axis=2)) / 2.0 + log_q
        weight = np.exp(weight - weight.max())
        possible = weight > IMPOSSIBLE
        range_f = _around(log_f[:, 0], possible.any(axis=1))
        if jig is None:
            range_q = _around(log_q, possible.any(axis=0))
    probability = weight / weight.sum()
    factor = 1.0 / float(np.sum(probability / f))
    middle = jig**2 if jig is not None else float(np.exp(np.sum(probability * log_q)))
    over_f, over_q = (np.broadcast_to(values, weight.shape)[possible] for values in (f / factor, q / (middle or 1.0)))
    return NoiseVariance(factor, sqrt(middle), over_f, over_q, probability[possible] / probability[possible].sum())


def _around(values: Array, possible: NDArray[np.bool_]) -> Array:
    """Return the first and the last possible value, and one beyond at either end."""
    at = np.flatnonzero(possible)
    return values[[max(at[0] - 1, 0), min(at[-1] + 1, len(values) - 1)]]


def variance_components(residuals: ProjectedResiduals) -> VarianceComponents:
    """Find the variance of the attitude angles from residuals."""
    dof, largest = residuals.dof, residuals.largest
    d2, z2, left, more = residuals.parts
    if not len(d2):
        return VarianceComponents(0.0, inf, 0.0, left / dof, float(dof), detectable=False)
    q = _restricted_likelihood(d2, z2, lowest=-POSITIVE / largest**2)
    exceeds = more > 0 and _upper_tail(left, more) < IMPROBABLE
    noise = left / more if exceeds else 1.0
    shares = 1.0 / (noise + q * d2)
    information = float(np.sum((d2 * shares) ** 2))
    if exceeds:
        return VarianceComponents(q, information, 0.0, noise, float(more), exceeds=True)
    return VarianceComponents(q, information, float(np.sum(d2 * shares**2)) / information, noise, inf)


def _restricted_likelihood(d2: Array, z2: Array, lowest: float) -> float:
    """Find the q at which independent values with variances 1 + q d² most likely have the squares z²."""
    low, high = lowest, max(float(np.max((z2 - 1.0) / d2)), 0.0)
    q = high
    for _ in range(BISECTIONS):
        q = (low + high) / 2.0
        if q in (low, high):
            break
        slope = np.sum(d2 * (1.0 + q * d2 - z2) / (1.0 + q * d2) ** 2)
        low, high = (low, q) if slope >= 0.0 else (q, high)
    return q


def _upper_tail(chi_square: float, dof: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(dof, chi_square))
