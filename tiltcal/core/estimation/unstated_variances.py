"""What the residuals show of the variances that are not stated: of the jig, of a thermometer, of a table's means.

Each is found at a minimum of the equations, which moves with it: so the equations are solved anew until both stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, sqrt

import numpy as np

from tiltcal.core.estimation.elimination import LinearSolution, linearised
from tiltcal.core.estimation.gauss_newton import minimise
from tiltcal.core.estimation.joint_equations import System
from tiltcal.core.estimation.variance_components import (
    NoiseVariance,
    ProjectedResiduals,
    VarianceComponents,
    noise_variance,
    variance_components,
)
from tiltcal.core.model import Array

ROUNDS = 20
"""Most times that the jig is estimated anew at the solution that the last one gave; three to five are usual."""

CLOSE = 1e-4
"""A relative change of the jig, or of chi-square, below which it is found."""

EXACT = 1e12
"""Readings of so many of their uncertainties have none that is known: their chi-square is no test."""

SMALLEST_THERMOMETER, LARGEST_THERMOMETER = 1e-3, 5.0
"""Standard uncertainties of a temperature that the residuals may show, °C."""


def minimum_from(system: System, z: Array, known: System | None = None) -> Array:
    """Return the minimum with all unknowns, from one with other errors of the bench (as set where none is given)."""
    return minimise(system, _transferred(z, system.as_if_perfect() if known is None else known, system))


def _transferred(z: Array, before: System, after: System) -> Array:
    """Return the unknowns of one system as those of another, zero where the first has none."""
    unknowns = np.zeros(after.unknowns)
    unknowns[: after.coefficients] = z[: before.coefficients]
    for old, new in (
        (before.attitudes, after.attitudes),
        (before.lean, after.lean),
        (before.temperature_errors, after.temperature_errors),
        (before.heading_errors, after.heading_errors),
    ):
        if old.stop > old.start and new.stop > new.start:
            unknowns[new] = z[old]
    return unknowns


def with_attitudes(system: System, z: Array) -> LinearSolution:
    """Linearise a system near its minimum, with attitude angles even where their variance is zero."""
    tilted = system if system.jig > 0 else replace(system, jig=1.0)
    return linearised(tilted, z if tilted is system else _transferred(z, system, tilted), system.jig)


def with_noise(system: System, factor: float) -> System:
    """Return the system with the variance of its noise multiplied; no reading is better than its rounding."""
    factor = max(factor, (np.finfo(float).eps * system.reach) ** 2)
    if factor == 1.0:
        return system
    return replace(system, blocks=tuple(replace(block, u=block.u * factor**0.5) for block in system.blocks))


def residuals_near(system: System, z: Array, dof: int) -> ProjectedResiduals:
    """Return the residuals near a point, with the angles that were taken off there put back."""
    near = with_attitudes(system, z)
    left, singular, _ = near.spectrum
    first = near.shared - near.angles
    right = near.elimination.rhs[first:]
    if system.jig > 0:
        right = right + near.elimination.triangle[first:, first:] @ z[near.system.attitudes]
    return ProjectedResiduals(
        singular, left.T @ right, near.elimination.residual_squares, dof, _largest_sensitivity(near)
    )


def find_jig(
    system: System, z: Array, components: VarianceComponents, dof: int, table: float
) -> tuple[System, Array, VarianceComponents]:
    """Find the jig's variance; return the system with it, its minimum, and what its residuals show.

    Parameters
    ----------
    system : System
        With a perfect jig.
    z : ndarray
        Its minimum.
    components : VarianceComponents
        What its residuals show.
    dof : int
        Degrees of freedom.
    table : float
        Standard uncertainty of the lean of the table, radians; infinite where nothing is known of it.
    """
    known = system
    for _ in range(ROUNDS):
        before, last = known.jig, known
        known = with_noise(replace(system, jig=components.angle), components.noise)
        z = minimum_from(known, z, last)
        if components.angle == before or abs(known.jig - before) <= CLOSE * before:
            break
        components = variance_components(residuals_near(replace(system, jig=components.angle, table=table), z, dof))
    return known, z, components


def find_noise(
    system: System, z: Array, dof: int, table: float, jig: float | None
) -> tuple[System, Array, NoiseVariance]:
    """Find the noise of readings of which only the rounding is stated; return it with the system and its minimum.

    Parameters
    ----------
    jig : float or None
        As it is stated, radians; otherwise it is found as well.
    """
    known, factor, angle = system, 1.0, jig or 0.0
    for _ in range(ROUNDS):
        last, known = known, with_noise(replace(system, jig=angle), factor)
        z = minimum_from(known, z, last)
        found = noise_variance(residuals_near(replace(known, table=table), z, dof), jig, 1.0 / factor)
        if abs(found.factor - 1.0) <= CLOSE and abs(found.jig - angle) <= CLOSE * angle:
            break
        factor, angle = max(factor * found.factor, 1.0), found.jig
    return known, z, found


@dataclass(frozen=True)
class FoundThermometer:
    """The system with the thermometer that the residuals show, its minimum, and that variance's degrees of freedom."""

    system: System
    z: Array
    dof: float


def find_thermometer(system: System, z: Array, chi_square: float, dof: int) -> FoundThermometer | None:
    """Find the thermometer's uncertainty with which chi-square is as large as its degrees of freedom.

    None where exact temperatures leave no more than that, or where no thermometer explains what they leave.

    Source: R. C. Paule, J. Mandel, *Consensus values and weighting factors*, J. Res. NBS 87 (1982) 377.
    """
    if chi_square <= dof or system.reach > EXACT or not system.own_temperatures + system.shared_temperatures:
        return None
    known, variance = system, SMALLEST_THERMOMETER**2
    for _ in range(ROUNDS):
        last, known = known, replace(system, thermometer=sqrt(variance))
        z = minimum_from(known, z, last)
        cost, errors = known.at(z).cost, z[known.temperature_errors]
        slope = float(errors @ errors) / variance**2
        if abs(cost - dof) <= CLOSE * dof:
            return FoundThermometer(known, z, (variance * slope) ** 2 / dof)
        # One over chi-square is nearly a straight line of the variance.
        variance = max(variance + cost * (cost - dof) / (dof * slope), variance / 4.0) if slope > 0.0 else inf
        if not SMALLEST_THERMOMETER**2 / 16.0 < variance < LARGEST_THERMOMETER**2:
            return None
    return None


def _largest_sensitivity(near: LinearSolution) -> float:
    """Return the largest singular value of the readings' derivatives by the attitude angles, over their noise."""
    squares = np.zeros((near.angles // 2, 2, 2))
    for block, equations in zip(near.system.blocks, near.equations.blocks, strict=True):
        by_angle = equations.shared[..., -2:].reshape(*block.u.shape, 2)
        np.add.at(squares, near.system.settings[block.places], np.einsum("scni,scnj->snij", by_angle, by_angle))
    return float(np.sqrt(np.linalg.eigvalsh(squares).max()))
