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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import cos, inf, radians, sin
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.attitude import heading_rotations, tangent_basis, turned
from tiltcal.core.estimation.positions import Indices, SensorObservations, require_sound
from tiltcal.core.model import Array, ChannelModel
from tiltcal.errors import EstimateError

Number = TypeVar("Number", np.float64, np.intp)

NOISE, ADC, JIG, TABLE, HEADING = "noise", "adc", "jig", "table", "heading"
REFERENCE = "reference"
THERMOMETER, HYSTERESIS, PRIOR, BASE = "thermometer", "hysteresis", "assumed", "base"  # where an uncertainty comes from

Bench = Mapping[str, float]
"""Standard uncertainties by source: JIG, TABLE, HEADING, radians; THERMOMETER, °C; NOISE, a factor of its variance;
REFERENCE 1, because the effects of its errors are those of one standard uncertainty."""

UNKNOWN_TABLE = radians(5.0)  # standard uncertainty of a lean that is not stated, radians: no table in use leans more
SAME_DIRECTION = 1e-6  # refuse two sensors whose directions for one position differ by more, g
_ROUNDED = 1e-9  # eigenvalue of a correlation below which it is what rounding leaves of zero

_PER_LEAN = np.array([[0.0, 1.0], [-1.0, 0.0]])


@dataclass(frozen=True)
class ChannelReadings:
    """The readings of one channel in n positions; every array has the shape (n,)."""

    sensor: int
    model: ChannelModel
    coefficients: slice  # among the unknowns
    orientation: Array  # of the sensor, shape (3, 3)
    places: Indices  # the position of each reading
    temperatures: Indices  # which temperature error each shares
    mean: Array
    u: Array
    adc: Array  # the part of rounding in u
    dof: Array  # of the rest
    dt: Array  # °C from the reference


@dataclass(frozen=True)
class Linearised:
    """The equations about some unknowns, over their uncertainty: the readings, what is stated, the bench's errors."""

    residual: Array  # shape (equations,)
    values: Array  # minus its derivatives by the few unknowns on which each equation depends, shape (equations, few)
    columns: Indices  # which these are, shape (equations, few)
    unknowns: int
    sigma: Array  # of each reading, shape (readings,), unit

    @cached_property
    def normal(self) -> Array:
        """Products of the derivatives, summed over the equations, shape (unknowns, unknowns)."""
        places, size = self.columns[:, :, None] * self.unknowns + self.columns[:, None, :], self.unknowns
        products = self.values[:, :, None] * self.values[:, None, :]
        return np.asarray(np.bincount(places.ravel(), products.ravel(), size * size).reshape(size, size), dtype=float)

    @cached_property
    def gradient(self) -> Array:
        """Products of derivatives and residuals, shape (unknowns,)."""
        products = self.values * self.residual[:, None]
        return np.asarray(np.bincount(self.columns.ravel(), products.ravel(), self.unknowns), dtype=float)

    def times(self, table: Array) -> Array:
        """Return the derivatives times a table, shape (unknowns, k) or (unknowns,): (equations, k) or (equations,)."""
        return np.asarray(np.einsum("ef,ef...->e...", self.values, table[self.columns]))

    def part(self, rows: slice | NDArray[np.bool_]) -> Linearised:
        """Return some of the equations."""
        return replace(self, residual=self.residual[rows], values=self.values[rows], columns=self.columns[rows])


class Equations:
    """All equations of a fixture; an EstimateError where positions are not sound, or two sensors disagree on one.

    The coefficients have their ``names`` sensor by sensor, ``prior_value`` and ``prior_u``, which is infinite where
    nothing is stated and 0 for one that is held. ``stated_values``, ``stated_columns`` and ``stated_target`` are all
    statements, over their uncertainty: factors of some coefficients, which, and the sums that result. ``gravity``,
    (places, 3), is as set in the fixture's frame, and can move along ``basis``, (places, 3, 2). ``exact``: a reading
    has no uncertainty that is known, and chi-square is no test. ``errors`` are the unknowns of the bench, by source.
    """

    def __init__(self, sensors: Sequence[SensorObservations]) -> None:
        require_sound(sensors)
        self.sensors = tuple(sensors)
        design = sensors[0].design
        self._place_positions()
        self._state_coefficients()
        self.exact = False
        self.channels = self._channels()
        self.u = np.concatenate([channel.u for channel in self.channels])
        self.basis = tangent_basis(self.gravity)
        self.table_stated = design.table_lean is not None
        several = len({round(heading % 360.0, 9) for heading in self.headings}) > 1
        leans = several if design.table_lean is None else design.table_lean > 0.0
        self._rotations = heading_rotations(np.radians(self.headings)) if leans else None
        self._shared = np.zeros((len(self.gravity), 2, 0))
        if design.instrument is not None:
            moves = design.instrument.moves(self.gravity, self.settings)
            self._shared = np.einsum("nji,njk->nik", self.basis, moves)
        warms = any(sensor.design.thermal for sensor in sensors) and design.thermometer != 0.0
        settings, temperatures = len(self.looser), 1 + max(int(c.temperatures.max()) for c in self.channels)
        self.errors: dict[str, slice] = {}
        start = len(self.names)
        for source, count in (
            (THERMOMETER, temperatures if warms else 0),
            (TABLE, 2 if leans else 0),
            (HEADING, settings if leans and design.heading else 0),
            (REFERENCE, self._shared.shape[2]),
            (JIG, 2 * settings),
        ):
            self.errors[source] = slice(start, start + count)
            start += count
        self.unknowns = start
        self.stated: Bench = {
            JIG: radians(design.jig or 0.0),
            TABLE: UNKNOWN_TABLE if design.table_lean is None else radians(design.table_lean),
            HEADING: radians(design.heading),
            THERMOMETER: design.thermometer or 0.0,
            NOISE: 1.0,
            REFERENCE: 1.0,
        }
        self.as_set: Bench = {**dict.fromkeys(self.stated, 0.0), NOISE: 1.0, TABLE: self.stated[TABLE]}
        self.noise_unknown = all(one.noise_unknown for sensor in sensors for one in sensor.observations)

    def rows(self, source: str) -> slice:
        """Return the equations of the errors of the bench, or of what is stated of the coefficients (PRIOR)."""
        readings, statements = len(self.u), len(self.stated_target)
        if source == PRIOR:
            return slice(readings, readings + statements)
        behind = readings + statements - len(self.names)
        return slice(self.errors[source].start + behind, self.errors[source].stop + behind)

    def sensor_coefficients(self) -> list[slice]:
        """Return the coefficients of each sensor among the unknowns."""
        ends = np.cumsum([0, *(len(sensor.design.names) for sensor in self.sensors)]).tolist()
        return [slice(start, stop) for start, stop in pairwise(ends)]

    def weights(self, bench: Bench) -> Array:
        """Return one over the standard uncertainty of each error of the bench, 0 for none, shape (unknowns,)."""
        weights = np.zeros(self.unknowns)
        for source, columns in self.errors.items():
            weights[columns] = 1.0 / bench[source] if bench[source] else 0.0
        weights[self.errors[JIG]] /= np.repeat(self.looser, 2)
        return weights

    def moving(self, bench: Bench) -> NDArray[np.bool_]:
        """Return which unknowns are not held, shape (unknowns,): an error without uncertainty is."""
        moving = self.weights(bench) > 0.0
        moving[: len(self.names)] = self.prior_u > 0.0
        return moving

    def at(self, z: Array, bench: Bench, shortened: Array | float = 0.0) -> Linearised:
        """Linearise about the unknowns; uncertain attitudes shorten gravity on average by a share, (settings,)."""
        shortened = np.full(len(self.looser), shortened)
        up, by_angle, by_heading = self._directions(z, shortened)
        warmer, heading = z[self.errors[THERMOMETER]], self.errors[HEADING]
        n, residuals, sigmas, values = len(self.names), [], [], []
        for channel in self.channels:
            places, settings = channel.places, self.settings[channel.places]
            dt = channel.dt + warmer[channel.temperatures] if len(warmer) else channel.dt
            reading = channel.model.read(z[channel.coefficients], up[places] @ channel.orientation.T, dt)
            by_gravity = reading.by_gravity @ channel.orientation
            residuals.append(channel.mean - reading.value)
            # The square of an angle shortens gravity, and scatters by as much as it does so on average.
            along = np.einsum("nj,nj->n", by_gravity, self.gravity[places]) * shortened[settings]
            sigmas.append(np.sqrt(bench[NOISE] * channel.u**2 + along**2))
            angle = np.einsum("nj,njk->nk", by_gravity, by_angle[places])
            terms = [reading.by_coefficient, angle]
            if len(warmer):
                terms.append(reading.by_temperature[:, None])
            if self._shared.shape[2]:
                terms.append(np.einsum("nj,njk->nk", angle, self._shared[places]))
            if by_heading is not None:
                rotations, per_heading = by_heading
                terms.append(np.einsum("nj,njk->nk", angle, rotations[places]))
                if heading.stop > heading.start:
                    terms.append(np.sum(angle * per_heading[places], axis=1)[:, None])
            values.append(np.hstack(terms))
        weights = self.weights(bench)
        missing = self.stated_target - np.sum(self.stated_values * z[self.stated_columns], axis=1)
        sigma = np.concatenate(sigmas)
        residual = np.concatenate([np.concatenate(residuals) / sigma, missing, -weights[n:] * z[n:]])
        table = _padded([*values, self.stated_values, weights[n:, None]])
        table[: len(sigma)] /= sigma[:, None]
        return Linearised(residual, table, self.columns, self.unknowns, sigma)

    @cached_property
    def columns(self) -> Indices:
        """The unknowns on which each equation depends, in the order of its derivatives, shape (equations, few)."""
        errors, tables = self.errors, []
        for channel in self.channels:
            settings = self.settings[channel.places][:, None]
            terms = [channel.coefficients, errors[JIG].start + 2 * settings + [0, 1]]
            if errors[THERMOMETER].stop > errors[THERMOMETER].start:
                terms.append(errors[THERMOMETER].start + channel.temperatures[:, None])
            terms += [errors[REFERENCE], errors[TABLE]]
            if errors[HEADING].stop > errors[HEADING].start:
                terms.append(errors[HEADING].start + settings)
            columns = [np.arange(term.start, term.stop) if isinstance(term, slice) else term for term in terms]
            tables.append(np.hstack([np.broadcast_to(some, (len(settings), some.shape[-1])) for some in columns]))
        return _padded([*tables, self.stated_columns, np.arange(len(self.names), self.unknowns)[:, None]])

    def unexplained(self, z: Array) -> Array:
        """Return measured minus modelled readings in the positions as set, shape (readings,), in the sensors' units.

        A lean of the table that the readings show is none of them.
        """
        as_set = z.copy()
        as_set[self.errors[JIG]] = as_set[self.errors[HEADING]] = 0.0
        up, _, _ = self._directions(as_set, np.zeros(len(self.looser)))
        return np.concatenate(
            [
                c.mean - c.model.read(z[c.coefficients], up[c.places] @ c.orientation.T, c.dt).value
                for c in self.channels
            ]
        )

    def _directions(self, z: Array, shortened: Array) -> tuple[Array, Array, tuple[Array, Array] | None]:
        """Return mean gravity and its derivative by the angles, and how these follow lean and heading at each place."""
        rotations, by_heading = self._rotations, None
        angles = z[self.errors[JIG]].reshape(-1, 2)[self.settings]
        angles = angles + self._shared[..., 1:] @ z[self.errors[REFERENCE]][1:]
        if rotations is not None:
            lean, headings = z[self.errors[TABLE]], z[self.errors[HEADING]]
            if len(headings):
                rotations = heading_rotations(headings[self.settings]) @ rotations
            angles = angles + rotations @ lean
            by_heading = rotations, (_PER_LEAN @ rotations) @ lean
        gravity, basis = self.gravity, self.basis
        if (design := self.sensors[0].design).instrument is not None:
            # Along an arc it would bend the plane, by more than a reference that repeats itself well leaves unseen.
            askew = z[self.errors[REFERENCE].start] * radians(design.instrument.alignment)
            turn = np.array([[cos(askew), -sin(askew), 0.0], [sin(askew), cos(askew), 0.0], [0.0, 0.0, 1.0]])
            gravity, basis = gravity @ turn.T, turn @ basis
        up, by_angle = turned(gravity, basis, angles)
        return up * (1.0 - shortened[self.settings, None]), by_angle, by_heading

    def _state_coefficients(self) -> None:
        """Collect what is stated of the coefficients; the estimate starts at what is stated last."""
        designs = [sensor.design for sensor in self.sensors]
        self.names = tuple(name for design in designs for name in design.names)
        priors = [design.priors.get(name) for design in designs for name in design.names]
        self.prior_value = np.array([prior.value if prior else 0.0 for prior in priors])
        self.prior_u = np.array([prior.u if prior else inf for prior in priors])
        assumed = np.flatnonzero((self.prior_u > 0.0) & (self.prior_u < inf))
        factors, columns = [1.0 / self.prior_u[assumed, None]], [assumed[:, None]]
        targets = [self.prior_value[assumed] / self.prior_u[assumed]]
        for design, own in zip(designs, self.sensor_coefficients(), strict=True):
            for rows, stated in design.stated:
                u = stated.u
                places = own.start + np.array([design.names.index(name) for name in stated.names], dtype=np.intp)
                self.prior_value[places], self.prior_u[places] = stated.value, u
                values, vectors = np.linalg.eigh(stated.covariance / np.outer(u, u))
                white = (vectors / np.sqrt(np.maximum(values, _ROUNDED))).T / u
                factors.append(white @ rows)
                columns.append(np.tile(np.arange(own.start, own.stop), (len(u), 1)))
                targets.append(white @ stated.value)
        self.stated_values, self.stated_columns = _padded(factors), _padded(columns)
        self.stated_target = np.concatenate(targets)

    def _place_positions(self) -> None:
        """Number the positions of all sensors by name, and the settings of the fixture."""
        self.places: dict[str, int] = {}
        self.headings: list[float] = []
        gravity, settings, looser = list[Array](), list[int](), list[float]()
        for sensor in self.sensors:
            back, setting = np.array(sensor.orientation, dtype=float).T, -1  # of the position before
            for one in sensor.observations:
                direction, heading = back @ one.gravity, one.heading or 0.0
                number = self.places.setdefault(one.position, len(gravity))
                if number == len(gravity):
                    if not one.held or setting < 0:
                        setting = len(looser)
                        looser.append(one.looser)
                    gravity.append(direction)
                    self.headings.append(heading)
                    settings.append(setting)
                elif np.max(np.abs(direction - gravity[number])) > SAME_DIRECTION or heading != self.headings[number]:
                    raise EstimateError(
                        f"position {one.position}: two sensors of the fixture name different directions for it; check "
                        "their axes"
                    )
                setting = settings[number]
        self.gravity, self.settings, self.looser = np.array(gravity), np.array(settings, np.intp), np.array(looser)

    def _channels(self) -> list[ChannelReadings]:
        channels, start = [], 0
        met: dict[tuple[str, float], int] = {}  # sensors that read the same temperature in a position share its error
        for number, sensor in enumerate(self.sensors):
            design, observations = sensor.design, sensor.observations
            places = np.array([self.places[one.position] for one in observations], dtype=np.intp)
            warmth = np.array([one.temperature or 0.0 for one in observations])
            errors = [met.setdefault((one.position, one.temperature or 0.0), len(met)) for one in observations]
            mean, u, adc, dof = np.empty((4, len(observations), len(design.channels)))
            for row, one in enumerate(observations):
                mean[row], u[row], adc[row], dof[row] = one.mean, one.u, one.adc, one.dof
            # Far below the others, and above the rounding of the arithmetic.
            size = np.maximum(np.ptp(mean, axis=0), 1e-6 * np.max(np.abs(mean), axis=0))
            least = 1e-9 * np.maximum(size, 1e-300)
            self.exact |= bool(np.any(u < least))
            u = np.maximum(u, least)
            if all(one.noise_unknown for one in observations):
                u = np.full(u.shape, u.max())
            for k, model in enumerate(design.models):
                channels.append(
                    ChannelReadings(
                        sensor=number,
                        model=model,
                        coefficients=slice(start, start + len(model.coefficients)),
                        orientation=np.array(sensor.orientation, dtype=float),
                        places=places,
                        temperatures=np.array(errors, dtype=np.intp),
                        mean=mean[:, k],
                        u=u[:, k],
                        adc=adc[:, k],
                        dof=dof[:, k],
                        dt=warmth - design.reference if design.thermal else np.zeros(len(warmth)),
                    )
                )
                start += len(model.coefficients)
        return channels


def _padded(tables: Sequence[NDArray[Number]]) -> NDArray[Number]:
    """Return tables of several widths in one, filled up with 0."""
    padded = np.zeros((sum(map(len, tables)), max(table.shape[1] for table in tables)), tables[0].dtype)
    start = 0
    for table in tables:
        padded[start : start + len(table), : table.shape[1]] = table
        start += len(table)
    return padded
