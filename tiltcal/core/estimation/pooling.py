"""The noise of several positions, each known from a few block means, made better known by one another.

Ten block means leave nine degrees of freedom: weights made of such variances would cost a fifth of what weighting can
give, and what is computed from them would look better known than it is. Positions at one bench have much the same
noise. Where the variances scatter no more than chance makes them, all are one. Where they do, they are taken for scaled
chi-squares about values that themselves scatter, as an inverse chi-square with ``d0`` degrees of freedom, and each is
drawn towards the common one in proportion.

Source: G. K. Smyth, *Linear models and empirical Bayes methods*, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3, section 6.
"""

from __future__ import annotations

import numpy as np

from tiltcal.core.model import Array

STEPS = 50
"""Most Newton steps of the inverse of the trigamma function, which takes about five."""

CHANCE = 0.01
"""Probability of a scatter of the variances' logarithms below which it is no chance."""

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
    from scipy.special import chdtrc, digamma, polygamma

    usual = float(np.median(variance)) or float(np.max(variance))
    logs = np.log(np.maximum(variance, FLOOR * usual)) - digamma(dof / 2.0) + np.log(dof / 2.0)
    by_chance, count = float(np.mean(polygamma(1, dof / 2.0))), len(logs)
    spread = float(np.var(logs, ddof=1))
    if chdtrc(count - 1, (count - 1) * spread / by_chance) > CHANCE:
        return float(np.sum(dof * variance) / np.sum(dof)), np.inf
    prior = 2.0 * _inverse_trigamma(spread - by_chance)
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
