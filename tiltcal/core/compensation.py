"""The compensation kernel: from raw readings to gravity, tilt and quality flags.

The model of :mod:`tiltcal.core.model` is inverted. With ``v_i = (u_i - offset_i - drift_i(dT)) / (1 + gain_i(dT))``::

    v = S g    =>    g = S⁻¹ v    =>    a' = R g    =>    tilt_i = asin(a'_i)

where R is the mounting rotation; tilts of three axes are arctangents. A sensor with two channels does not see g_z.
Where it is needed (a z column in S, or a mounting rotation) the missing equation is that gravity is a unit vector: with
``p = A⁻¹ v`` and ``q = A⁻¹ S_z``, A being the x and y columns of S,

    (g_x, g_y) = p - q g_z    and    g_x² + g_y² + g_z² = 1

which is a quadratic in g_z and is solved as one. Its sign is that of the sensor's face: up, unless the mounting turns
the sensor upside down. On edge, more than 45° from both, the face has a sign where the sensor itself lies near level.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, inf, isfinite, pi, radians, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiltcal.core import flags
from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.directions import Cone
from tiltcal.core.flags import Bytes, Reasons, mark
from tiltcal.core.model import AXES, Array, Coefficients, Limits, overlap, polynomial, take_out_nonlinearity
from tiltcal.core.tilt_angles import DIRECTIONS, tilt, tilts_of_three
from tiltcal.errors import EstimateError
from tiltcal.printable import counted

CLIP_LIMIT = 1.02  # an arcsine argument up to this is taken for ±90°, g
VANISHES = 1e-9  # gravity of three axes that is no longer than this has no direction, g
LENGTH_TOLERANCE = 0.02  # a length of gravity that differs from 1 g by more is suspect, if its uncertainty is not more
SHORTEST, LONGEST = 0.5, 2.0  # lengths of gravity beyond which three axes have no tilt, g
_EDGE = cos(radians(45.0))  # the z component between those of a sensor near level and of one on edge
_OVER = -sin(radians(5.0))  # element zz of the mounting below which two axes hang upside down: an estimate is no sign
CHUNK, UNCERTAIN_CHUNK = 32_768, 8192  # rows that stay in the cache from step to step; and with derivatives
_ROUNDING = 1e-12  # g: an argument this close to a bound is at the bound, whatever the order of the arithmetic
_TILT_SLACK = radians(1e-9)
_LARGEST_CONDITION = 1e12
_ONE_THREAD = 1 << 18  # multiplications for which the linear algebra starts no threads: they cost more than they bring


@dataclass(frozen=True)
class Compensated:
    """What the kernel makes of n rows; every array is NaN where the flag is 9.

    ``gravity``, (n, axes), is up in the application's frame, g; ``angles``, (n, angles), are the tilt of each axis and,
    of three, pitch, roll and inclination, degrees: NaN where the argument of an arcsine is beyond ±1.02, or three axes
    read less than 0.5 g or more than 2 g. ``flag`` and ``reason`` are those of :mod:`tiltcal.core.flags`.
    """

    gravity: Array
    angles: Array
    flag: Bytes
    reason: Reasons

    @classmethod
    def empty(cls, rows: int, axes: int) -> Compensated:
        """Return a result with memory for ``rows`` rows, laid out column after column."""
        gravity, angles = np.empty((axes, rows)), np.empty((axes + len(DIRECTIONS) * (axes == 3), rows))
        return cls(gravity.T, angles.T, np.empty(rows, np.uint8), np.empty(rows, np.uint16))

    def part(self, rows: slice) -> Compensated:
        """Return a view of some rows."""
        return Compensated(self.gravity[rows], self.angles[rows], self.flag[rows], self.reason[rows])

    @property
    def tilt(self) -> Array:
        """The tilt of each axis, shape (n, axes), degrees."""
        return self.angles[:, : self.gravity.shape[1]]


@dataclass(frozen=True)
class KernelChunk:
    """Some rows on their way through the kernel, for callers that need more than the result."""

    rows: slice  # which of all rows these are
    dt: Array | None  # T - T_ref, °C, (n,); 0 where the temperature is missing, None where none counts
    own: Array  # up in the sensor's frame, (axes, n), g
    hidden: Array | None  # g_z there, (n,), of a sensor that sees x and y only, where it is needed
    out: Compensated
    share: Array | float = 1.0  # of the variance of a single reading: 1 over the number of which a row is the mean


class Bounds:
    """The limits of a calibration as rows are compared with them: lengths of gravity, its components, and readings."""

    def __init__(self, limits: Limits, channels: tuple[str, ...], axes: tuple[str, ...]) -> None:
        length = LENGTH_TOLERANCE if limits.length is None else limits.length
        self._squares = VANISHES**2, inf
        if isfinite(length):
            self._squares = max(1.0 - length, SHORTEST) ** 2 - _ROUNDING, min(1.0 + length, LONGEST) ** 2 + _ROUNDING
        self._rails = {channels.index(name): rails for name, rails in limits.reading.items() if name in channels}
        self._reach = {
            axes.index(axis): (_sine_of_limit(low, -1), _sine_of_limit(high, +1))
            for axis, (low, high) in limits.tilt.items()
            if axis in axes
        }
        self._cone = None
        if axes == AXES and limits.directions is not None:
            self._reach = {}
            if not isinstance(limits.directions, str):
                self._cone = Cone(limits.directions)

    def judge_length(self, square: Array, out: Compensated) -> None:
        """Mark rows in which gravity is not 1 g long, and blank their angles where it is no gravity at all."""
        inside = (square >= self._squares[0]) & (square <= self._squares[1])
        if inside.all():
            return
        mark(out, ~inside, flags.SUSPECT, flags.GRAVITY_LENGTH)
        lost = ~inside & ~((square >= SHORTEST**2 - _ROUNDING) & (square <= LONGEST**2 + _ROUNDING))
        mark(out, lost, flags.FAIL, flags.GRAVITY_LENGTH)
        mark(out, square <= VANISHES**2, flags.FAIL, flags.NO_DIRECTION)
        out.angles[lost] = np.nan

    def judge_tilt(self, own: Array, out: Compensated) -> None:
        """Mark rows that tilt a sensor axis further than the calibration covers, or lie in another direction."""
        for axis, (low, high) in self._reach.items():
            argument = own[axis]
            measured = np.abs(argument) <= CLIP_LIMIT + _ROUNDING
            mark(out, measured & ((argument < low) | (argument > high)), flags.SUSPECT, flags.TILT_RANGE)
        if self._cone is not None:
            mark(out, ~self._cone.inside(own), flags.SUSPECT, flags.TILT_RANGE)

    def judge_readings(self, u: Array, out: Compensated) -> None:
        """Mark readings at the rail, and blank the rows that have a reading which is no number."""
        for channel, (low, high) in self._rails.items():
            mark(out, (u[channel] <= low) | (u[channel] >= high), flags.FAIL, flags.RAIL)
        finite = np.isfinite(u).all(axis=0)
        if finite.all():
            return
        missing = ~finite
        out.flag[missing] = flags.MISSING
        out.reason[missing] = flags.NOT_A_NUMBER
        out.gravity[missing] = out.angles[missing] = np.nan


class Compensation:
    """One sensor's calibration, ready to be applied to any number of rows.

    It takes as many channels as axes, two channels over x, y and z, or one channel over its own axis and others, which
    are taken to be level; an EstimateError refuses other coefficients, a singular matrix, and a mounting of a sensor
    that has no x and y. The tilt range of ``limits`` is that of the sensor's own axes, before the mounting, because
    that is where it was covered. ``first_order`` uses Cross-axis Compensation eq. 6 in place of the inverse of the
    matrix, for two channels.

    With two channels and a mounting rotation, or a z column, g_z is +sqrt(1 - g_x² - g_y²) unless element zz of the
    mounting matrix is negative (the sensor hangs upside down), then it is minus that. Where g_x² + g_y² > 1, g_z is 0
    and the row has flag 3 and reason 1. With a mounting on edge, what follows from a g_z of less than cos 45° is NaN,
    and the row has flag 4 and reason 128.

    It reports the ``axes`` of the sensor, without z where two channels measure x and y. ``inverse``, (axes, channels),
    takes the signal to them, g/unit; ``coupling``, (2,), is what a hidden g_z adds to x and y; ``rotation``, (3, 3),
    takes the sensor's frame to the application's. A g_z that two channels do not see is solved for where ``solves_z``;
    the mounting turns such a sensor over where ``upside_down``, and ``on_edge`` by more than 45° from both.
    ``columns`` are the names of what :meth:`table` gives, of which ``angles`` are some.
    """

    def __init__(self, coefficients: Coefficients, limits: Limits | None = None, *, first_order: bool = False) -> None:
        limits = limits or Limits()
        channels = len(coefficients.channels)
        own = tuple(axis for axis in AXES if axis in coefficients.axes)
        sensitivity = coefficients.sensitivity[:, [coefficients.axes.index(axis) for axis in own]]
        self.axes = own[:2] if (channels, own) == (2, AXES) else own
        if channels == 1 and coefficients.channels[0] in own:
            # What one channel reads of the other axes cannot be separated from tilt: they are taken to be level.
            self.axes = coefficients.channels
        if len(self.axes) != channels:
            raise EstimateError(
                f"{counted(channels, 'channel')} ({', '.join(coefficients.channels)}) cannot be turned into "
                f"{len(own)} axes ({', '.join(own)})"
            )
        if first_order and channels != 2:
            raise EstimateError(f"the first-order compensation is for two channels; this sensor has {channels}")

        self._coefficients, self._offset, self._thermal = coefficients, coefficients.offset, coefficients.thermal
        square = sensitivity[:, [own.index(axis) for axis in self.axes]]
        self.inverse = (
            _first_order_inverse(square, coefficients.channels, self.axes) if first_order else _inverse(square)
        )
        self.rotation: Array | None = None
        if coefficients.mounting is not None:
            rotation = mounting_matrix(coefficients.mounting)
            if not np.array_equal(rotation, np.eye(3)):
                if self.axes not in (("x", "y"), AXES):
                    raise EstimateError("a mounting rotation takes a sensor that measures at least x and y")
                self.rotation = rotation
        self.coupling = (
            self.inverse @ sensitivity[:, 2] if self.axes == own[:2] and len(own) > channels else np.zeros(2)
        )
        self.solves_z = channels == 2 and (len(own) > channels or self.rotation is not None)
        facing = 1.0 if self.rotation is None else float(self.rotation[2, 2])
        self.upside_down = facing < _OVER
        self.on_edge = self.solves_z and abs(facing) < _EDGE - _ROUNDING
        self._bounds = Bounds(limits, coefficients.channels, self.axes)
        self._temperatures = overlap(limits.temperature, None if self._thermal is None else self._thermal.range)
        self.angles = (*(f"tilt_{axis}" for axis in self.axes), *(DIRECTIONS if channels == 3 else ()))
        self.columns = (*(f"g_{axis}" for axis in self.axes), *self.angles, "flag", "reason")

    def table(self, compensated: Compensated) -> dict[str, NDArray[np.float64] | Bytes]:
        """Return the columns of a result under the names that :attr:`columns` lists."""
        columns = (*compensated.gravity.T, *compensated.angles.T, compensated.flag, compensated.reason)
        return dict(zip(self.columns, columns, strict=True))

    def __call__(
        self, readings: ArrayLike, temperature: ArrayLike | None = None, *, out: Compensated | None = None
    ) -> Compensated:
        """Compensate readings, (n, channels), in the unit of the calibration, fastest where each column is contiguous.

        ``temperature``, (n,), is in °C, NaN where it is missing; ``out`` is room for n rows that an earlier call has
        filled. A ValueError where the shapes do not fit.
        """
        result = Compensated.empty(len(np.asarray(readings)), len(self.axes)) if out is None else out
        for _chunk in self.chunks(readings, temperature, result):
            pass
        return result

    def chunks(
        self, readings: ArrayLike, temperature: ArrayLike | None, out: Compensated, size: int = CHUNK
    ) -> Iterator[KernelChunk]:
        """Compensate rows into ``out``, and yield ``size`` of them at a time while they are in the cache.

        The arguments and errors are those of a call.
        """
        u = np.asarray(readings, dtype=float)
        if u.ndim != 2 or u.shape[1] != len(self._offset):
            raise ValueError(f"readings have shape {u.shape}; the calibration takes (n, {len(self._offset)})")
        t = None if temperature is None else np.asarray(temperature, dtype=float)
        if t is not None and t.shape != u.shape[:1]:
            raise ValueError(f"temperature has shape {t.shape}; the readings need ({len(u)},)")
        if out.gravity.shape != (len(u), len(self.axes)):
            raise ValueError(f"out has shape {out.gravity.shape}; the result has ({len(u)}, {len(self.axes)})")
        for start in range(0, len(u), size):
            rows = slice(start, start + size)
            with np.errstate(all="ignore"):
                chunk = self._compensate(rows, u[rows].T, None if t is None else t[rows], out.part(rows))
            yield chunk

    def up(self, chunk: KernelChunk) -> Array:
        """Return g of some rows in the application's frame, with a component that is not measured; shape (3, n).

        A sensor of one channel has 0 along the axes that it does not see.
        """
        gravity = self.sensed(chunk)
        up: Array = gravity if self.rotation is None else self.rotation @ gravity
        up[[AXES.index(axis) for axis in self.axes]] = chunk.out.gravity.T
        return up

    def sensed(self, chunk: KernelChunk) -> Array:
        """Return g of some rows in the sensor's frame; see :meth:`up`."""
        if self.axes == ("x", "y"):
            hidden = chunk.hidden
            if hidden is None:
                hidden = np.sqrt(np.maximum(1.0 - np.sum(chunk.own**2, axis=0), 0.0))
            return np.concatenate([chunk.own, hidden[None]])
        gravity = np.zeros((3, chunk.own.shape[1]))
        gravity[[AXES.index(axis) for axis in self.axes]] = chunk.own
        return gravity

    def _compensate(self, rows: slice, u: Array, temperature: Array | None, out: Compensated) -> KernelChunk:
        """Compute one chunk into ``out``; ``u`` has a row for each channel."""
        out.flag.fill(flags.PASS)
        out.reason.fill(0)
        dt, application = self._temperature_difference(temperature, out), out.gravity.T
        angles, lost = self._coefficients.angles, None
        signal = self._signal(u if angles is None else angles.angle(u), dt)
        if angles is None:
            take_out_nonlinearity(signal, self._coefficients)
        else:
            clipped, lost, ambiguous = angles.to_components(
                signal, self._coefficients.channels, self._coefficients.sensitivity
            )
            mark(out, clipped, flags.SUSPECT, flags.CLIPPED)
            mark(out, ambiguous, flags.SUSPECT, flags.TILT_RANGE)
        own = product(self.inverse, signal)
        hidden = self._solve_hidden(own, out) if self.solves_z else None
        self._mount(own, hidden, application)
        if len(self.axes) == 3:
            self._bounds.judge_length(tilts_of_three(application, out.angles.T), out)
        else:
            for angle, argument in zip(out.angles.T, application, strict=True):
                _arcsine(argument, angle, out)
        if self.on_edge and hidden is not None:
            self._blank_unknown_sign(hidden, out)
        self._bounds.judge_tilt(own, out)
        if lost is not None and lost.any():
            mark(out, lost, flags.FAIL, flags.NO_DIRECTION)
            out.gravity[lost] = out.angles[lost] = np.nan
        self._bounds.judge_readings(u, out)
        return KernelChunk(rows, dt, own, hidden, out)

    def _temperature_difference(self, temperature: Array | None, out: Compensated) -> Array | None:
        """Return the excess over the reference temperature, °C, where it counts; mark the rows without one."""
        known = None
        if temperature is not None:
            known = np.isfinite(temperature)
            if self._temperatures is not None:
                low, high = self._temperatures
                mark(out, known & ((temperature < low) | (temperature > high)), flags.SUSPECT, flags.TEMPERATURE_RANGE)
        if self._thermal is None:
            return None
        if temperature is None or known is None:
            mark(out, np.ones(len(out.flag), bool), flags.SUSPECT, flags.NO_TEMPERATURE)
            return None
        dt: Array = temperature - self._thermal.reference
        if not known.all():
            mark(out, ~known, flags.SUSPECT, flags.NO_TEMPERATURE)
            dt[~known] = 0.0
        return dt

    def _signal(self, u: Array, dt: Array | None) -> Array:
        """Return the readings without offset, drift and gain: S g with its nonlinearity; unit."""
        signal: Array = u - self._offset[:, None]
        if self._thermal is None or dt is None:
            return signal
        for row, drift, gain in zip(signal, self._thermal.drift, self._thermal.gain, strict=True):
            if drift.any():
                row -= polynomial(drift, dt)
            if gain.any():
                row /= 1.0 + polynomial(gain, dt)
        return signal

    def _solve_hidden(self, own: Array, out: Compensated) -> Array:
        """Return g_z of a sensor that measures x and y only, and take its coupling out of ``own``."""
        q = self.coupling
        excess = np.einsum("ij,ij->j", own, own) - 1.0
        along = q @ own
        curvature = 1.0 + q @ q
        root = along * along - curvature * excess
        beyond = root < 0.0
        np.sqrt(root, out=root)
        hidden: Array = np.minimum(along - root, 0.0) if self.upside_down else np.maximum(along + root, 0.0)
        hidden /= curvature
        hidden[beyond] = 0.0
        if q.any():
            own -= q[:, None] * hidden
            excess = np.einsum("ij,ij->j", own, own) - 1.0
        mark(out, excess > _ROUNDING, flags.SUSPECT, flags.CLIPPED)
        return hidden

    def _mount(self, own: Array, hidden: Array | None, application: Array) -> None:
        """Turn ``own`` into the application frame."""
        if self.rotation is None:
            application[...] = own
        elif hidden is None:
            product(self.rotation, own, out=application)
        else:
            product(self.rotation[:2, :2], own, out=application)
            application += self.rotation[:2, 2:] * hidden

    def _blank_unknown_sign(self, hidden: Array, out: Compensated) -> None:
        """Blank what follows from a g_z whose sign nothing shows: the sensor is on edge in its mounting and in fact."""
        unknown = np.abs(hidden) < _EDGE - _ROUNDING
        if self.rotation is None or not unknown.any():
            return
        mark(out, unknown, flags.FAIL, flags.NO_DIRECTION)
        by_hidden = self.rotation[:2, 2] - self.rotation[:2, :2] @ self.coupling
        for column in np.flatnonzero(np.abs(by_hidden) > _ROUNDING):
            out.gravity[unknown, column] = out.angles[unknown, column] = np.nan


def _arcsine(argument: Array, angle: Array, out: Compensated) -> None:
    """Compute a tilt, trapped: ±90° a little beyond ±1, NaN further out, and the row's flag shows it."""
    tilt(argument, out=angle)
    size = np.abs(argument)
    inside = size <= 1.0 + _ROUNDING
    if inside.all():
        return
    mark(out, ~inside, flags.SUSPECT, flags.CLIPPED)
    lost = ~(size <= CLIP_LIMIT + _ROUNDING)
    mark(out, lost, flags.FAIL, flags.CLIPPED)
    angle[lost] = np.nan


def _inverse(sensitivity: Array) -> Array:
    if not np.isfinite(sensitivity).all() or not np.linalg.cond(sensitivity) < _LARGEST_CONDITION:
        raise EstimateError(
            "the sensitivity matrix is singular: two channels measure the same axis, or one measures none"
        )
    return np.asarray(np.linalg.inv(sensitivity), dtype=np.float64)


def _first_order_inverse(sensitivity: Array, channels: tuple[str, ...], axes: tuple[str, ...]) -> Array:
    """Return the linear map that eq. 6 applies, for X and, with the letters exchanged, for Y.

    The rows of ``sensitivity`` and the columns of the map are the channels; the others are the axes.
    """
    own = [channels.index(axis) for axis in axes if axis in channels]
    if len(own) < len(axes) or not np.diag(sensitivity[own]).all():
        raise EstimateError(
            "the first-order compensation divides by the sensitivity of each channel's own axis: one is 0"
        )
    (xx, xy), (yx, yy) = sensitivity[own]
    return np.array([[1.0 / xx, -xy / (xx * yy)], [-yx / (xx * yy), 1.0 / yy]])[:, np.argsort(own)]


def _sine_of_limit(angle: float, side: int) -> float:
    """Return the sine beyond which a tilt is outside a limit by more than the slack; none lies outside ±90°."""
    widened = angle + side * _TILT_SLACK
    if abs(widened) >= pi / 2:
        return float(np.copysign(np.inf, widened))
    return sin(widened)


def product(matrix: Array, columns: Array, out: Array | None = None) -> Array:
    """Return ``matrix @ columns``, shapes (k, m) and (m, n), in one thread however many columns there are."""
    found = np.empty((len(matrix), columns.shape[1])) if out is None else out
    step = max(1, _ONE_THREAD // max(1, matrix.size))
    for start in range(0, columns.shape[1], step):
        part = slice(start, start + step)
        np.matmul(matrix, columns[:, part], out=found[:, part])
    return found
