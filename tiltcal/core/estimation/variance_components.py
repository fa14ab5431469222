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


def variance_components(
    singular: Array, projected: Array, residual_squares: float, dof: int, largest: float
) -> VarianceComponents:
    """Find the variance of the attitude angles from residuals.

    Parameters
    ----------
    singular : ndarray, shape (angles,)
        d, the singular values of A in the space that M leaves, whitened by N.
    projected : ndarray, shape (angles,)
        The residuals along their left singular vectors.
    residual_squares : float
        The sum of squares of the residuals, whitened, beside these.
    dof : int
        The dimension of that space, above 0.
    largest : float
        The largest singular value of A, whitened by the noise alone.
    """
    sensitive = singular > INSENSITIVE * max(largest, 1e-300)
    d2, z2 = singular[sensitive] ** 2, projected[sensitive] ** 2
    left, more = residual_squares + float(np.sum(projected[~sensitive] ** 2)), dof - len(d2)
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
