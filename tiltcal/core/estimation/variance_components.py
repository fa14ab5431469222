"""How uncertain least squares is where the jig was not stated: the residuals say it.

All positions count the same, and the errors of the readings are noise, which is known, and the attitudes' errors, which
are not::

    residual = M (noise + lever a),    cov = V = noise² + q lever leverᵀ

where M takes away what the coefficients can follow. ``q``, the variance of an attitude angle, is found by restricted
maximum likelihood: within the space that M leaves, whitened by the noise, the lever's singular directions are
independent with variances 1 + q d². The uncertainty of a coefficient is then ``L V Lᵀ``. A q below zero is kept, as far
as V stays positive: it says that the residuals are smaller than the noise by chance, and as much smaller the scatter of
the coefficients that feel the jig is then taken to be. For a channel whose positions all feel it alike this is the
textbook's standard deviation of the residuals with Student's t.

Where no attitude shows in the residuals, they say the size of the noise instead.

Source: H. D. Patterson, R. Thompson, *Recovery of inter-block information*, Biometrika 58 (1971) 545.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from numpy.linalg import cholesky, norm, solve, svd

from tiltcal.core.model import Array

DOUBT = 0.01
"""Probability below which what is left, when the attitudes are taken out, is more than the noise that was measured."""

BISECTIONS = 200

POSITIVE = 0.9
"""How much of the noise a negative q may take away, where it takes away most."""

FEELS = 1e-9
"""A direction that the lever moves by less than this share of all that it moves does not feel the attitudes."""


@dataclass(frozen=True)
class VarianceComponents:
    """What residuals say of their causes.

    Attributes
    ----------
    jig : float
        Variance of an attitude angle, rad²; below zero where the residuals are smaller than the noise.
    information : float
        Degrees of freedom of a variance that is q times x are ``(q x)² information / x²``; infinite where nothing was
        learnt of q.
    trade : float
        By how much, per the noise's variance, q falls where the noise is greater than was measured: the residuals know
        their sum.
    noise : float
        By what the noise's variance is to be multiplied.
    noise_dof : float
        Degrees of freedom of that; infinite where the noise stands as it was measured.
    directions : ndarray, shape (n, m)
        Of the residuals, orthonormal: those that feel the attitudes.
    exceeds : bool
        True where more is left than noise and attitudes explain.
    """

    jig: float
    information: float
    trade: float
    noise: float
    noise_dof: float
    directions: Array
    exceeds: bool = False

    @property
    def angle(self) -> float:
        """Standard deviation of an attitude angle, radians; 0 where none shows."""
        return sqrt(max(self.jig, 0.0))

    @property
    def jig_squared(self) -> float:
        """The square of that variance, rad⁴: less than ``jig`` squared, which its own scatter makes too great."""
        dof = self.information * self.jig**2
        return self.jig**2 * dof / (dof + 2.0)

    @property
    def silent(self) -> bool:
        """True where no attitude shows in the residuals."""
        return self.directions.size == 0


def scatter_of(residual: Array, jacobian: Array, noise: Array, lever: Array) -> VarianceComponents:
    """Judge the residuals of unweighted least squares.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        In any unit, one for each reading.
    jacobian : ndarray, shape (n, k)
        Of what was fitted; n is larger than its rank.
    noise : ndarray, shape (n, n)
        Covariance of the readings without the jig.
    lever : ndarray, shape (n, m)
        What an attitude angle does to each reading, per radian.
    """
    rest = _complement(jacobian)
    factor = cholesky(rest.T @ noise @ rest)
    white = solve(factor, rest.T @ residual)
    vectors, felt, _ = svd(solve(factor, rest.T @ lever), full_matrices=False)
    whole = svd(solve(cholesky(noise), lever), compute_uv=False)
    feels = felt > FEELS * max(float(norm(whole)), 1e-300)
    d2, z2 = felt[feels] ** 2, (vectors[:, feels].T @ white) ** 2
    # The residuals whitened, and led back to the readings: rest factor⁻ᵀ vectors picks one direction of them.
    directions = rest @ solve(factor.T, vectors[:, feels])
    total, dof = float(white @ white), len(white)
    if not len(d2):
        return VarianceComponents(0.0, inf, 0.0, total / dof, float(dof), directions)
    q = _restricted_likelihood(d2, z2, lowest=-POSITIVE / float(whole[0]) ** 2)
    information = float(np.sum((d2 / (1.0 + q * d2)) ** 2))
    trade = float(np.sum(d2 / (1.0 + q * d2) ** 2)) / information
    left, more = total - float(np.sum(z2)), dof - len(d2)
    if more and _upper_tail(left, more) < DOUBT:
        return VarianceComponents(q, information, 0.0, left / more, float(more), directions, exceeds=True)
    return VarianceComponents(q, information, trade, 1.0, inf, directions)


def _complement(jacobian: Array) -> Array:
    """Orthonormal directions of the readings that no coefficient can follow."""
    size = norm(jacobian, axis=0)
    left, values, _ = svd(jacobian / np.where(size > 0.0, size, 1.0), full_matrices=True)
    return np.asarray(left[:, int(np.sum(values > 1e-12 * values[0])) :])


def _restricted_likelihood(d2: Array, z2: Array, lowest: float) -> float:
    """The q at which independent values with variances 1 + q d² are likeliest to have the squares z²."""
    low, high = lowest, max(float(np.max((z2 - 1.0) / d2)), 0.0)
    for _ in range(BISECTIONS):
        q = (low + high) / 2.0
        slope = np.sum(d2 * (1.0 + q * d2 - z2) / (1.0 + q * d2) ** 2)
        low, high = (low, q) if slope >= 0.0 else (q, high)
    return (low + high) / 2.0


def _upper_tail(chi_square: float, dof: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(dof, chi_square))
