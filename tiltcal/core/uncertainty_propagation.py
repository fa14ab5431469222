"""The propagation of a calibration's uncertainty to the angles of each row, by the law of the GUM.

The compensation solves ``u = f(c, T, g)``, so its error follows from the derivatives of the model that it inverts. With
the slope w of a channel, one over the derivative of its reading by the signal v = S g::

    dv = w (du - sum_k (df/dc_k) dc_k - (df/dT) dT)
    dg = S⁻¹ dv + (rotation error of the mounting) × g

and the covariance of two channels' signals is a quadratic form of their derivatives, taken for many rows at a time.
A component that is not measured follows the two that are; see :mod:`tiltcal.core.compensation`. From the components to
the angles it is a gradient again, except at an edge: at ±90° of a tilt the interval of the argument is taken through
the arcsine, and where an angle of three axes comes from a length near zero, an error across it counts too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from tiltcal.core.compensation import Compensation, KernelChunk
from tiltcal.core.coverage_factor import NEGLIGIBLE, NORMAL_FACTOR, coverage_factors
from tiltcal.core.flags import FAIL, NO_TEMPERATURE
from tiltcal.core.matrix_product import columns_of_one_thread, form, pairs_of, product, products_of
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.mounting_angles import UNKNOWN_ANGLE
from tiltcal.core.signal_derivatives import SignalDerivatives
from tiltcal.core.tilt_angles import DIRECTIONS
from tiltcal.core.uncertainty_columns import round_up
from tiltcal.core.uncertainty_inputs import TURN, UncertaintyInputs
from tiltcal.errors import EstimateError

HALF_TURN = pi
"""No half width is more, radians."""

CIRCLE = 1.2489
"""Radius of the circle that holds 95 % of the errors in two directions, over the half width that holds them in one."""

_EXACT = 1e-9  # part of a square below which its error changes nothing else
_DEGREES = 180.0 / pi
_ROWS = 16384  # of a step: most of them stay in the cache, and the calls cost little against the arithmetic
_CURVED = 0.02  # the second-order part of an arcsine above which its interval is taken through it

Signals = tuple[Array, Array | None]
"""The derivatives of the signals: the table by the coefficients, and of each channel times u(temperature)."""


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


class Propagation:
    """The propagation from rows on their way through the kernel to the uncertainty of their angles.

    The outputs are the components of g in the application's frame; or, of two channels, those in the sensor's frame
    and, where the mounting is uncertain, behind them the errors in the application's frame that its rotation makes.
    Errors of outputs are sums over the rows of one table of derivatives, all with the sign turned round, so that
    every covariance of two outputs is a quadratic form: a product of a matrix with the products of two rows each.
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
        self._derivatives = SignalDerivatives(coefficients, inputs.names)
        self._parameters = self._of_channels(inputs.names)
        widening = inputs.factors / NORMAL_FACTOR
        self._known = bool(np.all(np.abs(widening - 1.0) <= NEGLIGIBLE))
        """Whether every coefficient has the normal factor, so that one variance is enough."""
        self._coverage = None if self._known else coverage_factors()
        alike = not self._known and bool(np.ptp(widening) <= _EXACT * widening[0])
        self._widened = float(widening[0]) ** 2 if alike else 0.0
        """What the factor of all coefficients stretches their variance by; 0 where they have different ones."""
        covariances = [inputs.covariance]
        if not (self._known or self._widened):
            covariances.append(inputs.covariance * np.outer(widening, widening))
        self._kinds = len(covariances) + (not self._known)
        order = [inputs.names.index(name) for names in self._parameters for name in names]
        order += [inputs.names.index(TURN + axis) for axis in AXES] if self._rotated else []
        self._whole = [covariance[np.ix_(order, order)] for covariance in covariances]
        self._lift, errors = self._outputs(compensation, inputs.names)
        pairs = pairs_of(len(errors))
        if not (self._sees_all or self._rotated or compensation.solves_z):
            pairs = [(a, b) for a, b in pairs if a == b]
        self._pairs = {pair: k for k, pair in enumerate(pairs)}
        own = [form(errors[a] @ covariance @ errors[b].T) for covariance in covariances for a, b in pairs]
        self._by_noise = np.array([form(self._noise(self._lift[a] * self._lift[b], errors.shape[1])) for a, b in pairs])
        self._forms = np.zeros((self._kinds * len(pairs), self._by_noise.shape[1]))
        self._forms[: len(own)] = own

    def __call__(self, chunk: KernelChunk, out: Array | None = None, *, rounded: bool = True) -> Array:
        """Return standard and expanded uncertainty of every angle, rounded up or not, shape (2, angles, n), degrees."""
        count = len(chunk.out.flag)
        room = np.empty((2, self._angles, count)) if out is None else out
        for start in range(0, count, _ROWS):
            rows = slice(start, start + _ROWS)
            self._fill(chunk.part(rows), room[:, :, rows])
            if rounded:
                round_up(room[:, :, rows], _DEGREES)
            else:
                room[:, :, rows] *= _DEGREES
        lost = (chunk.out.flag >= FAIL) | (chunk.out.reason & NO_TEMPERATURE > 0)
        if lost.any():
            room[:, :, lost] = np.nan
        return room

    def _fill(self, chunk: KernelChunk, room: Array) -> None:
        variances = self._variances(chunk)
        application = chunk.out.gravity.T
        if self._sees_all:
            self._angles_of_three(application, variances, room)
            return
        slope = None if chunk.hidden is None else self._slope_of_hidden(chunk.own, chunk.hidden, variances)
        for axis, argument in enumerate(application):
            variance, factor = self._whole_variance(self._of_axis(axis, chunk.own, slope, variances))
            _through_arcsine(argument, variance, factor, room[1, axis])
            np.divide(room[1, axis], factor, out=room[0, axis])

    def length_half_width(self, chunk: KernelChunk) -> Array:
        """Return half of the 95 % interval of the length of gravity of three axes, shape (n,), g."""
        gravity = chunk.out.gravity.T
        along = list(gravity / np.sqrt(np.einsum("in,in->n", gravity, gravity)))
        return self._half(self._along(self._variances(chunk), along))[0]

    def half_widths(self, chunk: KernelChunk, gradients: Sequence[UpGradient]) -> tuple[Array, Array]:
        """Return half of the 95 % interval of quantities that follow from up, in their units, and the coverage factors.

        Both have the shape (quantities, n).

        Parameters
        ----------
        gradients : sequence of UpGradient
            One for each quantity.
        """
        halves, factors = np.ones((2, len(gradients), len(chunk.out.flag)))
        for start in range(0, halves.shape[1], _ROWS):
            rows = slice(start, start + _ROWS)
            part = chunk.part(rows)
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
        rows, by_temperature = signals
        by_signal = self._compensation.inverse.T @ by_measured
        places = self._derivatives.rows
        terms = [
            signal * rows[[places[name] for name in names]]
            for signal, names in zip(by_signal, self._parameters, strict=True)
        ]
        table = np.concatenate([*terms, -by_turn] if self._rotated else terms)
        found = np.zeros((self._kinds, by_signal.shape[1]))
        for kind, covariance in enumerate(self._whole):
            np.einsum("kn,kn->n", table, covariance @ table, out=found[kind])
        if by_temperature is not None:
            found[-1] += np.einsum("cn,cn->n", by_signal, by_temperature) ** 2
        for signal, slope, noise in zip(by_signal, self._derivatives.slopes, self._readings, strict=True):
            found[-1] += (signal * rows[slope] * noise) ** 2 * chunk.share
        return found

    # ------------------------------------------------------------------------------------- from errors to components

    def _of_channels(self, names: Sequence[str]) -> list[list[str]]:
        """Return the uncertain coefficients of each channel."""
        found = [[name for name in model.coefficients if name in names] for model in self._models]
        known = {TURN + axis for axis in AXES}.union(*found)
        for name in names:
            if name not in known:
                raise EstimateError(f"the calibration has no coefficient {name!r}")
        return found

    def _outputs(self, compensation: Compensation, names: Sequence[str]) -> tuple[Array, Array]:
        """Return the matrix from signals to outputs, and that of each output from errors to the table's rows.

        Returns
        -------
        tuple of ndarray, shapes (outputs, channels) and (outputs, rows, names)
        """
        lift = self._rotation @ compensation.inverse if self._sees_all else compensation.inverse
        seen, places = len(self._axes), {name: k for k, name in enumerate(names)}
        count = 2 * seen if self._rotated and not self._sees_all else seen
        lift = np.vstack([lift, np.zeros((count - seen, lift.shape[1]))])
        errors = np.zeros((count, self._derivatives.count + 3 * self._rotated, len(names)))
        for channel, own in enumerate(self._parameters):
            for name in own:
                errors[:, self._derivatives.rows[name], places[name]] += lift[:, channel]
        if self._rotated:
            # The rotation error r adds r × g: its component along an axis takes the two other components of r.
            up, about = self._derivatives.count, [places[TURN + axis] for axis in AXES]
            for axis, output in enumerate(range(count - seen, count)):
                following, last = (axis + 1) % 3, (axis + 2) % 3
                errors[output, up + last, about[following]] -= 1.0
                errors[output, up + following, about[last]] += 1.0
        return lift, errors

    def _noise(self, weights: Array, rows: int) -> Array:
        """Return the quadratic form of the readings' noise, each channel with a weight, shape (rows, rows)."""
        found = np.zeros((rows, rows))
        np.add.at(found, (self._derivatives.slopes,) * 2, weights * self._readings**2)
        return found

    def _variances(self, chunk: KernelChunk) -> Array:
        """Return the covariance of each pair of outputs, shape (kinds, pairs, n).

        Kinds: all together where every coefficient has the normal factor; else of the coefficients, where their factors
        differ the same widened by them, and of readings and temperature.
        """
        table, by_temperature = self._signals(chunk)
        if self._rotated:
            table = np.concatenate([table, self._compensation.up(chunk)])
        forms = self._forms.copy()
        forms[-len(self._pairs) :] += self._by_noise * (chunk.share if isinstance(chunk.share, float) else 0.0)
        found = np.empty((self._kinds, len(self._pairs), table.shape[1]))
        flat = found.reshape(-1, table.shape[1])
        step = columns_of_one_thread(forms)
        for start in range(0, table.shape[1], step):
            part = slice(start, start + step)
            products = products_of(table[:, part])
            np.matmul(forms, products, out=flat[:, part])
            if not isinstance(chunk.share, float):
                found[-1, :, part] += product(self._by_noise, products) * chunk.share[part]
        if by_temperature is not None:
            moved = self._lift @ by_temperature
            for (a, b), k in self._pairs.items():
                found[-1, k] += moved[a] * moved[b]
        if self._alignment:
            self._add_alignment(found[-1], self._compensation.sensed(chunk))
        return found

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

    def _signals(self, chunk: KernelChunk) -> tuple[Array, Array | None]:
        """Return the table of derivatives, and those of each signal times u(temperature); None where that is 0."""
        axes, derivatives = self._models[0].axes, self._derivatives
        along = (
            chunk.own if axes == self._axes else self._compensation.sensed(chunk)[[AXES.index(axis) for axis in axes]]
        )
        table = np.empty((derivatives.count, along.shape[1]))
        signals = derivatives(along, chunk.signal, chunk.dt, table)
        if not self._temperature:
            return table, None
        dt = np.zeros(along.shape[1]) if chunk.dt is None else chunk.dt
        warm = [
            model.by_temperature(theta, signal, dt)
            for model, theta, signal in zip(self._models, self._vectors, signals, strict=True)
        ]
        return table, table[derivatives.slopes] * (self._temperature * np.stack(warm))

    # ------------------------------------------------------------------------------------- from components to angles

    def _along(self, variances: Array, gradient: Sequence[Array | float]) -> Array:
        """Return the variance along a gradient over the outputs, shape (kinds, n)."""
        total, term = np.empty((2, len(variances), variances.shape[2]))
        target = total
        for (first, second), k in self._pairs.items():
            by_first, by_second = gradient[first], gradient[second]
            if _is_zero(by_first) or _is_zero(by_second):
                continue
            weight = by_first * by_second if first == second else (2.0 * by_first) * by_second
            np.multiply(weight, variances[:, k], out=target)
            if target is term:
                total += term
            target = term
        return total

    def _slope_of_hidden(self, own: Array, hidden: Array, variances: Array) -> Array:
        """Return what the error of half the square of a hidden g_z is divided by for its own."""
        along, _ = self._half(self._along(variances, [own[0], own[1], *([0.0, 0.0] if self._rotated else [])]))
        return _slope_of_root(hidden - self._coupling @ own, along)

    def _of_axis(self, axis: int, own: Array, slope: Array | None, variances: Array) -> Array:
        """Return the variance of one component of g in the application, shape (kinds, n)."""
        moved = self._rotated and not self._sees_all
        if slope is None:
            if not moved:
                return np.asarray(variances[:, self._pairs[axis, axis]])
            gradient: list[Array | float] = [float(axis == k) for k in range(2)]
        else:
            q, row = self._coupling, self._rotation[axis]
            share = (row[:2] @ q - row[2]) / slope
            gradient = [row[k] + share * own[k] for k in range(2)]
        if moved:
            gradient += [float(axis == k) for k in range(2)]
        return self._along(variances, gradient)

    def _half(self, parts: Array) -> tuple[Array, Array | float]:
        """Return the half width of the 95 % interval, and its coverage factor."""
        variance, factor = self._whole_variance(parts)
        return factor * np.sqrt(variance), factor

    def _whole_variance(self, parts: Array) -> tuple[Array, Array | float]:
        """Return the variance of all kinds together, and the coverage factor of its 95 % interval."""
        np.maximum(parts, 0.0, out=parts)
        if self._coverage is None:
            return parts[0], NORMAL_FACTOR
        return self._coverage.whole(parts[0], self._widened or parts[1], parts[-1])

    def _angles_of_three(self, gravity: Array, variances: Array, room: Array) -> None:
        """Fill in the angles of three axes: arctangents of one component and the length of the two others."""
        for alone, (first, second) in enumerate(((1, 2), (0, 2), (0, 1))):
            length = _length(gravity[first], gravity[second])
            cosine, sine = gravity[first] / length, gravity[second] / length
            nowhere = length == 0.0
            if nowhere.any():
                cosine[nowhere], sine[nowhere] = 1.0, 0.0
            gradient: list[Array | float] = [0.0, 0.0, 0.0]
            gradient[first], gradient[second] = -sine, cosine
            across, factor = self._half(self._along(variances, gradient))
            if alone == 0:
                _within_a_turn(across / length, factor, room[:, 3 + DIRECTIONS.index("roll")])
            size = length * length + gravity[alone] * gravity[alone]
            share = gravity[alone] / -size
            gradient[alone], gradient[first], gradient[second] = length / size, share * cosine, share * sine
            half, factor = self._half(self._along(variances, gradient))
            # The length of the two grows by an error across it, which near zero is as good as one along it.
            width = _length(half, (_length(length, across) - length) * share)
            # Within the circle that holds 95 % of the errors, the truth may as well be straight up or down.
            from_edge = length / np.abs(gravity[alone])
            within = from_edge <= CIRCLE * np.maximum(half, across / np.sqrt(size))
            np.copyto(width, np.maximum(width, from_edge), where=within)
            _within_a_turn(width, factor, room[:, alone])
        room[:, 3 + DIRECTIONS.index("pitch")], room[:, 3 + DIRECTIONS.index("inclination")] = room[:, 0], room[:, 2]


def _within_a_turn(half: Array, factor: Array | float, room: Array) -> None:
    """Fill in the standard and the expanded uncertainty of an angle from half of its interval, radians."""
    np.minimum(half, HALF_TURN, out=room[1])
    np.minimum(half / factor, UNKNOWN_ANGLE, out=room[0])


def _is_zero(component: Array | float) -> bool:
    return isinstance(component, float) and component == 0.0


def _slope_of_root(root: Array, half: Array) -> Array:
    """Return what the error of half a square is divided by for that of its root; all of its interval near zero."""
    size, square = np.abs(root), root * root
    low, high = np.sqrt(np.maximum(square - 2.0 * half, 0.0)), np.sqrt(square + 2.0 * half)
    slope = half / np.where(low > 0.0, size - low, high)
    return np.copysign(np.where(half > _EXACT * square, slope, size), root)


def _length(a: Array, b: Array) -> Array:
    """Compute the hypotenuse in half the time of ``hypot``: nothing here comes near an overflow."""
    return np.asarray(np.sqrt(a * a + b * b))


def _through_arcsine(argument: Array, variance: Array, factor: Array | float, width: Array) -> None:
    """Compute half the interval of an arcsine, radians, from its argument's variance; NaN where that is beyond ±1."""
    room = argument * argument
    np.subtract(1.0, room, out=room)
    half = np.max(factor) * sqrt(np.max(variance))
    all_straight = bool(half <= _CURVED * np.min(room))  # not with a NaN among them
    np.divide(variance, room if all_straight else np.maximum(room, 1e-300), out=width)
    np.sqrt(width, out=width)
    width *= factor
    if all_straight:
        return
    halves = factor * np.sqrt(variance)
    curved = np.flatnonzero(halves * np.abs(argument) > _CURVED * room)
    near, reach = argument[curved], halves[curved]
    middle, low, high = (np.arcsin(np.clip(near + side * reach, -1.0, 1.0)) for side in (0.0, -1.0, 1.0))
    widest = np.maximum(high - middle, middle - low)
    widest[widest == 0.0] = np.nan
    width[curved] = widest
