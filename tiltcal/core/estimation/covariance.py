"""The uncertainty of an estimate: of the bench as it was stated, or as the residuals show it.

Near the minimum every unknown is a linear function of the equations' errors, so every equation has its share of every
variance. The effect of the attitudes' errors on the coefficients is in it: the attitudes are unknowns of the same
system.
"""

from __future__ import annotations

import numpy as np

from tiltcal.core.budget import Budget, welch_satterthwaite
from tiltcal.core.estimation.equations import ADC, JIG, NOISE, System
from tiltcal.core.estimation.gauss_newton import LinearSolution
from tiltcal.core.estimation.variance_components import VarianceComponents
from tiltcal.core.model import Array

KENWARD_ROGER = 2.0


def stated_budget(system: System, near: LinearSolution, bias: Array | None = None) -> Budget:
    """The coefficients' uncertainty where noise and bench are as they were stated.

    Parameters
    ----------
    system : System
    near : LinearSolution
    bias : ndarray, shape (coefficients,), optional
        What was taken off for the squares of the attitudes' errors.
    """
    inverse = near.inverse[: system.coefficients]
    squared = inverse**2
    of_readings = squared[:, : system.readings]
    adc = np.concatenate([(block.adc / block.u) ** 2 for block in system.blocks]).clip(0.0, 1.0)
    variance = {NOISE: of_readings @ (1.0 - adc), ADC: of_readings @ adc}
    for source in dict.fromkeys(system.sources):
        rows = [system.readings + k for k, name in enumerate(system.sources) if name == source]
        variance[source] = squared[:, rows].sum(axis=1)
    covariance = inverse @ inverse.T
    if bias is not None:
        # The scatter of the squares is in the inverse, which was taken where the errors have led, but not that they all
        # go one way: the correction counts as uncertain by its own size.
        covariance = covariance + np.outer(bias, bias)
        variance[JIG] = variance[JIG] + bias**2
    parts = _noise_parts(system, of_readings * (1.0 - adc))
    return Budget(covariance, variance, welch_satterthwaite(np.diag(covariance), parts))


def scaled_budget(system: System, near: LinearSolution, scale: float, dof: float) -> Budget:
    """The coefficients' uncertainty where nothing was stated and the residuals say the size of the noise.

    Parameters
    ----------
    system : System
    near : LinearSolution
    scale : float
        Sum of squares over degrees of freedom.
    dof : float
    """
    inverse = near.inverse[: system.coefficients]
    covariance = scale * (inverse @ inverse.T)
    return Budget(covariance, {NOISE: np.diag(covariance)}, np.full(len(inverse), float(dof)))


def estimated_jig_budget(
    system: System, near: LinearSolution, components: VarianceComponents, attitude: Array, bias: Array | None
) -> Budget:
    """Return the coefficients' uncertainty where the jig was not stated and the residuals show it.

    Parameters
    ----------
    system : System
        With the jig and the noise that were found.
    near : LinearSolution
        The system at its minimum.
    components : VarianceComponents
    attitude : ndarray, shape (readings, angles)
        Sensitivity of each reading to the attitude angles, per radian.
    bias : ndarray, shape (coefficients,), optional
        What was taken off for the squares of the attitudes' errors.

    Notes
    -----
    Weights that come from an estimated variance are not the best, and that variance is on average too small: both are
    put right to first order by twice the covariance of what the weights' error does (Kenward and Roger, 1997). The
    degrees of freedom of the estimate go into Student's t (GUM, eq. G.2b).
    """
    if not components.detectable:
        budget = stated_budget(system, near, bias)
        dof = np.full(system.coefficients, components.noise_dof)
        return Budget(budget.covariance, budget.variance, dof)
    stated = stated_budget(system, near, bias)
    per_reading = near.inverse[: system.coefficients, : system.readings] / system.sigma
    per_angle = per_reading @ attitude
    angles = np.sum(per_angle**2, axis=1)
    by_weights = 2.0 / components.information * per_angle @ components.precision @ per_angle.T
    fewer = min(components.jig, 0.0)
    covariance = stated.covariance + KENWARD_ROGER * by_weights + fewer * per_angle @ per_angle.T
    # A q below zero shows that the noise, by chance, was less than measured; no jig takes uncertainty away.
    variance = dict(stated.variance)
    variance[NOISE] = variance[NOISE] + fewer * angles
    variance[JIG] = variance.get(JIG, np.zeros_like(angles)) + KENWARD_ROGER * np.diag(by_weights)
    # A part that goes with the square of the jig's variance is twice as uncertain as one that goes with it.
    squares = 0.0 if bias is None else 2.0 * bias**2 / components.jig
    parts = [(angles + squares, components.information)]
    of_noise = per_reading**2 * system.sigma**2
    if np.isfinite(components.noise_dof):
        parts.append((of_noise.sum(axis=1), components.noise_dof))
    else:
        noise = of_noise.sum(axis=1)
        kept = 1.0 - components.trade * angles / np.where(noise > 0.0, noise, 1.0)
        parts += [(part * kept, dof) for part, dof in _noise_parts(system, of_noise)]
    return Budget(covariance, variance, welch_satterthwaite(np.diag(covariance), parts))


def _noise_parts(system: System, shares: Array) -> list[tuple[Array, float]]:
    """Shares of the noise that were estimated together, each with its degrees of freedom.

    Readings of one channel with the same uncertainty have it from one pooled estimate.
    """
    parts = []
    start = 0
    for block in system.blocks:
        stop = start + len(block.u)
        for u, dof in sorted(set(zip(block.u.tolist(), block.dof.tolist(), strict=True))):
            rows = start + np.flatnonzero((block.u == u) & (block.dof == dof))
            parts.append((shares[:, rows].sum(axis=1), dof))
        start = stop
    return parts
