"""The one estimator: from positions to coefficients, jointly over all sensors and channels of a fixture.

Generalised least squares on the covariance of noise and bench serves every bench
(:mod:`tiltcal.core.estimation.equations`). At most one variance is estimated from the residuals, the first that is not
stated: that of the noise, of the jig, of the thermometer (:mod:`tiltcal.core.estimation.solve`). A grossly wrong
position is refused before its attitude becomes an unknown: an estimate that may turn it would fit it. Attitudes that
nobody set have a fit of their own (:mod:`tiltcal.core.estimation.free`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import degrees, hypot, inf, radians, sqrt
from typing import Any

import numpy as np

from tiltcal.core.angle_readings import DEGREES
from tiltcal.core.estimation.design import listed, require_determined
from tiltcal.core.estimation.equations import HYSTERESIS, JIG, NOISE, TABLE, THERMOMETER, Equations
from tiltcal.core.estimation.positions import Design, Observation, SensorObservations
from tiltcal.core.estimation.solve import (
    LARGEST_JIG,
    Solution,
    budgets,
    shown_variance,
    solved,
    solved_at,
    start_as_set,
    with_estimated,
)
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.uncertain import Uncertain
from tiltcal.errors import EstimateError, WrongPositions

LARGEST_THERMOMETER = 5.0  # standard deviation of a temperature above which no thermometer explains the residuals, °C
SUSPICION = 0.01  # probability, over all positions together, of suspecting one of a jig that is as stated
IMPROBABLE = 0.01  # say that more is left than noise and attitudes explain if its probability is below this
BEYOND, SMALLEST_ERROR = 5.0, 2.0  # a position is wrong if it is off by more stated jigs and noises, and degrees
GROSS = 10.0  # without stated jig and noise, ask whether attitudes explain errors that are larger, degrees
LIKE_THE_REST = 0.2  # positions agree without one of them where the largest error falls to this share of what it was
LEAST_SENSITIVITY = 0.5  # a singular value below this share of the nominal sensitivity follows from a wrong position
ALIKE = 1.5  # temperatures that are no further apart are one temperature met twice, °C
SIGNIFICANT = 3.0  # standard uncertainties above which the difference of two readings at one temperature is hysteresis

NO_FREEDOM = "no degree of freedom is left: the positions fit whatever was read, and nothing checks them"
LEAN = "lean"  # in ``not_covered``: all positions have one heading, where a lean of the table goes into the offsets

JIG_NOT_SHOWN = (
    "the jig is not stated, and no position shows the angle in which the sensor was held: it is not in the uncertainty"
)
ABOVE_NOISE = "the residuals are larger than noise and attitudes explain: is the sensor linear, and was it still?"


@dataclass(frozen=True)
class AttitudeError:
    """Attitude error of a position, as the readings show it."""

    position: str
    off: float  # degrees
    chi_square: float  # its square, over the variance that it should have if the jig is as stated
    p: float  # probability of that much or more


@dataclass(frozen=True)
class Estimate:
    """Coefficients of one sensor, with their uncertainty and the residuals."""

    coefficients: Coefficients
    uncertain: Uncertain  # the coefficients by their dotted names, channel by channel
    positions: tuple[str, ...]
    residuals: Array  # measured minus modelled in the positions as they were set, (positions, channels), unit
    dof: int  # left over all channels of all sensors of the fixture
    chi_square: float | None  # sum of squares of all that was stated, over the same; None where nothing is left over
    p: float | None  # probability of such a chi-square or a greater one, if what was stated is true
    stated: bool  # whether the covariance comes from stated uncertainties, and not from the residuals
    suspects: tuple[AttitudeError, ...] = ()  # positions further off than the stated jig allows, the worst first
    # Standard deviations that the residuals show of what is not stated:
    estimated_jig: float | None = None  # of a set angle, degrees
    estimated_thermometer: float | None = None  # of a temperature beside a stated jig, °C
    estimated_noise: float | None = None  # of the readings, unit
    by_reading: Array | None = None  # how the coefficients follow the readings, (coefficients, positions, channels)
    notes: tuple[str, ...] = ()  # what limits the numbers, in words
    not_covered: tuple[str, ...] = ()  # errors of the bench that no position shows and that are not in the uncertainty

    def uncertainty(self) -> dict[str, float]:
        """Return the standard uncertainty of each coefficient by its dotted name."""
        return self.uncertain.by_name(self.uncertain.u)


def estimate(observations: Sequence[Observation], design: Design) -> Estimate:
    """Determine the coefficients of one sensor from positions; see :func:`estimate_jointly`."""
    return estimate_jointly([SensorObservations(design, observations)])[0]


def estimate_jointly(sensors: Sequence[SensorObservations]) -> tuple[Estimate, ...]:
    """Determine the coefficients of each sensor of a fixture, whose attitude errors are common to them.

    The sensors have the same jig, table and thermometer, and their positions belong together by their names. An
    EstimateError names coefficients that stay undetermined, a position that is grossly wrong or lacks its temperature.
    """
    jig = sensors[0].design.jig
    equations, start = _begun(sensors)
    if jig is not None:
        errors, limit = _errors_as_set(equations, start), max(BEYOND * jig, SMALLEST_ERROR)
        if max(errors.values()) > limit:
            raise _contradicting(
                equations,
                errors,
                limit,
                f"positions as they were set contradict the readings by up to {max(errors.values()):.3g}°, where a jig "
                f"of {jig:g}° is stated; see that it was the one that is named, and take it again",
            )
    solution = solved_at(equations, start)
    try:
        if solution.dof <= 0 or not (jig is None or equations.noise_unknown):
            solution = solved(equations, equations.stated, start)
        dof, chi_square = solution.dof, solution.chi_square
        if source := _not_stated(solution):
            gross = source == NOISE and jig is None and max(_errors_as_set(equations, start).values()) > GROSS
            fitted = with_estimated(solution, JIG if gross else source)
            if gross and fitted.bench[JIG] <= LARGEST_JIG:  # attitudes explain it: the noise is estimated as usual
                fitted = with_estimated(solution, source)
            if source != THERMOMETER or fitted.bench[THERMOMETER] < LARGEST_THERMOMETER:
                solution = fitted
        why = "the residuals are larger than any error of the set angles explains; see that the positions are named "
        why = f"{why}right, and that the readings are plausible" if solution.bench[JIG] > LARGEST_JIG else ""
    except EstimateError as unsettled:
        why = str(unsettled)
    if why:
        errors = _errors_as_set(equations, start)
        raise _contradicting(equations, errors, LIKE_THE_REST * max(errors.values()), why)
    return _estimates(solution, dof, chi_square)


def _begun(sensors: Sequence[SensorObservations]) -> tuple[Equations, Array]:
    """Return the equations of sensors and their unknowns as set; an EstimateError where these stay undetermined."""
    equations = Equations(sensors)
    start = start_as_set(equations)
    require_determined(equations, start)
    return equations, start


def _not_stated(solution: Solution) -> str:
    """Return the source of the variance that the residuals show; empty where all is stated, or nothing is left over."""
    from scipy.special import chdtrc

    equations, design = solution.equations, solution.equations.sensors[0].design
    if solution.dof <= 0:
        return ""
    if equations.noise_unknown:
        return NOISE
    if design.jig is None:
        return JIG
    thermal = any(sensor.design.thermal for sensor in equations.sensors)
    if not thermal or design.thermometer is not None or equations.exact or solution.chi_square <= solution.dof:
        return ""
    beside = shown_variance(solution, THERMOMETER)
    return THERMOMETER if not beside.count or chdtrc(beside.count, beside.rest) > IMPROBABLE else ""


# What an estimate states


def _estimates(solution: Solution, dof: int, chi_square: float) -> tuple[Estimate, ...]:
    """Return the result of each sensor; ``dof`` and ``chi_square`` are those with all as it is stated."""
    from scipy.special import chdtrc

    equations, design, bench = solution.equations, solution.equations.sensors[0].design, solution.bench
    source = "" if solution.estimated is None else solution.estimated.source
    by_noise = solution.estimated if source == NOISE else None
    attitudes = _attitudes(solution) if design.jig else []
    residuals, sigma, first = equations.unexplained(solution.z), solution.near.sigma, 0
    lean = equations.errors[TABLE]
    covered = lean.stop > lean.start or design.table_lean is not None
    estimates = []
    for sensor, own, uncertain in zip(
        equations.sensors, equations.sensor_coefficients(), budgets(solution), strict=True
    ):
        shape = (len(sensor.design.channels), len(sensor.observations))
        rows = slice(first, first + shape[0] * shape[1])
        first = rows.stop
        by_reading = solution.near.part(rows).times(solution.covariance[:, own]).T / sigma[rows]
        here = {observation.position for observation in sensor.observations}
        noise = sqrt(max(bench[NOISE] - 1.0, 0.0)) * float(equations.u[rows.start])
        estimates.append(
            Estimate(
                coefficients=sensor.coefficients(solution.z[own]),
                uncertain=uncertain,
                positions=tuple(observation.position for observation in sensor.observations),
                residuals=residuals[rows].reshape(shape).T,
                dof=dof,
                chi_square=chi_square if dof else None,
                p=float(chdtrc(dof, chi_square)) if dof else None,
                stated=design.jig is not None or not dof,
                suspects=tuple(one for one in attitudes if one.position in here and one.p < SUSPICION / len(here)),
                estimated_jig=degrees(bench[JIG]) if design.jig is None and dof else None,
                estimated_thermometer=bench[THERMOMETER] or None if source == THERMOMETER else None,
                estimated_noise=None if by_noise is None else noise,
                by_reading=np.swapaxes(by_reading.reshape(-1, *shape), 1, 2),
                notes=tuple(_notes(solution, dof)),
                not_covered=() if covered else (LEAN,),
            )
        )
    return tuple(estimates)


def _notes(solution: Solution, dof: int) -> list[str]:
    """Return what limits the numbers, in words."""
    from scipy.special import chdtrc

    if not dof:
        return [NO_FREEDOM]
    notes, shown = list[str](), solution.estimated
    if shown is None or shown.source != JIG:
        return notes
    if shown.count and chdtrc(shown.count, shown.rest) < IMPROBABLE:
        notes.append(ABOVE_NOISE)
    if not shown.dof:
        angles, coefficients = solution.equations.errors[JIG], slice(0, len(solution.equations.names))
        if np.any(solution.covariance[coefficients] @ solution.near.normal[:, angles]):
            notes.append(JIG_NOT_SHOWN)
    return notes


def _attitudes(solution: Solution) -> list[AttitudeError]:
    """Test attitude errors against the variance that their estimates have under the stated jig, the worst first."""
    from scipy.special import chdtrc

    equations, columns = solution.equations, solution.equations.errors[JIG]
    angles = solution.z[columns].reshape(-1, 2)
    covariance = solution.covariance[columns, columns].reshape(len(angles), 2, len(angles), 2)
    settings = np.arange(len(angles))
    stated = (solution.bench[JIG] * equations.looser) ** 2
    values, vectors = np.linalg.eigh(stated[:, None, None] * np.eye(2) - covariance[settings, :, settings])
    seen = values > 1e-6 * stated[:, None]
    along = np.einsum("sij,si->sj", vectors, angles)
    squares = np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1)
    count = seen.sum(axis=1)
    p = np.where(count > 0, chdtrc(np.maximum(count, 1), squares), 1.0)
    off = np.degrees(np.linalg.norm(angles, axis=1))
    errors = [
        AttitudeError(name, float(off[setting]), float(squares[setting]), float(p[setting]))
        for name, setting in zip(equations.places, equations.settings, strict=True)
    ]
    return sorted(errors, key=lambda error: error.chi_square, reverse=True)


# Grossly wrong positions


def _contradicting(equations: Equations, errors: Mapping[str, float], limit: float, why: str) -> WrongPositions:
    """Name the positions without which the others are off by less than a limit, degrees, else all beyond it."""
    named = [position for position in errors if _agree(equations.sensors, position, limit)]
    named = named or [position for position, off in errors.items() if off > limit]
    return WrongPositions(named, f"{listed(named, 'or')} is wrong: {why}")


def _errors_as_set(equations: Equations, start: Array) -> dict[str, float]:
    """Return how far each position is off, degrees, by its readings near a start as set, averaged over a setting."""
    sensors, first = equations.sensors, 0
    near = equations.at(start, equations.as_set)  # a lean that the start shows is no error
    residuals = near.residual[: len(near.sigma)] * near.sigma
    nominal = [
        sensor.design.nominal or sizes.max(initial=0.0) or inf
        for sensor, sizes in zip(sensors, _sizes(equations, start), strict=True)
    ]
    groups = equations.settings
    if sensors[0].design.thermal:
        groups = np.unique(np.round(equations.gravity, 6), axis=0, return_inverse=True)[1].ravel()
    largest = np.zeros(int(groups.max()) + 1)
    for channel in equations.channels:
        group, rows = groups[channel.places], slice(first, first + len(channel.u))
        first = rows.stop
        count = np.maximum(np.bincount(group, minlength=len(largest)), 1)
        mean, noise = (np.abs(np.bincount(group, part, len(largest))) / count for part in (residuals[rows], channel.u))
        np.maximum(largest, (mean - BEYOND * noise) / nominal[channel.sensor], out=largest)
    return dict(zip(equations.places, np.degrees(largest[groups]).tolist(), strict=True))


def _agree(sensors: Sequence[SensorObservations], without: str, limit: float) -> bool:
    """Return whether the positions without one of them agree, and give sensitivities that a sensor has."""
    kept = [
        replace(sensor, observations=[one for one in sensor.observations if one.position != without])
        for sensor in sensors
    ]
    try:
        equations, start = _begun(kept)
    except EstimateError:  # nothing checks what the others give
        return False
    for sensor, sizes in zip(kept, _sizes(equations, start), strict=True):
        nominal = sensor.design.nominal or sizes.max()
        if sizes.min() < LEAST_SENSITIVITY * nominal or sizes.max() > nominal / LEAST_SENSITIVITY:
            return False
    return max(_errors_as_set(equations, start).values()) <= limit


def _sizes(equations: Equations, z: Array) -> list[Array]:
    """Return the singular values of the sensitivities of each sensor, unit/g."""
    return [
        np.asarray(np.linalg.svd(sensor.coefficients(z[own]).sensitivity, compute_uv=False))
        * (1.0 if sensor.design.angles is None else DEGREES)
        for sensor, own in zip(equations.sensors, equations.sensor_coefficients(), strict=True)
    ]


# Hysteresis: two readings in one position at one temperature, reached from two sides. The curve may follow one reading
# and the truth the other: the difference is the half width of a rectangular distribution (GUM 4.3.7), alike for all
# positions of the setting that shows the loop, and by itself for each of them that was met only once.


def with_hysteresis(fitted: Estimate, sensor: SensorObservations) -> Estimate:
    """Return the estimate with the loops between temperatures that were met twice in its uncertainty."""
    observations, pairs = sensor.observations, met_twice(sensor.observations)
    if fitted.coefficients.thermal is None or fitted.by_reading is None or not pairs:
        return fitted
    jig = fitted.estimated_jig if sensor.design.jig is None else sensor.design.jig
    settings = np.cumsum([not observation.held for observation in observations])
    axes = [AXES.index(axis) for axis in fitted.coefficients.axes]
    added = np.zeros_like(fitted.uncertain.covariance)
    for column, sensitivity in enumerate(fitted.coefficients.sensitivity):
        loops = []
        for i, j in pairs:
            # Two attitudes that were set apart differ by the jig.
            across = float(np.linalg.norm(np.cross(np.eye(3)[axes].T @ sensitivity, observations[i].gravity)))
            by_jig = 0.0 if settings[i] == settings[j] else sqrt(2.0) * radians(jig or 0.0) * across
            u = hypot(observations[i].u[column], observations[j].u[column], by_jig)
            loop = abs(float(fitted.residuals[j, column] - fitted.residuals[i, column]))
            loops.append((loop / u if u else loop, loop, u))
        _, loop, u = max(loops)
        if loop > SIGNIFICANT * u:
            twice = sorted({index for pair in pairs for index in pair})
            for setting in dict.fromkeys(settings[twice].tolist()):
                together = np.flatnonzero(settings == setting)
                for rows in (together, *(together[together == row] for row in set(together.tolist()) - set(twice))):
                    moved = fitted.by_reading[:, rows, column].sum(axis=1) * loop
                    added += np.outer(moved, moved) / 3.0
    if not added.any():
        return fitted
    by_loops = Uncertain.errors(fitted.uncertain.names, added, source=HYSTERESIS)
    return replace(fitted, uncertain=fitted.uncertain + by_loops)


def met_twice(observations: Sequence[Any]) -> list[tuple[int, int]]:
    """Return the pairs of positions, observed or measured, with one attitude and one temperature."""
    return [
        (i, j)
        for (i, first), (j, second) in combinations(enumerate(observations), 2)
        if np.array_equal(first.gravity, second.gravity)
        and first.heading == second.heading
        and first.temperature is not None
        and second.temperature is not None
        and abs(first.temperature - second.temperature) <= ALIKE
    ]
