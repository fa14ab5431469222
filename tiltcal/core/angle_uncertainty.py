"""The uncertainty of every angle that the kernel gives, row by row, by the GUM's law of propagation.

What the compensation finds solves ``u = f(c, T, g)``, so its error follows from the derivatives of the model that it
turned round. With the slope w of a channel, which is 1 / ((1 + gain) B') for a bend B(a), the straight signal v errs by

    dv = w (du - d offset - d drift - B S_ii d gain) - sum_j g_j dS_ij - ...
    dg = S⁻¹ dv + (turn of the mounting) × g

Each term is a coefficient's error times something of the row: 1, dT, g_x, ... So the covariance of g is a quadratic
form of a few such features, whose matrix is worked out once. Where a third component is hidden it follows the two that
are seen; see :mod:`tiltcal.core.compensation`. From the components to the angles it is a gradient again, except where
an angle has an edge: at ±90° of a tilt the interval of the argument is taken through the arcsine, and where pitch or
inclination comes from a length near zero, an error across it counts too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiltcal.core.angle_terms import TURN, AngleTerm, AngleTerms
from tiltcal.core.budget import NEGLIGIBLE
from tiltcal.core.compensation import DIRECTIONS, FAIL, NO_TEMPERATURE, Bytes, Compensated, Compensation, KernelChunk
from tiltcal.core.expanded_uncertainty import ExpandedUncertainty
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.quadratic_forms import QuadraticForms, pairs_of
from tiltcal.errors import EstimateError

HALF_TURN = pi
"""No half width is more, radians."""

CIRCLE = 1.2489
"""Radius of the circle that holds 95 % of the errors in two directions, over the half width that holds them in one."""

ANYWHERE = pi / sqrt(3.0)
"""Standard uncertainty of an angle of which nothing is known, radians."""

_EXACT = 1e-9  # part of a square below which its error changes nothing else
_LOWEST = -60  # binary exponent of an angle too small for anyone
_SCALES = 10.0 ** np.clip(3 - np.floor(np.log10(2.0) * (np.arange(_LOWEST, 10) - 1)), 0, 22)  # by binary exponent
_CURVED = 0.02  # the second-order part of an arcsine above which its interval is taken through it


@dataclass(frozen=True)
class UncertaintyInputs:
    """What the angles are uncertain by.

    Attributes
    ----------
    names : tuple of str
        Dotted names of the uncertain coefficients; ``mounting.turn.x`` is a small turn of the mounting about the
        application's x axis, radians.
    covariance : ndarray, shape (k, k)
    factors : ndarray, shape (k,)
        What each one's standard uncertainty is multiplied with for an interval of 95 %.
    readings : ndarray, shape (channels,)
        Standard uncertainty of a single reading, unit; channels are independent.
    temperature : float
        Standard uncertainty of a temperature, °C.
    """

    names: tuple[str, ...]
    covariance: Array
    factors: Array
    readings: Array
    temperature: float = 0.0


@dataclass(frozen=True)
class AngleUncertainty:
    """What the kernel makes of n rows, and how uncertain its angles are.

    Attributes
    ----------
    compensated : Compensated
    standard : ndarray, shape (n, angles)
        Standard uncertainty of each angle (k = 1), degrees, to four digits; NaN where nobody knows it.
    expanded : ndarray, shape (n, angles)
        Half width of its 95 % interval, degrees.
    """

    compensated: Compensated
    standard: Array
    expanded: Array

    @property
    def flag(self) -> Bytes:
        """1 pass, 3 suspect, 4 fail, 9 missing; shape (n,)."""
        return self.compensated.flag

    @property
    def reason(self) -> Bytes:
        """Bit mask; shape (n,)."""
        return self.compensated.reason


class CompensationWithUncertainty:
    """A compensation that tells how uncertain each of its angles is.

    Parameters
    ----------
    compensation : Compensation
    coefficients : Coefficients
        Those of the compensation.
    doubt : UncertaintyInputs

    Raises
    ------
    EstimateError
        The coefficients have none of a name, or a mounting is uncertain of a sensor that has no x and y.

    Notes
    -----
    A row has no uncertainty (NaN) where its flag is 4 or 9, where its temperature is missing and counts, and where the
    argument of an arcsine is so far beyond ±1 that its interval does not reach back.
    """

    def __init__(self, compensation: Compensation, coefficients: Coefficients, doubt: UncertaintyInputs) -> None:
        self._compensation = compensation
        self._propagation = _Propagation(compensation, coefficients, doubt)
        self._angles = compensation.angles

    @property
    def expanded(self) -> tuple[str, ...]:
        """Names of the columns that hold half widths of 95 % intervals, in the order of the angles."""
        return tuple(f"U95_{angle}" for angle in self._angles)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that :meth:`table` gives."""
        return (*self._compensation.columns, *(f"u_{angle}" for angle in self._angles), *self.expanded)

    def table(self, found: AngleUncertainty) -> dict[str, NDArray[np.float64] | Bytes]:
        """The columns of a result under the names that :attr:`columns` lists."""
        added = (*found.standard.T, *found.expanded.T)
        own = self._compensation.table(found.compensated)
        return own | dict(zip(self.columns[len(own) :], added, strict=True))

    def __call__(self, readings: ArrayLike, temperature: ArrayLike | None = None) -> AngleUncertainty:
        """Compensate rows; the arguments are those of :class:`Compensation`."""
        room = np.empty((2, len(self._angles), len(np.asarray(readings))))

        def follow(stage: KernelChunk) -> None:
            self._propagation(stage, room[:, :, stage.rows])

        compensated = self._compensation(readings, temperature, follow=follow)
        return AngleUncertainty(compensated, room[0].T, room[1].T)


class _Propagation:
    """From rows on their way through the kernel to the uncertainty of their angles.

    The forms' outputs are the components of g in the application; or, of two channels, those in the sensor's frame and,
    where the mounting is uncertain, behind them what its turn moves in the application.
    """

    def __init__(self, compensation: Compensation, coefficients: Coefficients, doubt: UncertaintyInputs) -> None:
        self._axes = compensation.axes
        self._coupling = compensation.coupling
        self._turn = np.eye(3) if compensation.rotation is None else compensation.rotation
        self._sees_all = len(self._axes) == 3
        self._turned = any(name.startswith(TURN) for name in doubt.names)
        if self._turned and self._axes not in (("x", "y"), AXES):
            raise EstimateError("a mounting that is uncertain takes a sensor that measures at least x and y")
        self._features = AngleTerms(coefficients, self._axes, self._turn)
        self._expansion = ExpandedUncertainty()
        moves = self._moves(coefficients, doubt)
        stretch = doubt.factors / self._expansion.normal
        if np.allclose(stretch, 1.0, rtol=NEGLIGIBLE):
            joined = np.zeros((sum(one.shape[1] for one in moves),) * 2)
            joined[: len(stretch), : len(stretch)] = doubt.covariance
            joined[len(stretch) :, len(stretch) :] = np.eye(len(joined) - len(stretch))
            kinds = [(np.concatenate(moves, axis=1), joined)]
        else:
            stretched = doubt.covariance * np.outer(stretch, stretch)
            kinds = [(moves[0], doubt.covariance), (moves[0], stretched), (moves[1], np.eye(moves[1].shape[1]))]
        self._forms = QuadraticForms(kinds, self._lift(compensation))
        self._pairs = {pair: k for k, pair in enumerate(pairs_of(self._forms.outputs))}

    def __call__(self, stage: KernelChunk, room: Array) -> None:
        """Standard and expanded uncertainty of every angle into ``room``, shape (2, angles, n), degrees."""
        for start in range(0, room.shape[2], self._forms.rows):
            rows = slice(start, start + self._forms.rows)
            self._fill(_part(stage, rows), room[:, :, rows])
            _shorten(room[:, :, rows])
        lost = (stage.out.flag >= FAIL) | (stage.out.reason & NO_TEMPERATURE > 0)
        if lost.any():
            room[:, :, lost] = np.nan

    def _fill(self, stage: KernelChunk, room: Array) -> None:
        variances = self._forms(self._features(stage))
        application = stage.out.gravity.T
        for axis, argument in enumerate(application):
            half, factor = self._half(self._of_axis(axis, stage, variances))
            room[1, axis] = _through_arcsine(argument, half)
            np.divide(room[1, axis], factor, out=room[0, axis])
        if self._sees_all:
            for number, name in enumerate(DIRECTIONS, start=len(self._axes)):
                self._direction(name, application, variances, room[:, number])

    # ------------------------------------------------------------------------------------------- what depends on what

    def _moves(self, coefficients: Coefficients, doubt: UncertaintyInputs) -> tuple[Array, Array]:
        """How each coefficient, and each reading and the temperature, moves each channel's straight signal.

        Shapes (channels, k, features); where the mounting is uncertain, behind the channels what its turn moves.
        """
        features, channels = self._features, len(coefficients.channels)
        of_coefficients: list[tuple[int, int, AngleTerm, float]] = []
        for k, name in enumerate(doubt.names):
            if name.startswith(TURN):
                axis = AXES.index(name.removeprefix(TURN))
                first, second = (axis + 1) % 3, (axis + 2) % 3
                for row, column, sign in ((second, first, 1.0), (first, second, -1.0)):
                    if row < len(self._axes):
                        of_coefficients.append((channels + row, k, AngleTerm("up", column), sign))
            else:
                of_coefficients += [(i, k, term, -1.0) for i, term in features.of_coefficient(name)]
        of_readings = [(i, i, features.of_reading(i), sigma) for i, sigma in enumerate(doubt.readings.tolist())]
        for i in range(channels):
            of_readings += [
                (i, channels, term, -weight * doubt.temperature) for term, weight in features.of_temperature(i)
            ]
        for _, _, term, _ in (*of_coefficients, *of_readings):
            features.add(term)
        outputs = channels + (len(self._axes) if self._turned else 0)
        return (
            self._map(of_coefficients, outputs, len(doubt.names)),
            self._map(of_readings, outputs, channels + 1),
        )

    def _map(self, entries: Sequence[tuple[int, int, AngleTerm, float]], outputs: int, count: int) -> Array:
        table = np.zeros((outputs, count, len(self._features)))
        for row, k, term, weight in entries:
            table[row, k, self._features.place(term)] += weight
        return table

    def _lift(self, compensation: Compensation) -> Array:
        """From the channels' straight signals to the outputs."""
        seen = len(self._axes)
        lift = self._turn @ compensation.inverse if self._sees_all else compensation.inverse
        if not self._turned:
            return lift
        if self._sees_all:
            return np.hstack([lift, np.eye(seen)])
        return np.block([[lift, np.zeros((seen, seen))], [np.zeros((seen, seen)), np.eye(seen)]])

    # ------------------------------------------------------------------------------------------------------ to angles

    def _along(self, variances: Array, gradient: Sequence[Array | float]) -> Array:
        """Variance along a gradient over the outputs, shape (kinds, n)."""
        total = np.zeros((variances.shape[0], variances.shape[2]))
        for (first, second), k in self._pairs.items():
            double = 1.0 if first == second else 2.0
            total += (double * gradient[first]) * gradient[second] * variances[:, k]
        return total

    def _of_axis(self, axis: int, stage: KernelChunk, variances: Array) -> Array:
        """Variance of one component of g in the application, shape (kinds, n)."""
        moved = self._turned and not self._sees_all
        if stage.hidden is None:
            if not moved:
                return np.asarray(variances[:, self._pairs[axis, axis]])
            gradient: list[Array | float] = [float(axis == k) for k in range(2)]
        else:
            q, row = self._coupling, self._turn[axis]
            own = stage.own
            along, _ = self._half(self._along(variances, [own[0], own[1], *([0.0, 0.0] if moved else [])]))
            share = (row[:2] @ q - row[2]) / _slope_of_root(stage.hidden - q @ own, along)
            gradient = [row[k] + share * own[k] for k in range(2)]
        if moved:
            gradient += [float(axis == k) for k in range(2)]
        return self._along(variances, gradient)

    def _half(self, parts: Array) -> tuple[Array, Array | float]:
        """Half width of the 95 % interval, and its coverage factor."""
        np.maximum(parts, 0.0, out=parts)
        if self._forms.kinds == 1:
            return self._expansion.normal * np.sqrt(parts[0]), self._expansion.normal
        factor = self._expansion.factor(*parts)
        return factor * np.sqrt(parts[0] + parts[2]), factor

    def _direction(self, name: str, gravity: Array, variances: Array, room: Array) -> None:
        """Pitch, roll or inclination: an arctangent of one component over the length of the two others."""
        alone, across = (0, (1, 2)) if name != "inclination" else (2, (0, 1))
        length = _length(gravity[across[0]], gravity[across[1]])
        cosine, sine = gravity[across[0]] / length, gravity[across[1]] / length
        nowhere = length == 0.0
        if nowhere.any():
            cosine[nowhere], sine[nowhere] = 1.0, 0.0
        gradient: list[Array | float] = [0.0, 0.0, 0.0]
        gradient[across[0]], gradient[across[1]] = -sine, cosine
        beside, factor = self._half(self._along(variances, gradient))
        if name == "roll":
            half = beside / length
            np.minimum(half, HALF_TURN, out=room[1])
            np.minimum(half / factor, ANYWHERE, out=room[0])
            return
        size = length * length + gravity[alone] * gravity[alone]
        gradient[alone] = length / size
        gradient[across[0]] = gravity[alone] * cosine / -size
        gradient[across[1]] = gravity[alone] * sine / -size
        half, factor = self._half(self._along(variances, gradient))
        # The length of the two grows by an error across it, which near zero is as good as one along it.
        longer = gravity[alone] * (_length(length, beside) - length) / size
        width = _length(half, longer)
        # Within the circle that holds 95 % of the errors, the truth may as well be straight down.
        from_edge = length / np.abs(gravity[alone])
        within = from_edge <= CIRCLE * np.maximum(half, beside / np.sqrt(size))
        np.copyto(width, np.maximum(width, from_edge), where=within)
        np.minimum(width, HALF_TURN, out=room[1])
        np.minimum(room[1] / factor, ANYWHERE, out=room[0])


def _slope_of_root(root: Array, half: Array) -> Array:
    """What the error of half a square is divided by for that of its root; all of its interval near zero."""
    size, square = np.abs(root), root * root
    low, high = np.sqrt(np.maximum(square - 2.0 * half, 0.0)), np.sqrt(square + 2.0 * half)
    slope = half / np.where(low > 0.0, size - low, high)
    return np.copysign(np.where(half > _EXACT * square, slope, size), root)


def _length(one: Array, other: Array) -> Array:
    """What hypot gives, in half its time: nothing here comes near an overflow."""
    return np.asarray(np.sqrt(one * one + other * other))


def _through_arcsine(argument: Array, half: Array) -> Array:
    """Half width of an arcsine, radians, from that of its argument; NaN where all of that is beyond ±1."""
    room = 1.0 - argument * argument
    width = half / np.sqrt(np.maximum(room, 1e-300))
    curved = np.flatnonzero(half * np.abs(argument) > _CURVED * room)
    if len(curved):
        near, reach = argument[curved], half[curved]
        middle, low, high = (np.arcsin(np.clip(near + side * reach, -1.0, 1.0)) for side in (0.0, -1.0, 1.0))
        widest = np.maximum(high - middle, middle - low)
        widest[widest == 0.0] = np.nan
        width[curved] = widest
    return width


def _shorten(room: Array) -> None:
    """Radians to degrees of four digits, or five, rounded up: an uncertainty has no more."""
    room *= 180.0 / pi
    scale = np.take(_SCALES, np.frexp(room)[1] - _LOWEST, mode="clip")
    room *= scale
    np.ceil(room, out=room)
    room /= scale


def _part(stage: KernelChunk, rows: slice) -> KernelChunk:
    """Some rows of a stage; of what comes out, gravity alone."""
    out = stage.out
    return KernelChunk(
        rows,
        None if stage.dt is None else stage.dt[rows],
        stage.signal[:, rows],
        stage.own[:, rows],
        None if stage.hidden is None else stage.hidden[rows],
        Compensated(out.gravity[rows], out.tilt[rows], None, None, None, out.flag[rows], out.reason[rows]),
    )
