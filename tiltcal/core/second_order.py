"""What the squares of the attitudes' errors do: the part of an uncertainty that no derivative shows.

A channel that points straight up reads cos a: an attitude error lowers it by a²/2 and never raises it. With a jig of
0.5° that is 4e-5 g, as much as the noise of a good sensor. To second order in the attitudes' errors ``a``, which have
the standard uncertainty of the jig, the estimate is off by ``D a + aᵀ Q_k a``; Q follows from putting the second-order
expansion of the model into the condition for the minimum, ``J(z)ᵀ W (y - model(z)) = 0``::

    second = G [H(a, a) - H(Da, Da)] / 2 + C H(Da)ᵀ W r

with G the linear estimator, C the covariance, H the model's second derivatives (by attitude twice, and by sensitivity
and attitude), and r what the first order leaves of the readings. Mean and covariance of a quadratic form of normal
errors are ``s² tr Q_k`` and ``2 s⁴ tr Q_k Q_l``.

Source: M. J. Box, *Bias in nonlinear estimation*, J. R. Statist. Soc. B 33 (1971) 171, for errors in the settings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.model import AXES, Array
from tiltcal.core.system import Indices, System


@dataclass(frozen=True)
class SecondOrder:
    """The second-order part of the coefficients' errors.

    Attributes
    ----------
    bias : ndarray, shape (coefficients,)
        By how much they are estimated too large on average.
    covariance : ndarray, shape (coefficients, coefficients)
        About that average.
    """

    bias: Array
    covariance: Array


def second_order(system: System, z: Array, jacobian: Array, gain: Array, variance: float) -> SecondOrder:
    """The second-order part for attitude angles of a given variance.

    Parameters
    ----------
    system : System
        With or without attitudes among its unknowns.
    z : ndarray, shape (unknowns,)
        The minimum.
    jacobian, gain : ndarray
        See :class:`tiltcal.core.uncertainty.Linear`.
    variance : float
        Of an attitude angle, rad².
    """
    count, readings = system.coefficients, system.readings
    lever, curvature, stands = attitude_lever(system, z)
    weighted = gain[:, :readings] / system.sigma
    follows = weighted @ lever
    own = _own_attitudes(system, follows)
    left = lever - (jacobian[:, : system.unknowns] @ follows)[:readings] * system.sigma[:, None]
    angles = lever.shape[1]
    forms = np.zeros((count, angles, angles))
    size = angles // 2
    # aᵀa and âᵀâ of each stand, times the curvature of the readings taken there.
    bent = np.zeros((count, size))
    np.add.at(bent.T, stands, (weighted[:count] * curvature).T)
    for stand in range(size):
        pair = slice(2 * stand, 2 * stand + 2)
        square = own[pair].T @ own[pair]
        square[pair, pair] -= np.eye(2)
        forms += 0.5 * bent[:, stand, None, None] * square
    forms += _products(system, z, weighted[:count], follows, own, stands)
    forms += _residual_products(system, z, gain, left, follows, own, stands, curvature)
    forms = (forms + np.swapaxes(forms, 1, 2)) / 2.0
    bias = variance * np.trace(forms, axis1=1, axis2=2)
    flat = forms.reshape(count, -1)
    return SecondOrder(bias, 2.0 * variance**2 * (flat @ flat.T))


def attitude_lever(system: System, z: Array) -> tuple[Array, Array, Indices]:
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


def _own_attitudes(system: System, follows: Array) -> Array:
    """How the estimated attitudes follow the true ones, shape (angles, angles)."""
    if system.jig > 0:
        return follows[system.attitudes]
    return np.zeros((follows.shape[1], follows.shape[1]))


def _by_sensitivity(system: System, z: Array) -> list[tuple[slice, Indices, Array]]:
    """For each channel: columns of its sensitivities, readings' rows, and d²u / dS da, shape (n, axes, 2)."""
    found = []
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
        found.append((slice(first, first + len(axes)), rows, scale[:, None, None] * turn))
        start += len(block.mean)
    return found


def _products(system: System, z: Array, weighted: Array, follows: Array, own: Array, stands: Indices) -> Array:
    """Minus G times the products of sensitivity and attitude errors."""
    count, angles = weighted.shape[0], own.shape[0]
    forms = np.zeros((count, angles, angles))
    if system.jig == 0:
        return forms
    for columns, rows, mixed in _by_sensitivity(system, z):
        pairs = own.reshape(-1, 2, angles)[stands[rows]]
        moved = np.einsum("nik,nkm->nim", mixed, pairs)
        by_reading = np.einsum("ia,nib->nab", follows[columns], moved)
        forms -= np.tensordot(weighted[:, rows], by_reading, axes=1)
    return forms


def _residual_products(
    system: System, z: Array, gain: Array, left: Array, follows: Array, own: Array, stands: Indices, curvature: Array
) -> Array:
    """C times the derivatives' own change, times what the first order leaves of the readings."""
    count, angles = system.coefficients, own.shape[0]
    covariance = gain[:count] @ gain.T
    forms = np.zeros((count, angles, angles))
    if system.jig == 0:
        return forms
    weight = 1.0 / system.sigma**2
    for columns, rows, mixed in _by_sensitivity(system, z):
        pairs = own.reshape(-1, 2, angles)[stands[rows]]
        rest = weight[rows, None] * left[rows]
        moved = np.einsum("nik,nkm->nim", mixed, pairs)
        forms += np.einsum("ki,nia,nb->kab", covariance[:, columns], moved, rest, optimize=True)
        turned = np.einsum("nik,im->nkm", mixed, follows[columns]) - curvature[rows, None, None] * pairs
        at = system.attitudes.start + 2 * stands[rows][:, None] + np.arange(2)
        forms += np.einsum("knj,nja,nb->kab", covariance[:, at], turned, rest, optimize=True)
    return forms
