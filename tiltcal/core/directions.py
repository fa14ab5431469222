"""The directions of gravity in which three axes were calibrated: their hull on the sphere, and 5° about each.

Each direction counts with the signs of x and of y reversed as well, never with that of z. So the hull is symmetric
about the z axis: it is the whole sphere where directions lie above and below the horizon and turn about both other
axes, and else a cone about z, which is a convex polygon in the plane z = ±1.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property, reduce
from math import asin, cos, pi, radians

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.attitude import Vector
from tiltcal.core.model import AXES, Array

ALL = "all"

Directions = tuple[Vector, ...] | str  # unit vectors that were met, in the sensor's frame; ALL: their hull is a sphere
_MARGIN = cos(radians(5.0))  # a row that is no further than this from a direction is inside
_FLAT = 1e-6  # components below this are zero, g
_ROUNDING = 1e-12
_DIGITS = 4  # decimals of a direction in a file: 0.006°


class Cone:
    """The hull of some directions on the sphere, with the margin about each."""

    def __init__(self, directions: Sequence[Vector]) -> None:
        self.side = -1.0 if sum(z for _, _, z in directions) < 0.0 else 1.0
        signs = np.array([(x, y, 1.0) for x in (1.0, -1.0) for y in (1.0, -1.0)])
        self._met = np.unique((np.array(directions).reshape(-1, 1, 3) * signs).reshape(-1, 3), axis=0)

    @cached_property
    def faces(self) -> Array:
        """The normals of the planes that bound it, inwards, shape (faces, 3); none where it is flat."""
        if np.any(np.max(np.abs(self._met[:, :2]), axis=0, initial=0.0) < _FLAT):
            return np.empty((0, 3))
        from scipy.spatial import ConvexHull

        plane = self._met[:, :2] / np.maximum(np.abs(self._met[:, 2:]), _FLAT)
        corners = np.column_stack([plane, np.full(len(plane), self.side)])[ConvexHull(plane).vertices]
        return np.asarray(np.cross(corners, np.roll(corners, -1, axis=0)) * self.side)

    def inside(self, up: Array) -> NDArray[np.bool_]:
        """Return whether gravity, of any length, shape (3, n), is inside, shape (n,)."""
        within = np.full(up.shape[1], False)
        if len(self.faces):
            within = np.asarray((self.faces @ up >= -_ROUNDING).all(axis=0))
        rest = up[:, ~within]
        within[~within] = (self._met @ rest).max(axis=0, initial=-1.0) >= _MARGIN * np.linalg.norm(rest, axis=0)
        return within


def covered(directions: Iterable[Vector]) -> Directions:
    """Return the directions that were met, rounded and each once; ALL where their hull is the whole sphere."""
    met = tuple(dict.fromkeys(tuple(round(c, _DIGITS) + 0.0 for c in direction) for direction in directions))
    x, y, z = np.array(met).T
    around = np.abs(x).max() > _FLAT and np.abs(y).max() > _FLAT and z.min() < -_FLAT and z.max() > _FLAT
    return ALL if around else tuple((a, b, c) for a, b, c in met)


def common(several: Iterable[Directions]) -> Directions:
    """Return what is inside for all of several."""
    return reduce(_both, several)


def _both(first: Directions, second: Directions) -> Directions:
    if isinstance(first, str) or isinstance(second, str):
        return second if isinstance(first, str) else first
    one, other = Cone(first), Cone(second)
    here = tuple(v for v, there in zip(first, other.inside(np.array(first).reshape(-1, 3).T), strict=True) if there)
    both = tuple(v for v, there in zip(second, one.inside(np.array(second).reshape(-1, 3).T), strict=True) if there)
    if here == first or both == second:
        return here if here == first else both
    if one.side != other.side or not (len(one.faces) and len(other.faces)):
        return (*here, *both)
    from scipy.spatial import HalfspaceIntersection

    planes = -np.vstack([one.faces, other.faces]) * (1.0, 1.0, one.side)
    corners = HalfspaceIntersection(planes, np.zeros(2)).intersections
    up = np.column_stack([corners, np.full(len(corners), one.side)])
    return covered((x, y, z) for x, y, z in (up / np.linalg.norm(up, axis=1, keepdims=True)).tolist())


def tilts(directions: Directions) -> dict[str, tuple[float, float]]:
    """Return the tilts of x, y and z that directions reach, radians."""
    if isinstance(directions, str):
        return dict.fromkeys(AXES, (-pi / 2, pi / 2))
    ranges = {}
    for axis, components in zip(AXES, zip(*directions, strict=True), strict=False):
        low, high = asin(max(min(components), -1.0)), asin(min(max(components), 1.0))
        ranges[axis] = (low, high) if axis == "z" else (-max(-low, high), max(-low, high))
    return ranges
