"""The uncertainty of every angle, row by row, by the law of propagation: J C Jᵀ (GUM, 5.1.2).

The compensation solves ``u = f(c, T, g)``, so its error follows from the derivatives of the model that it inverts::

    dv = (du - sum_k (df/dc_k) dc_k - (df/dT) dT) / (df/dv)          v = S g, the signal of a channel
    dg = S⁻¹ dv + (rotation error of the mounting) × g

The covariance of signals and turns is computed once a row; the variance of every quantity is a quadratic form of it.
A component that is not measured follows the two that are; see :mod:`tiltcal.core.compensation`. From the components to
the angles it is a gradient again, except at an edge: at ±90° of a tilt the interval of the argument is taken through
the arcsine, and where an angle of three axes comes from a length near zero, an error across it counts too.

Intervals of 95 % come from ``wide``, and standard uncertainties alike from ``covariance`` where it differs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from math import nan, pi

import numpy as np
from numpy.typing import ArrayLike

from tiltcal.core.attitude import UNKNOWN_ANGLE
from tiltcal.core.compensation import UNCERTAIN_CHUNK, Compensated, Compensation, KernelChunk, product
from tiltcal.core.flags import FAIL, NO_TEMPERATURE
from tiltcal.core.model import AXES, Array, Coefficients, Limits, overlap
from tiltcal.core.tilt_angles import DIRECTIONS
from tiltcal.core.uncertain import ALIGNMENT, NEGLIGIBLE, NORMAL_FACTOR, READING, TURN, Uncertain
from tiltcal.errors import EstimateError

HALF_TURN = pi  # no half width is more, radians
CIRCLE = 1.2489  # radius of the circle that holds 95 % of errors in two directions, over the half width for one
_EXACT = 1e-9  # part of a square below which its error changes nothing else
_CURVED = 0.02  # the second-order part of an arcsine above which its interval is taken through it
_ATTITUDES, _ROUNDING = 9, 1e-9  # values of g_x and of g_y at which the length of gravity is tried; g
_SCALES = 10.0 ** np.clip(3 - np.floor(np.log10(2.0) * (np.arange(2048.0) - 1023.0)), 1, 22)  # by biased exponent
_MANTISSA = np.uint64(52)  # bits behind the exponent of a double


_Errors = dict[tuple[int, int], Array]  # covariances of the signals of rows, behind them of the turns, by pair, (n,)


class CompensationWithUncertainty:
    """A compensation, of the same coefficients, with the uncertainty of each angle.

    It is NaN where the flag is 4 or 9, a temperature is missing that counts, or the argument of an arcsine is so far
    beyond ±1 that its interval does not reach back. An EstimateError refuses an uncertain coefficient that is not
    there, and an uncertain mounting of a sensor that has no x and y.
    """

    def __init__(self, compensation: Compensation, coefficients: Coefficients, uncertain: Uncertain) -> None:
        self._compensation, self._coupling = compensation, compensation.coupling
        self._rotation = np.eye(3) if compensation.rotation is None else compensation.rotation
        self._sees_all = len(compensation.axes) == 3
        alone = uncertain.by_name(uncertain.u)
        self._readings = [alone.get(READING + channel, 0.0) for channel in coefficients.channels]
        self._thermometer, self._alignment = alone.get(f"{READING}temperature", 0.0), alone.get(ALIGNMENT, 0.0)
        known = uncertain.without(READING, ALIGNMENT)
        self._rotated = any(name.startswith(TURN) for name in known.names)
        if self._rotated and compensation.axes not in (("x", "y"), AXES):
            raise EstimateError("a mounting that is uncertain takes a sensor that measures at least x and y")
        self._models, self._vectors = coefficients.models, coefficients.vectors
        parts = [[name for name in model.coefficients if name in known.names] for model in self._models]
        parts += [[TURN + axis] for axis in AXES] if self._rotated else []
        for name in set(known.names).difference(*parts):
            raise EstimateError(f"the calibration has no coefficient {name!r}")
        self._columns = [
            [model.coefficients.index(name) for name in names]
            for model, names in zip(self._models, parts, strict=False)
        ]
        known = known.named([name for names in parts for name in names])
        self._parts = [slice(*ends) for ends in pairwise(np.cumsum([0, *map(len, parts)]).tolist())]
        self._kinds = [known.wide]
        if np.any(np.abs(known.factors / NORMAL_FACTOR - 1.0) > NEGLIGIBLE):
            self._kinds.append(known.covariance)

    def __call__(self, readings: ArrayLike, temperature: ArrayLike | None = None) -> tuple[Compensated, Array]:
        """Compensate rows as :class:`Compensation` does; return them with :meth:`of_angles`, rounded up."""
        rows = len(np.asarray(readings))
        compensated = Compensated.empty(rows, len(self._compensation.axes))
        room = np.empty((2, len(self._compensation.angles), rows))
        with np.errstate(all="ignore"):
            for chunk in self._compensation.chunks(readings, temperature, compensated, UNCERTAIN_CHUNK):
                room[:, :, chunk.rows] = self.of_angles(chunk)
        _round_up(room)
        return compensated, room

    def of_angles(self, chunk: KernelChunk) -> Array:
        """Return the uncertainty of every angle, k = 1 and half of the 95 % interval, (2, angles, n), degrees."""
        room, kinds = np.empty((2, len(self._compensation.angles), len(chunk.out.flag))), self._errors(chunk)
        for errors, half in zip(kinds, room[::-1], strict=False):
            self._angles(chunk, errors, half)
        np.minimum(room[-len(kinds)] / NORMAL_FACTOR, UNKNOWN_ANGLE, out=room[0])
        np.minimum(room[1], HALF_TURN, out=room[1])
        room *= 180.0 / pi
        lost = (chunk.out.flag >= FAIL) | (chunk.out.reason & NO_TEMPERATURE > 0)
        if lost.any():
            room[:, :, lost] = np.nan
        return room

    def length_half_width(self, chunk: KernelChunk) -> Array:
        """Return half of the 95 % interval of the length of gravity of three axes, shape (n,), g."""
        return self._half(self._errors(chunk)[0], chunk.own / np.sqrt(np.sum(chunk.own**2, axis=0)))

    def of_up(self, chunk: KernelChunk, gradients: Iterable[tuple[Array, Array, Array | float]]) -> Array:
        """Return standard and expanded uncertainty of quantities that follow from up, shape (2, quantities, n).

        A gradient has the derivatives by the unit vector that points up, across it, and by a turn of the mounting about
        the application's axes, both (3, n), and the variance that other sources of known size add, (n,).
        """
        kinds, gravity = self._errors(chunk), self._compensation.sensed(chunk)
        length = np.sqrt(np.einsum("in,in->n", gravity, gravity))
        halves = []
        for by_up, by_turn, more in gradients:
            own = (self._rotation.T @ by_up) / length
            for errors in kinds:
                by_measured = own
                if not self._sees_all:  # g_z follows from the length of up, which stays 1
                    share = (self._coupling @ own[:2] - own[2]) / self._slope_of_hidden(errors, gravity)
                    by_measured = own[:2] + share * gravity[:2]
                halves.append(self._half(errors, by_measured, by_turn if self._rotated else None, more))
        found = np.array(halves).reshape(-1, len(kinds), len(length))
        return np.stack([found[:, -1] / NORMAL_FACTOR, found[:, 0]])

    # From errors to quantities

    def _errors(self, chunk: KernelChunk) -> list[_Errors]:
        """Return the covariance of the signals and turns of some rows, by ``wide`` and, where it differs, as it is."""
        gravity = self._compensation.sensed(chunk)
        dt = np.zeros(gravity.shape[1]) if chunk.dt is None else chunk.dt
        since_level = gravity - self._rotation[2][:, None]
        if len(self._compensation.axes) == 1:  # the rest of gravity lies along an axis that the sensor does not see
            hidden = 0 if self._compensation.axes == ("z",) else 2
            since_level[hidden] += np.sqrt(np.maximum(1.0 - np.sum(gravity**2, axis=0), 0.0))
        rows: list[Array] = []  # derivatives by the coefficients
        noise: list[Array] = []  # variances of a reading
        shared: list[Array] = []  # derivatives by errors of the temperature and the alignment, which channels share
        for model, theta, columns, u in zip(self._models, self._vectors, self._columns, self._readings, strict=True):
            read = model.read(theta, gravity.T, dt)
            slope = 1.0 / read.by_signal
            rows.append(read.by_coefficient.T[columns] * -slope)
            noise.append((u * slope) ** 2 * chunk.share)
            shared.append((self._thermometer * slope * read.by_temperature)[None])
            if self._alignment:
                by_alignment = self._alignment * np.cross(since_level, read.sensitivity[:, None], axis=0)
                shared[-1] = np.vstack([shared[-1], by_alignment])
        rows += [np.ones((1, len(dt)))] * (3 * self._rotated)
        return [self._signals(covariance, rows, noise, shared) for covariance in self._kinds]

    def _signals(self, covariance: Array, rows: list[Array], noise: list[Array], shared: list[Array]) -> _Errors:
        """Return the covariance of signals and turns by pair, from their derivatives, shape (inputs, n) each."""
        found: _Errors = {}
        for b, second in enumerate(self._parts):
            weighted = product(covariance[: second.stop, second], rows[b])
            for a, first in enumerate(self._parts[: b + 1]):
                found[a, b] = np.einsum("kn,kn->n", rows[a], weighted[first])
        for b, by_shared in enumerate(shared):
            found[b, b] += noise[b]
            for a in range(b + 1):
                found[a, b] += np.einsum("kn,kn->n", shared[a], by_shared)
        return found

    def _half(
        self, errors: _Errors, by_measured: Array, by_turn: Array | None = None, more: Array | float = 0.0
    ) -> Array:
        """Return half of the 95 % interval of a quantity from its gradients by measured components and turn, (n,)."""
        gradient = [*(self._compensation.inverse.T @ by_measured), *(() if by_turn is None else by_turn)]
        total = np.zeros(by_measured.shape[1]) + more
        for (a, b), covariance in errors.items():
            if b < len(gradient):
                total += (1.0 if a == b else 2.0) * gradient[a] * gradient[b] * covariance
        return np.asarray(NORMAL_FACTOR * np.sqrt(np.maximum(total, 0.0, out=total)))

    def _slope_of_hidden(self, errors: _Errors, gravity: Array) -> Array:
        """Return what the error of half the square of a hidden g_z is divided by for its own."""
        half, root = self._half(errors, gravity[:2]), gravity[2] - self._coupling @ gravity[:2]
        size, square = np.abs(root), root * root
        low, high = np.sqrt(np.maximum(square - 2.0 * half, 0.0)), np.sqrt(square + 2.0 * half)
        slope = half / np.where(low > 0.0, size - low, high)  # all of its interval counts near zero
        return np.asarray(np.copysign(np.where(half > _EXACT * square, slope, size), root))

    # From components to angles

    def _angles(self, chunk: KernelChunk, errors: _Errors, half: Array) -> None:
        """Fill in the half width of every angle, shape (angles, n), radians."""
        if self._sees_all:
            self._angles_of_three(chunk.out.gravity.T, errors, half)
            return
        slope = None if chunk.hidden is None else self._slope_of_hidden(errors, self._compensation.sensed(chunk))
        for axis, argument in enumerate(chunk.out.gravity.T):
            by_own = np.zeros_like(chunk.own)
            by_own[axis] = 1.0
            if slope is not None:
                row = self._rotation[axis]
                by_own = row[:2, None] + (row[:2] @ self._coupling - row[2]) / slope * chunk.own
            by_turn = None
            if self._rotated:
                by_turn = np.cross(self._compensation.up(chunk), np.eye(3)[axis][:, None], axis=0)
            _through_arcsine(argument, self._half(errors, by_own, by_turn), half[axis])

    def _angles_of_three(self, gravity: Array, errors: _Errors, half: Array) -> None:
        """Fill in the angles of three axes: arctangents of one component and the length of the two others."""

        def half_along(gradient: Array) -> Array:
            by_turn = np.cross(gravity, gradient, axis=0) if self._rotated else None
            return self._half(errors, self._rotation.T @ gradient, by_turn)

        places = {name: 3 + k for k, name in enumerate(DIRECTIONS)}
        for alone, (first, second) in enumerate(((1, 2), (0, 2), (0, 1))):
            length = _length(gravity[first], gravity[second])
            nowhere = length == 0.0
            cosine = np.where(nowhere, 1.0, gravity[first] / length)
            sine = np.where(nowhere, 0.0, gravity[second] / length)
            gradient = np.zeros_like(gravity)
            gradient[first], gradient[second] = -sine, cosine
            across = half_along(gradient)
            if alone == 0:
                np.divide(across, length, out=half[places["roll"]])
            size = length * length + gravity[alone] * gravity[alone]
            share = gravity[alone] / -size
            gradient[alone], gradient[first], gradient[second] = length / size, share * cosine, share * sine
            along = half_along(gradient)
            # The length of the two grows by an error across it, which near zero is as good as one along it.
            width = _length(along, (_length(length, across) - length) * share)
            # Within the circle that holds 95 % of the errors, the truth may as well be straight up or down.
            from_edge = length / np.abs(gravity[alone])
            within = from_edge <= CIRCLE * np.maximum(along, across / np.sqrt(size))
            half[alone] = np.where(within, np.maximum(width, from_edge), width)
        half[places["pitch"]], half[places["inclination"]] = half[0], half[2]


def length_half_width(coefficients: Coefficients, limits: Limits, uncertain: Uncertain) -> float:
    """Return half of the widest 95 % interval of the length of gravity in the calibrated range, g; 0 if it is empty."""
    ends = (limits.tilt.get(axis, (-pi / 2, pi / 2)) for axis in AXES)
    x, y, z = (np.sin(np.linspace(low, high, _ATTITUDES)) for low, high in ends)
    g_x, g_y, side = np.meshgrid(x, y, np.array([1.0, -1.0]))
    square = 1.0 - g_x**2 - g_y**2
    g_z = side * np.sqrt(np.maximum(square, 0.0))
    reached = (square > -_ROUNDING) & (g_z >= z[0] - _ROUNDING) & (g_z <= z[-1] + _ROUNDING)
    gravity = np.stack([g_x, g_y, g_z], axis=-1)[reached]
    thermal = coefficients.thermal
    covered = None if thermal is None else overlap(limits.temperature, thermal.range)
    temperatures = (nan,) if thermal is None else (thermal.reference, *(covered or ()))
    gravity, temperature = np.tile(gravity, (len(temperatures), 1)), np.repeat(temperatures, len(gravity))
    compensation, out = Compensation(coefficients), Compensated.empty(len(gravity), 3)
    # A turn changes no length.
    kernel = CompensationWithUncertainty(compensation, coefficients, uncertain.without(TURN))
    chunks = compensation.chunks(coefficients.predict(gravity, temperature), temperature, out)
    return max((float(kernel.length_half_width(chunk).max()) for chunk in chunks), default=0.0)


# The columns of a log


def uncertainty_columns(quantities: Sequence[str], *, averaged: bool) -> tuple[str, ...]:
    """Return the names of the columns that hold the uncertainties of some quantities; of means, with their shares."""
    leads = ("u_", "U95_", *(("u_random_", "u_common_") if averaged else ()))
    return tuple(f"{lead}{name}" for lead in leads for name in quantities)


def uncertainty_table(uncertainty: Callable[[KernelChunk], Array], chunk: KernelChunk, *, averaged: bool) -> Array:
    """Return :func:`uncertainty_columns` of rows, rounded up, (columns, n), from (2, quantities, n) of a function."""
    table = uncertainty(chunk)
    if averaged:
        common = uncertainty(replace(chunk, share=0.0))[0]
        random = np.sqrt(np.maximum(table[0] ** 2 - common**2, 0.0))
        table = np.stack([*table, random, common])
    _round_up(table)
    return table.reshape(-1, table.shape[-1])


def _round_up(room: Array) -> None:
    """Round numbers that are not negative up to four digits, or five, in place."""
    scale = np.take(_SCALES, (room.view(np.uint64) >> _MANTISSA).view(np.int64), mode="clip")
    room *= scale
    np.ceil(room, out=room)
    room /= scale


def _length(a: Array, b: Array) -> Array:
    return np.asarray(np.sqrt(a * a + b * b))  # in half the time of hypot: nothing here comes near an overflow


def _through_arcsine(argument: Array, half: Array, width: Array) -> None:
    """Compute half the interval of an arcsine, radians, from that of its argument; NaN where all is beyond ±1."""
    room = 1.0 - argument * argument
    np.divide(half, np.sqrt(np.maximum(room, 1e-300)), out=width)
    curved = np.flatnonzero(half * np.abs(argument) > _CURVED * room)
    if len(curved):
        middle, low, high = (
            np.arcsin(np.clip(argument[curved] + side * half[curved], -1.0, 1.0)) for side in (0.0, -1.0, 1.0)
        )
        widest = np.maximum(high - middle, middle - low)
        width[curved] = np.where(widest == 0.0, np.nan, widest)
