"""Heading, and velocities in the earth frame, from gravity and the earth's magnetic field.

With ``up`` the unit vector that points up and ``m`` the magnetic field, both in the application's frame::

    east = m × up / |m × up|        north = up × east

and turned by the declination these point true. The x axis has the components ``x·east`` and ``x·north``::

    heading = atan2(x·east, x·north)            v_east, v_north, v_up = v·east, v·north, v·up

Where a heading is measured by something else, ``east`` and ``north`` follow from it and the horizontal part of x.

Source: A Solid State Tilt Meter for Current Meter Attitude Determination, section I and figure 8, has the purpose; the
vector products are textbook geometry.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import NO_DIRECTION, SUSPECT, Mask, mark_columns
from tiltcal.core.model import Array

HEADING = "heading"
VELOCITY = ("v_east", "v_north", "v_up")

_VANISHES = 1e-6
"""A horizontal part below this share of the whole has no direction in double precision that means anything."""

FIELD_TOLERANCE = 0.05
"""The share of its usual length by which the field may differ."""

_USUAL = 1000
"""Rows of which the median length of the field is the usual one."""


@dataclass(frozen=True)
class EarthFrame:
    """The directions of the earth for n rows, in the application's frame; NaN where there is none.

    Attributes
    ----------
    up, east, north : ndarray, shape (3, n)
        Unit vectors; true, where the declination or the heading is.
    heading : ndarray, shape (n,)
        Of the x axis, radians, 0 to 2π.
    magnetic_east : ndarray, shape (3, n), or None
        Without the declination; None where the heading comes from elsewhere.
    horizontal, down : ndarray, shape (n,), or None
        The field's horizontal part and its part along down, in its unit.
    """

    up: Array
    east: Array
    north: Array
    heading: Array
    magnetic_east: Array | None = None
    horizontal: Array | None = None
    down: Array | None = None

    @classmethod
    def of_field(cls, up: Array, field: Array, declination: float = 0.0) -> EarthFrame:
        """Find the earth's directions from the magnetic field.

        Parameters
        ----------
        up : ndarray, shape (3, n)
            Unit vectors.
        field : ndarray, shape (3, n)
            In any unit.
        declination : float
            How far magnetic north is east of true north, radians.
        """
        across = cross(field, up)
        horizontal = length_of(across)
        horizontal[horizontal <= _VANISHES * length_of(field)] = np.nan
        magnetic_east = across / horizontal
        magnetic_north = cross(up, magnetic_east)
        east = cos(declination) * magnetic_east + sin(declination) * magnetic_north
        north = cos(declination) * magnetic_north - sin(declination) * magnetic_east
        heading = np.arctan2(east[0], north[0])
        heading[np.hypot(east[0], north[0]) <= _VANISHES] = np.nan
        down = -np.einsum("in,in->n", field, up)
        return cls(up, east, north, full_circle(heading, 2 * np.pi), magnetic_east, horizontal, down)

    @classmethod
    def of_heading(cls, up: Array, heading: Array) -> EarthFrame:
        """Find the earth's directions from a true heading, radians."""
        along = -up[0] * up
        along[0] += 1.0
        length = length_of(along)
        length[length <= _VANISHES] = np.nan
        along /= length
        heading = np.where(np.isfinite(length), heading, np.nan)
        right = cross(along, up)
        sine, cosine = np.sin(heading), np.cos(heading)
        return cls(up, along * sine + right * cosine, along * cosine - right * sine, full_circle(heading, 2 * np.pi))

    def velocity(self, instrument: Array) -> Array:
        """Return the components east, north and up of a velocity in the application's frame, both of shape (3, n)."""
        known = np.isfinite(self.heading)
        turned = np.stack([np.einsum("in,in->n", instrument, axis) for axis in (self.east, self.north, self.up)])
        turned[:2, ~known] = np.nan
        return turned


def full_circle(angle: Array, turn: float) -> Array:
    """Return an angle from 0 to below a whole turn."""
    angle = np.mod(angle, turn)
    angle[angle == turn] = 0.0
    return angle


def cross(a: Array, b: Array) -> Array:
    """Return the vector product of vectors in columns; twice as fast as numpy's."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def length_of(vectors: Array) -> Array:
    """Return the length of vectors in columns."""
    return np.asarray(np.sqrt(np.einsum("in,in->n", vectors, vectors)))


class FieldLength:
    """Rows whose field is longer or shorter than usual.

    The usual length is the median of the first thousand rows, or of those up to the row itself; so it does not depend
    on where blocks end.
    """

    def __init__(self) -> None:
        self._first: list[float] = []

    def flagged(self, table: Mapping[str, NDArray[Any]], field: Array) -> dict[str, NDArray[Any]]:
        """Return the columns of some rows, flagged 3 with reason 128 where the field has another length than usual.

        Parameters
        ----------
        table : mapping of str to ndarray
            As :func:`tiltcal.core.flags.mark_columns` takes it.
        field : ndarray, shape (n, 3)
            Of the next rows, in order.
        """
        return mark_columns(table, self.wanders(length_of(field.T)), SUSPECT, NO_DIRECTION)

    def wanders(self, lengths: Array) -> Mask:
        """Return which of the next lengths, shape (n,), differ by more than :data:`FIELD_TOLERANCE`; NaN does not."""
        usual = np.full(len(lengths), np.nan)
        row = 0
        while row < len(lengths) and len(self._first) < _USUAL:
            if np.isfinite(lengths[row]):
                insort(self._first, float(lengths[row]))
            usual[row] = self._median()
            row += 1
        usual[row:] = self._median()
        return np.asarray(np.abs(lengths - usual) > FIELD_TOLERANCE * usual)

    def _median(self) -> float:
        count = len(self._first)
        return (self._first[(count - 1) // 2] + self._first[count // 2]) / 2.0 if count else np.nan
