"""The propagation of a calibration's uncertainty to the angles of each row, by the law of the GUM: J C Jᵀ.

The compensation solves ``u = f(c, T, g)``, so its error follows from the derivatives of the model that it inverts::

    dv = (du - sum_k (df/dc_k) dc_k - (df/dT) dT) / (df/dv)          v = S g, the signal of a channel
    dg = S⁻¹ dv + (rotation error of the mounting) × g

The covariance of signals and turns is computed once a row; the variance of every quantity is a quadratic form of it.
A component that is not measured follows the two that are; see :mod:`tiltcal.core.compensation`. From the components to
the angles it is a gradient again, except at an edge: at ±90° of a tilt the interval of the argument is taken through
the arcsine, and where an angle of three axes comes from a length near zero, an error across it counts too.

An interval of 95 % is propagated like a standard uncertainty, from the covariance of known errors that have the 95 %
intervals of the coefficients: few degrees of freedom widen what they are of, and nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import pi, sqrt

import numpy as np

from tiltcal.core.compensation import Compensation, KernelChunk
from tiltcal.core.flags import FAIL, NO_TEMPERATURE
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.mounting_angles import UNKNOWN_ANGLE
from tiltcal.core.tilt_angles import DIRECTIONS
from tiltcal.core.uncertain import (
    ALIGNMENT,
    NEGLIGIBLE,
    NORMAL_FACTOR,
    READING,
    TURN,
    Uncertain,
)
from tiltcal.core.uncertainty_columns import round_up
from tiltcal.errors import EstimateError

HALF_TURN = pi
"""No half width is more, radians."""

CIRCLE = 1.2489
"""Radius of the circle that holds 95 % of the errors in two directions, over the half width that holds them in one."""

_EXACT = 1e-9  # part of a square below which its error changes nothing else
_DEGREES = 180.0 / pi
_ROWS = 4096  # of a step: its derivatives stay in the cache
_CURVED = 0.02  # the second-order part of an arcsine above which its interval is taken through it


@dataclass(frozen=True)
class UpGradient:
    """The derivatives of a quantity that follows from up, for n rows.

    Attributes
    ----------
    by_up : ndarray, shape (3, n)
        By the unit vector that points up in the application's frame; across it.
    by_turn : ndarray, shape (3, n)
        By a turn of the mounting about the application's axes, 1/rad.
    variance : ndarray, shape (n,)
        What other sources add, independent of all others and of known size.
    """

    by_up: Array
    by_turn: Array
    variance: Array


@dataclass(frozen=True)
class _Errors:
    """Some rows with the covariance of their signals, behind them of the turns, by pair."""

    chunk: KernelChunk
    covariances: dict[tuple[int, int], Array]


class Propagation:
    """The propagation from rows on their way through the kernel to the uncertainty of their angles."""

    def __init__(self, compensation: Compensation, coefficients: Coefficients, uncertain: Uncertain) -> None:
        self._compensation = compensation
        self._angles, self._channels = len(compensation.angles), len(coefficients.models)
        self._coupling = compensation.coupling
        self._rotation = np.eye(3) if compensation.rotation is None else compensation.rotation
        self._sees_all = len(compensation.axes) == 3
        alone = uncertain.by_name(uncertain.u)
        self._readings = np.array([alone.get(READING + channel, 0.0) for channel in coefficients.channels])
        self._thermometer, self._alignment = alone.get(f"{READING}temperature", 0.0), alone.get(ALIGNMENT, 0.0)
        known = uncertain.without(READING, ALIGNMENT)
        self._rotated = any(name.startswith(TURN) for name in known.names)
        if self._rotated and compensation.axes not in (("x", "y"), AXES):
            raise EstimateError("a mounting that is uncertain takes a sensor that measures at least x and y")
        self._models, self._vectors, self._thermal = coefficients.models, coefficients.vectors, coefficients.thermal
        parts = [[name for name in model.coefficients if name in known.names] for model in self._models]
        parts += [[TURN + axis] for axis in AXES] if self._rotated else []
        for name in set(known.names).difference(*parts):
            raise EstimateError(f"the calibration has no coefficient {name!r}")
        self._columns = [
            [model.coefficients.index(name) for name in names]
            for model, names in zip(self._models, parts, strict=False)
        ]
        known = known.named([name for names in parts for name in names])
        ends = np.cumsum([0, *(len(names) for names in parts)])
        self._parts = [slice(start, end) for start, end in pairwise(ends)]
        self._covariances = [known.wide]
        if np.any(np.abs(known.factors / NORMAL_FACTOR - 1.0) > NEGLIGIBLE):
            self._covariances.append(known.covariance)

    def __call__(self, chunk: KernelChunk, out: Array | None = None, *, rounded: bool = True) -> Array:
        """Return standard and expanded uncertainty of every angle, rounded up or not, shape (2, angles, n), degrees."""
        count = len(chunk.out.flag)
        room = np.empty((2, self._angles, count)) if out is None else out
        for start in range(0, count, _ROWS):
            rows = slice(start, start + _ROWS)
            kinds = self._errors(chunk.part(rows))
            self._fill(kinds[0], room[1, :, rows])
            if len(kinds) > 1:
                self._fill(kinds[1], room[0, :, rows])
            room[0, :, rows] = np.minimum(room[-len(kinds), :, rows] / NORMAL_FACTOR, UNKNOWN_ANGLE)
            np.minimum(room[1, :, rows], HALF_TURN, out=room[1, :, rows])
            if rounded:
                round_up(room[:, :, rows], _DEGREES)
            else:
                room[:, :, rows] *= _DEGREES
        lost = (chunk.out.flag >= FAIL) | (chunk.out.reason & NO_TEMPERATURE > 0)
        if lost.any():
            room[:, :, lost] = np.nan
        return room

    def length_half_width(self, chunk: KernelChunk) -> Array:
        """Return half of the 95 % interval of the length of gravity of three axes, shape (n,), g."""
        return self._half(self._errors(chunk)[0], chunk.own / np.sqrt(np.sum(chunk.own**2, axis=0)))

    def half_widths(self, chunk: KernelChunk, gradients: Sequence[UpGradient]) -> Array:
        """Return of quantities that follow from up 1.96 standard uncertainties, and half of the 95 % interval.

        In their units, shape (2, quantities, n).
        """
        halves = np.empty((2, len(gradients), len(chunk.out.flag)))
        for start in range(0, halves.shape[2], _ROWS):
            rows = slice(start, start + _ROWS)
            kinds = self._errors(chunk.part(rows))
            for row, gradient in enumerate(gradients):
                for kind in (0, -1):
                    by_own = self._by_measured(kinds[kind], gradient.by_up[:, rows])
                    halves[kind + 1, row, rows] = self._half(
                        kinds[kind], by_own, gradient.by_turn[:, rows], gradient.variance[rows]
                    )
        return halves

    # ------------------------------------------------------------------------------------------ errors of the signals

    def _derivatives(self, gravity: Array, dt: Array) -> tuple[list[Array], Array, Array]:
        """Return minus the derivatives of each signal, and 1 for a turn, by uncertain inputs, by reading, by dT."""
        rows, by_reading, by_temperature = [], [], []
        for model, theta, columns in zip(self._models, self._vectors, self._columns, strict=True):
            read = model.read(theta, gravity.T, dt)
            slope = 1.0 / read.by_signal
            rows.append(read.by_coefficient.T[columns] * -slope)
            by_reading.append(slope)
            by_temperature.append(slope * read.by_temperature)
        rows += [np.ones((1, len(dt)))] * (3 * self._rotated)
        return rows, np.array(by_reading), np.array(by_temperature)

    def _pairs(self, rows: list[Array], covariance: Array) -> dict[tuple[int, int], Array]:
        found = {}
        for b, second in enumerate(self._parts):
            weighted = covariance[: second.stop, second] @ rows[b]
            for a, first in enumerate(self._parts[: b + 1]):
                found[a, b] = np.einsum("kn,kn->n", rows[a], weighted[first])
        return found

    def _stated(self, by_reading: Array, by_temperature: Array, share: Array | float) -> dict[tuple[int, int], Array]:
        """Return the covariances of the signals by the noise of readings and the thermometer."""
        stated = {(a, a): (u * by_reading[a]) ** 2 * share for a, u in enumerate(self._readings)}
        if self._thermometer:
            for b in range(self._channels):
                for a in range(b + 1):
                    warm = by_temperature[a] * by_temperature[b] * self._thermometer**2
                    stated[a, b] = stated.get((a, b), 0.0) + warm
        return stated

    def _errors(self, chunk: KernelChunk) -> list[_Errors]:
        """Return the covariance of the signals and turns of some rows: widened, and where that differs as it is."""
        dt = np.zeros(len(chunk.out.flag)) if chunk.dt is None else chunk.dt
        rows, by_reading, by_temperature = self._derivatives(self._compensation.sensed(chunk), dt)
        stated, kinds = self._stated(by_reading, by_temperature, chunk.share), []
        for covariance in self._covariances:
            pairs = self._pairs(rows, covariance)
            kinds.append(_Errors(chunk, {**stated, **{p: found + stated.get(p, 0.0) for p, found in pairs.items()}}))
        return kinds

    # ------------------------------------------------------------------------------------ from errors to quantities

    def _variance(
        self, errors: _Errors, by_measured: Array, by_turn: Array | None = None, more: Array | float = 0.0
    ) -> Array:
        """Return the variance of a quantity from its gradients."""
        gradient = [*(self._compensation.inverse.T @ by_measured), *(() if by_turn is None else by_turn)]
        return _form(gradient, errors.covariances) + more + self._of_alignment(errors.chunk, by_measured)

    def _half(
        self, errors: _Errors, by_measured: Array, by_turn: Array | None = None, more: Array | float = 0.0
    ) -> Array:
        """Return the half width of the 95 % interval of a quantity."""
        return np.asarray(NORMAL_FACTOR * np.sqrt(self._variance(errors, by_measured, by_turn, more)))

    def _by_measured(self, errors: _Errors, by_up: Array) -> Array:
        """Return a gradient by the components that are measured from one by up, shape (axes, n)."""
        gravity = self._compensation.sensed(errors.chunk)
        own: Array = (self._rotation.T @ by_up) / np.sqrt(np.einsum("in,in->n", gravity, gravity))
        if self._sees_all:
            return own
        # g_z follows from the length of up, which stays 1.
        q = self._coupling
        share = (q @ own[:2] - own[2]) / self._slope_of_hidden(errors, gravity)
        return np.asarray(own[:2] + share * gravity[:2])

    def _slope_of_hidden(self, errors: _Errors, gravity: Array) -> Array:
        """Return what the error of half the square of a hidden g_z is divided by for its own."""
        along = self._half(errors, gravity[:2])
        return _slope_of_root(gravity[2] - self._coupling @ gravity[:2], along)

    def _of_alignment(self, chunk: KernelChunk, by_measured: Array) -> Array | float:
        """Return the variance of a turn θ of the sensor since it was level: θ × (g - z), alike about every axis."""
        if not self._alignment:
            return 0.0
        axes, gravity = self._compensation.axes, self._compensation.sensed(chunk)
        if len(axes) == 1:  # the rest of gravity lies along an axis that the sensor does not see
            gravity[0 if axes == ("z",) else 2] = np.sqrt(np.maximum(1.0 - np.sum(gravity**2, axis=0), 0.0))
        moved = gravity - self._rotation[2][:, None]
        by_gravity = np.zeros_like(moved)
        by_gravity[[AXES.index(axis) for axis in axes]] = by_measured
        if len(axes) == 2:
            by_gravity[2] += self._coupling @ by_measured
        turned = self._alignment * np.cross(moved, by_gravity, axis=0)
        return np.asarray(np.einsum("in,in->n", turned, turned))

    def _by_turn(self, up: Array, by_up: Array) -> Array | None:
        """Return the gradient by a turn of the mounting, which turns up with it."""
        return np.cross(up, by_up, axis=0) if self._rotated else None

    # ------------------------------------------------------------------------------------- from components to angles

    def _fill(self, errors: _Errors, room: Array) -> None:
        chunk = errors.chunk
        if self._sees_all:
            self._angles_of_three(errors, room)
            return
        slope = None if chunk.hidden is None else self._slope_of_hidden(errors, self._compensation.sensed(chunk))
        for axis, argument in enumerate(chunk.out.gravity.T):
            by_own = np.zeros_like(chunk.own)
            by_own[axis] = 1.0
            if slope is not None:
                row = self._rotation[axis]
                by_own = row[:2, None] + (row[:2] @ self._coupling - row[2]) / slope * chunk.own
            by_turn = self._by_turn(self._compensation.up(chunk), np.eye(3)[axis][:, None]) if self._rotated else None
            _through_arcsine(argument, self._variance(errors, by_own, by_turn), room[axis])

    def _angles_of_three(self, errors: _Errors, room: Array) -> None:
        """Fill in the angles of three axes: arctangents of one component and the length of the two others."""
        gravity = errors.chunk.out.gravity.T

        def half_along(gradient: Array) -> Array:
            return self._half(errors, self._rotation.T @ gradient, self._by_turn(gravity, gradient))

        for alone, (first, second) in enumerate(((1, 2), (0, 2), (0, 1))):
            length = _length(gravity[first], gravity[second])
            cosine, sine = gravity[first] / length, gravity[second] / length
            nowhere = length == 0.0
            if nowhere.any():
                cosine[nowhere], sine[nowhere] = 1.0, 0.0
            gradient = np.zeros_like(gravity)
            gradient[first], gradient[second] = -sine, cosine
            across = half_along(gradient)
            if alone == 0:
                np.divide(across, length, out=room[3 + DIRECTIONS.index("roll")])
            size = length * length + gravity[alone] * gravity[alone]
            share = gravity[alone] / -size
            gradient[alone], gradient[first], gradient[second] = length / size, share * cosine, share * sine
            half = half_along(gradient)
            # The length of the two grows by an error across it, which near zero is as good as one along it.
            width = _length(half, (_length(length, across) - length) * share)
            # Within the circle that holds 95 % of the errors, the truth may as well be straight up or down.
            from_edge = length / np.abs(gravity[alone])
            within = from_edge <= CIRCLE * np.maximum(half, across / np.sqrt(size))
            np.copyto(width, np.maximum(width, from_edge), where=within)
            room[alone] = width
        room[3 + DIRECTIONS.index("pitch")], room[3 + DIRECTIONS.index("inclination")] = room[0], room[2]


def _form(gradient: Sequence[Array], covariances: dict[tuple[int, int], Array]) -> Array:
    """Return the variance along a gradient from the covariance of each pair, shape (n,); further pairs count 0."""
    total = np.zeros(len(gradient[0]))
    for (a, b), covariance in covariances.items():
        if b < len(gradient):
            total += (1.0 if a == b else 2.0) * gradient[a] * gradient[b] * covariance
    return np.maximum(total, 0.0, out=total)


def _slope_of_root(root: Array, half: Array) -> Array:
    """Return what the error of half a square is divided by for that of its root; all of its interval near zero."""
    size, square = np.abs(root), root * root
    low, high = np.sqrt(np.maximum(square - 2.0 * half, 0.0)), np.sqrt(square + 2.0 * half)
    slope = half / np.where(low > 0.0, size - low, high)
    return np.copysign(np.where(half > _EXACT * square, slope, size), root)


def _length(a: Array, b: Array) -> Array:
    """Compute the hypotenuse in half the time of ``hypot``: nothing here comes near an overflow."""
    return np.asarray(np.sqrt(a * a + b * b))


def _through_arcsine(argument: Array, variance: Array, width: Array) -> None:
    """Compute half the interval of an arcsine, radians, from its argument's variance; NaN where that is beyond ±1."""
    room = argument * argument
    np.subtract(1.0, room, out=room)
    half = NORMAL_FACTOR * sqrt(np.max(variance))
    all_straight = bool(half <= _CURVED * np.min(room))  # not with a NaN among them
    np.divide(variance, room if all_straight else np.maximum(room, 1e-300), out=width)
    np.sqrt(width, out=width)
    width *= NORMAL_FACTOR
    if all_straight:
        return
    halves = NORMAL_FACTOR * np.sqrt(variance)
    curved = np.flatnonzero(halves * np.abs(argument) > _CURVED * room)
    near, reach = argument[curved], halves[curved]
    middle, low, high = (np.arcsin(np.clip(near + side * reach, -1.0, 1.0)) for side in (0.0, -1.0, 1.0))
    widest = np.maximum(high - middle, middle - low)
    widest[widest == 0.0] = np.nan
    width[curved] = widest
