"""The assembly of the joint equations, from the observations of all sensors of a fixture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, groupby
from math import inf, radians

import numpy as np

from tiltcal.core.estimation.attitude import heading_rotations
from tiltcal.core.estimation.design import Observation, SensorObservations
from tiltcal.core.estimation.joint_equations import EquationBlock, Indices, System
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

UNKNOWN_TABLE = 5.0
"""Standard uncertainty of a lean that is not stated, degrees: no table in use leans more."""

SAME_DIRECTION = 1e-6
"""How far the directions that two sensors give for one position may differ, g."""

LARGEST_BLOCK = 8
"""Most sensors in a block: more of them need more memory at a time, and are hardly quicker."""


def system_of(sensors: Sequence[SensorObservations]) -> System:
    """Return the equations of the sensors of one fixture.

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
    places, gravity, headings, settings = _places(sensors)
    names = [sensor.design.names for sensor in sensors]
    priors = [sensor.design.priors.get(name) for sensor, own in zip(sensors, names, strict=True) for name in own]
    lean_unknown = design.table > 0 if design.table is not None else len({heading % 360.0 for heading in headings}) > 1
    temperatures, own, shared = _temperatures(sensors, places)
    return System(
        blocks=tuple(_blocks(sensors, places, temperatures, own)),
        orientations=np.array([sensor.orientation for sensor in sensors], dtype=float),
        gravity=gravity,
        settings=settings,
        lean_rotations=heading_rotations(np.radians(headings)) if lean_unknown else None,
        names=tuple(chain.from_iterable(names)),
        sensors=np.repeat(np.arange(len(sensors)), [len(name) for name in names]),
        prior_value=np.array([prior.value if prior else 0.0 for prior in priors]),
        prior_u=np.array([prior.u if prior else inf for prior in priors]),
        own_temperatures=own,
        shared_temperatures=shared,
        jig=radians(design.jig or 0.0),
        table=radians(UNKNOWN_TABLE if design.table is None else design.table),
        table_stated=design.table is not None,
        heading=radians(design.heading),
        thermometer=(design.thermometer or 0.0) if any(sensor.design.thermal for sensor in sensors) else 0.0,
        noise_unknown=all(observation.noise_unknown for sensor in sensors for observation in sensor.observations),
    )


def _places(sensors: Sequence[SensorObservations]) -> tuple[dict[str, int], Array, list[float], Indices]:
    """Return the positions of all sensors by name, their directions in the fixture's frame, headings and settings."""
    numbers: dict[str, int] = {}
    gravity: list[Array] = []
    headings: list[float] = []
    settings: list[int] = []
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
                another = max(settings, default=-1) + 1
                settings.append(settings[before] if observation.held and before is not None else another)
            elif np.max(np.abs(direction - gravity[number])) > SAME_DIRECTION or heading != headings[number]:
                raise EstimateError(
                    f"position {observation.position}: two sensors of the fixture name different directions for it; "
                    "check their axes"
                )
            before = number
    return numbers, np.array(gravity), headings, np.array(settings, dtype=np.intp)


def _temperatures(sensors: Sequence[SensorObservations], places: dict[str, int]) -> tuple[list[Indices], int, int]:
    """Number the temperature errors of all readings; count those of one sensor and those of several.

    Sensors that have the same temperature in all their common positions have one thermometer. The errors of a
    thermometer that one sensor alone has come first.
    """
    thermometers: list[dict[int, float]] = []
    users: list[list[int]] = []
    read: list[Indices] = []
    for number, sensor in enumerate(sensors):
        read_there = {
            places[observation.position]: observation.temperature or 0.0 for observation in sensor.observations
        }
        read.append(np.array(list(read_there), dtype=np.intp))
        for known, using in zip(thermometers, users, strict=True):
            common = known.keys() & read_there.keys()
            if common and all(known[place] == read_there[place] for place in common):
                known.update(read_there)
                using.append(number)
                break
        else:
            thermometers.append(dict(read_there))
            users.append([number])
    order = sorted(range(len(users)), key=lambda place: len(users[place]) > 1)
    numbers: dict[int, Indices] = {}
    counts = [0, 0]
    for place in order:
        at = {place: k + sum(counts) for k, place in enumerate(thermometers[place])}
        counts[len(users[place]) > 1] += len(at)
        numbers |= {
            user: np.array([at[place] for place in read[user].tolist()], dtype=np.intp) for user in users[place]
        }
    return [numbers[k] for k in range(len(sensors))], counts[0], counts[1]


def _blocks(
    sensors: Sequence[SensorObservations], places: dict[str, int], temperatures: Sequence[Indices], own: int
) -> Iterator[EquationBlock]:
    """Yield the sensors in their order, as many at a time as are alike."""
    starts = np.cumsum([0, *(len(sensor.design.names) for sensor in sensors)])
    kinds = [
        (
            sensor.design.models,
            sensor.design.thermal,
            sensor.design.reference,
            len(sensor.observations),
            int(errors[0]) < own,
        )
        for sensor, errors in zip(sensors, temperatures, strict=True)
    ]
    for (*_, own_thermometer), alike in groupby(range(len(sensors)), key=lambda number: kinds[number]):
        numbers = list(alike)
        for k in range(0, len(numbers), LARGEST_BLOCK):
            some = slice(numbers[k], numbers[k : k + LARGEST_BLOCK][-1] + 1)
            yield _block(sensors[some], some, starts, places, temperatures[some], own_thermometer)


def _block(
    group: Sequence[SensorObservations],
    numbers: slice,
    starts: Indices,
    places: dict[str, int],
    temperatures: Sequence[Indices],
    own_thermometer: bool,
) -> EquationBlock:
    """Return the readings of some sensors that are alike, whose coefficients begin at ``starts``."""
    design, n = group[0].design, len(group[0].observations)
    models, size = design.models, len(design.models[0].coefficients)
    observations = [observation for sensor in group for observation in sensor.observations]
    shape = (len(group), n)
    read_there = np.array([observation.temperature or 0.0 for observation in observations]).reshape(shape)
    mean = _table(group, lambda observation: observation.mean)
    u = _floored(_table(group, lambda observation: observation.u), mean)
    return EquationBlock(
        models=models,
        sensors=np.arange(numbers.start, numbers.stop),
        columns=starts[numbers, None, None] + np.arange(len(models) * size).reshape(len(models), size),
        places=np.array([places[observation.position] for observation in observations], dtype=np.intp).reshape(shape),
        mean=mean,
        u=_alike(u) if all(observation.noise_unknown for observation in observations) else u,
        adc=_table(group, lambda observation: observation.adc),
        dof=_table(group, lambda observation: observation.dof),
        dt=read_there - design.reference if design.thermal else np.zeros(shape),
        temperatures=np.array(temperatures),
        own_thermometer=own_thermometer,
    )


def _table(group: Sequence[SensorObservations], value: Callable[[Observation], Array | float]) -> Array:
    """Return a value of each reading, shape (sensors, channels, positions)."""
    rows = [[value(observation) for observation in sensor.observations] for sensor in group]
    if any(isinstance(number, float) for row in rows for number in row):  # one for all channels
        rows = [[np.broadcast_to(number, len(group[0].design.channels)) for number in row] for row in rows]
    return np.array(rows, dtype=float).swapaxes(1, 2)


def _alike(u: Array) -> Array:
    """Return the largest uncertainty of each sensor for all its readings."""
    return np.broadcast_to(u.max(axis=(1, 2), keepdims=True), u.shape)


def _floored(u: Array, mean: Array) -> Array:
    """Return uncertainties that are never zero: far below the others, and above rounding."""
    size = np.maximum(np.ptp(mean, axis=2), 1e-6 * np.max(np.abs(mean), axis=2))
    return np.asarray(np.maximum(u, 1e-9 * np.maximum(size, 1e-300)[..., None]))
