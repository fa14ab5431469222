"""The jig's uncertainty where it was not stated: the residuals show it.

The errors of the readings are noise and what else is known, with the covariance N, and the errors of the attitude
angles a, whose variance q is not known::

    residual = M (n + A a),    cov = V = N + q A Aᵀ

M takes away what the coefficients can follow, and A holds the readings' sensitivities to the angles. ``q`` is found by
restricted maximum likelihood (REML): in the space that M leaves, whitened by N, the singular directions of A are
independent with variances 1 + q d². A q below zero is kept, as far as V stays positive: the residuals are then smaller
than the noise by chance, and as much smaller the coefficients that depend on the attitudes scatter. For one channel
whose positions all depend on it alike this is the textbook's standard deviation of the residuals with Student's t.

Where no attitude shows in the residuals, they show the size of the noise instead.

Sources: H. D. Patterson, R. Thompson, *Recovery of inter-block information*, Biometrika 58 (1971) 545; M. G. Kenward,
J. H. Roger, *Small sample inference for fixed effects from REML*, Biometrics 53 (1997) 983.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from numpy.linalg import cholesky, norm, solve, svd

from tiltcal.core.model import Array

IMPROBABLE = 0.01
"""Probability below which what is left, when the attitudes are taken out, is more than the noise that was measured."""

BISECTIONS = 200

POSITIVE = 0.9
"""How much of the noise a negative q may take away, where it takes away most."""

INSENSITIVE = 1e-9
"""A direction with less than this share of the whole sensitivity to the attitudes has none."""


@dataclass(frozen=True)
class VarianceComponents:
    """The causes of residuals.

    Attributes
    ----------
    jig : float
        Variance of an attitude angle, rad²; below zero where the residuals are smaller than the noise.
    information : float
        Half of it is the Fisher information of ``jig``: a variance x ``jig`` has ``(x jig)² information / x²`` degrees
        of freedom. Infinite where the residuals hold nothing of it.
    precision : ndarray, shape (angles, angles)
        Aᵀ P A, with P the inverse of V in the space that M leaves.
    trade : float
        By how much, per the noise's variance, q falls where the noise is greater than was measured: the residuals show
        their sum.
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
    precision: Array
    trade: float
    noise: float
    noise_dof: float
    detectable: bool = True
    exceeds: bool = False

    @property
    def angle(self) -> float:
        """Standard deviation of an attitude angle, radians; 0 where none shows."""
        return sqrt(max(self.jig, 0.0))


def variance_components(residual: Array, jacobian: Array, noise: Array, attitude: Array) -> VarianceComponents:
    """Find the variance of the attitude angles from residuals.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        In any unit, one for each reading.
    jacobian : ndarray, shape (n, k)
        Of the coefficients that the readings determine; n is larger than its rank.
    noise : ndarray, shape (n, n)
        Covariance of the readings without the jig.
    attitude : ndarray, shape (n, angles)
        Sensitivity of each reading to the attitude angles, per radian.
    """
    rest = _complement(jacobian)
    factor = cholesky(rest.T @ noise @ rest)
    white = solve(factor, rest.T @ residual)
    vectors, singular, angles = svd(solve(factor, rest.T @ attitude), full_matrices=False)
    whole = svd(solve(cholesky(noise), attitude), compute_uv=False)
    sensitive = singular > INSENSITIVE * max(float(norm(whole)), 1e-300)
    d2, z2 = singular[sensitive] ** 2, (vectors[:, sensitive].T @ white) ** 2
    total, dof = float(white @ white), len(white)
    if not len(d2):
        nothing = np.zeros((attitude.shape[1],) * 2)
        return VarianceComponents(0.0, inf, nothing, 0.0, total / dof, float(dof), detectable=False)
    q = _restricted_likelihood(d2, z2, lowest=-POSITIVE / float(whole[0]) ** 2)
    weight = d2 / (1.0 + q * d2)
    information = float(np.sum(weight**2))
    trade = float(np.sum(d2 / (1.0 + q * d2) ** 2)) / information
    precision = (angles[sensitive].T * (d2 / (1.0 + max(q, 0.0) * d2))) @ angles[sensitive]
    left, more = total - float(np.sum(z2)), dof - len(d2)
    if more and _upper_tail(left, more) < IMPROBABLE:
        return VarianceComponents(q, information, precision, 0.0, left / more, float(more), exceeds=True)
    return VarianceComponents(q, information, precision, trade, 1.0, inf)


def _complement(jacobian: Array) -> Array:
    """Return orthonormal directions of the readings that no coefficient can follow."""
    size = norm(jacobian, axis=0)
    left, values, _ = svd(jacobian / np.where(size > 0.0, size, 1.0), full_matrices=True)
    return np.asarray(left[:, int(np.sum(values > 1e-12 * values[0])) :])


def _restricted_likelihood(d2: Array, z2: Array, lowest: float) -> float:
    """Find the q at which independent values with variances 1 + q d² most likely have the squares z²."""
    low, high = lowest, max(float(np.max((z2 - 1.0) / d2)), 0.0)
    for _ in range(BISECTIONS):
        q = (low + high) / 2.0
        slope = np.sum(d2 * (1.0 + q * d2 - z2) / (1.0 + q * d2) ** 2)
        low, high = (low, q) if slope >= 0.0 else (q, high)
    return (low + high) / 2.0


def _upper_tail(chi_square: float, dof: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(dof, chi_square))
