"""The uncertainty of an estimate: of the bench as it was stated, or as the residuals show it.

Near the minimum every unknown is a linear function of the equations' errors (:mod:`tiltcal.core.estimation.linear`), so
that every equation has its share of every variance. What the attitudes' errors do to the coefficients is already in it:
the attitudes are unknowns of the same system.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiltcal.core.budget import Budget, welch_satterthwaite
from tiltcal.core.estimation.equations import ADC, JIG, NOISE, PRIOR, THERMOMETER, System
from tiltcal.core.estimation.linear import LinearSolution
from tiltcal.core.estimation.variance_components import VarianceComponents
from tiltcal.core.model import Array


def stated_budget(system: System, near: LinearSolution, bias: Array | None = None) -> Budget:
    """The coefficients' uncertainty where noise and bench are as they were stated.

    Parameters
    ----------
    system : System
    near : LinearSolution
    bias : ndarray, shape (coefficients,), optional
        What was taken off for the squares of the attitudes' errors.
    """
    gain = near.gain[: system.coefficients]
    squared = gain**2
    of_readings = squared[:, : system.readings]
    adc = np.concatenate([(block.adc / block.u) ** 2 for block in system.blocks]).clip(0.0, 1.0)
    variance = {NOISE: of_readings @ (1.0 - adc), ADC: of_readings @ adc}
    for source in dict.fromkeys(system.sources):
        rows = [system.readings + k for k, name in enumerate(system.sources) if name == source]
        variance[source] = squared[:, rows].sum(axis=1)
    covariance = gain @ gain.T
    if bias is not None:
        # The scatter of the squares is in the gain already, which was taken where the errors have led. What it does not
        # show is that they all go one way: the correction counts as uncertain by its own size.
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
    gain = near.gain[: system.coefficients]
    covariance = scale * (gain @ gain.T)
    return Budget(covariance, {NOISE: np.diag(covariance)}, np.full(len(gain), float(dof)))


def scattered_budget(
    system: System,
    near: LinearSolution,
    levers: SensitivityCoefficients,
    scatter: VarianceComponents,
    squares: Array | None,
) -> Budget:
    """The coefficients' uncertainty where the jig was not stated.

    Parameters
    ----------
    system : System
        In which all positions counted the same.
    near : LinearSolution
    levers : SensitivityCoefficients
        What the errors that it does not know of do to the readings.
    scatter : VarianceComponents
        What the residuals say of them.
    squares : ndarray, shape (coefficients, coefficients), or None
        Mean squares of what the squares of the attitudes' errors do.
    """
    count, readings = system.coefficients, system.readings
    gain = near.gain[:count, :readings] / system.sigma
    of_readings = gain**2 * levers.noise**2
    noise = scatter.noise * of_readings.sum(axis=1)
    adc = scatter.noise * (gain**2) @ levers.adc**2
    by_angle = gain @ levers.attitude
    by_warmth = gain @ levers.warmth
    rest = near.gain[:count, readings:]
    readings_covariance = scatter.noise * levers.covariance + scatter.jig * levers.attitude @ levers.attitude.T
    by_assumption = levers.known - gain @ levers.assumed
    covariance = gain @ readings_covariance @ gain.T + rest @ rest.T + by_assumption @ by_assumption.T
    angles = np.sum(by_angle**2, axis=1)
    jig = scatter.jig * angles
    # A part that goes with the square of the jig's variance is twice as uncertain as one that goes with it.
    felt = angles
    if squares is not None:
        covariance = covariance + squares
        jig = jig + np.diag(squares)
        felt = felt + 2.0 * np.diag(squares) / scatter.jig
    # A q below zero says that the noise, by chance, was less than measured; no jig takes uncertainty away.
    variance = {
        NOISE: noise - adc + np.minimum(jig, 0.0),
        ADC: adc,
        JIG: np.maximum(jig, 0.0),
        THERMOMETER: np.sum(by_warmth**2, axis=1),
        PRIOR: np.sum(by_assumption**2, axis=1),
    }
    for source in dict.fromkeys(system.sources):
        rows = [k for k, name in enumerate(system.sources) if name == source]
        variance[source] = variance.get(source, np.zeros(count)) + np.sum(rest[:, rows] ** 2, axis=1)
    parts = [(felt, scatter.information), (noise, scatter.noise_dof)]
    if not np.isfinite(scatter.noise_dof):
        kept = 1.0 - scatter.trade * angles / np.where(noise > 0.0, noise, 1.0)
        parts += [(part * kept, dof) for part, dof in _noise_parts(system, of_readings)]
    total = np.diag(covariance)
    return Budget(
        covariance,
        variance,
        welch_satterthwaite(total, parts),
        _explained(scatter, gain * system.sigma, readings_covariance / np.outer(system.sigma, system.sigma), total),
    )


def _explained(scatter: VarianceComponents, gain: Array, covariance: Array, variance: Array) -> Array:
    """The part of each coefficient's variance that is in the residuals which feel the attitudes."""
    if scatter.silent:
        return np.zeros(len(variance))
    seen = scatter.directions
    shared = gain @ covariance @ seen
    of_residuals = seen.T @ covariance @ seen
    part = np.sum(shared * np.linalg.solve(of_residuals, shared.T).T, axis=1)
    return np.asarray(part / np.where(variance > 0.0, variance, 1.0))


@dataclass(frozen=True)
class SensitivityCoefficients:
    """What errors do to the readings, in their units.

    Attributes
    ----------
    noise, adc : ndarray, shape (readings,)
        Standard uncertainty of each reading, and the part of it that is quantisation.
    attitude : ndarray, shape (readings, angles)
        Per radian.
    warmth : ndarray, shape (readings, temperatures)
        Per standard uncertainty of the thermometer.
    assumed : ndarray, shape (readings, assumed)
        Per standard uncertainty of each coefficient that something is known of.
    known : ndarray, shape (coefficients, assumed)
        Those standard uncertainties, each in its coefficient's row.
    """

    noise: Array
    adc: Array
    attitude: Array
    warmth: Array
    assumed: Array
    known: Array

    @property
    def covariance(self) -> Array:
        """Of the readings, without the attitudes and the assumptions."""
        return np.diag(self.noise**2) + self.warmth @ self.warmth.T


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
