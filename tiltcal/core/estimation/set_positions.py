"""Grossly wrong positions, by the coefficients with every position as it was set.

A grossly wrong position is refused before its attitude becomes an unknown: an estimate that may turn it would fit it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np

from tiltcal.core.estimation.design import SensorObservations
from tiltcal.core.estimation.equations import BenchErrors, Equations
from tiltcal.core.estimation.identifiability import require_determined
from tiltcal.core.estimation.solve import start_as_set
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

BEYOND, SMALLEST_ERROR = 5.0, 2.0
"""A position is grossly wrong where it is off by more than so many stated jigs and noises, and by more degrees."""

LIKE_THE_REST = 0.2
"""Positions agree without one of them where the largest error falls to this share of what it was."""

LEAST_SENSITIVITY = 0.5
"""Sensitivities of which a singular value is less than this share of the nominal one follow from a wrong position."""


def require_positions(equations: Equations, z: Array, jig: float) -> None:
    """Refuse a position that is off by more than a stated jig, degrees, explains; ``z`` is the start as set.

    Raises
    ------
    EstimateError
        Names the position, or all among which it lies.
    """
    errors, limit = errors_as_set(equations, z), max(BEYOND * jig, SMALLEST_ERROR)
    if max(errors.values()) > limit:
        raise EstimateError(
            f"{wrong_position(equations, errors, limit)}: positions as they were set contradict the readings by up to "
            f"{max(errors.values()):.3g}°, where a jig of {jig:g}° is stated; see that it was the one that is "
            "named, and take it again"
        )


def wrong_position(equations: Equations, errors: dict[str, float], limit: float) -> str:
    """Return the position without which the errors of the others stay below a limit, degrees, in words.

    Where no single one is, these are all that are off by more.
    """
    named = [position for position in errors if _agree(equations.sensors, position, limit)]
    named = named or [position for position, off in errors.items() if off > limit]
    return f"{' or '.join(filter(None, (', '.join(named[:-1]), named[-1])))} is wrong"


def errors_as_set(equations: Equations, z: Array) -> dict[str, float]:
    """Return how far each position is off, degrees, by its readings near a start as set.

    Those of one setting are averaged, and those of one direction at several temperatures: what a reading changes with
    temperature is no error of a position.
    """
    sensors, row = equations.sensors, 0
    perfect, exact = BenchErrors(0.0, equations.stated.table, 0.0, 0.0), np.zeros(int(equations.settings.max()) + 1)
    residuals = equations.at(z, perfect, exact).residual * equations.u  # a lean that the start shows is no error
    sizes = _sizes(sensors, z)
    nominal = [sensor.design.nominal or own.max(initial=0.0) or inf for sensor, own in zip(sensors, sizes, strict=True)]
    groups = equations.settings
    if sensors[0].design.thermal:
        groups = np.unique(np.round(equations.gravity, 6), axis=0, return_inverse=True)[1].ravel()
    largest = np.zeros(int(groups.max()) + 1)
    for channel in equations.channels:
        group, own = groups[channel.places], residuals[row : row + len(channel.u)]
        row += len(own)
        count = np.maximum(np.bincount(group, minlength=len(largest)), 1)
        mean, noise = (np.abs(np.bincount(group, table, len(largest))) / count for table in (own, channel.u))
        np.maximum(largest, (mean - BEYOND * noise) / nominal[channel.sensor], out=largest)
    return dict(zip(equations.places, np.degrees(largest[groups]).tolist(), strict=True))


def _agree(sensors: Sequence[SensorObservations], without: str, limit: float) -> bool:
    """Return whether the positions without one of them agree, and give sensitivities that a sensor has."""
    kept = [
        replace(sensor, observations=[o for o in sensor.observations if o.position != without]) for sensor in sensors
    ]
    try:
        equations = Equations(kept)
        z = start_as_set(equations)
        require_determined(equations, z)
    except EstimateError:  # nothing checks what the others give
        return False
    for sensor, own in zip(kept, _sizes(kept, z), strict=True):
        nominal = sensor.design.nominal or own.max()
        if own.min() < LEAST_SENSITIVITY * nominal or own.max() > nominal / LEAST_SENSITIVITY:
            return False
    return max(errors_as_set(equations, z).values()) <= limit


def _sizes(sensors: Sequence[SensorObservations], z: Array) -> list[Array]:
    """Return the singular values of the sensitivities of each sensor, unit/g."""
    vectors = np.split(z, np.cumsum([len(sensor.design.names) for sensor in sensors]))
    found = []
    for sensor, vector in zip(sensors, vectors, strict=False):  # what follows are errors of the bench
        table = vector.reshape(len(sensor.design.channels), -1)
        found.append(np.asarray(np.linalg.svd(sensor.design.models[0].split(table)[0], compute_uv=False)))
    return found
