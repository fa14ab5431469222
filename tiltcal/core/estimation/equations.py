"""The joint system: every reading of every sensor on a fixture, every unknown, every prior, as one weighted residual.

The unknowns are the coefficients of all channels, two attitude angles for each stand of the fixture, the lean of the
table and the error of each temperature. The equations are the readings, and what the bench states of itself::

    0 = (u - model(coefficients, attitude, temperature)) / sigma_noise      one for each reading
    0 = -attitude / jig,  -lean / table,  -temperature error / thermometer  one for each of the bench's own errors
    0 = (value - coefficient) / u                                           one for each coefficient known before

A perfect jig has no attitude angles and least squares remains. A jig of which nothing is known has no equations for
them, and what remains is that gravity is a unit vector.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, radians

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.estimation.attitude import heading_rotations, tangent_basis, turned
from tiltcal.core.estimation.design import SensorObservations
from tiltcal.core.model import Array, ChannelModel
from tiltcal.errors import EstimateError

Indices = NDArray[np.intp]

UNKNOWN_TABLE = 5.0
"""Standard uncertainty of a lean of which nothing was said, degrees: no table that anyone works at leans more."""

SAME = 1e-6
"""How far two sensors' word on one position's direction may differ, g."""

NOISE, ADC, JIG, TABLE, HEADING = "noise", "adc", "jig", "table", "heading"
THERMOMETER, HYSTERESIS, PRIOR = "thermometer", "hysteresis", "assumed"
"""Where an uncertainty comes from."""


@dataclass(frozen=True)
class EquationBlock:
    """The readings of one channel.

    Attributes
    ----------
    model : ChannelModel
    sensor : int
    columns : slice
        Of its coefficients among the unknowns.
    places : ndarray of int, shape (n,)
        The position of each reading.
    mean, u, adc, dof, dt : ndarray, shape (n,)
        Reading, its standard uncertainty, the part that quantisation gives, degrees of freedom of the rest, and the
        temperature from the reference.
    temperatures : ndarray of int, shape (n,)
        Which of the temperature errors each reading shares.
    """

    model: ChannelModel
    sensor: int
    columns: slice
    places: Indices
    mean: Array
    u: Array
    adc: Array
    dof: Array
    dt: Array
    temperatures: Indices


@dataclass(frozen=True)
class Weighted:
    """The equations at one point, each divided by its standard uncertainty.

    Attributes
    ----------
    residual : ndarray, shape (equations,)
    jacobian : ndarray, shape (equations, unknowns)
        Of minus the residual.
    """

    residual: Array
    jacobian: Array


@dataclass(frozen=True)
class System:
    """All equations of a fixture.

    Attributes
    ----------
    blocks : tuple of EquationBlock
    orientations : ndarray, shape (sensors, 3, 3)
    gravity : ndarray, shape (places, 3)
        As set, in the fixture's frame.
    stands : ndarray of int, shape (places,)
        The attitude that each place has; places that were held on share one.
    lean_rotations : ndarray, shape (places, 2, 2), or None
        From the lean of the table to the attitude angles of each place; None where no lean is estimated.
    names : tuple of str
        Of the coefficients, sensor by sensor.
    sensors : ndarray of int, shape (coefficients,)
        Whose they are.
    prior_value, prior_u : ndarray, shape (coefficients,)
        What is known of them; infinite u for nothing.
    jig, table : float
        Radians; a jig of 0 has no attitude angles.
    table_stated : bool
        Whether ``table`` was said, and is no mere bound.
    heading : float
        Radians; 0 has no heading errors.
    thermometer : float
        °C; 0 has no temperature errors.
    """

    blocks: tuple[EquationBlock, ...]
    orientations: Array
    gravity: Array
    stands: Indices
    lean_rotations: Array | None
    names: tuple[str, ...]
    sensors: Indices
    prior_value: Array
    prior_u: Array
    jig: float
    table: float
    table_stated: bool
    heading: float
    thermometer: float

    @cached_property
    def basis(self) -> Array:
        """The directions in which gravity can move, shape (places, 3, 2)."""
        return tangent_basis(self.gravity)

    @property
    def coefficients(self) -> int:
        """How many coefficients there are."""
        return len(self.names)

    @cached_property
    def attitudes(self) -> slice:
        """Columns of the attitude angles."""
        count = 2 * (int(self.stands.max()) + 1) if self.jig > 0 else 0
        return slice(self.coefficients, self.coefficients + count)

    @cached_property
    def lean(self) -> slice:
        """Columns of the table's lean."""
        start = self.attitudes.stop
        return slice(start, start + (2 if self.lean_rotations is not None else 0))

    @cached_property
    def temperature_errors(self) -> slice:
        """Columns of the temperature errors."""
        start = self.lean.stop
        count = 1 + max(int(block.temperatures.max()) for block in self.blocks) if self.thermometer > 0 else 0
        return slice(start, start + count)

    @cached_property
    def heading_errors(self) -> slice:
        """Columns of the heading errors, one for each stand."""
        start = self.temperature_errors.stop
        count = int(self.stands.max()) + 1 if self.heading > 0 and self.lean_rotations is not None else 0
        return slice(start, start + count)

    @property
    def unknowns(self) -> int:
        """How many columns there are."""
        return int(self.heading_errors.stop)

    @cached_property
    def readings(self) -> int:
        """How many equations are readings; the others are priors."""
        return sum(len(block.mean) for block in self.blocks)

    @cached_property
    def sigma(self) -> Array:
        """Standard uncertainty of each reading, shape (readings,)."""
        return np.concatenate([block.u for block in self.blocks])

    @cached_property
    def fixed(self) -> NDArray[np.bool_]:
        """Which unknowns are held at their values, shape (unknowns,)."""
        held = np.zeros(self.unknowns, dtype=bool)
        held[: self.coefficients] = self.prior_u == 0.0
        return held

    @cached_property
    def sources(self) -> tuple[str, ...]:
        """Where the uncertainty of each equation comes from; a reading's is split between noise and ADC later."""
        return tuple(source for source, _, _ in self.priors)

    @cached_property
    def priors(self) -> tuple[tuple[str, int, float], ...]:
        """Source, unknown and standard uncertainty of each equation that is no reading."""
        known = [(PRIOR, column, float(u)) for column, u in enumerate(self.prior_u) if 0.0 < u < inf]
        for source, columns, u in (
            (JIG, self.attitudes, self.jig),
            (TABLE, self.lean, self.table),
            (THERMOMETER, self.temperature_errors, self.thermometer),
            (HEADING, self.heading_errors, self.heading),
        ):
            if u < inf:
                known += [(source, column, u) for column in range(columns.start, columns.stop)]
        return tuple(known)

    @cached_property
    def assumed(self) -> Indices:
        """Which coefficients something uncertain is known of, shape (assumed,)."""
        return np.flatnonzero((self.prior_u > 0.0) & np.isfinite(self.prior_u))

    def start(self) -> Array:
        """Every unknown at what is known of it, shape (unknowns,)."""
        z = np.zeros(self.unknowns)
        z[: self.coefficients] = self.prior_value
        return z

    def directions(self, z: Array) -> tuple[Array, Array]:
        """Gravity in every place in the fixture's frame, and its derivative by the place's two angles."""
        return turned(self.gravity, self.basis, self.angles(z))

    def angles(self, z: Array) -> Array:
        """Attitude error of every place, the table's lean included, shape (places, 2), radians."""
        angles = np.zeros((len(self.gravity), 2))
        if self.jig > 0:
            angles += z[self.attitudes].reshape(-1, 2)[self.stands]
        if self.lean_rotations is not None:
            angles += self._lean(z)[0] @ z[self.lean]
        return angles

    def _lean(self, z: Array) -> tuple[Array, Array]:
        """Matrices from the lean to each place's angles, and their derivatives by its heading, shape (places, 2, 2)."""
        rotations = np.zeros((0, 2, 2)) if self.lean_rotations is None else self.lean_rotations
        if self.heading_errors.stop > self.heading_errors.start:
            rotations = heading_rotations(z[self.heading_errors][self.stands]) @ rotations
        return rotations, np.array([[0.0, 1.0], [-1.0, 0.0]]) @ rotations

    def at(self, z: Array) -> Weighted:
        """The equations at a point."""
        direction, derivative = self.directions(z)
        rows = [self._block(block, z, direction, derivative) for block in self.blocks]
        residual = np.concatenate([value for value, _ in rows]) / self.sigma
        jacobian = np.concatenate([slopes for _, slopes in rows]) / self.sigma[:, None]
        known, slopes = self._known(z)
        return Weighted(np.concatenate([residual, known]), np.concatenate([jacobian, slopes]))

    def unexplained(self, z: Array) -> Array:
        """Measured minus modelled, shape (readings,), in the sensors' units."""
        direction, _ = self.directions(z)
        return np.concatenate([self._block(block, z, direction, None)[0] for block in self.blocks])

    def as_set(self, z: Array) -> Array:
        """The same coefficients with a perfect jig, table and thermometer."""
        perfect = z.copy()
        perfect[self.coefficients :] = 0.0
        return perfect

    def _block(self, block: EquationBlock, z: Array, direction: Array, derivative: Array | None) -> tuple[Array, Array]:
        """Residual of one channel's readings, and derivatives of what is modelled."""
        seen = self.orientations[block.sensor]
        dt = block.dt + z[self.temperature_errors][block.temperatures] if self.thermometer > 0 else block.dt
        reading = block.model.read(z[block.columns], direction[block.places] @ seen.T, dt)
        residual = block.mean - reading.value
        jacobian = np.zeros((len(residual), self.unknowns))
        if derivative is None:
            return residual, jacobian
        rows = np.arange(len(residual))
        jacobian[:, block.columns] = reading.by_coefficient
        by_angle = np.einsum("ni,nij->nj", reading.by_gravity @ seen, derivative[block.places])
        if self.jig > 0:
            for axis in (0, 1):
                jacobian[rows, self.attitudes.start + 2 * self.stands[block.places] + axis] = by_angle[:, axis]
        if self.lean_rotations is not None:
            rotations, slopes = (one[block.places] for one in self._lean(z))
            jacobian[:, self.lean] = np.einsum("ni,nij->nj", by_angle, rotations)
            if self.heading_errors.stop > self.heading_errors.start:
                by_heading = np.einsum("ni,nij,j->n", by_angle, slopes, z[self.lean])
                jacobian[rows, self.heading_errors.start + self.stands[block.places]] = by_heading
        if self.thermometer > 0:
            jacobian[rows, self.temperature_errors.start + block.temperatures] = reading.by_temperature
        return residual, jacobian

    def _known(self, z: Array) -> tuple[Array, Array]:
        """The equations that are no readings."""
        known = self.priors
        columns = np.array([column for _, column, _ in known], dtype=np.intp)
        u = np.array([u for _, _, u in known])
        centre = np.zeros(self.unknowns)
        centre[: self.coefficients] = self.prior_value
        jacobian = np.zeros((len(known), self.unknowns))
        jacobian[np.arange(len(known)), columns] = 1.0 / u
        return (centre - z)[columns] / u, jacobian

    def degrees_of_freedom(self, jacobian: Array) -> int:
        """How many equations are left over when each unknown has one; below zero where some have none.

        Parameters
        ----------
        jacobian : ndarray, shape (equations, unknowns)
        """
        moving = ~self.fixed
        left = len(jacobian) - int(np.sum(moving))
        if self.lean_rotations is None or self.table_stated:
            return left
        # The bound that keeps the lean finite judges nothing: it counts where no reading tells the lean.
        telling = np.array([True] * self.readings + [source != TABLE for source in self.sources])
        size = np.linalg.norm(jacobian, axis=0)
        rows = (jacobian / np.where(size > 0.0, size, 1.0))[np.ix_(telling, moving)]
        return len(rows) - int(np.linalg.matrix_rank(rows, tol=SAME))

    def unweighted(self) -> System:
        """The same equations with a perfect jig and thermometer, in which all positions count the same.

        What is known of a coefficient cannot be weighed against readings whose uncertainty is not: it is held.
        """
        blocks = tuple(replace(block, u=np.full_like(block.u, np.sqrt(np.mean(block.u**2)))) for block in self.blocks)
        held = np.where(np.isfinite(self.prior_u), 0.0, np.inf)
        return replace(self, blocks=blocks, prior_u=held, jig=0.0, thermometer=0.0, heading=0.0)


def system_of(sensors: Sequence[SensorObservations]) -> System:
    """The equations of the sensors of one fixture.

    Parameters
    ----------
    sensors : sequence of SensorObservations
        Sound ones, see :func:`tiltcal.core.estimation.design.require_sound`.

    Raises
    ------
    EstimateError
        Two sensors disagree on the direction or heading of a position.
    """
    design = sensors[0].design
    places, gravity, headings, stands = _places(sensors)
    names = [name for sensor in sensors for name in sensor.design.names]
    owners = [number for number, sensor in enumerate(sensors) for _ in sensor.design.names]
    priors = [sensor.design.priors.get(name) for sensor in sensors for name in sensor.design.names]
    leans = design.table > 0 if design.table is not None else len({heading % 360.0 for heading in headings}) > 1
    return System(
        blocks=tuple(_blocks(sensors, places)),
        orientations=np.array([sensor.orientation for sensor in sensors], dtype=float),
        gravity=gravity,
        stands=stands,
        lean_rotations=heading_rotations(np.radians(headings)) if leans and not design.free else None,
        names=tuple(names),
        sensors=np.array(owners, dtype=np.intp),
        prior_value=np.array([prior.value if prior else 0.0 for prior in priors]),
        prior_u=np.array([prior.u if prior else inf for prior in priors]),
        jig=radians(design.jig or 0.0),
        table=radians(UNKNOWN_TABLE if design.table is None else design.table),
        table_stated=design.table is not None,
        heading=radians(design.heading),
        thermometer=design.thermometer if any(sensor.design.thermal for sensor in sensors) else 0.0,
    )


def _places(sensors: Sequence[SensorObservations]) -> tuple[dict[str, int], Array, list[float], Indices]:
    """The positions of all sensors by name, their directions in the fixture's frame, headings and stands."""
    numbers: dict[str, int] = {}
    gravity: list[Array] = []
    headings: list[float] = []
    stands: list[int] = []
    for sensor in sensors:
        back = np.array(sensor.orientation, dtype=float).T
        before: int | None = None
        for observation in sensor.observations:
            direction = back @ observation.gravity
            heading = observation.heading or 0.0
            number = numbers.setdefault(observation.position, len(gravity))
            if number == len(gravity):
                gravity.append(direction)
                headings.append(heading)
                held = observation.held and before is not None
                stands.append(stands[before] if held and before is not None else max(stands, default=-1) + 1)
            elif np.max(np.abs(direction - gravity[number])) > SAME or heading != headings[number]:
                raise EstimateError(
                    f"position {observation.position}: two sensors of the fixture name different directions for it; "
                    "check their axes"
                )
            before = number
    return numbers, np.array(gravity), headings, np.array(stands, dtype=np.intp)


def _blocks(sensors: Sequence[SensorObservations], places: dict[str, int]) -> list[EquationBlock]:
    blocks: list[EquationBlock] = []
    column = 0
    known: dict[tuple[int, float], int] = {}
    for number, sensor in enumerate(sensors):
        design, observations = sensor.design, sensor.observations
        where = np.array([places[observation.position] for observation in observations], dtype=np.intp)
        told = [observation.temperature for observation in observations]
        # Sensors that were told the same temperature were told it by one thermometer, and share its error.
        temperatures = [known.setdefault((int(p), t or 0.0), len(known)) for p, t in zip(where, told, strict=True)]
        dt = np.array([t - design.reference if design.thermal and t is not None else 0.0 for t in told])
        for row, model in enumerate(design.models):
            size = len(model.coefficients)
            mean = np.array([observation.mean[row] for observation in observations])
            adc = [0.0 if observation.adc is None else observation.adc[row] for observation in observations]
            dof = [inf if observation.dof is None else observation.dof[row] for observation in observations]
            blocks.append(
                EquationBlock(
                    model=model,
                    sensor=number,
                    columns=slice(column, column + size),
                    places=where,
                    mean=mean,
                    u=_floored(np.array([observation.u[row] for observation in observations]), mean),
                    adc=np.array(adc),
                    dof=np.array(dof),
                    dt=dt,
                    temperatures=np.array(temperatures, dtype=np.intp),
                )
            )
            column += size
    return blocks


def _floored(u: Array, mean: Array) -> Array:
    """Uncertainties of readings that were given without any: far below the rest, and above rounding."""
    floor = 1e-9 * max(float(np.ptp(mean)), 1e-6 * float(np.max(np.abs(mean))), 1e-300)
    return np.maximum(u, floor)
