"""The one estimator: from positions to coefficients, jointly over all sensors and channels of a fixture.

One least-squares system (:mod:`tiltcal.core.estimation.joint_equations`) serves every bench; what is stated of the jig
chooses how far its attitudes are unknowns:

- **stated**, any angle from 0 up: each attitude is an unknown with the jig's uncertainty as its prior. At 0 it is
  ordinary weighted least squares.
- **not stated** (None): the residuals show its uncertainty, and the equations are solved as if that was stated
  (:mod:`tiltcal.core.estimation.variance_components`).

Attitudes that nobody set have a fit of their own (:mod:`tiltcal.core.estimation.free`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees, inf, radians, sqrt

import numpy as np

from tiltcal.core.estimation.attitude import rotation_vectors
from tiltcal.core.estimation.covariance import estimated_jig_budgets, stated_budgets
from tiltcal.core.estimation.design import Design, Observation, SensorObservations, require_sound
from tiltcal.core.estimation.elimination import LinearSolution, linearised
from tiltcal.core.estimation.equation_assembly import system_of
from tiltcal.core.estimation.joint_equations import System
from tiltcal.core.estimation.second_order import second_order_bias
from tiltcal.core.estimation.set_positions import (
    LIKE_THE_REST,
    errors_as_set,
    require_positions,
    start_as_set,
    wrong_position,
)
from tiltcal.core.estimation.unstated_variances import (
    find_jig,
    find_noise,
    find_thermometer,
    minimum_from,
    residuals_near,
    with_attitudes,
)
from tiltcal.core.estimation.variance_components import NoiseVariance, variance_components
from tiltcal.core.model import Array, Coefficients, Thermal
from tiltcal.core.named_coefficients import DeterminedCoefficients
from tiltcal.core.uncertainty_budget import Budget
from tiltcal.errors import EstimateError

LARGEST_JIG = radians(45.0)
"""Standard deviation of a set angle above which the positions are not those that were set, radians."""

SUSPICION = 0.01
"""Probability, over all positions together, of suspecting one of a jig that is as stated."""

NO_FREEDOM = "no degree of freedom is left: the positions fit whatever was read, and nothing checks them"
LEAN = "lean"
"""In ``not_covered``: all positions have one heading, where a lean of the table goes into the offsets."""

JIG_NOT_SHOWN = (
    "the jig is not stated, and no position shows the angle in which the sensor was held: it is not in the uncertainty"
)
ABOVE_NOISE = "the residuals are larger than noise and attitudes explain: is the sensor linear, and was it still?"


@dataclass(frozen=True)
class AttitudeError:
    """Attitude error of a position, as the readings show it.

    Attributes
    ----------
    turn : ndarray, shape (3,)
        Rotation vector of gravity in the fixture's frame, degrees.
    chi_square : float
        The turn, squared, over the variance that it should have if the jig is as stated.
    p : float
        Probability of that much or more.
    """

    position: str
    turn: Array
    chi_square: float
    p: float


@dataclass(frozen=True)
class Estimate(DeterminedCoefficients):
    """Coefficients of one sensor, with their uncertainty and the residuals.

    Attributes
    ----------
    residuals : ndarray, shape (positions, channels)
        Measured minus modelled in the positions as they were set, in the sensor's unit.
    dof : int
        Degrees of freedom left, over all channels of all sensors of the fixture.
    chi_square : float or None
        Sum of squares of all that was stated, over the same; None where nothing is left over to judge.
    p : float or None
        Probability of such a chi-square or a greater one, if what was stated is true.
    stated : bool
        Whether the covariance comes from stated uncertainties, and not from the residuals.
    attitudes : tuple of AttitudeError
        One a position, where the jig is stated; empty otherwise.
    estimated_jig : float or None
        Standard deviation of a set angle that the residuals show where the jig is not stated, degrees.
    estimated_thermometer : float or None
        Standard deviation of a temperature that they show where a jig, but no thermometer is stated, °C.
    estimated_noise : float or None
        Standard deviation of the readings' noise that they show where nothing is stated of it, unit.
    noise_dof : float or None
        Degrees of freedom of that.
    notes : tuple of str
        What limits the numbers, in words.
    not_covered : tuple of str
        Errors of the bench that no position shows and that are not in the uncertainty.
    """

    positions: tuple[str, ...]
    residuals: Array
    dof: int
    chi_square: float | None
    p: float | None
    stated: bool
    attitudes: tuple[AttitudeError, ...] = ()
    estimated_jig: float | None = None
    estimated_thermometer: float | None = None
    estimated_noise: float | None = None
    noise_dof: float | None = None
    notes: tuple[str, ...] = ()
    not_covered: tuple[str, ...] = ()

    def suspects(self) -> list[AttitudeError]:
        """Return the positions that were further off than the stated jig allows, the worst first."""
        worst = [attitude for attitude in self.attitudes if attitude.p < SUSPICION / len(self.attitudes)]
        return sorted(worst, key=lambda attitude: attitude.chi_square, reverse=True)


def estimate(observations: Sequence[Observation], design: Design) -> Estimate:
    """Determine the coefficients of one sensor from positions.

    Raises
    ------
    EstimateError
        The positions leave coefficients undetermined (they are named), or a temperature is missing.
    """
    return estimate_jointly([SensorObservations(design, observations)])[0]


def estimate_jointly(sensors: Sequence[SensorObservations]) -> tuple[Estimate, ...]:
    """Determine the coefficients of each sensor of a fixture; their attitude errors are common to them.

    Parameters
    ----------
    sensors : sequence of SensorObservations
        With the same jig, table and thermometer. Positions belong together by their names.

    Raises
    ------
    EstimateError
        The positions leave coefficients undetermined (they are named), or a temperature is missing.
    """
    require_sound(sensors)
    design = sensors[0].design
    system = system_of(sensors)
    found = _unstated(sensors, system) if design.jig is None else _stated(sensors, system, design.jig)
    if design.table is not None or system.lean_rotations is not None:
        return found
    return tuple(replace(estimate, not_covered=(LEAN,)) for estimate in found)


def _stated(sensors: Sequence[SensorObservations], system: System, jig: float) -> tuple[Estimate, ...]:
    """Estimate with all errors of the bench as unknowns, whose uncertainty is stated; the jig in degrees."""
    z = start_as_set(system)
    require_positions(sensors, system, z, jig)
    z = minimum_from(system, z)
    near = linearised(system, z)
    dof = system.degrees_of_freedom(near.unobservable_leans)
    chi_square = near.equations.cost if dof else None
    shown, noise = None, None
    if dof and system.noise_unknown:
        system, z, noise = find_noise(system, z, dof, _known_table(near), system.jig)
        near = linearised(system, z)
    elif chi_square is not None and sensors[0].design.thermometer is None:
        shown = find_thermometer(system, z, chi_square, dof)
    if shown is not None:
        system, z = shown.system, shown.z
        near = linearised(system, z)
    z, bias = _without_bias(near, z)
    budgets = stated_budgets(near, bias, inf if shown is None else shown.dof, noise)
    attitudes = _attitudes(sensors, system, z, near) if system.jig > 0 else ()
    found = _Found(
        z,
        budgets,
        dof,
        chi_square,
        True,
        attitudes,
        estimated_thermometer=None if shown is None else system.thermometer,
        noise_dof=None if noise is None else noise.own_dof,
        notes=() if dof else (NO_FREEDOM,),
    )
    return _estimates(sensors, system, found)


def _unstated(sensors: Sequence[SensorObservations], system: System) -> tuple[Estimate, ...]:
    """Estimate the jig from the residuals, and solve the equations with it as if it were stated."""
    start = start_as_set(system.unweighted())
    z = minimum_from(system, start)
    near = with_attitudes(system, z)
    dof = system.degrees_of_freedom(near.unobservable_leans)
    if dof <= 0:
        return _estimates(sensors, system, _Found(z, stated_budgets(near), 0, None, True, notes=(NO_FREEDOM,)))
    table = _known_table(near)
    components = variance_components(residuals_near(replace(system, table=table), z, dof))
    if components.angle > LARGEST_JIG:
        errors = errors_as_set(sensors, system, start)
        raise EstimateError(
            f"{wrong_position(sensors, errors, LIKE_THE_REST * max(errors.values()))}: the residuals are larger than "
            "any error of the set angles explains; see that the positions are named right, and that the readings are "
            "plausible"
        )
    if system.noise_unknown:
        known, z, noise = find_noise(system, z, dof, table, None)
        return _estimates(sensors, known, _of_residuals(system, known, z, dof, noise))
    known, z, components = find_jig(system, z, components, dof, table)
    near = with_attitudes(known, z)
    z, bias = _without_bias(near, z)
    budgets = estimated_jig_budgets(near, components, bias)
    notes = []
    if components.exceeds:
        notes.append(ABOVE_NOISE)
    if not components.detectable and np.any(near.response[:, near.shared - near.angles :] != 0.0):
        notes.append(JIG_NOT_SHOWN)
    chi_square = _chi_square(system, z)
    found = _Found(z, budgets, dof, chi_square, False, estimated_jig=degrees(components.angle), notes=tuple(notes))
    return _estimates(sensors, known, found)


def _without_bias(near: LinearSolution, z: Array) -> tuple[Array, Array | None]:
    """Return the unknowns at a minimum less the second-order bias of the coefficients, and that; None without a jig."""
    if not near.jig > 0:
        return z, None
    bias = second_order_bias(near, z)
    z = z.copy()
    z[: len(bias)] -= bias
    return z, bias


def _chi_square(system: System, z: Array) -> float:
    """Return the sum of squares of the residuals in the positions as they were set."""
    residual = system.unexplained(system.as_set(z)) / system.sigma
    return float(residual @ residual)


def _known_table(near: LinearSolution) -> float:
    """Return what is known of the table, radians: the mere bound of a lean that the readings show is no evidence."""
    return near.system.table if near.system.table_stated or near.unobservable_leans else inf


def _of_residuals(before: System, system: System, z: Array, dof: int, noise: NoiseVariance) -> _Found:
    """Return the minimum of a system whose noise and jig were found, with the chi-square that it had before."""
    near = with_attitudes(system, z)
    z, bias = _without_bias(near, z)
    hidden = system.jig == 0.0 and np.any(near.response[:, near.shared - near.angles :] != 0.0)
    return _Found(
        z,
        stated_budgets(near, bias, shown=noise),
        dof,
        _chi_square(before, z),
        False,
        estimated_jig=degrees(system.jig),
        noise_dof=noise.own_dof,
        notes=(JIG_NOT_SHOWN,) if hidden else (),
    )


@dataclass(frozen=True)
class _Found:
    """Minimum of the sum of squares, with uncertainty and tests, over all sensors."""

    z: Array
    budgets: Sequence[Budget]
    dof: int
    chi_square: float | None
    stated: bool
    attitudes: tuple[AttitudeError, ...] = ()
    estimated_jig: float | None = None
    estimated_thermometer: float | None = None
    noise_dof: float | None = None
    notes: tuple[str, ...] = ()


def _attitudes(
    sensors: Sequence[SensorObservations], system: System, z: Array, near: LinearSolution
) -> tuple[AttitudeError, ...]:
    """Test each position's attitude error against the variance that its estimate has under the stated jig."""
    from scipy.special import chdtrc

    angles = system.angles(z)
    turns = rotation_vectors(system.gravity, system.basis, angles)
    names = list(dict.fromkeys(o.position for sensor in sensors for o in sensor.observations))
    own = z[system.attitudes].reshape(-1, 2)
    covariance = near.shared_covariance[-near.angles :, -near.angles :].reshape(len(own), 2, len(own), 2)
    settings = np.arange(len(own))
    values, vectors = np.linalg.eigh(system.jig**2 * np.eye(2) - covariance[settings, :, settings])
    seen = values > 1e-6 * system.jig**2
    along = np.einsum("sij,si->sj", vectors, own)
    squares = np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1)
    count = seen.sum(axis=1)
    p = np.where(count > 0, chdtrc(np.maximum(count, 1), squares), 1.0)
    judged = list(zip(squares.tolist(), p.tolist(), strict=True))
    return tuple(
        AttitudeError(name, np.degrees(turn), *judged[setting])
        for name, turn, setting in zip(names, turns, system.settings, strict=True)
    )


def _estimates(sensors: Sequence[SensorObservations], system: System, found: _Found) -> tuple[Estimate, ...]:
    """Return the result of each sensor."""
    from scipy.special import chdtrc

    p = None if found.chi_square is None else float(chdtrc(found.dof, found.chi_square))
    as_set = system.unexplained(system.as_set(found.z))
    estimates = []
    row = 0
    for number, sensor in enumerate(sensors):
        own = np.flatnonzero(system.sensors == number)
        shape = (len(sensor.design.channels), len(sensor.observations))
        rows = slice(row, row + shape[0] * shape[1])
        here = {observation.position for observation in sensor.observations}
        noise = sqrt(max(float(system.sigma[row] ** 2 - np.max(sensor.observations[0].u) ** 2), 0.0))
        estimates.append(
            Estimate(
                coefficients=_coefficients(sensor, found.z[own]),
                names=sensor.design.names,
                budget=found.budgets[number],
                positions=tuple(observation.position for observation in sensor.observations),
                residuals=as_set[rows].reshape(shape).T,
                dof=found.dof,
                chi_square=found.chi_square,
                p=p,
                stated=found.stated,
                attitudes=tuple(attitude for attitude in found.attitudes if attitude.position in here),
                estimated_jig=found.estimated_jig,
                estimated_thermometer=found.estimated_thermometer,
                estimated_noise=None if found.noise_dof is None else noise,
                noise_dof=found.noise_dof,
                notes=found.notes,
            )
        )
        row = rows.stop
    return tuple(estimates)


def _coefficients(sensor: SensorObservations, theta: Array) -> Coefficients:
    design = sensor.design
    table = theta.reshape(len(design.channels), -1)
    split = [model.split(row) for model, row in zip(design.models, table, strict=True)]
    sensitivity, drift, gain, bend = (np.array(part) for part in zip(*split, strict=True))
    thermal = None
    if design.thermal:
        temperatures = [
            observation.temperature for observation in sensor.observations if observation.temperature is not None
        ]
        thermal = Thermal(design.reference, (float(min(temperatures)), float(max(temperatures))), drift, gain)
    return Coefficients(
        channels=design.channels,
        axes=design.axes,
        offset=table[:, 0],
        sensitivity=sensitivity,
        thermal=thermal,
        nonlinearity=bend if design.nonlinearity else None,
    )
