"""The weighted equations solved with the unknowns of each sensor eliminated first.

The sensors of a fixture meet only in the shared unknowns, so that each one's own unknowns are eliminated by themselves
(the Schur complement). With the QR decomposition ``J = Q R`` of one set of equations by its local unknowns x, and its
derivatives ``A`` by the shared unknowns y::

    J x + A y = r     gives     x = R⁻¹ Qᵀ (r - A y),     (A - Q Qᵀ A) y = r - Q Qᵀ r

The right equations of all sets, and what is known of y, are reduced together to a triangle as they come. The time and
the memory are proportional to the number of sensors, and nothing is squared on the way: the result is as accurate as
that of the whole Jacobian.

Source: G. H. Golub, C. F. Van Loan, *Matrix Computations*, 4th edition (2013), 5.3 and 6.1 (block QR); GUM 5.2 for the
covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tiltcal.core.estimation.joint_equations import Equations, Indices, LocalEquations, System
from tiltcal.core.model import Array

DEGENERATE = 1e-10
"""Share of a column's length that is left without the others, below which a singular value decomposition is used."""

ROWS = 4096
"""Equations of shared unknowns that are reduced at a time."""

UNSEEN = 1e-6
"""A lean with less than this share of its effect left, once the coefficients follow it, shows in no reading."""


@dataclass(frozen=True)
class LocalFactor:
    """Orthogonal factors of one block, with which its local unknowns are eliminated.

    Attributes
    ----------
    unknowns : ndarray of int, shape (B, local)
    basis : ndarray, shape (B, rows, local)
        Q: orthonormal columns.
    inverse : ndarray, shape (B, local, local)
        R⁻¹; zero for unknowns that are held.
    follows : ndarray, shape (B, local, shared)
        Qᵀ A.
    rhs : ndarray, shape (B, local)
        Qᵀ r.
    """

    unknowns: Indices
    basis: Array
    inverse: Array
    follows: Array
    rhs: Array


@dataclass(frozen=True)
class Elimination:
    """The equations of the shared unknowns, after the local ones are eliminated.

    Attributes
    ----------
    triangle : ndarray, shape (shared, shared)
        The remaining equations for the shared unknowns.
    rhs : ndarray, shape (shared,)
        Their right-hand side.
    residual_squares : float
        The sum of squares that no unknown can take away.
    """

    factors: tuple[LocalFactor, ...]
    triangle: Array
    rhs: Array
    residual_squares: float

    @property
    def decrease(self) -> float:
        """Decrease of the sum of squares by the solution, if the equations were linear."""
        own = sum(float(np.vdot(factor.rhs, factor.rhs)) for factor in self.factors)
        return own + float(self.rhs @ self.rhs)

    def step(self, system: System) -> Array:
        """Return the solution, shape (unknowns,)."""
        step = np.empty(system.unknowns)
        shared = step[system.local :]
        shared[:] = solve(self.triangle, self.rhs)
        for factor in self.factors:
            right = factor.rhs - factor.follows @ shared
            step[factor.unknowns] = (factor.inverse @ right[..., None])[..., 0]
        return step


def eliminate(equations: Equations, shared: int, *, damping: float = 0.0, without: int = 0) -> Elimination:
    """Eliminate the local unknowns.

    Parameters
    ----------
    shared : int
        How many unknowns are shared.
    damping : float
        Levenberg's, relative to the square of each column's length.
    without : int
        How many of the last equations that are no readings are left out.
    """
    known = len(equations.columns) - without
    table = np.zeros((known, shared + 1))
    table[np.arange(known), equations.columns[:known]] = equations.weight[:known]
    table[:, shared] = equations.residual[:known]
    waiting, rows, factors = [table], 0, []
    for block in equations.blocks:
        factor, left = _eliminated(block, shared, damping)
        factors.append(factor)
        waiting.append(left)
        rows += len(left)
        if rows > ROWS:
            waiting, rows = [_triangle(waiting)], 0
    triangle = np.zeros((shared + 1, shared + 1))
    found = _triangle(waiting)
    triangle[: len(found)] = found
    if damping > 0.0:
        size = np.linalg.norm(triangle[:, :shared], axis=0)
        more = np.hstack([np.diag(np.sqrt(damping) * np.where(size > 0.0, size, 1.0)), np.zeros((shared, 1))])
        triangle = _triangle([triangle, more])
    return Elimination(
        tuple(factors), triangle[:shared, :shared], triangle[:shared, shared], float(triangle[shared, shared] ** 2)
    )


def _triangle(rows: Sequence[Array]) -> Array:
    """Reduce equations to a triangle."""
    return np.asarray(np.linalg.qr(np.concatenate(rows), mode="r"))


def shared_table(block: LocalEquations, shared: int) -> Array:
    """Return the derivatives by the shared unknowns, and the residual beside them, shape (B, rows, shared + 1)."""
    sets, rows = block.residual.shape
    table = np.zeros((sets, rows, shared + 1))
    if block.shared.shape[2]:
        np.put_along_axis(table[:, : block.readings], block.columns, block.shared, axis=2)
    table[..., shared] = block.residual
    return table


def _eliminated(block: LocalEquations, shared: int, damping: float) -> tuple[LocalFactor, Array]:
    """Eliminate the local unknowns of one block; return its factors and the equations of the shared unknowns."""
    jacobian, table = block.jacobian, shared_table(block, shared)
    size = np.sqrt(np.einsum("bij,bij->bj", jacobian, jacobian))
    if damping > 0.0:
        more = np.sqrt(damping) * np.where(size > 0.0, size, 1.0)[:, None] * np.eye(size.shape[1])
        jacobian = np.concatenate([jacobian, more], axis=1)
        table = np.concatenate([table, np.zeros((*more.shape[:2], shared + 1))], axis=1)
    basis, triangle = np.linalg.qr(jacobian)
    diagonal = np.abs(np.diagonal(triangle, axis1=1, axis2=2))
    if np.all(diagonal > DEGENERATE * size):
        inverse = np.linalg.inv(triangle)
    else:
        size = np.where(size > 0.0, size, 1.0)
        basis, values, rotation = np.linalg.svd(jacobian / size[:, None], full_matrices=False)
        kept = values > DEGENERATE * values[:, :1]
        basis = basis * kept[:, None]
        share = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
        inverse = rotation.swapaxes(1, 2) * share[:, None] / size[:, :, None]
    if block.held.any():
        inverse = inverse * ~block.held[:, :, None]
    follows = basis.swapaxes(1, 2) @ table
    table -= basis @ follows
    factor = LocalFactor(block.unknowns, basis, inverse, follows[..., :shared], follows[..., shared])
    return factor, table.reshape(-1, shared + 1)


def solve(triangle: Array, right: Array) -> Array:
    """Solve the equations of a triangle; where they have no solution, by the pseudo-inverse."""
    size = np.linalg.norm(triangle, axis=0)
    if np.all(np.abs(np.diag(triangle)) > DEGENERATE * size):
        return np.asarray(np.linalg.solve(triangle, right))
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(((np.linalg.pinv(triangle / size, rcond=DEGENERATE) @ right).T / size).T)


@dataclass(frozen=True)
class LinearSolution:
    """The equations near their minimum, where every unknown is a linear function of the equations' errors.

    The attitude angles have the variance ``jig²``; what else is known is in the triangle. The singular values d of the
    triangle's part for the attitudes, which no other unknown can follow, measure how well the readings show each
    combination of angles: its variance is jig² / (1 + jig² d²).

    Attributes
    ----------
    system : System
        With attitude angles, unless its jig is perfect.
    elimination : Elimination
        Without the equations that state the jig.
    jig : float
        Radians; infinite where nothing is known.
    """

    system: System
    equations: Equations
    elimination: Elimination
    jig: float

    @property
    def angles(self) -> int:
        """Number of attitude angles."""
        return int(self.system.attitudes.stop - self.system.attitudes.start)

    @property
    def shared(self) -> int:
        """Number of shared unknowns."""
        return self.system.unknowns - self.system.local

    @cached_property
    def spectrum(self) -> tuple[Array, Array, Array]:
        """Left vectors, values and right vectors of the triangle's part for the attitudes, shape (angles, angles)."""
        first = self.shared - self.angles
        u, d, w = np.linalg.svd(self.elimination.triangle[first:, first:])
        return u, d, w.T

    @cached_property
    def unobserved(self) -> Array:
        """Share of each combination of angles that no reading shows, 1 / (1 + jig² d²)."""
        d = self.spectrum[1]
        return np.asarray(1.0 / (1.0 + (self.jig * d) ** 2))

    @cached_property
    def directions(self) -> Array:
        """Independent combinations of the shared unknowns, a column each; the last are those of the angles."""
        first = self.shared - self.angles
        triangle = self.elimination.triangle
        directions = np.zeros((self.shared, self.shared))
        directions[:first, :first] = solve(triangle[:first, :first], np.eye(first))
        if self.angles:
            right = self.spectrum[2]
            directions[first:, first:] = right
            directions[:first, first:] = -directions[:first, :first] @ triangle[:first, first:] @ right
        return directions

    @cached_property
    def variances(self) -> Array:
        """Variance along each of :attr:`directions`."""
        variances = np.ones(self.shared)
        if self.angles:
            variances[self.shared - self.angles :] = self.jig**2 * self.unobserved
        return variances

    @cached_property
    def shared_covariance(self) -> Array:
        """Covariance of the shared unknowns, shape (shared, shared)."""
        return np.asarray((self.directions * self.variances) @ self.directions.T)

    @cached_property
    def response(self) -> Array:
        """Decrease of each coefficient with each of :attr:`directions`, shape (coefficients, shared)."""
        response = np.zeros((self.system.local, self.shared))
        for factor in self.elimination.factors:
            response[factor.unknowns] = factor.inverse @ (factor.follows @ self.directions)
        return response[: self.system.coefficients]

    def own_covariances(self, number: int) -> Array:
        """Return covariances of a block's coefficients as if the shared unknowns were known, shape (S, C k, C k)."""
        block, factor = self.system.blocks[number], self.elimination.factors[number]
        inverse = np.asarray(factor.inverse @ factor.inverse.swapaxes(1, 2))
        sensors, channels, k = block.columns.shape
        if len(inverse) == sensors and channels > 1:
            return inverse[:, : channels * k, : channels * k]
        found = np.zeros((sensors, channels, k, channels, k))
        for channel in range(channels):
            found[:, channel, :, channel] = inverse.reshape(sensors, channels, -1, inverse.shape[2])[:, channel, :k, :k]
        return found.reshape(sensors, channels * k, channels * k)

    @cached_property
    def unobservable_leans(self) -> int:
        """Number of directions of the table's lean that no reading shows."""
        if self.system.lean_rotations is None:
            return 0
        start = self.system.lean.start - self.system.local
        whole, left = np.zeros((2, 2)), np.zeros((2, 2))
        for block, factor in zip(self.equations.blocks, self.elimination.factors, strict=True):
            table = shared_table(block, self.shared)[..., start : start + 2]
            whole += np.einsum("bri,brj->ij", table, table)
            table -= factor.basis @ factor.follows[..., start : start + 2]
            left += np.einsum("bri,brj->ij", table, table)
        size = np.sqrt(np.diag(whole))
        size = np.where(size > 0.0, size, 1.0)
        return int(np.sum(np.linalg.eigvalsh(left / np.outer(size, size)) < UNSEEN**2))


def linearised(system: System, z: Array, jig: float | None = None) -> LinearSolution:
    """Linearise the system at a point; coefficients that are held do not move.

    Parameters
    ----------
    z : ndarray, shape (unknowns,)
    jig : float, optional
        Standard deviation of the attitude angles, radians; the system's own where it is left out.
    """
    equations = system.at(z)
    angles = system.attitudes.stop - system.attitudes.start
    elimination = eliminate(equations, system.unknowns - system.local, without=angles)
    return LinearSolution(system, equations, elimination, system.jig if jig is None else jig)
