"""Calibration without a jig: the sensor is laid down anyhow, and gravity is a unit vector.

The readings then lie on an ellipsoid, ``(u - offset)ᵀ (S Sᵀ)⁻¹ (u - offset) = 1``. Its algebraic fit gives the start;
the estimator takes it from there, with every direction an unknown of its own. A turn of all directions together, undone
in S, changes no reading: the gauge makes S upper triangular.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tiltcal.core.estimation.elimination import LinearSolution
from tiltcal.core.estimation.identifiability import undetermined_unknowns
from tiltcal.core.estimation.joint_equations import Indices, System
from tiltcal.core.intrinsic_parameters import separated
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError


def directions_from_readings(mean: Array) -> Array:
    """Return a first guess at the directions of gravity, from the readings alone.

    Parameters
    ----------
    mean : ndarray, shape (n, 3)
        Mean readings of three channels in n free positions, any unit; at least nine, spread over the sphere.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit vectors, in the frame in which the sensitivity matrix is upper triangular with positive diagonal: a
        channel that is mounted against its axis shows up in the other two.

    Raises
    ------
    EstimateError
        The readings do not lie on an ellipsoid.
    """
    centre, scale = mean.mean(axis=0), float(np.max(np.ptp(mean, axis=0)))
    if len(mean) < 9 or scale == 0.0:
        raise EstimateError(f"{len(mean)} free positions; an ellipsoid takes at least nine, well spread")
    x, y, z = ((mean - centre) / scale).T
    terms = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
    a, b, c, d, e, f, *half = np.linalg.lstsq(terms, np.ones(len(mean)), rcond=None)[0]
    shape = np.array([[a, d, e], [d, b, f], [e, f, c]])
    try:
        offset = -np.linalg.solve(shape, half)
        # sᵀ shape s = 1 + offsetᵀ shape offset; S Sᵀ is the inverse of the normalised shape.
        factor = np.linalg.cholesky(shape / (1.0 + offset @ shape @ offset))
    except np.linalg.LinAlgError:
        raise EstimateError(
            "the readings do not lie on an ellipsoid: lay the sensor on more sides, each axis up and down among them"
        ) from None
    # shape = L Lᵀ and S⁻¹ upper triangular with S⁻ᵀ S⁻¹ = shape: S⁻¹ = Lᵀ.
    gravity = (np.stack([x, y, z], axis=1) - offset) @ factor
    unit: Array = gravity / np.linalg.norm(gravity, axis=1, keepdims=True)
    return unit


def triangular_gauge(system: System, z: Array) -> tuple[System, Array]:
    """Turn the directions so that the first sensor's sensitivity matrix is upper triangular, and hold it so.

    Parameters
    ----------
    z : ndarray, shape (unknowns without attitudes,)
        A start.

    Returns
    -------
    system : System
        About the turned directions, with the elements below the diagonal held at zero.
    z : ndarray, shape (unknowns,)

    Raises
    ------
    EstimateError
        No sensor has three channels and axes.
    """
    number, columns = _three_axes(system)
    seen = system.orientations[number]
    matrix = z[columns]
    try:
        upper, turn = separated(matrix)
    except EstimateError as error:
        raise EstimateError(f"the first guess at the directions does not do: {error}") from None
    gravity = system.gravity @ (seen.T @ turn @ seen).T
    held = system.prior_u.copy()
    start = np.zeros(system.unknowns)
    start[: system.coefficients] = z[: system.coefficients]
    start[columns] = np.triu(upper)
    held[columns[np.tril_indices(3, -1)]] = 0.0
    return replace(system, gravity=gravity, prior_u=held), start


def require_enough(system: System) -> None:
    """Refuse fewer readings than unknowns.

    Raises
    ------
    EstimateError
    """
    moving = system.unknowns - int(system.fixed.sum())
    if system.readings + system.priors < moving:
        raise EstimateError(
            f"{len(system.gravity)} free positions give {system.readings} readings for {moving} unknowns (two of each "
            "position's direction among them): a sensor of three axes needs at least nine positions, well spread"
        )


def require_spread(near: LinearSolution) -> None:
    """Refuse free positions that leave coefficients undetermined.

    Raises
    ------
    EstimateError
        They are named.
    """
    system = near.system
    require_enough(system)
    mixed = undetermined_unknowns(near)
    if mixed:
        raise EstimateError(
            f"the {len(system.gravity)} free positions do not determine {', '.join(mixed[:4])}: add positions that are "
            "spread over the whole sphere, each axis up and down among them"
        )


def _three_axes(system: System) -> tuple[int, Indices]:
    """Return the first sensor with three channels and axes, and its sensitivities among the unknowns, shape (3, 3)."""
    for block in system.blocks:
        if len(block.models) == 3 and len(block.models[0].axes) == 3:
            return int(block.sensors[0]), block.columns[0, :, 1:4]
    raise EstimateError("free positions need a sensor of three channels: unit gravity does not determine fewer")
