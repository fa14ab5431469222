"""The joint equations: every reading of every sensor on a fixture, every unknown and prior, as one weighted residual.

The unknowns are the coefficients of all channels, the error of each temperature, the lean of the table, the error of
each heading and two attitude angles for each setting of the fixture. The equations are the readings, and what the bench
states of itself::

    0 = (u - model(coefficients, attitude, temperature)) / sigma_noise      one for each reading
    0 = -attitude / jig,  -lean / table,  -temperature error / thermometer  one for each of the bench's own errors
    0 = (value - coefficient) / u                                           one for each coefficient known before

A perfect jig has no attitude angles and least squares remains. A jig of which nothing is known has no equations for
them, and what remains is that gravity is a unit vector.

A coefficient belongs to one channel, and the error of a thermometer that one sensor alone has belongs to that sensor.
The sensors meet in the other unknowns, which come last: each reading depends on a few of them. The Jacobian is kept in
these parts, and is never written out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.estimation.attitude import heading_rotations, tangent_basis, turned
from tiltcal.core.model import Array, ChannelModel, ModelReading

Indices = NDArray[np.intp]

NOISE, ADC, JIG, TABLE, HEADING = "noise", "adc", "jig", "table", "heading"
THERMOMETER, HYSTERESIS, PRIOR = "thermometer", "hysteresis", "assumed"
"""Where an uncertainty comes from."""

_PER_LEAN = np.array([[0.0, 1.0], [-1.0, 0.0]])


@dataclass(frozen=True)
class EquationBlock:
    """Readings of some sensors that are alike: S sensors with C channels of k coefficients in n positions.

    Attributes
    ----------
    models : tuple of ChannelModel
        One for each channel.
    sensors : ndarray of int, shape (S,)
    columns : ndarray of int, shape (S, C, k)
        Of the coefficients among the unknowns.
    places : ndarray of int, shape (S, n)
        The position of each reading.
    mean, u, adc, dof : ndarray, shape (S, C, n)
        Reading, its standard uncertainty, the part that quantisation gives, and degrees of freedom of the rest.
    dt : ndarray, shape (S, n)
        Temperature from the reference, °C.
    temperatures : ndarray of int, shape (S, n)
        Which of the temperature errors each reading shares.
    own_thermometer : bool
        Whether each sensor has its temperature errors for itself.
    """

    models: tuple[ChannelModel, ...]
    sensors: Indices
    columns: Indices
    places: Indices
    mean: Array
    u: Array
    adc: Array
    dof: Array
    dt: Array
    temperatures: Indices
    own_thermometer: bool

    def read(self, z: Array, gravity: Array, dt: Array) -> ModelReading:
        """Compute what the model expects, gravity of shape (S, n, 3) in each sensor's frame."""
        theta = z[self.columns]
        if not self.models[0].nonlinearity:
            return self.models[0].read(theta, gravity, dt)
        found = [
            [model.read(coefficients, up, temperature) for model, coefficients in zip(self.models, sensor, strict=True)]
            for sensor, up, temperature in zip(theta, gravity, dt, strict=True)
        ]
        fields = ("value", "by_coefficient", "by_signal", "by_temperature", "sensitivity")
        return ModelReading(
            *(np.array([[getattr(reading, name) for reading in sensor] for sensor in found]) for name in fields)
        )


@dataclass(frozen=True)
class LocalEquations:
    """Equations of one block at one point, each divided by its standard uncertainty, in B independent sets.

    A set is a channel, or a sensor that has a thermometer of its own. In every set the readings come first, then an
    equation for each local unknown: what is known of it, that it is held, or nothing.

    Attributes
    ----------
    unknowns : ndarray of int, shape (B, local)
    residual : ndarray, shape (B, rows)
    jacobian : ndarray, shape (B, rows, local)
        Of minus the residual, by the local unknowns.
    shared : ndarray, shape (B, readings, few)
        The same by the shared unknowns on which each reading depends.
    columns : ndarray of int, shape (B, readings, few)
        Which of the shared unknowns these are.
    held : ndarray of bool, shape (B, local)
    """

    unknowns: Indices
    residual: Array
    jacobian: Array
    shared: Array
    columns: Indices
    held: NDArray[np.bool_]

    @property
    def readings(self) -> int:
        """Number of equations of a set that are readings."""
        return int(self.shared.shape[1])


@dataclass(frozen=True)
class Equations:
    """Equations of all sensors, linearised at one point.

    Attributes
    ----------
    columns : ndarray of int, shape (priors,)
        The shared unknown of each equation that is no reading; those of the attitudes come last.
    weight, residual : ndarray, shape (priors,)
        One over the standard uncertainty, and the residual in its units.
    """

    blocks: tuple[LocalEquations, ...]
    columns: Indices
    weight: Array
    residual: Array

    @cached_property
    def cost(self) -> float:
        """The sum of squares of all residuals."""
        return sum(
            float(np.vdot(residual, residual))
            for residual in (self.residual, *(block.residual for block in self.blocks))
        )


@dataclass(frozen=True)
class System:
    """All equations of a fixture.

    Attributes
    ----------
    blocks : tuple of EquationBlock
        In the order of the sensors.
    orientations : ndarray, shape (sensors, 3, 3)
    gravity : ndarray, shape (places, 3)
        As set, in the fixture's frame.
    settings : ndarray of int, shape (places,)
        The attitude that each place has; places that were held on share one.
    lean_rotations : ndarray, shape (places, 2, 2), or None
        From the lean of the table to the attitude angles of each place; None where no lean is estimated.
    names : tuple of str
        Of the coefficients, sensor by sensor.
    sensors : ndarray of int, shape (coefficients,)
        Whose they are.
    prior_value, prior_u : ndarray, shape (coefficients,)
        What is known of them; infinite u for nothing, 0 for one that is held at its value.
    own_temperatures, shared_temperatures : int
        How many temperature errors belong to one sensor, and to several.
    jig, table : float
        Radians; a jig of 0 has no attitude angles.
    table_stated : bool
        Whether ``table`` is stated, and no mere bound.
    heading : float
        Radians; 0 has no heading errors.
    thermometer : float
        °C; 0 has no temperature errors.
    noise_unknown : bool
        Whether nothing but the rounding of the readings is known of their noise.
    """

    blocks: tuple[EquationBlock, ...]
    orientations: Array
    gravity: Array
    settings: Indices
    lean_rotations: Array | None
    names: tuple[str, ...]
    sensors: Indices
    prior_value: Array
    prior_u: Array
    own_temperatures: int
    shared_temperatures: int
    jig: float
    table: float
    table_stated: bool
    heading: float
    thermometer: float
    noise_unknown: bool = False

    @cached_property
    def basis(self) -> Array:
        """The directions in which gravity can move, shape (places, 3, 2)."""
        return tangent_basis(self.gravity)

    @property
    def coefficients(self) -> int:
        """Number of coefficients."""
        return len(self.names)

    @cached_property
    def temperature_errors(self) -> slice:
        """Unknowns that are errors of a temperature, those of a single sensor first."""
        count = self.own_temperatures + self.shared_temperatures if self.thermometer > 0 else 0
        return slice(self.coefficients, self.coefficients + count)

    @cached_property
    def local(self) -> int:
        """Number of unknowns that belong to one sensor; the others are shared."""
        return self.coefficients + (self.own_temperatures if self.thermometer > 0 else 0)

    @cached_property
    def lean(self) -> slice:
        """Unknowns that are the table's lean."""
        start = self.temperature_errors.stop
        return slice(start, start + (2 if self.lean_rotations is not None else 0))

    @cached_property
    def heading_errors(self) -> slice:
        """Unknowns that are heading errors, one for each setting."""
        count = int(self.settings.max()) + 1 if self.heading > 0 and self.lean_rotations is not None else 0
        return slice(self.lean.stop, self.lean.stop + count)

    @cached_property
    def attitudes(self) -> slice:
        """Unknowns that are attitude angles."""
        count = 2 * (int(self.settings.max()) + 1) if self.jig > 0 else 0
        return slice(self.heading_errors.stop, self.heading_errors.stop + count)

    @cached_property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return int(self.attitudes.stop)

    @cached_property
    def readings(self) -> int:
        """Number of equations that are readings; the others are priors."""
        return sum(block.mean.size for block in self.blocks)

    @cached_property
    def sigma(self) -> Array:
        """Standard uncertainty of each reading, shape (readings,)."""
        return np.concatenate([block.u.ravel() for block in self.blocks])

    @cached_property
    def reach(self) -> float:
        """The largest reading in units of its uncertainty."""
        return max(float(np.max(np.abs(block.mean) / block.u)) for block in self.blocks)

    @cached_property
    def fixed(self) -> NDArray[np.bool_]:
        """Which coefficients are held at their values, shape (coefficients,)."""
        return np.asarray(self.prior_u == 0.0)

    @cached_property
    def assumed(self) -> NDArray[np.bool_]:
        """Which coefficients have a prior with an uncertainty, shape (coefficients,)."""
        return np.asarray((self.prior_u > 0.0) & np.isfinite(self.prior_u))

    @cached_property
    def shared_priors(self) -> tuple[tuple[str, slice, float], ...]:
        """Source, unknowns and standard uncertainty of what is known of the shared unknowns, the attitudes last."""
        temperature = slice(self.local, self.temperature_errors.stop)
        known = (
            (THERMOMETER, temperature, self.thermometer),
            (TABLE, self.lean, self.table),
            (HEADING, self.heading_errors, self.heading),
            (JIG, self.attitudes, self.jig),
        )
        return tuple((source, columns, u) for source, columns, u in known if u < inf and columns.stop > columns.start)

    @property
    def priors(self) -> int:
        """Number of equations that are no readings."""
        own = self.local - self.coefficients
        return int(self.assumed.sum() + own + sum(prior.stop - prior.start for _, prior, _ in self.shared_priors))

    def start(self) -> Array:
        """Return every unknown at its prior value, shape (unknowns,)."""
        z = np.zeros(self.unknowns)
        z[: self.coefficients] = self.prior_value
        return z

    def directions(self, z: Array) -> tuple[Array, Array]:
        """Return gravity in every place in the fixture's frame, and its derivative by the place's two angles."""
        if not self.jig and self.lean_rotations is None:
            return self.gravity, self.basis
        return turned(self.gravity, self.basis, self.angles(z))

    def angles(self, z: Array) -> Array:
        """Return the attitude error of every place, the table's lean included, shape (places, 2), radians."""
        angles = np.zeros((len(self.gravity), 2))
        if self.jig > 0:
            angles += z[self.attitudes].reshape(-1, 2)[self.settings]
        if self.lean_rotations is not None:
            angles += self._lean(z)[0] @ z[self.lean]
        return angles

    def _lean(self, z: Array) -> tuple[Array, Array]:
        """Return the matrices from lean to angles in each place, and derivatives by heading, shape (places, 2, 2)."""
        rotations = np.zeros((0, 2, 2)) if self.lean_rotations is None else self.lean_rotations
        if self.heading_errors.stop > self.heading_errors.start:
            rotations = heading_rotations(z[self.heading_errors][self.settings]) @ rotations
        return rotations, _PER_LEAN @ rotations

    def at(self, z: Array) -> Equations:
        """Linearise the equations at a point."""
        direction, derivative = self.directions(z)
        blocks = tuple(self._block(number, z, direction, derivative) for number in range(len(self.blocks)))
        columns, weight = self._shared_known
        return Equations(blocks, columns - self.local, weight, -z[columns] * weight)

    def unexplained(self, z: Array) -> Array:
        """Return measured minus modelled readings, shape (readings,), in the sensors' units."""
        direction, _ = self.directions(z)
        return np.concatenate([(block.mean - self.reading(block, z, direction).value).ravel() for block in self.blocks])

    def reading(self, block: EquationBlock, z: Array, direction: Array) -> ModelReading:
        """Return what a block's sensors read for directions of gravity in the fixture's frame, shape (places, 3)."""
        dt = block.dt + z[self.temperature_errors][block.temperatures] if self.thermometer > 0 else block.dt
        return block.read(z, self.seen(block, direction), dt)

    def seen(self, block: EquationBlock, direction: Array) -> Array:
        """Return directions in the frames of a block's sensors, shape (S, n, 3)."""
        return np.asarray(direction[block.places] @ np.swapaxes(self.orientations[block.sensors], 1, 2))

    def as_set(self, z: Array) -> Array:
        """Return the same coefficients with a perfect jig, table and thermometer."""
        perfect = np.zeros(self.unknowns)
        perfect[: self.coefficients] = z[: self.coefficients]
        return perfect

    def channels(self) -> Iterator[tuple[EquationBlock, int, int]]:
        """Yield each channel: its block, the sensor there, and the channel of that sensor."""
        for block in self.blocks:
            for sensor in range(len(block.sensors)):
                for channel in range(len(block.models)):
                    yield block, sensor, channel

    @cached_property
    def _shared_known(self) -> tuple[Indices, Array]:
        """Shared unknown of each equation that is no reading, and its weight."""
        columns = [np.arange(prior.start, prior.stop) for _, prior, _ in self.shared_priors]
        weight = [np.full(prior.stop - prior.start, 1.0 / u) for _, prior, u in self.shared_priors]
        return np.concatenate([np.zeros(0, dtype=np.intp), *columns]), np.concatenate([np.zeros(0), *weight])

    @cached_property
    def _shared_columns(self) -> tuple[Indices, ...]:
        """Shared unknowns of each reading of each block, shape (S, C, n, few)."""
        found = []
        for block in self.blocks:
            shape = (*block.places.shape, 1)
            settings = self.settings[block.places][..., None]
            parts = []
            if self.thermometer > 0 and not block.own_thermometer:
                parts.append(self.temperature_errors.start + block.temperatures[..., None])
            if self.lean_rotations is not None:
                parts.append(np.broadcast_to(np.arange(self.lean.start, self.lean.stop), (*shape[:2], 2)))
                if self.heading_errors.stop > self.heading_errors.start:
                    parts.append(self.heading_errors.start + settings)
            if self.jig > 0:
                parts.append(self.attitudes.start + 2 * settings + np.arange(2))
            columns = np.concatenate(parts, axis=2) if parts else np.zeros((*shape[:2], 0), dtype=np.intp)
            few = columns.shape[2]
            found.append(np.broadcast_to(columns[:, None], (*block.mean.shape, few)) - self.local)
        return tuple(found)

    @cached_property
    def _local_known(self) -> tuple[tuple[Indices, Array, Array, NDArray[np.bool_]], ...]:
        """Local unknowns of each set of each block: numbers, prior values, weights, and which are held."""
        found = []
        for block in self.blocks:
            sets = (
                len(block.sensors)
                if self._has_temperature_errors(block)
                else block.columns.shape[0] * block.columns.shape[1]
            )
            unknowns = block.columns.reshape(sets, -1)
            value, u = self.prior_value[unknowns], self.prior_u[unknowns]
            if self._has_temperature_errors(block):
                errors = self.temperature_errors.start + block.temperatures
                unknowns = np.concatenate([unknowns, errors], axis=1)
                value = np.concatenate([value, np.zeros(errors.shape)], axis=1)
                u = np.concatenate([u, np.full(errors.shape, self.thermometer)], axis=1)
            held = u == 0.0
            weight = np.where(held, 1.0, 1.0 / np.where(held, 1.0, u))
            found.append((unknowns, value, weight, held))
        return tuple(found)

    def _has_temperature_errors(self, block: EquationBlock) -> bool:
        """Return whether temperature errors are among the local unknowns of a block."""
        return self.thermometer > 0 and block.own_thermometer

    def _block(self, number: int, z: Array, direction: Array, derivative: Array) -> LocalEquations:
        """Linearise the equations of one block."""
        block = self.blocks[number]
        reading = self.reading(block, z, direction)
        parts = []
        if self.thermometer > 0 and not block.own_thermometer:
            parts.append(reading.by_temperature[..., None])
        if self.jig > 0 or self.lean_rotations is not None:
            turns = self.orientations[block.sensors][:, None] @ derivative[block.places]
            by_angle = reading.by_signal[..., None] * (reading.sensitivity[:, None] @ turns).swapaxes(1, 2)
            if self.lean_rotations is not None:
                rotations, slopes = (by_user[block.places] for by_user in self._lean(z))
                parts.append((by_angle[..., None, :] @ rotations[:, None])[..., 0, :])
                if self.heading_errors.stop > self.heading_errors.start:
                    parts.append(np.sum(by_angle * (slopes @ z[self.lean])[:, None], axis=3, keepdims=True))
            if self.jig > 0:
                parts.append(by_angle)
        shared = (
            np.concatenate(parts, axis=3) if len(parts) > 1 else parts[0] if parts else np.zeros((*block.u.shape, 0))
        )
        unknowns, value, weight, held = self._local_known[number]
        sets, local = unknowns.shape
        readings = block.u.size // sets
        residual = np.empty((sets, readings + local))
        residual[:, :readings] = ((block.mean - reading.value) / block.u).reshape(sets, readings)
        residual[:, readings:] = np.where(held, 0.0, (value - z[unknowns]) * weight)
        jacobian = np.zeros((sets, readings + local, local))
        by_coefficient = reading.by_coefficient / block.u[..., None]
        if self._has_temperature_errors(block):
            channels, n, k = by_coefficient.shape[1:]
            for channel in range(channels):
                rows, columns = slice(channel * n, channel * n + n), slice(channel * k, channel * k + k)
                jacobian[:, rows, columns] = by_coefficient[:, channel]
                jacobian[:, channel * n + np.arange(n), channels * k + np.arange(n)] = (
                    reading.by_temperature / block.u
                )[:, channel]
        else:
            jacobian[:, :readings] = by_coefficient.reshape(sets, readings, local)
        jacobian[:, :readings] *= ~held[:, None]
        jacobian[:, readings + np.arange(local), np.arange(local)] = weight
        shape = (sets, readings, shared.shape[3])
        shared = (shared / block.u[..., None]).reshape(shape)
        return LocalEquations(unknowns, residual, jacobian, shared, self._shared_columns[number].reshape(shape), held)

    def degrees_of_freedom(self, undetermined: int) -> int:
        """Return equations minus unknowns; ``undetermined`` counts the directions of the lean that no reading shows."""
        left = self.readings + self.priors - (self.unknowns - int(self.fixed.sum()))
        if self.lean_rotations is None or self.table_stated:
            return left
        # The bound that keeps the lean finite judges nothing: it counts where no reading shows the lean.
        return left - 2 + undetermined

    def holding(self, held: NDArray[np.bool_]) -> System:
        """Return the same equations with some coefficients held where they are."""
        return replace(self, prior_u=np.where(held, 0.0, self.prior_u))

    def as_if_perfect(self) -> System:
        """Return the same equations with a perfect jig and thermometer."""
        return replace(self, jig=0.0, thermometer=0.0, heading=0.0)

    def unweighted(self) -> System:
        """Return the same equations with a perfect jig and thermometer, and one weight for all positions.

        What is known of a coefficient cannot be weighed against readings whose uncertainty is not: it is held.
        """
        blocks = tuple(
            replace(block, u=np.broadcast_to(np.sqrt(np.mean(block.u**2, axis=2, keepdims=True)), block.u.shape))
            for block in self.blocks
        )
        held = np.where(np.isfinite(self.prior_u), 0.0, np.inf)
        return replace(self.as_if_perfect(), blocks=blocks, prior_u=held)
