"""The noise of several positions, each known from a few block means, made better known by one another.

Ten block means leave nine degrees of freedom: weights made of such variances would cost a fifth of what weighting can
give. Positions at one bench have much the same noise, and how much the same, the variances themselves say: they are
taken for scaled chi-squares about values that scatter as an inverse chi-square with ``d0`` degrees of freedom. Each is
then drawn towards the common one in proportion, all the way where they scatter no more than chance makes them.

Source: G. K. Smyth, *Linear models and empirical Bayes methods*, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3, section 6.
"""

from __future__ import annotations

import numpy as np

from tiltcal.core.model import Array

STEPS = 50
"""Most Newton steps of the inverse of the trigamma function, which takes about five."""

FLOOR = 1e-5
"""A variance below this share of the median counts as that: a reading that never changed has no logarithm."""


def pooled(variance: Array, dof: Array) -> tuple[Array, Array]:
    """Better estimates of the variances of several positions.

    Parameters
    ----------
    variance : ndarray, shape (n,)
        Of each position's mean, from its own samples.
    dof : ndarray, shape (n,)
        Degrees of freedom of each; infinite ones are known, and stay as they are.

    Returns
    -------
    variance, dof : ndarray, shape (n,)
    """
    drawn = np.isfinite(dof)
    if np.sum(drawn) < 2 or not np.any(variance[drawn] > 0.0):
        return variance, dof
    own, degrees = variance[drawn], dof[drawn]
    common, prior = _common(own, degrees)
    better, freedom = variance.copy(), dof.copy()
    if np.isinf(prior):
        better[drawn], freedom[drawn] = common, np.sum(degrees)
    else:
        better[drawn] = (prior * common + degrees * own) / (prior + degrees)
        freedom[drawn] = prior + degrees
    return better, freedom


def _common(variance: Array, dof: Array) -> tuple[float, float]:
    """The variance that all are drawn to, and how many degrees of freedom it counts for."""
    from scipy.special import digamma, polygamma

    usual = float(np.median(variance)) or float(np.max(variance))
    logs = np.log(np.maximum(variance, FLOOR * usual)) - digamma(dof / 2.0) + np.log(dof / 2.0)
    spread = float(np.var(logs, ddof=1) - np.mean(polygamma(1, dof / 2.0)))
    if spread <= 0.0:
        return float(np.sum(dof * variance) / np.sum(dof)), np.inf
    prior = 2.0 * _inverse_trigamma(spread)
    return float(np.exp(np.mean(logs) + digamma(prior / 2.0) - np.log(prior / 2.0))), prior


def _inverse_trigamma(value: float) -> float:
    """Where the trigamma function has a value; Newton's steps on its reciprocal, which is all but straight."""
    from scipy.special import polygamma

    y = 0.5 + 1.0 / value
    for _ in range(STEPS):
        trigamma = float(polygamma(1, y))
        step = trigamma * (1.0 - trigamma / value) / float(polygamma(2, y))
        y += step
        if abs(step) <= 1e-10 * y:
            break
    return y
