"""The linear equations of one fixture: every reading of every sensor, and what is stated of every unknown.

The unknowns are the coefficients of all channels and the errors of the bench: of each temperature, the lean of the
table, of each heading, and two attitude angles for each setting of the fixture. Each reading is one equation, and what
is stated of an unknown is another one::

    (u - model(coefficients, attitude, temperature)) / sigma_noise = 0
    (value - unknown) / standard uncertainty = 0

So it is generalised least squares on the covariance of noise and bench. An angle that the readings leave uncertain by
the variance q per axis shortens gravity on average by 1 - q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, radians

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.estimation.attitude import heading_rotations, tangent_basis, turned
from tiltcal.core.estimation.design import SensorObservations
from tiltcal.core.model import Array, ChannelModel
from tiltcal.errors import EstimateError

Indices = NDArray[np.intp]

NOISE, ADC, JIG, TABLE, HEADING = "noise", "adc", "jig", "table", "heading"
THERMOMETER, HYSTERESIS, PRIOR = "thermometer", "hysteresis", "assumed"
"""Where an uncertainty comes from."""

UNKNOWN_TABLE = radians(5.0)
"""Standard uncertainty of a lean that is not stated, radians: no table in use leans more."""

SAME_DIRECTION = 1e-6
"""Refuse two sensors whose directions for one position differ by more, g."""

_ROUNDED = 1e-9
"""Eigenvalue of a correlation below which it is what rounding leaves of zero."""

_PER_LEAN = np.array([[0.0, 1.0], [-1.0, 0.0]])


@dataclass(frozen=True)
class BenchErrors:
    """Standard uncertainties of the bench: jig and lean in radians, thermometer in °C; and the factor of the noise."""

    jig: float
    table: float
    heading: float
    thermometer: float
    noise: float = 1.0


@dataclass(frozen=True)
class ChannelReadings:
    """The readings of one channel of one sensor in n positions.

    Attributes
    ----------
    sensor : int
    coefficients : slice
        Its coefficients among the unknowns.
    places, settings : ndarray of int, shape (n,)
        The position of each reading, and the setting of the fixture there.
    temperatures : ndarray of int, shape (n,)
        Which temperature error each reading shares.
    mean, u, adc, dof, dt : ndarray, shape (n,)
        Reading, its standard uncertainty, the part of rounding, degrees of freedom of the rest; °C from the reference.
    """

    sensor: int
    model: ChannelModel
    coefficients: slice
    orientation: Array
    places: Indices
    settings: Indices
    temperatures: Indices
    mean: Array
    u: Array
    adc: Array
    dof: Array
    dt: Array


@dataclass(frozen=True)
class Linearised:
    """The equations about some unknowns: residuals over their uncertainty, and minus their derivatives.

    Attributes
    ----------
    values : ndarray, shape (readings, few)
        Derivatives of each reading by the few unknowns on which it depends.
    columns : ndarray of int, shape (readings, few)
        Which these are.
    unknowns : int
        How many there are.
    measured : ndarray, shape (readings,)
        The share of noise and rounding in the variance of each reading; the rest is the square of uncertain attitudes.
    """

    residual: Array
    values: Array
    columns: Indices
    unknowns: int
    measured: Array

    @cached_property
    def normal(self) -> Array:
        """Products of the derivatives by all unknowns, summed over the readings, shape (unknowns, unknowns)."""
        places = self.columns[:, :, None] * self.unknowns + self.columns[:, None, :]
        products = self.values[:, :, None] * self.values[:, None, :]
        size = self.unknowns
        return np.asarray(np.bincount(places.ravel(), products.ravel(), size * size).reshape(size, size), dtype=float)

    @cached_property
    def gradient(self) -> Array:
        """Products of derivatives and residuals, shape (unknowns,)."""
        products = self.values * self.residual[:, None]
        return np.asarray(np.bincount(self.columns.ravel(), products.ravel(), self.unknowns), dtype=float)

    def times(self, table: Array) -> Array:
        """Return the derivatives times a table, shape (unknowns, k) or (unknowns,): (readings, k) or (readings,)."""
        return np.asarray(np.einsum("rf,rf...->r...", self.values, table[self.columns]))


class Equations:
    """All equations of a fixture.

    Attributes
    ----------
    channels : list of ChannelReadings
        Sensor by sensor; the readings follow each other in this order.
    names : tuple of str
        Of the coefficients, sensor by sensor.
    gravity : ndarray, shape (places, 3)
        As set, in the fixture's frame.
    prior_value, prior_u : ndarray, shape (coefficients,)
        What is stated of each; infinite u for nothing, 0 for one that is held at its value.
    prior_rows, prior_target : ndarray, shape (statements, coefficients) and (statements,)
        All that is stated of them, over its uncertainty: ``prior_rows @ coefficients`` is ``prior_target``.
    exact : bool
        Whether a reading has no uncertainty that is known: chi-square is then no test.
    errors : mapping of str to slice
        The unknowns that are errors of the bench, by their source.

    Raises
    ------
    EstimateError
        Two sensors disagree on the direction or heading of a position.
    """

    def __init__(self, sensors: Sequence[SensorObservations]) -> None:
        self.sensors = tuple(sensors)
        design = sensors[0].design
        self._place_positions()
        thermal = any(sensor.design.thermal for sensor in sensors) and design.thermometer != 0.0
        self.names = tuple(name for sensor in sensors for name in sensor.design.names)
        priors = [sensor.design.priors.get(name) for sensor in sensors for name in sensor.design.names]
        self.prior_value = np.array([prior.value if prior else 0.0 for prior in priors])
        self.prior_u = np.array([prior.u if prior else inf for prior in priors])
        self.prior_rows, self.prior_target = self._statements()
        temperatures, count = self._number_temperatures()
        self.exact = False
        self.channels = self._channels(temperatures)
        self.table_stated = design.table is not None
        leans = design.table != 0.0 and (self.table_stated or len({round(h % 360.0, 9) for h in self.headings}) > 1)
        self._rotations = heading_rotations(np.radians(self.headings)) if leans else None
        settings = int(self.settings.max()) + 1
        self.errors: dict[str, slice] = {}
        start = len(self.names)
        for source, number in (
            (THERMOMETER, count if thermal else 0),
            (TABLE, 2 if leans else 0),
            (HEADING, settings if leans and design.heading else 0),
            (JIG, 2 * settings),
        ):
            self.errors[source] = slice(start, start + number)
            start += number
        self.unknowns = start
        self.stated = BenchErrors(
            radians(design.jig or 0.0),
            radians(design.table) if design.table is not None else UNKNOWN_TABLE,
            radians(design.heading),
            design.thermometer or 0.0,
        )
        self.noise_unknown = all(one.noise_unknown for sensor in sensors for one in sensor.observations)

    @cached_property
    def u(self) -> Array:
        """Standard uncertainty of each reading, shape (readings,)."""
        return np.concatenate([channel.u for channel in self.channels])

    @cached_property
    def basis(self) -> Array:
        """The directions in which gravity can move, shape (places, 3, 2)."""
        return tangent_basis(self.gravity)

    def start(self) -> Array:
        """Return every unknown at its prior value, shape (unknowns,)."""
        return np.concatenate([self.prior_value, np.zeros(self.unknowns - len(self.names))])

    def weights(self, errors: BenchErrors) -> Array:
        """Return one over the standard uncertainty of each error of the bench, 0 for none, shape (unknowns,)."""
        weights = np.zeros(self.unknowns)
        stated = {THERMOMETER: errors.thermometer, TABLE: errors.table, HEADING: errors.heading, JIG: errors.jig}
        for source, u in stated.items():
            weights[self.errors[source]] = 1.0 / u if u else 0.0
        weights[self.errors[JIG]] /= np.repeat(self.looser, 2)
        return weights

    def moving(self, errors: BenchErrors) -> NDArray[np.bool_]:
        """Return which unknowns are not held, shape (unknowns,): an error without uncertainty is."""
        moving = self.weights(errors) > 0.0
        moving[: len(self.names)] = self.prior_u > 0.0
        return moving

    def at(self, z: Array, errors: BenchErrors, shortened: Array) -> Linearised:
        """Linearise about the unknowns.

        ``shortened`` is by how much the attitude angles that are left uncertain shorten gravity on average, shape
        (settings,).
        """
        up, by_angle, rotations, by_heading = self._directions(z, shortened)
        warmer = z[self.errors[THERMOMETER]]
        residuals, values, columns, bent = [], [], [], []
        for channel in self.channels:
            own, places = channel.coefficients, channel.places
            dt = channel.dt + warmer[channel.temperatures] if len(warmer) else channel.dt
            reading = channel.model.read(z[own], up[places] @ channel.orientation.T, dt)
            residuals.append(channel.mean - reading.value)
            along = np.einsum("nj,nj->n", reading.by_gravity @ channel.orientation, self.gravity[places])
            bent.append(along * shortened[channel.settings])
            angle = np.einsum("i,ij,njk->nk", reading.sensitivity, channel.orientation, by_angle[places])
            angle *= reading.by_signal[:, None]
            value = [reading.by_coefficient, angle]
            column = [np.broadcast_to(np.arange(own.start, own.stop), reading.by_coefficient.shape)]
            column.append(self.errors[JIG].start + 2 * channel.settings[:, None] + [0, 1])
            if len(warmer):
                value.append(reading.by_temperature[:, None])
                column.append(self.errors[THERMOMETER].start + channel.temperatures[:, None])
            if rotations is not None:
                lean = self.errors[TABLE]
                value.append(np.einsum("nj,njk->nk", angle, rotations[places]))
                column.append(np.broadcast_to(np.arange(lean.start, lean.stop), (len(places), 2)))
            if by_heading is not None:
                value.append(np.sum(angle * by_heading[places], axis=1)[:, None])
                column.append(self.errors[HEADING].start + channel.settings[:, None])
            values.append(np.hstack(value))
            columns.append(np.hstack(column))
        # The square of an angle shortens gravity, and scatters by as much as it does so on average.
        sigma = np.sqrt(errors.noise * self.u**2 + np.concatenate(bent) ** 2)
        few = max(value.shape[1] for value in values)
        table, where = (
            np.concatenate([np.pad(part, ((0, 0), (0, few - part.shape[1]))) for part in parts])
            for parts in (values, columns)
        )
        measured = errors.noise * self.u**2 / sigma**2
        return Linearised(np.concatenate(residuals) / sigma, table / sigma[:, None], where, self.unknowns, measured)

    def unexplained(self, z: Array) -> Array:
        """Return measured minus modelled readings in the positions as set, shape (readings,), in the sensors' units."""
        return np.concatenate(
            [
                c.mean - c.model.read(z[c.coefficients], self.gravity[c.places] @ c.orientation.T, c.dt).value
                for c in self.channels
            ]
        )

    def _directions(self, z: Array, shortened: Array) -> tuple[Array, Array, Array | None, Array | None]:
        """Return mean gravity and its derivative by the angles, and how lean and heading turn each place."""
        rotations, headings = self._rotations, z[self.errors[HEADING]]
        angles = z[self.errors[JIG]].reshape(-1, 2)[self.settings]
        if rotations is not None:
            if len(headings):
                rotations = heading_rotations(headings[self.settings]) @ rotations
            angles = angles + rotations @ z[self.errors[TABLE]]
        up, by_angle = turned(self.gravity, self.basis, angles)
        up *= 1.0 - shortened[self.settings, None]
        if rotations is None or not len(headings):
            return up, by_angle, rotations, None
        return up, by_angle, rotations, (_PER_LEAN @ rotations) @ z[self.errors[TABLE]]

    def _statements(self) -> tuple[Array, Array]:
        """Return the rows and the target of what is stated; the estimate starts at what is stated last."""
        assumed = np.flatnonzero((self.prior_u > 0.0) & (self.prior_u < inf))
        rows = [np.eye(len(self.names))[assumed] / self.prior_u[assumed, None]]
        targets, start = [self.prior_value[assumed] / self.prior_u[assumed]], 0
        for sensor in self.sensors:
            stop = start + len(sensor.design.names)
            for stated in sensor.design.stated:
                u = np.sqrt(np.diag(stated.covariance))
                at = start + np.array([sensor.design.names.index(name) for name in stated.names], dtype=np.intp)
                self.prior_value[at], self.prior_u[at] = stated.values, u
                values, vectors = np.linalg.eigh(stated.covariance / np.outer(u, u))
                white = (vectors / np.sqrt(np.maximum(values, _ROUNDED))).T / u
                rows.append(np.zeros((len(u), len(self.names))))
                rows[-1][:, start:stop] = white @ stated.rows
                targets.append(white @ stated.values)
            start = stop
        return np.vstack(rows), np.concatenate(targets)

    def _place_positions(self) -> None:
        """Number the positions of all sensors by name, and the settings of the fixture."""
        self.places: dict[str, int] = {}
        gravity: list[Array] = []
        headings: list[float] = []
        settings: list[int] = []
        looser: dict[int, float] = {}
        for sensor in self.sensors:
            back = np.array(sensor.orientation, dtype=float).T
            before: int | None = None
            for one in sensor.observations:
                direction, heading = back @ one.gravity, one.heading or 0.0
                number = self.places.setdefault(one.position, len(gravity))
                if number == len(gravity):
                    gravity.append(direction)
                    headings.append(heading)
                    held = one.held and before is not None
                    settings.append(settings[before or 0] if held else max(settings, default=-1) + 1)
                    looser.setdefault(settings[-1], one.looser)
                elif np.max(np.abs(direction - gravity[number])) > SAME_DIRECTION or heading != headings[number]:
                    raise EstimateError(
                        f"position {one.position}: two sensors of the fixture name different directions for it; check "
                        "their axes"
                    )
                before = number
        self.gravity, self.headings = np.array(gravity), headings
        self.settings: Indices = np.array(settings, dtype=np.intp)
        self.looser = np.array([looser[setting] for setting in sorted(looser)])

    def _number_temperatures(self) -> tuple[list[Indices], int]:
        """Number the temperature errors; sensors that read the same temperatures have one thermometer."""
        thermometers: list[dict[str, tuple[float, int]]] = []
        numbers, count = [], 0
        for sensor in self.sensors:
            read = {one.position: one.temperature or 0.0 for one in sensor.observations}
            shared = next(
                (
                    known
                    for known in thermometers
                    if known.keys() & read.keys()
                    and all(known[name][0] == read[name] for name in known.keys() & read.keys())
                ),
                None,
            )
            if shared is None:
                shared = {}
                thermometers.append(shared)
            for name, temperature in read.items():
                if name not in shared:
                    shared[name] = (temperature, count)
                    count += 1
            numbers.append(np.array([shared[name][1] for name in read], dtype=np.intp))
        return numbers, count

    def _channels(self, temperatures: Sequence[Indices]) -> list[ChannelReadings]:
        channels, start = [], 0
        for number, sensor in enumerate(self.sensors):
            design, observations = sensor.design, sensor.observations
            places = np.array([self.places[one.position] for one in observations], dtype=np.intp)
            dt = np.array(
                [(one.temperature or 0.0) - design.reference if design.thermal else 0.0 for one in observations]
            )
            shape = (len(observations), len(design.channels))
            mean, u, adc, dof = (
                np.array([np.broadcast_to(getattr(one, name), shape[1]) for one in observations], dtype=float)
                for name in ("mean", "u", "adc", "dof")
            )
            # Far below the others, and above the rounding of the arithmetic.
            size = np.maximum(np.ptp(mean, axis=0), 1e-6 * np.max(np.abs(mean), axis=0))
            least = 1e-9 * np.maximum(size, 1e-300)
            self.exact |= bool(np.any(u < least))
            u = np.maximum(u, least)
            if all(one.noise_unknown for one in observations):
                u = np.full(shape, u.max())
            for k, model in enumerate(design.models):
                own = slice(start, start + len(model.coefficients))
                start = own.stop
                channels.append(
                    ChannelReadings(
                        number,
                        model,
                        own,
                        np.array(sensor.orientation, dtype=float),
                        places,
                        self.settings[places],
                        temperatures[number],
                        mean[:, k],
                        u[:, k],
                        adc[:, k],
                        dof[:, k],
                        dt,
                    )
                )
        return channels
