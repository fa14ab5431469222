"""The coefficients with every position as it was set: the start of each estimate, and what shows a wrong position.

A grossly wrong position is refused before its attitude becomes an unknown: an estimate that may turn it would fit it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np

from tiltcal.core.estimation.design import SensorObservations
from tiltcal.core.estimation.equation_assembly import system_of
from tiltcal.core.estimation.gauss_newton import minimise
from tiltcal.core.estimation.identifiability import require_determined
from tiltcal.core.estimation.joint_equations import System
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

BEYOND, SMALLEST_ERROR = 5.0, 2.0
"""A position is grossly wrong where it is off by more than so many stated jigs and noises, and by more degrees."""

LIKE_THE_REST = 0.2
"""Positions agree without one of them where the largest error falls to this share of what it was."""

LEAST_SENSITIVITY = 0.5
"""Sensitivities of which a singular value is less than this share of the nominal one follow from a wrong position."""


def start_as_set(system: System) -> Array:
    """Return the coefficients with the attitudes as set: the result for a perfect jig, the start for any other."""
    set_right = system.as_if_perfect()
    free = set_right.holding(set_right.assumed)
    z = set_right.start()
    # Gain and nonlinearity have no effect before a sensitivity is known: they join in the second round.
    insensitive = free.assumed.copy()
    for block in free.at(z).blocks:
        insensitive[block.unknowns] = ~np.any(block.jacobian[:, : block.readings], axis=1)
    z = minimise(free.holding(insensitive), z)
    require_determined(set_right, z)
    return minimise(free, z) if insensitive.any() else z


def require_positions(sensors: Sequence[SensorObservations], system: System, z: Array, jig: float) -> None:
    """Refuse a position that is off by more than a stated jig, degrees, explains; ``z`` is the start as set.

    Raises
    ------
    EstimateError
        Names the position, or all among which it lies.
    """
    errors, limit = errors_as_set(sensors, system, z), max(BEYOND * jig, SMALLEST_ERROR)
    if max(errors.values()) > limit:
        raise EstimateError(
            f"{wrong_position(sensors, errors, limit)}: positions as they were set contradict the readings by up to "
            f"{max(errors.values()):.3g}°, where a jig of {jig:g}° is stated; see that it was the one that is "
            "named, and take it again"
        )


def wrong_position(sensors: Sequence[SensorObservations], errors: dict[str, float], limit: float) -> str:
    """Return the position without which the errors of the others stay below a limit, degrees, in words.

    Where no single one is, these are all that are off by more.
    """
    named = [position for position in errors if _agree(sensors, position, limit)]
    named = named or [position for position, off in errors.items() if off > limit]
    return f"{' or '.join(filter(None, (', '.join(named[:-1]), named[-1])))} is wrong"


def errors_as_set(sensors: Sequence[SensorObservations], system: System, z: Array) -> dict[str, float]:
    """Return how far each position is off, degrees, by its readings near a start as set.

    Those of one setting are averaged, and those of one direction at several temperatures: what a reading changes with
    temperature is no error of a position.
    """
    residual, row = system.as_if_perfect().unexplained(z), 0
    sizes = _sizes(sensors, z)
    nominal = [sensor.design.nominal or own.max(initial=0.0) or inf for sensor, own in zip(sensors, sizes, strict=True)]
    groups = system.settings
    if sensors[0].design.thermal:
        groups = np.unique(np.round(system.gravity, 6), axis=0, return_inverse=True)[1].ravel()
    largest = np.zeros(int(groups.max()) + 1)
    for block, sensor, channel in system.channels():
        group = groups[block.places[sensor]]
        own, u = residual[row : row + len(group)], block.u[sensor, channel]
        row += len(group)
        count = np.maximum(np.bincount(group, minlength=len(largest)), 1)
        mean, noise = (np.abs(np.bincount(group, table, len(largest))) / count for table in (own, u))
        np.maximum(largest, (mean - BEYOND * noise) / nominal[int(block.sensors[sensor])], out=largest)
    names = list(dict.fromkeys(o.position for sensor in sensors for o in sensor.observations))
    return dict(zip(names, np.degrees(largest[groups]).tolist(), strict=True))


def _agree(sensors: Sequence[SensorObservations], without: str, limit: float) -> bool:
    """Return whether the positions without one of them agree, and give sensitivities that a sensor has."""
    kept = [
        replace(sensor, observations=[o for o in sensor.observations if o.position != without]) for sensor in sensors
    ]
    try:
        system = system_of(kept)
        z = start_as_set(system)
    except EstimateError:  # nothing checks what the others give
        return False
    for sensor, own in zip(kept, _sizes(kept, z), strict=True):
        nominal = sensor.design.nominal or own.max()
        if own.min() < LEAST_SENSITIVITY * nominal or own.max() > nominal / LEAST_SENSITIVITY:
            return False
    return max(errors_as_set(kept, system, z).values()) <= limit


def _sizes(sensors: Sequence[SensorObservations], z: Array) -> list[Array]:
    """Return the singular values of the sensitivities of each sensor, unit/g."""
    vectors = np.split(z, np.cumsum([len(sensor.design.names) for sensor in sensors]))
    found = []
    for sensor, vector in zip(sensors, vectors, strict=False):  # what follows are errors of the bench
        table = vector.reshape(len(sensor.design.channels), -1)
        found.append(np.asarray(np.linalg.svd(sensor.design.models[0].split(table)[0], compute_uv=False)))
    return found
