"""Heading, and velocities in the earth frame, from gravity and the earth's magnetic field.

With ``up`` the unit vector that points up and ``m`` the magnetic field, both in the application's frame::

    east = m × up / |m × up|        north = up × east

and turned by the declination these point true. The x axis has the components ``x·east`` and ``x·north``::

    heading = atan2(x·east, x·north)            v_east, v_north, v_up = v·east, v·north, v·up

Where a heading is measured by something else, ``east`` and ``north`` follow from it and the horizontal part of x.

An error of ``up`` by the small vector ``d`` (across up) tips east and north by the part of ``d`` along each, and turns
both about the vertical by ``k·d``::

    k = -(Z / H) east_magnetic          with a field of horizontal part H and part Z along down
    k = -(x_up / h²) (x_east north - x_north east)      with a heading of the x axis; h² = 1 - x_up²

From these follow the gradients by ``up``, all of them across up::

    heading    k + (x_up / h²) (x_east north - x_north east)
    v_east     k v_north - v_up east
    v_north   -k v_east  - v_up north
    v_up       v_east east + v_north north

An error of the field turns east and north alone, by ``-east_magnetic / H`` for the k above. A mounting that is
uncertain turns up and the field alike. The magnetometer's own calibration, the declination, a heading that is given and
the velocity itself count as exact.

Source: A Solid State Tilt Meter for Current Meter Attitude Determination, section I and figure 8, has the purpose; the
vector products are textbook geometry.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import cos, isfinite, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.core import flags
from tiltcal.core.angle_uncertainty import (
    HALF_TURN,
    CompensationWithUncertainty,
    uncertainty_columns,
    uncertainty_table,
)
from tiltcal.core.attitude import UNKNOWN_ANGLE
from tiltcal.core.compensation import CLIP_LIMIT, VANISHES, Compensation, KernelChunk
from tiltcal.core.flags import CLIPPED, FAIL, MISSING, NO_DIRECTION, SUSPECT, mark
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

HEADING = "heading"
VELOCITY = ("v_east", "v_north", "v_up")

_VANISHES = 1e-6  # a horizontal part below this share of the whole has no direction in double precision
FIELD_TOLERANCE = 0.05  # the share of its usual length by which the field may differ
_USUAL = 1000  # rows of which the median length of the field is the usual one


@dataclass(frozen=True)
class EarthFrame:
    """The directions of the earth for n rows, in the application's frame; NaN where there is none.

    ``up``, ``east`` and ``north`` are unit vectors, (3, n), true where the declination or the heading is; ``heading``
    is that of the x axis, (n,), radians, 0 to 2π. Of a magnetic ``field`` these are its east, (3, n), and its parts
    that are horizontal and along down, (n,), in its unit.
    """

    up: Array
    east: Array
    north: Array
    heading: Array
    field: tuple[Array, Array, Array] | None = None

    @classmethod
    def of_field(cls, up: Array, field: Array, declination: float) -> EarthFrame:
        """Find the earth's directions from the field, (3, n); magnetic north is east of north by the declination."""
        across = np.cross(field, up, axis=0)
        horizontal = length_of(across)
        horizontal[horizontal <= _VANISHES * length_of(field)] = np.nan
        magnetic_east = across / horizontal
        magnetic_north = np.cross(up, magnetic_east, axis=0)
        east = cos(declination) * magnetic_east + sin(declination) * magnetic_north
        north = cos(declination) * magnetic_north - sin(declination) * magnetic_east
        heading = np.arctan2(east[0], north[0])
        heading[np.hypot(east[0], north[0]) <= _VANISHES] = np.nan
        down = -np.einsum("in,in->n", field, up)
        return cls(up, east, north, full_circle(heading, 2 * np.pi), (magnetic_east, horizontal, down))

    @classmethod
    def of_heading(cls, up: Array, heading: Array) -> EarthFrame:
        """Find the earth's directions from a true heading, (n,), radians."""
        along = -up[0] * up
        along[0] += 1.0
        length = length_of(along)
        length[length <= _VANISHES] = np.nan
        along /= length
        heading = np.where(np.isfinite(length), heading, np.nan)
        right = np.cross(along, up, axis=0)
        sine, cosine = np.sin(heading), np.cos(heading)
        return cls(up, along * sine + right * cosine, along * cosine - right * sine, full_circle(heading, 2 * np.pi))

    def velocity(self, instrument: Array) -> Array:
        """Return the components east, north and up of a velocity in the application's frame, both of shape (3, n)."""
        turned = np.stack([np.einsum("in,in->n", instrument, axis) for axis in (self.east, self.north, self.up)])
        turned[:2, ~np.isfinite(self.heading)] = np.nan
        return turned

    def gradients(self, velocity: Array | None) -> Iterator[tuple[Array, Array]]:
        """Yield the derivatives of heading (of a field) and velocities, by up and by a turn of east about it."""
        east, north = self.east, self.north
        own = (self.up[0] / (east[0] ** 2 + north[0] ** 2)) * (east[0] * north - north[0] * east)
        turn = -own
        if self.field is not None:
            magnetic_east, horizontal, down = self.field
            turn = -(down / horizontal) * magnetic_east
            yield turn + own, np.ones(own.shape[1])
        if velocity is not None:
            v_east, v_north, v_up = self.velocity(velocity)
            yield v_north * turn - v_up * east, v_north
            yield -v_east * turn - v_up * north, -v_east
            yield v_east * east + v_north * north, np.zeros(len(v_up))


class EarthFrameCompensation:
    """Adds heading and earth velocities to the rows of a compensation, and their flags.

    ``magnetometer``: the heading comes from a field, and is added; else rows have one. ``declination``: added to the
    heading, degrees. ``uncertain``: adds the uncertainty of each column, with that of each component of the field,
    ``field_noise``, in its unit. ``averaged``: rows are means, whose uncertainties have a random and a common share.

    Sensor and magnetometer have the same axes, and a mounting turns both, but not the velocities. ``columns`` are the
    names of the columns of a call, in order.
    """

    def __init__(
        self,
        compensation: Compensation,
        *,
        magnetometer: bool,
        velocity: bool,
        declination: float = 0.0,
        uncertain: CompensationWithUncertainty | None = None,
        field_noise: float = 0.0,
        averaged: bool = False,
    ) -> None:
        if not {"x", "y"} <= set(compensation.axes):
            raise EstimateError("heading and velocities take a sensor that measures at least x and y")
        self._compensation, self._declination = compensation, radians(declination)
        self._uncertain, self._field_noise, self._averaged = uncertain, field_noise, averaged
        own = (*((HEADING,) if magnetometer else ()), *(VELOCITY if velocity else ()))
        self.columns = own if uncertain is None else (*own, *uncertainty_columns(own, averaged=averaged))

    def __call__(self, chunk: KernelChunk, field: Array | None, heading: Array | None, velocity: Array | None) -> Array:
        """Return the columns of compensated rows, shape (columns, n), and mark their flags.

        It takes a field in the sensor's frame, (n, 3), or a heading, (n,), degrees, and a velocity, (n, 3).
        """
        up, rotation = self._up(chunk), self._compensation.rotation
        turned = None if field is None else field.T if rotation is None else np.asarray(rotation @ field.T)
        if turned is not None:
            frame = EarthFrame.of_field(up, turned, self._declination)
        elif heading is not None:
            frame = EarthFrame.of_heading(up, np.radians(heading) + self._declination)
        else:
            raise ValueError("heading and velocities take a field or a heading")
        missing = np.zeros(len(chunk.out.flag), bool)
        for given in (field, heading, velocity):
            if given is not None:
                missing |= ~np.isfinite(given).reshape(len(given), -1).all(axis=1)
        mark(chunk.out, missing & (chunk.out.flag < MISSING), FAIL, flags.NOT_A_NUMBER)
        without = ~missing & ~np.isfinite(frame.heading)
        mark(chunk.out, without & (np.isfinite(up[0]) | (chunk.out.flag < FAIL)), FAIL, NO_DIRECTION)
        rows = [] if field is None else [full_circle(np.degrees(frame.heading), 360.0)]
        instrument = None if velocity is None else velocity.T
        found = np.stack([*rows, *(() if instrument is None else frame.velocity(instrument))])
        if self._uncertain is None:
            return found
        uncertainty = partial(self._uncertainty, self._uncertain, frame, turned, instrument)
        return np.concatenate([found, uncertainty_table(uncertainty, chunk, averaged=self._averaged)])

    def _uncertainty(
        self,
        uncertain: CompensationWithUncertainty,
        frame: EarthFrame,
        field: Array | None,
        velocity: Array | None,
        chunk: KernelChunk,
    ) -> Array:
        """Return standard and expanded uncertainty of each column, not rounded, shape (2, columns, n)."""

        def gradients() -> Iterator[tuple[Array, Array, Array | float]]:
            for by_up, by_azimuth in frame.gradients(velocity):
                by_turn = np.cross(frame.up, by_up, axis=0)
                if field is None or frame.field is None:
                    yield by_up, by_turn, 0.0
                else:
                    by_field = -by_azimuth / frame.field[1]
                    by_turn += np.cross(field, by_field * frame.field[0], axis=0)
                    yield by_up, by_turn, (by_field * self._field_noise) ** 2 * chunk.share

        found = uncertain.of_up(chunk, gradients())
        if velocity is not None:
            # What errors of the two other components take from one, whose length stays: it counts where the flow is
            # along it, and it has no error of first order.
            squares, size = found[:, -3:] ** 2, 2.0 * length_of(velocity)
            curved = (squares.sum(axis=1, keepdims=True) - squares) / np.where(size > 0.0, size, np.inf)
            np.sqrt(squares + curved**2, out=found[:, -3:])
        if field is not None:
            for half, most in zip(found, (UNKNOWN_ANGLE, HALF_TURN), strict=True):
                half[0] = np.degrees(np.minimum(half[0], most))
        lost = (chunk.out.flag == MISSING) | (chunk.out.reason & flags.NO_TEMPERATURE > 0) | ~np.isfinite(frame.heading)
        found[:, :, lost] = np.nan
        return found

    def _up(self, chunk: KernelChunk) -> Array:
        """Return the unit vector that points up in the application's frame, shape (3, n); NaN where it is unknown."""
        up = self._compensation.up(chunk)
        length = length_of(up)
        unknown = chunk.out.flag == MISSING
        if len(self._compensation.axes) == 2:
            mark(chunk.out, length > 1.0 + 1e-9, SUSPECT, CLIPPED)
            lost = length > CLIP_LIMIT
            mark(chunk.out, lost, FAIL, CLIPPED)
            unknown |= lost
        else:
            unknown |= np.isnan(chunk.out.angles[:, 0])
        length[unknown | (length <= VANISHES)] = np.nan
        return np.asarray(up / length)


def full_circle(angle: Array, turn: float) -> Array:
    """Return an angle from 0 to below a whole turn."""
    angle = np.mod(angle, turn)
    angle[angle == turn] = 0.0
    return angle


def length_of(vectors: Array) -> Array:
    """Return the length of vectors in columns."""
    return np.asarray(np.sqrt(np.einsum("in,in->n", vectors, vectors)))


class FieldLength:
    """Rows whose field is longer or shorter than usual, the median of the first thousand rows up to the row itself."""

    def __init__(self) -> None:
        self._first: list[float] = []

    def flagged(self, table: Mapping[str, NDArray[Any]], field: Array) -> dict[str, NDArray[Any]]:
        """Return the columns of the next rows, flagged 3, reason 128, where the field, (n, 3), is of unusual length."""
        lengths, known = length_of(field.T), self._first
        usual = np.full(len(lengths), np.nan)
        for row, length in enumerate(lengths):
            if len(known) >= _USUAL:
                usual[row:] = usual[row - 1] if row else (known[(_USUAL - 1) // 2] + known[_USUAL // 2]) / 2.0
                break
            if isfinite(length):
                insort(known, float(length))
            usual[row] = (known[(len(known) - 1) // 2] + known[len(known) // 2]) / 2.0 if known else np.nan
        return flags.mark_columns(table, np.abs(lengths - usual) > FIELD_TOLERANCE * usual, SUSPECT, NO_DIRECTION)
