"""Second-order terms of the attitude errors: the part of an uncertainty that no derivative shows.

A channel that points straight up reads cos a: an attitude error lowers it by a²/2 and never raises it. With a jig of
0.5° that is 4e-5 g, as much as the noise of a good sensor. To second order in the attitudes' errors ``a`` the estimate
is off by ``D a + second``, and the condition for the minimum, ``J(z)ᵀ W (y - model(z)) = 0``, says::

    second = G [H(a, a) - H(Da, Da)] / 2 + C H(Da)ᵀ W r

with G the linear estimator, C the covariance, H the model's second derivatives (by attitude twice, and by sensitivity
and attitude), and r what the first order leaves of the readings. The angles are independent and have the variance s²,
so that the mean of each product is s² times the sum of the factors' products over the angles.

Arrays have the indices ``s`` of a sensor in its block, ``c`` of its channel, ``n`` of its reading, ``i`` of an axis of
the sensitivity, ``k`` of the two angles of the reading's setting, and ``a`` of the angle that errs::

    curvature[s, c, n]       -H by either angle of the setting twice; by both it is 0
    mixed[s, c, n, i, k]     H by sensitivity i and angle k
    own[setting, k, a]       D of angle k of a setting
    follows[coefficient, a]  D of a coefficient
    left[s, c, n, a]         W r

**By hand.** One channel of known offset in one position reads ``S (sin t (1 - (a1² + a2²)/2) + cos t a1)`` with the
noise u, and S is known to v before. What it reads differs from S sin t with the variance V, and nothing shows a2::

    V = u² + (v sin t)² + (s S cos t)²
    follows = v² S sin t cos t / V,   own = (s S cos t)² / V,   left = S cos t / V          of a1, and 0 of a2
    curvature = S sin t,   mixed = cos t
    off      = curvature (own² - 2) / 2 - mixed follows own         what the readings bend; 2 for the true a1 and a2
    by_angle = left (mixed follows - curvature own),   pull = left mixed own                H(Da)ᵀ W r, of a1 and of S
    second   = v² / V [sin t off + (u² + (s S cos t)²) pull - s² S sin t cos t by_angle]    times s²

The factors in the last line are v² sin t / V, the estimator, and the covariances of S with itself and with a1.

Source: M. J. Box, *Bias in nonlinear estimation*, J. R. Statist. Soc. B 33 (1971) 171, for errors in the settings.
"""

from __future__ import annotations

import numpy as np

from tiltcal.core.estimation.elimination import LinearSolution, shared_table
from tiltcal.core.estimation.joint_equations import EquationBlock, System
from tiltcal.core.model import AXES, Array


def second_order_bias(near: LinearSolution, z: Array) -> Array:
    """Compute the second-order bias of the coefficients where attitudes are unknowns, shape (coefficients,).

    Parameters
    ----------
    near : LinearSolution
        With attitude angles, at the minimum.
    z : ndarray, shape (unknowns,)
        The minimum.
    """
    system, first, q = near.system, near.shared - near.angles, near.jig**2
    covariance = near.shared_covariance[:, first:] / q
    # Of a true error of the angles the attitudes follow the unit matrix less this, and the coefficients the response.
    own = (np.eye(near.angles) - covariance[first:]).reshape(-1, 2, near.angles)
    follows = (near.response * near.variances) @ near.directions[first:].T / q
    # aᵀa is 2 s² for each setting's two angles; âᵀâ is what the estimate follows of them.
    squares = np.sum(own**2, axis=(1, 2)) - 2.0
    direction, derivative = system.directions(z)
    right, locally = np.zeros(near.shared), []
    for block, equations, factor in zip(system.blocks, near.equations.blocks, near.elimination.factors, strict=True):
        settings = system.settings[block.places]
        seen = system.seen(block, direction)
        curvature = (block.read(z, seen, block.dt).by_gravity @ seen[:, None].swapaxes(2, 3)).diagonal(0, 2, 3)
        mixed = _by_sensitivity_and_angle(system, block, z, derivative)
        columns = block.columns[:, :, 1 : 1 + mixed.shape[3]]
        followed = follows[columns].swapaxes(2, 3)

        table = shared_table(equations, near.shared)[:, : equations.readings, : near.shared]
        left = table @ covariance - factor.basis[:, : equations.readings] @ (factor.follows @ covariance)
        left = left.reshape(*block.u.shape, near.angles) / block.u[..., None]
        moved = (own.reshape(-1, near.angles) @ followed).reshape(*columns.shape[:2], len(own), 2, -1)
        moved = np.stack([value[:, at] for value, at in zip(moved, settings, strict=True)])
        # What each reading bends: mixed follows own, summed over axes i, angles k, and the errors a (in ``moved``).
        off = 0.5 * curvature * squares[settings][:, None] - np.einsum("scnik,scnki->scn", mixed, moved)
        # H(Da)ᵀ W r: W r times D of each angle k, summed over the errors a; then by angle k of each reading,
        # and by sensitivity i of each channel, which takes all its readings n and angles k.
        by_own = np.einsum("scna,snka->scnk", left, own[settings])
        by_angle = np.einsum("scnik,scni->scnk", mixed, left @ followed) - curvature[..., None] * by_own
        pull = np.zeros(system.coefficients)
        pull[columns] = np.einsum("scnik,scnk->sci", mixed, by_own)
        np.add.at(right[first:].reshape(-1, 2), settings, by_angle.sum(axis=1))

        residual = (off / block.u).reshape(len(factor.basis), -1)
        of_own = factor.unknowns[0] < system.coefficients
        pulled = factor.inverse[:, of_own].swapaxes(1, 2) @ pull[factor.unknowns[:, of_own]][..., None]
        locally.append(factor.basis[:, : equations.readings].swapaxes(1, 2) @ residual[..., None] + pulled)
        right += np.tensordot(residual, table, 2) - np.tensordot(locally[-1][..., 0], factor.follows, 2)
    shared = near.shared_covariance @ right
    bias = np.empty(system.local)
    for factor, own_part in zip(near.elimination.factors, locally, strict=True):
        bias[factor.unknowns] = (factor.inverse @ (own_part - (factor.follows @ shared)[..., None]))[..., 0]
    return q * bias[: system.coefficients]


def _by_sensitivity_and_angle(system: System, block: EquationBlock, z: Array, derivative: Array) -> Array:
    """Return second derivatives of a block's readings by sensitivity and attitude angle, shape (S, C, n, axes, 2)."""
    axes = [AXES.index(axis) for axis in block.models[0].axes]
    turn = (system.orientations[block.sensors][:, None] @ derivative[block.places])[:, None, :, axes]
    _, _, gain, _ = block.models[0].split(z[block.columns])
    powers = block.dt[:, None, :, None] ** np.arange(1, gain.shape[-1] + 1)
    return np.asarray((1.0 + np.sum(powers * gain[:, :, None], axis=-1))[..., None, None] * turn)
