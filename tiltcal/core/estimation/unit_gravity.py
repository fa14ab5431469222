"""The estimator's equations where no jig sets the positions: the directions of gravity are unknown unit vectors.

A turn of all directions together, undone in S, changes no reading: the gauge makes S upper triangular. The ellipsoid of
the readings (:mod:`tiltcal.core.estimation.ellipsoid`) gives the directions to start from.
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
    try:
        upper, turn = separated(z[columns])
    except EstimateError as error:
        raise EstimateError(f"the first guess at the directions does not do: {error}") from None
    gravity = system.gravity @ (seen.T @ turn @ seen).T
    held = system.prior_u.copy()
    start = system.as_set(z)
    start[columns] = np.triu(upper)
    held[columns[np.tril_indices(3, -1)]] = 0.0
    return replace(system, gravity=gravity, prior_u=held), start


def require_enough(system: System) -> None:
    """Refuse fewer readings than unknowns, with an EstimateError."""
    moving = system.unknowns - int(system.fixed.sum())
    if system.readings + system.priors < moving:
        raise EstimateError(
            f"{len(system.gravity)} free positions give {system.readings} readings for {moving} unknowns (two of each "
            "position's direction among them): a sensor of three axes needs at least nine positions, well spread"
        )


def require_spread(near: LinearSolution) -> None:
    """Refuse free positions that leave coefficients undetermined, with an EstimateError that names them."""
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
