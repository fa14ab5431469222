"""The minimum of a weighted sum of squares, by Gauss-Newton steps that are shortened where they lead uphill."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.estimation.equations import System, Weighted
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

STEPS = 200
"""Most steps; a bench needs three to six, free directions from a poor start some ten, and one that is far worse than it
was stated to be some sixty."""

SETTLED = 1e-12
"""A step below this share of each unknown's size is none, the size of all columns being one."""

LEVEL = 1e-12
"""A fall of the sum of squares below this share of it moves no unknown by a millionth of its uncertainty."""

CREEPING = 1e-3
"""A fall below this share of the sum, after all steps: far from what was stated, the way down is long and flat."""

ROUNDING = 1e-6
"""A fall of the sum of squares below this share of it is lost in the rounding of the readings."""

DAMPING = (0.0, 1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4)
"""Levenberg's damping, tried in turn until the sum of squares falls."""

DEGENERATE = 1e-10
"""A column this much shorter, once the others are taken out of it, is left to the slower way that bears it."""


def minimise(equations: Callable[[Array], Weighted], start: Array, moving: NDArray[np.bool_]) -> Array:
    """Where the sum of squared residuals is least.

    Parameters
    ----------
    equations : callable
        Residual and Jacobian at a point.
    start : ndarray, shape (unknowns,)
    moving : ndarray of bool, shape (unknowns,)
        Which unknowns are sought; the others stay.

    Returns
    -------
    ndarray, shape (unknowns,)

    Raises
    ------
    EstimateError
        No minimum is reached.
    """
    z = start.copy()
    here = equations(z)
    fall = 1.0
    for _ in range(STEPS):
        jacobian = here.jacobian[:, moving]
        size = column_sizes(jacobian)
        cost = float(here.residual @ here.residual)
        for damping in DAMPING:
            step = _step(jacobian / size, here.residual, damping)
            trial = z.copy()
            trial[moving] += step / size
            there = equations(trial)
            reach = 1.0 + float(np.max(np.abs(z[moving] * size), initial=0.0))
            small = float(np.max(np.abs(step), initial=0.0)) <= SETTLED * reach
            if small or there.residual @ there.residual < cost:
                break
        else:
            if _promised(jacobian / size, here.residual) <= ROUNDING * (1.0 + cost):
                return z
            raise EstimateError(
                "the estimate does not settle: are the positions named right, and the readings plausible?"
            )
        z, here = trial, there
        fall = (cost - float(there.residual @ there.residual)) / (1.0 + cost)
        if small or fall <= LEVEL:
            return z
    if fall <= CREEPING:
        return z
    raise EstimateError(f"the estimate does not settle in {STEPS} steps: are the positions named right?")


@dataclass(frozen=True)
class LinearSolution:
    """The system near its minimum, where every unknown is a linear function of the equations' errors.

    The covariance of the unknowns is the inverse times its transpose.

    Attributes
    ----------
    jacobian : ndarray, shape (equations, unknowns)
        Weighted.
    inverse : ndarray, shape (unknowns, equations)
        Pseudo-inverse of the Jacobian: the sensitivity of each unknown to each equation's error, which is in units of
        its standard uncertainty.
    """

    jacobian: Array
    inverse: Array


def linearised(system: System, z: Array) -> LinearSolution:
    """Linearise the system at a point; unknowns that are held do not move."""
    jacobian = system.at(z).jacobian
    moving = ~system.fixed
    size = column_sizes(jacobian)
    inverse = np.zeros(jacobian.T.shape)
    inverse[moving] = pseudo_inverse((jacobian / size)[:, moving]) / size[moving, None]
    return LinearSolution(jacobian, inverse)


def column_sizes(jacobian: Array) -> Array:
    """Length of each column; 1 for one that is zero."""
    size = np.linalg.norm(jacobian, axis=0)
    return np.asarray(np.where(size > 0.0, size, 1.0))


def pseudo_inverse(jacobian: Array) -> Array:
    """The pseudo-inverse of a Jacobian with columns of length one, by the quick way where it is safe."""
    q, r = np.linalg.qr(jacobian)
    return np.asarray(np.linalg.solve(r, q.T)) if _regular(r) else np.asarray(np.linalg.pinv(jacobian))


def _step(jacobian: Array, residual: Array, damping: float) -> Array:
    if damping > 0.0:
        unknowns = jacobian.shape[1]
        jacobian = np.concatenate([jacobian, np.sqrt(damping) * np.eye(unknowns)])
        residual = np.concatenate([residual, np.zeros(unknowns)])
    q, r = np.linalg.qr(jacobian)
    if _regular(r):
        return np.asarray(np.linalg.solve(r, q.T @ residual))
    return np.asarray(np.linalg.lstsq(jacobian, residual, rcond=None)[0])


def _regular(r: Array) -> bool:
    """Whether a triangular factor can be inverted without loss."""
    return r.shape[0] == r.shape[1] and bool(np.all(np.abs(np.diag(r)) > DEGENERATE))


def _promised(jacobian: Array, residual: Array) -> float:
    """By how much an undamped step would lower the sum of squares, were the equations linear."""
    predicted = jacobian @ _step(jacobian, residual, 0.0)
    return float(predicted @ predicted)
