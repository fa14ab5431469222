"""What the squares of the attitudes' errors do: the part of an uncertainty that no derivative shows.

A channel that points straight up reads cos a: an attitude error lowers it by a²/2 and never raises it. With a jig of
0.5° that is 4e-5 g, as much as the noise of a good sensor. To second order in the attitudes' errors ``a`` the estimate
is off by ``D a + second``, and the condition for the minimum, ``J(z)ᵀ W (y - model(z)) = 0``, says::

    second = G [H(a, a) - H(Da, Da)] / 2 + C H(Da)ᵀ W r

with G the linear estimator, C the covariance, H the model's second derivatives (by attitude twice, and by sensitivity
and attitude), and r what the first order leaves of the readings. The angles are independent and have the variance s²,
so that the mean of each product is s² times the sum of the factors' products over the angles.

Source: M. J. Box, *Bias in nonlinear estimation*, J. R. Statist. Soc. B 33 (1971) 171, for errors in the settings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tiltcal.core.estimation.equations import Indices, System
from tiltcal.core.estimation.gauss_newton import LinearSolution
from tiltcal.core.model import AXES, Array


def second_order_bias(system: System, z: Array, near: LinearSolution, variance: float) -> Array:
    """By how much the coefficients are estimated too large on average, where attitudes are among the unknowns.

    Parameters
    ----------
    system : System
        Of a jig with attitude angles.
    z : ndarray, shape (unknowns,)
        The minimum.
    near : LinearSolution
        The system there.
    variance : float
        Of an attitude angle, rad².

    Returns
    -------
    ndarray, shape (coefficients,)
    """
    lever, curvature, stands = attitude_sensitivity(system, z)
    readings = system.readings
    linear = near.inverse[:, :readings] / system.sigma
    follows = linear @ lever
    own = follows[system.attitudes].reshape(-1, 2, lever.shape[1])
    left = (lever - (near.jacobian @ follows)[:readings] * system.sigma[:, None]) / system.sigma[:, None] ** 2
    # aᵀa is 2 s² for each stand's two angles; âᵀâ is what the estimate follows of them.
    squares = np.sum(own**2, axis=(1, 2)) - 2.0
    off = 0.5 * curvature * squares[stands]
    pull = np.zeros(system.unknowns)
    for columns, rows, mixed in _by_sensitivity(system, z):
        own_there, left_there = own[stands[rows]], left[rows]
        moved = np.einsum("nik,nkm->nim", mixed, own_there)
        off[rows] -= np.einsum("im,nim->n", follows[columns], moved)
        pull[columns] += np.einsum("nim,nm->i", moved, left_there)
        turned = np.einsum("nik,im->nkm", mixed, follows[columns]) - curvature[rows, None, None] * own_there
        at = system.attitudes.start + 2 * stands[rows][:, None] + np.arange(2)
        np.add.at(pull, at, np.einsum("nkm,nm->nk", turned, left_there))
    coefficients = slice(0, system.coefficients)
    bias = linear[coefficients] @ off + near.inverse[coefficients] @ (near.inverse.T @ pull)
    return np.asarray(variance * bias)


def attitude_sensitivity(system: System, z: Array) -> tuple[Array, Array, Indices]:
    """What attitude angles do to the readings.

    Returns
    -------
    lever : ndarray, shape (readings, angles)
        unit/rad.
    curvature : ndarray, shape (readings,)
        Minus the second derivative by either angle of the reading's own stand, unit/rad².
    stands : ndarray of int, shape (readings,)
    """
    count = system.coefficients
    tilted = system if system.jig > 0 else replace(system, jig=1.0)
    z_tilted = np.zeros(tilted.unknowns)
    z_tilted[:count] = z[:count]
    z_tilted[tilted.lean] = z[system.lean]
    if system.jig > 0:
        z_tilted = z
    lever = tilted.at(z_tilted).jacobian[: system.readings, tilted.attitudes] * system.sigma[:, None]
    direction, _ = tilted.directions(z_tilted)
    curvature = []
    for block in system.blocks:
        seen = direction[block.places] @ system.orientations[block.sensor].T
        reading = block.model.read(z[block.columns], seen, block.dt)
        curvature.append(np.einsum("ni,ni->n", reading.by_gravity, seen))
    stands = np.concatenate([system.stands[block.places] for block in system.blocks])
    return lever, np.concatenate(curvature), stands


def _by_sensitivity(system: System, z: Array) -> Iterator[tuple[slice, Indices, Array]]:
    """For each channel: columns of its sensitivities, readings' rows, and d²u / dS da, shape (n, axes, 2)."""
    start = 0
    _, derivative = system.directions(z)
    for block in system.blocks:
        axes = [AXES.index(axis) for axis in block.model.axes]
        seen = system.orientations[block.sensor]
        turn = np.einsum("ij,njk->nik", seen, derivative[block.places])[:, axes]
        _, _, gain, _ = block.model.split(z[block.columns])
        scale = 1.0 + (block.dt[:, None] ** np.arange(1, len(gain) + 1)) @ gain
        first = block.columns.start + 1
        rows = np.arange(start, start + len(block.mean), dtype=np.intp)
        yield slice(first, first + len(axes)), rows, scale[:, None, None] * turn
        start += len(block.mean)
