"""The uncertainty of an estimate: of the bench as it was stated, or as the residuals show it.

Near the minimum every unknown is a linear function of the equations' errors, so every equation has its share of every
variance. The effect of the attitudes' errors on the coefficients is in it: the attitudes are unknowns of the same
system.

Each equation is divided by its standard uncertainty, so that its error has the variance 1. ``found[j, b, r]`` is the
change of coefficient j by the error of equation r in set b of a block: a channel, or a sensor with a thermometer of its
own. The readings come first, then what is known of each local unknown. The variance of j is the sum of the squares.
``left[b, r, y]`` is what remains of the derivative by the shared unknown y, once the local unknowns follow it.

**By hand.** One channel of known offset in one position reads ``S sin(t + a)`` with the uncertainty u, of which
quantisation gives q; S is known to v before, and the jig to s. What it reads differs from S sin t with the variance V,
and S changes by G for a unit of it::

    V = u² + (v sin t)² + (s S cos t)²,   G = v² sin t / V
    noise = G² (u² - q²),   adc = G² q²,   assumed = (1 - G sin t)² v²,   jig = (G s S cos t)²

The four add up to v² (1 - G sin t). A noise that was estimated with m degrees of freedom has the estimated part
``noise / sqrt(m)``: as a part of one degree of freedom it gives Welch and Satterthwaite's formula the same as noise
with m.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, isfinite

import numpy as np

from tiltcal.core.coverage_factor import welch_satterthwaite
from tiltcal.core.estimation.elimination import LinearSolution, shared_table
from tiltcal.core.estimation.joint_equations import ADC, HEADING, JIG, NOISE, PRIOR, TABLE, THERMOMETER, EquationBlock
from tiltcal.core.estimation.variance_components import NoiseVariance, VarianceComponents
from tiltcal.core.model import Array
from tiltcal.core.uncertainty_budget import Budget

KENWARD_ROGER = 2.0


def stated_budgets(
    near: LinearSolution,
    bias: Array | None = None,
    thermometer_dof: float = inf,
    shown: NoiseVariance | None = None,
) -> list[Budget]:
    """Return the uncertainty of each sensor's coefficients where noise and bench are as they were stated.

    Parameters
    ----------
    bias : ndarray, shape (coefficients,), optional
        What was taken off for the squares of the attitudes' errors.
    thermometer_dof : float
        Degrees of freedom of the thermometer's variance, where it was estimated.
    shown : NoiseVariance, optional
        Where the residuals show the noise.
    """
    variances, of_noise = _variances(near)
    budgets = []
    for own, covariance, variance in _by_sensor(near, variances, bias):
        if shown is not None:
            total = np.diag(covariance)
            safe = np.where(total > 0.0, total, 1.0)
            of_jig = variance.get(JIG, np.zeros_like(total)) / safe
            budgets.append(Budget(covariance, variance, shown.dof((variance[NOISE] + variance[ADC]) / safe, of_jig)))
            continue
        estimated = [(of_noise[own], 1.0)]
        if isfinite(thermometer_dof):
            estimated.append((variance[THERMOMETER], thermometer_dof))
        budgets.append(Budget(covariance, variance, welch_satterthwaite(np.diag(covariance), estimated)))
    return budgets


def estimated_jig_budgets(near: LinearSolution, components: VarianceComponents, bias: Array | None) -> list[Budget]:
    """Return the uncertainty of each sensor's coefficients where the jig was not stated and the residuals show it.

    Parameters
    ----------
    near : LinearSolution
        With the jig and the noise that were found.
    bias : ndarray, shape (coefficients,), optional
        What was taken off for the squares of the attitudes' errors.

    Notes
    -----
    Weights that come from an estimated variance are not the best, and that variance is on average too small: both are
    put right to first order by twice the covariance of what the weights' error does (Kenward and Roger, 1997). The
    degrees of freedom of the estimate go into Student's t (GUM, eq. G.2b).
    """
    variances, of_noise = _variances(near)
    budgets = []
    d2 = near.spectrum[1] ** 2
    # Columns: what the error of each combination of the angles does to the coefficients.
    by_angle = near.response[:, near.shared - near.angles :] * near.unobserved
    for own, covariance, variance in _by_sensor(near, variances, bias):
        if not components.detectable:
            budgets.append(Budget(covariance, variance, np.full(len(covariance), components.noise_dof)))
            continue
        per_angle = by_angle[own]
        angles = np.sum(per_angle**2, axis=1)
        by_weights = 2.0 / components.information * (per_angle * (d2 * near.unobserved)) @ per_angle.T
        fewer = min(components.jig, 0.0)
        covariance = covariance + KENWARD_ROGER * by_weights + fewer * per_angle @ per_angle.T
        noise = variance[NOISE]
        # A q below zero shows that the noise, by chance, was less than measured; no jig takes uncertainty away.
        variance[NOISE] = noise + fewer * angles
        variance[JIG] = variance.get(JIG, np.zeros_like(angles)) + KENWARD_ROGER * np.diag(by_weights)
        # A part that goes with the square of the jig's variance is twice as uncertain as one that goes with it.
        squares = 0.0 if bias is None else 2.0 * bias[own] ** 2 / components.jig
        parts = [(angles + squares, components.information)]
        if isfinite(components.noise_dof):
            parts.append((noise, components.noise_dof))
        else:
            kept = 1.0 - components.by_noise * angles / np.where(noise > 0.0, noise, 1.0)
            parts.append((of_noise[own] * kept, 1.0))
        budgets.append(Budget(covariance, variance, welch_satterthwaite(np.diag(covariance), parts)))
    return budgets


def _by_sensor(
    near: LinearSolution, variance: dict[str, Array], bias: Array | None
) -> Iterator[tuple[slice, Array, dict[str, Array]]]:
    """Yield each sensor's coefficients, their covariance, and its sources."""
    for number, block in enumerate(near.system.blocks):
        for columns, own in zip(block.columns, near.own_covariances(number), strict=True):
            rows_of_sensor = slice(int(columns[0, 0]), int(columns[-1, -1]) + 1)
            response = near.response[rows_of_sensor]
            covariance = own + (response * near.variances) @ response.T
            sources = {source: part[rows_of_sensor] for source, part in variance.items()}
            if bias is not None:
                # The scatter of the squares is in the covariance, which was taken where the errors have led, but not
                # that they all go one way: the correction counts as uncertain by its own size.
                covariance = covariance + np.outer(bias[rows_of_sensor], bias[rows_of_sensor])
                sources[JIG] = sources[JIG] + bias[rows_of_sensor] ** 2
            yield rows_of_sensor, covariance, sources


def _variances(near: LinearSolution) -> tuple[dict[str, Array], Array]:
    """Return the variances of all coefficients by their sources, shape (coefficients,) each, and the estimated part.

    That is a variance whose square is the sum of the squares of all estimated parts over their degrees of freedom.
    """
    system, count = near.system, near.system.coefficients
    spread = near.response * near.variances
    noise, adc, prior, thermometer, estimated = (np.zeros(count) for _ in range(5))
    for block, equations, factor in zip(system.blocks, near.equations.blocks, near.elimination.factors, strict=True):
        sets, rows, _ = factor.basis.shape
        left = shared_table(equations, near.shared)[..., : near.shared] - factor.basis @ factor.follows
        # By way of the shared unknowns; below, within its own set (``of_own``: local unknown by equation).
        found = -spread @ (left.reshape(sets * rows, near.shared) @ near.directions).T
        found = found.reshape(count, sets, rows)
        own = factor.unknowns[0] < count
        of_own = (factor.inverse @ factor.basis.swapaxes(1, 2))[:, own]
        found[factor.unknowns[:, own], np.arange(sets)[:, None]] += of_own
        found *= found
        readings = found[..., : equations.readings].reshape(count, -1)
        share = np.clip((block.adc / block.u) ** 2, 0.0, 1.0).ravel()
        if share.any():
            adc += readings @ share
            readings = readings * (1.0 - share)
        noise += readings.sum(axis=1)
        known = found[..., equations.readings :].sum(axis=1)
        prior += known[:, own].sum(axis=1)
        thermometer += known[:, ~own].sum(axis=1)
        estimated += _estimated(readings, block)
    variance = {NOISE: noise, ADC: adc}
    if system.assumed.any():
        variance[PRIOR] = prior
    known = {source: (columns, u) for source, columns, u in system.shared_priors}
    by_shared = spread @ near.directions.T
    for source in (JIG, TABLE, THERMOMETER, HEADING):
        if source == THERMOMETER and system.local > count:
            variance[source] = thermometer
        if source not in known or (source == JIG and near.jig == 0.0):
            continue
        columns, u = known[source]
        part = by_shared[:, columns.start - system.local : columns.stop - system.local]
        part = part / (near.jig if source == JIG else u)
        variance[source] = variance.get(source, np.zeros(count)) + np.sum(part**2, axis=1)
    return variance, np.sqrt(estimated)


def _estimated(shares: Array, block: EquationBlock) -> Array:
    """Sum the squares of the noise's parts that were estimated together, each over its degrees of freedom.

    Readings of one channel with the same uncertainty have it from one pooled estimate.

    Parameters
    ----------
    shares : ndarray, shape (coefficients, readings)
    """
    if np.all(np.isinf(block.dof)):
        return np.zeros(len(shares))
    channel = np.broadcast_to(np.arange(block.u[..., 0].size).reshape(*block.u.shape[:2], 1), block.u.shape)
    keys = (block.dof.ravel(), block.u.ravel(), channel.ravel())
    order = np.lexsort(keys)
    new = np.zeros(len(order), dtype=bool)
    for key in keys:
        new[1:] |= np.diff(key[order]) != 0.0
    new[0] = True
    starts = np.flatnonzero(new)
    if np.any(np.diff(order) != 1):  # a copy of all shares
        shares = shares[:, order]
    parts = np.add.reduceat(shares, starts, axis=1)
    return np.asarray(parts**2 @ (1.0 / block.dof.ravel()[order][starts]))
