"""The propagation of a calibration's uncertainty to the angles of each row, by the law of the GUM.

The compensation solves ``u = f(c, T, g)``, so its error follows from the derivatives of the model that it inverts. With
the slope w of a channel, one over the derivative of its reading by the signal v = S g::

    dv = w (du - sum_k (df/dc_k) dc_k - (df/dT) dT)
    dg = S⁻¹ dv + (rotation error of the mounting) × g

and the covariance of two channels' signals is a quadratic form of their derivatives, taken for many rows at a time.
A component that is not measured follows the two that are; see :mod:`tiltcal.core.compensation`. From the components to
the angles it is a gradient again, except at an edge: at ±90° of a tilt the interval of the argument is taken through
the arcsine, and where pitch or inclination comes from a length near zero, an error across it counts too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations_with_replacement
from math import pi, sqrt

import numpy as np

from tiltcal.core.compensation import Compensated, Compensation, KernelChunk
from tiltcal.core.coverage_factor import NEGLIGIBLE, NORMAL_FACTOR, coverage_factors
from tiltcal.core.flags import FAIL, NO_TEMPERATURE
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.tilt_angles import DIRECTIONS
from tiltcal.core.uncertainty_columns import round_up
from tiltcal.core.uncertainty_inputs import TURN, UncertaintyInputs
from tiltcal.errors import EstimateError
from tiltcal.frozen import frozen

HALF_TURN = pi
"""No half width is more, radians."""

CIRCLE = 1.2489
"""Radius of the circle that holds 95 % of the errors in two directions, over the half width that holds them in one."""

ANYWHERE = pi / sqrt(3.0)
"""Standard uncertainty of an angle of which nothing is known, radians."""

_EXACT = 1e-9  # part of a square below which its error changes nothing else
_DEGREES = 180.0 / pi
_ROWS = 16384  # of a step: most of them stay in the cache, and the calls cost little against the arithmetic
_ONE_THREAD = 1 << 18  # multiplications of a matrix product for which the linear algebra starts no threads
_CURVED = 0.02  # the second-order part of an arcsine above which its interval is taken through it

Signals = tuple[list[Array], list[Array], list[Array]]
"""The derivatives of each channel's signal: by its coefficients, by its reading, and times u(temperature)."""


@frozen
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


class Propagation:
    """From rows on their way through the kernel to the uncertainty of their angles.

    The raw outputs are the signals of the channels and, where the mounting is uncertain, behind them the errors of the
    components in the application's frame that its rotation makes. The outputs are the components of g in the
    application's frame; or, of two channels, those in the sensor's frame and behind them the rotation's errors.
    """

    def __init__(self, compensation: Compensation, coefficients: Coefficients, inputs: UncertaintyInputs) -> None:
        self._compensation = compensation
        self._axes = compensation.axes
        self._angles = len(compensation.angles)
        self._coupling = compensation.coupling
        self._rotation = np.eye(3) if compensation.rotation is None else compensation.rotation
        self._sees_all = len(self._axes) == 3
        self._rotated = any(name.startswith(TURN) for name in inputs.names)
        if self._rotated and self._axes not in (("x", "y"), AXES):
            raise EstimateError("a mounting that is uncertain takes a sensor that measures at least x and y")
        self._models, self._vectors = coefficients.models, coefficients.vectors
        self._readings, self._temperature = inputs.readings, inputs.temperature
        self._alignment = inputs.alignment
        self._chosen, parameters = self._parameters(inputs.names)
        widening = inputs.factors / NORMAL_FACTOR
        self._known = bool(np.allclose(widening, 1.0, rtol=NEGLIGIBLE))
        """Whether every coefficient has the normal factor, so that one variance says all."""
        self._coverage = None if self._known else coverage_factors()
        covariances = (
            [inputs.covariance]
            if self._known
            else [inputs.covariance, inputs.covariance * np.outer(widening, widening)]
        )
        whole = [k for of_channel in parameters[: len(self._models)] for k in of_channel]
        whole += [inputs.names.index(TURN + axis) for axis in AXES] if self._rotated else []
        self._whole = [covariance[np.ix_(whole, whole)] for covariance in covariances]
        self._raw = _pairs(len(parameters))
        self._rows = min(_ROWS, _ONE_THREAD // max(1, *(len(parameter) ** 2 for parameter in parameters)))
        blocks = (
            [covariance[np.ix_(parameters[a], parameters[b])] for covariance in covariances] for a, b in self._raw
        )
        self._covariances = [block if np.any(block) else [] for block in blocks]
        lift = self._lift(compensation)
        self._pair_lift = _pair_lift(lift)
        self._pairs = {pair: k for k, pair in enumerate(_pairs(len(lift)))}

    def __call__(self, chunk: KernelChunk) -> Array:
        """Return standard and expanded uncertainty of every angle, rounded up, shape (2, angles, n), degrees."""
        return self._uncertainties(chunk, round_up)

    def exact(self, chunk: KernelChunk) -> Array:
        """Return standard and expanded uncertainty of every angle, shape (2, angles, n), degrees."""
        return self._uncertainties(chunk, lambda room: None)

    def _uncertainties(self, chunk: KernelChunk, finish: Callable[[Array], None]) -> Array:
        count = len(chunk.out.flag)
        room = np.empty((2, self._angles, count))
        for start in range(0, count, self._rows):
            rows = slice(start, start + self._rows)
            self._fill(_part(chunk, rows), room[:, :, rows])
            room[:, :, rows] *= _DEGREES
            finish(room[:, :, rows])
        lost = (chunk.out.flag >= FAIL) | (chunk.out.reason & NO_TEMPERATURE > 0)
        if lost.any():
            room[:, :, lost] = np.nan
        return room

    def _fill(self, chunk: KernelChunk, room: Array) -> None:
        variances = self._variances(chunk)
        application = chunk.out.gravity.T
        for axis, argument in enumerate(application):
            half, factor = self._half(self._of_axis(axis, chunk, variances))
            room[1, axis] = _through_arcsine(argument, half)
            np.divide(room[1, axis], factor, out=room[0, axis])
        if self._sees_all:
            for number, name in enumerate(DIRECTIONS, start=len(self._axes)):
                self._direction(name, application, variances, room[:, number])

    def half_widths(self, chunk: KernelChunk, gradients: Sequence[UpGradient]) -> tuple[Array, Array]:
        """Return half of the 95 % interval of any quantities that follow from up, and the coverage factors.

        Parameters
        ----------
        gradients : sequence of UpGradient
            One for each quantity.

        Returns
        -------
        tuple of ndarray, shape (quantities, n)
            In the unit of each quantity.
        """
        halves, factors = np.ones((2, len(gradients), len(chunk.out.flag)))
        for start in range(0, halves.shape[1], self._rows):
            rows = slice(start, start + self._rows)
            part = _part(chunk, rows)
            signals = self._signals(part)
            for row, gradient in enumerate(gradients):
                by_own = self._by_measured(part, signals, gradient.by_up[:, rows])
                parts = self._quantity(part, signals, by_own, gradient.by_turn[:, rows])
                parts[-1] += gradient.variance[rows] + self._of_alignment(part, by_own)
                halves[row, rows], factors[row, rows] = self._half(parts)
        return halves, factors

    def _by_measured(self, chunk: KernelChunk, signals: Signals, by_up: Array) -> Array:
        """Return a gradient by the components that are measured from one by up, shape (axes, n)."""
        gravity = self._compensation.sensed(chunk)
        own: Array = (self._rotation.T @ by_up) / np.sqrt(np.einsum("in,in->n", gravity, gravity))
        if self._sees_all:
            return own
        # g_z follows from the length of up, which stays 1.
        along, _ = self._half(self._quantity(chunk, signals, gravity[:2], np.zeros_like(by_up)))
        q = self._coupling
        share = (q @ own[:2] - own[2]) / _slope_of_root(gravity[2] - q @ gravity[:2], along)
        return np.asarray(own[:2] + share * gravity[:2])

    def _of_alignment(self, chunk: KernelChunk, by_measured: Array) -> Array | float:
        """Return the variance that a turn of the sensor since it was level gives; see :meth:`_add_alignment`."""
        if not self._alignment:
            return 0.0
        moved = self._compensation.sensed(chunk) - self._rotation[2][:, None]
        by_gravity = np.zeros_like(moved)
        by_gravity[[AXES.index(axis) for axis in self._axes]] = by_measured
        if not self._sees_all:
            by_gravity[2] += self._coupling @ by_measured
        turned: Array = self._alignment * np.cross(moved, by_gravity, axis=0)
        return np.asarray(np.einsum("in,in->n", turned, turned))

    def _quantity(self, chunk: KernelChunk, signals: Signals, by_measured: Array, by_turn: Array) -> Array:
        """Return the variance of a quantity, shape (kinds, n), from its gradients."""
        derivatives, slopes, by_temperature = signals
        by_signal = self._compensation.inverse.T @ by_measured
        terms = [signal * table for signal, table in zip(by_signal, derivatives, strict=True)]
        table = np.concatenate([*terms, by_turn] if self._rotated else terms)
        found = np.zeros((1 if self._known else 3, by_signal.shape[1]))
        for kind, covariance in enumerate(self._whole):
            np.einsum("kn,kn->n", table, covariance @ table, out=found[kind])
        found[-1] += np.einsum("cn,cn->n", by_signal, np.stack(by_temperature)) ** 2
        for signal, slope, noise in zip(by_signal, slopes, self._readings, strict=True):
            found[-1] += (signal * slope * noise) ** 2 * chunk.share
        return found

    # ------------------------------------------------------------------------------------- from errors to components

    def _parameters(self, names: Sequence[str]) -> tuple[list[slice | list[int]], list[list[int]]]:
        """Return the derivatives that count of each raw output, and the uncertain parameters that they belong to."""
        places = {name: k for k, name in enumerate(names)}
        chosen: list[slice | list[int]] = []
        parameters = []
        for model in self._models:
            rows = [row for row, name in enumerate(model.coefficients) if name in places]
            # Neighbours are a slice, which takes no copy.
            chosen.append(slice(rows[0], rows[-1] + 1) if rows and rows[-1] - rows[0] < len(rows) else rows)
            parameters.append([places.pop(model.coefficients[row]) for row in rows])
        if self._rotated:
            about = [places.pop(TURN + axis) for axis in AXES]
            # The rotation error r adds r × g: its component along an axis takes the two other components of r.
            parameters += [[about[(axis + 1) % 3], about[(axis + 2) % 3]] for axis in range(len(self._axes))]
        if places:
            raise EstimateError(f"the calibration has no coefficient {next(iter(places))!r}")
        return chosen, parameters

    def _variances(self, chunk: KernelChunk) -> Array:
        """Return the covariance of each pair of outputs, shape (kinds, pairs, n).

        Kinds: all together where every coefficient has the normal factor; else of the coefficients, the same widened by
        their factors, and of readings and temperature.
        """
        derivatives, slopes, by_temperature = self._signals(chunk)
        n = len(slopes[0])
        if self._rotated:
            up = self._compensation.up(chunk)
            derivatives += [np.stack([up[(k + 2) % 3], -up[(k + 1) % 3]]) for k in range(len(self._axes))]
        found = np.zeros((1 if self._known else 3, len(self._raw), n))
        for k, (a, b) in enumerate(self._raw):
            for kind, covariance in enumerate(self._covariances[k]):
                np.einsum("kn,kn->n", derivatives[a], covariance @ derivatives[b], out=found[kind, k])
            if b < len(slopes):
                if self._temperature:
                    found[-1, k] += by_temperature[a] * by_temperature[b]
                if a == b:
                    found[-1, k] += (slopes[a] * self._readings[a]) ** 2 * chunk.share
        variances = np.asarray(np.matmul(self._pair_lift, found))
        if self._alignment:
            self._add_alignment(variances[-1], self._compensation.sensed(chunk))
        return variances

    def _add_alignment(self, variances: Array, gravity: Array) -> None:
        """Add what a turn θ of the sensor since it was level makes: θ × (g - z), θ alike about every axis."""
        level = self._rotation[2]
        if self._sees_all:
            moved = self._rotation @ (gravity - level[:, None])
            outputs = np.eye(3)
        else:
            if len(self._axes) == 1:  # the rest of gravity lies along an axis that the sensor does not see
                gravity[0 if self._axes == ("z",) else 2] = np.sqrt(np.maximum(1.0 - np.sum(gravity**2, axis=0), 0.0))
            moved = gravity - level[:, None]
            outputs = np.eye(3)[[AXES.index(axis) for axis in self._axes]]
            if len(self._axes) == 2:
                outputs[:, 2] += self._coupling
        length, along = np.sum(moved**2, axis=0), outputs @ moved
        for (a, b), k in self._pairs.items():
            if b < len(outputs):
                spread = float(outputs[a] @ outputs[b]) * length - along[a] * along[b]
                variances[k] += self._alignment**2 * spread

    def _signals(self, chunk: KernelChunk) -> Signals:
        """Return the derivatives of each channel's signal: by its coefficients, by its reading, by u(temperature)."""
        places = [AXES.index(axis) for axis in self._models[0].axes]
        sensed = chunk.own if self._models[0].axes == self._axes else self._compensation.sensed(chunk)[places]
        dt = np.zeros(sensed.shape[1]) if chunk.dt is None else chunk.dt
        derivatives, slopes, by_temperature = [], [], []
        for model, theta, chosen in zip(self._models, self._vectors, self._chosen, strict=True):
            found = model.derivatives(theta, sensed, dt)
            slopes.append(1.0 / found.by_signal)
            table = found.by_coefficient
            derivatives.append(table[chosen])
            derivatives[-1] *= -slopes[-1]
            if self._temperature:
                warm = model.by_temperature(theta, found.signal, dt)
                by_temperature.append(slopes[-1] * (self._temperature * warm))
            else:
                by_temperature.append(np.zeros_like(dt))
        return derivatives, slopes, by_temperature

    def _lift(self, compensation: Compensation) -> Array:
        """Return the matrix from the raw outputs to the outputs."""
        seen = len(self._axes)
        lift = self._rotation @ compensation.inverse if self._sees_all else compensation.inverse
        if not self._rotated:
            return lift
        if self._sees_all:
            return np.hstack([lift, np.eye(seen)])
        return np.block([[lift, np.zeros((seen, seen))], [np.zeros((seen, seen)), np.eye(seen)]])

    # ------------------------------------------------------------------------------------- from components to angles

    def _along(self, variances: Array, gradient: Sequence[Array | float]) -> Array:
        """Variance along a gradient over the outputs, shape (kinds, n)."""
        total = np.zeros((variances.shape[0], variances.shape[2]))
        for (first, second), k in self._pairs.items():
            double = 1.0 if first == second else 2.0
            total += (double * gradient[first]) * gradient[second] * variances[:, k]
        return total

    def _of_axis(self, axis: int, chunk: KernelChunk, variances: Array) -> Array:
        """Variance of one component of g in the application, shape (kinds, n)."""
        moved = self._rotated and not self._sees_all
        if chunk.hidden is None:
            if not moved:
                return np.asarray(variances[:, self._pairs[axis, axis]])
            gradient: list[Array | float] = [float(axis == k) for k in range(2)]
        else:
            q, row = self._coupling, self._rotation[axis]
            own = chunk.own
            along, _ = self._half(self._along(variances, [own[0], own[1], *([0.0, 0.0] if moved else [])]))
            share = (row[:2] @ q - row[2]) / _slope_of_root(chunk.hidden - q @ own, along)
            gradient = [row[k] + share * own[k] for k in range(2)]
        if moved:
            gradient += [float(axis == k) for k in range(2)]
        return self._along(variances, gradient)

    def _half(self, parts: Array) -> tuple[Array, Array | float]:
        """Half width of the 95 % interval, and its coverage factor."""
        np.maximum(parts, 0.0, out=parts)
        if self._coverage is None:
            return NORMAL_FACTOR * np.sqrt(parts[0]), NORMAL_FACTOR
        factor = self._coverage.factor(*parts)
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


def _pairs(count: int) -> list[tuple[int, int]]:
    return list(combinations_with_replacement(range(count), 2))


def _pair_lift(lift: Array) -> Array:
    """Return the matrix from covariances of the raw outputs to those of the outputs, shape (pairs, raw pairs)."""
    rows = []
    for a, b in _pairs(len(lift)):
        table = np.outer(lift[a], lift[b])
        table = table + table.T
        rows.append([table[i, j] / (2.0 if i == j else 1.0) for i, j in _pairs(lift.shape[1])])
    return np.array(rows)


def _slope_of_root(root: Array, half: Array) -> Array:
    """Return what the error of half a square is divided by for that of its root; all of its interval near zero."""
    size, square = np.abs(root), root * root
    low, high = np.sqrt(np.maximum(square - 2.0 * half, 0.0)), np.sqrt(square + 2.0 * half)
    slope = half / np.where(low > 0.0, size - low, high)
    return np.copysign(np.where(half > _EXACT * square, slope, size), root)


def _length(a: Array, b: Array) -> Array:
    """Compute the hypotenuse in half the time of ``hypot``: nothing here comes near an overflow."""
    return np.asarray(np.sqrt(a * a + b * b))


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


def _part(chunk: KernelChunk, rows: slice) -> KernelChunk:
    """Some rows of a chunk; of what comes out, gravity alone."""
    out = chunk.out
    return KernelChunk(
        rows,
        None if chunk.dt is None else chunk.dt[rows],
        chunk.signal[:, rows],
        chunk.own[:, rows],
        None if chunk.hidden is None else chunk.hidden[rows],
        Compensated(out.gravity[rows], out.tilt[rows], None, None, None, out.flag[rows], out.reason[rows]),
        chunk.share if isinstance(chunk.share, float) else chunk.share[rows],
    )
