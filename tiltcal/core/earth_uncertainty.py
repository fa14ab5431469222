"""The uncertainty of heading and earth velocities, row by row, by the GUM's law of propagation.

An error of ``up`` by the small vector ``d`` (across up) turns the earth's directions: east and north tip by the part of
``d`` along each, and both turn about the vertical by ``k·d``::

    k = -(Z / H) east_magnetic          with a field of horizontal part H and part Z along down
    k = -(x_up / h²) (x_east north - x_north east)      with a heading of the x axis; h² = 1 - x_up²

From these follow the gradients by ``up``, all of them across up::

    heading    k + (x_up / h²) (x_east north - x_north east)
    v_east     k v_north - v_up east
    v_north   -k v_east  - v_up north
    v_up       v_east east + v_north north

An error of the field turns east and north alone, by ``-east_magnetic / H`` for the k above. The components of gravity
have the errors of :mod:`tiltcal.core.angle_uncertainty`. A mounting that is uncertain turns up and the field alike.

What counts: the covariance of the calibration, the noise of a reading, the thermometer, and the noise of the
magnetometer where it is stated. What does not: the magnetometer's own calibration, the declination, a heading that is
given, and the velocity itself; these count as exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiltcal.core.compensation import KernelChunk
from tiltcal.core.flags import MISSING, NO_TEMPERATURE
from tiltcal.core.heading import EarthFrame, cross, length_of
from tiltcal.core.model import Array
from tiltcal.core.mounting_angles import UNKNOWN_ANGLE
from tiltcal.core.uncertain import NORMAL_FACTOR
from tiltcal.core.uncertainty_propagation import HALF_TURN, Propagation, UpGradient


class EarthUncertainty:
    """The propagation from rows in the earth frame to the uncertainty of heading and velocities.

    Parameters
    ----------
    propagation : Propagation
        Of the calibration.
    field_noise : float
        Standard uncertainty of each component of the field, in its unit.
    """

    def __init__(self, propagation: Propagation, field_noise: float = 0.0) -> None:
        self._propagation = propagation
        self._field_noise = field_noise

    def __call__(
        self, chunk: KernelChunk, frame: EarthFrame, field: Array | None, velocity: Array | None
    ) -> tuple[Array, Array]:
        """Return standard and expanded uncertainty of each column, not rounded, each of shape (columns, n).

        Degrees for the heading, which is a column where there is a field, and the velocity's unit.

        Parameters
        ----------
        frame : EarthFrame
            Of the same rows.
        field, velocity : ndarray, shape (3, n), or None
            In the application's frame.
        """
        halves = self._propagation.half_widths(
            chunk,
            [
                self._through(gradient, frame, field, chunk.share)
                for gradient in _gradients(frame, velocity)[field is None :]
            ],
        )
        if velocity is not None:
            for kind in halves:
                _add_second_order(kind[-3:], velocity)
        standard, expanded = halves[0] / NORMAL_FACTOR, halves[1]
        if field is not None:
            standard[0] = np.degrees(np.minimum(standard[0], UNKNOWN_ANGLE))
            expanded[0] = np.degrees(np.minimum(expanded[0], HALF_TURN))
        lost = (chunk.out.flag == MISSING) | (chunk.out.reason & NO_TEMPERATURE > 0) | ~np.isfinite(frame.heading)
        for room in (standard, expanded):
            room[:, lost] = np.nan
        return standard, expanded

    def _through(self, gradient: _Gradient, frame: EarthFrame, field: Array | None, share: Array | float) -> UpGradient:
        """Return what a quantity has of up, of the mounting's turn, and of the field's noise."""
        by_turn = cross(frame.up, gradient.by_up)
        if field is None or frame.horizontal is None or frame.magnetic_east is None:
            return UpGradient(gradient.by_up, by_turn, np.zeros_like(gradient.by_azimuth))
        by_field = -gradient.by_azimuth / frame.horizontal
        by_turn += cross(field, by_field * frame.magnetic_east)
        return UpGradient(gradient.by_up, by_turn, (by_field * self._field_noise) ** 2 * share)


@dataclass(frozen=True)
class _Gradient:
    """The derivatives of a quantity: by ``up``, shape (3, n), and by a turn of the earth's directions about it."""

    by_up: Array
    by_azimuth: Array


def _gradients(frame: EarthFrame, velocity: Array | None) -> list[_Gradient]:
    """Return the gradients of heading and, with a velocity, of its components east, north and up."""
    east, north = frame.east, frame.north
    own = (frame.up[0] / (east[0] ** 2 + north[0] ** 2)) * (east[0] * north - north[0] * east)
    turn = -own
    if frame.down is not None and frame.horizontal is not None and frame.magnetic_east is not None:
        turn = -(frame.down / frame.horizontal) * frame.magnetic_east
    found = [_Gradient(turn + own, np.ones(own.shape[1]))]
    if velocity is not None:
        v_east, v_north, v_up = frame.velocity(velocity)
        found += [
            _Gradient(v_north * turn - v_up * east, v_north),
            _Gradient(-v_east * turn - v_up * north, -v_east),
            _Gradient(v_east * east + v_north * north, np.zeros(len(v_up))),
        ]
    return found


def _add_second_order(halves: Array, velocity: Array) -> None:
    """Widen the interval of each component by what errors of the two others take from it: the length stays.

    It counts where the flow is along a component, which then has no error of first order.
    """
    size = 2.0 * length_of(velocity)
    squares = halves * halves
    curved = (squares.sum(axis=0) - squares) / np.where(size > 0.0, size, np.inf)
    np.sqrt(squares + curved * curved, out=halves)
