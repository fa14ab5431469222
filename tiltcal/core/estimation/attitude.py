"""Small attitude errors: how a fixture that is set a little wrong turns gravity.

A position is set to the direction ``g``; its true direction is ``g'``, a great-circle arc away::

    g' = cos|a| g + sin|a| / |a| * (b1 a1 + b2 a2)

``b1, b2`` span the plane perpendicular to ``g`` and ``a`` holds the two angles in radians. A turn about gravity itself
moves no reading, so two angles are all there is. The basis is what the shortest turn from level to ``g`` makes of the
fixture's x and y: a table that leans by ``(t1, t2)`` then adds the same two angles to every position that is set with
the fixture at one heading, and turned ones to a position at another heading.
"""

from __future__ import annotations

import numpy as np

from tiltcal.core.model import Array

_UPSIDE_DOWN = 1e-12
_SMALL = 1e-6


def tangent_basis(gravity: Array) -> Array:
    """Return the two directions in which each unit vector can move.

    Parameters
    ----------
    gravity : ndarray, shape (n, 3)

    Returns
    -------
    ndarray, shape (n, 3, 2)
        Orthonormal columns, perpendicular to gravity. Upside down, where the shortest turn is not unique, it is the
        half turn about x.
    """
    x, y, z = gravity.T
    below = 1.0 + z < _UPSIDE_DOWN
    share = 1.0 / np.where(below, 1.0, 1.0 + z)
    basis = np.empty((len(gravity), 3, 2))
    basis[:, :, 0] = np.stack([1.0 - x * x * share, -x * y * share, -x], axis=1)
    basis[:, :, 1] = np.stack([-x * y * share, 1.0 - y * y * share, -y], axis=1)
    basis[below] = np.array([[1.0, 0.0], [0.0, -1.0], [0.0, 0.0]])
    return basis


def turned(gravity: Array, basis: Array, angles: Array) -> tuple[Array, Array]:
    """Turn gravity along the arc ``angles``, and differentiate it by them.

    Parameters
    ----------
    gravity : ndarray, shape (n, 3)
    basis : ndarray, shape (n, 3, 2)
        From :func:`tangent_basis`.
    angles : ndarray, shape (n, 2)
        Radians.

    Returns
    -------
    direction : ndarray, shape (n, 3)
    derivative : ndarray, shape (n, 3, 2)
        g/rad.
    """
    size = np.linalg.norm(angles, axis=1)
    sinc = np.sinc(size / np.pi)
    # (cos r - sin r / r) / r², whose limit is -1/3.
    small = size < _SMALL
    bend = np.where(small, -1.0 / 3.0, (np.cos(size) - sinc) / np.where(small, 1.0, size) ** 2)
    along = np.einsum("nij,nj->ni", basis, angles)
    direction = np.cos(size)[:, None] * gravity + sinc[:, None] * along
    derivative = sinc[:, None, None] * (basis - gravity[:, :, None] * angles[:, None, :])
    derivative += bend[:, None, None] * along[:, :, None] * angles[:, None, :]
    return direction, derivative


def heading_rotations(heading: Array) -> Array:
    """Return the matrices that take the lean of a table to the angles of positions at several headings.

    Parameters
    ----------
    heading : ndarray, shape (n,)
        How far the fixture is turned about the vertical, counterclockwise seen from above, radians.

    Returns
    -------
    ndarray, shape (n, 2, 2)
        ``angles = matrix @ lean``, the lean in the frame of the table.
    """
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([np.stack([c, s], axis=1), np.stack([-s, c], axis=1)], axis=1)


def rotation_vectors(gravity: Array, basis: Array, angles: Array) -> Array:
    """Return the arcs of :func:`turned` as right-handed rotation vectors in the fixture's frame, shape (n, 3), radians.

    None has a part along gravity.
    """
    return np.cross(gravity, np.einsum("nij,nj->ni", basis, angles))
