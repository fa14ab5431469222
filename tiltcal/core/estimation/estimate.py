"""The one estimator: from positions to coefficients, jointly over all sensors and channels of a fixture.

Generalised least squares on the covariance of noise and bench serves every bench
(:mod:`tiltcal.core.estimation.equations`). At most one variance is estimated from the residuals, the first that is not
stated: that of the noise, of the jig, of the thermometer (:mod:`tiltcal.core.estimation.solve`). Attitudes that nobody
set have a fit of their own (:mod:`tiltcal.core.estimation.free`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import degrees, sqrt

import numpy as np

from tiltcal.core.estimation.attitude import rotation_vectors
from tiltcal.core.estimation.budget import budgets
from tiltcal.core.estimation.design import Design, Observation, SensorObservations, require_sound
from tiltcal.core.estimation.equations import ADC, JIG, THERMOMETER, Equations
from tiltcal.core.estimation.identifiability import require_determined
from tiltcal.core.estimation.set_positions import LIKE_THE_REST, errors_as_set, require_positions, wrong_position
from tiltcal.core.estimation.solve import (
    LARGEST_JIG,
    EstimatedVariance,
    Solution,
    projected,
    solved,
    solved_at,
    start_as_set,
    with_estimated,
)
from tiltcal.core.model import Array, Coefficients, Thermal
from tiltcal.core.uncertain import Uncertain
from tiltcal.errors import EstimateError

LARGEST_THERMOMETER = 5.0
"""Standard deviation of a temperature above which no thermometer explains the residuals, °C."""

SUSPICION = 0.01
"""Probability, over all positions together, of suspecting one of a jig that is as stated."""

IMPROBABLE = 0.01
"""Say that more is left than noise and attitudes explain if its probability is below this."""

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
class Estimate:
    """Coefficients of one sensor, with their uncertainty and the residuals.

    Attributes
    ----------
    uncertain : Uncertain
        The coefficients by their dotted names, channel by channel.
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

    coefficients: Coefficients
    uncertain: Uncertain
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

    def uncertainty(self) -> dict[str, float]:
        """Return the standard uncertainty of each coefficient by its dotted name."""
        return self.uncertain.by_name(self.uncertain.u)

    def coverage_factors(self) -> dict[str, float]:
        """Return the coverage factor of each one's 95 % interval by its dotted name."""
        return self.uncertain.by_name(self.uncertain.factors)

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
        The positions leave coefficients undetermined (they are named), a position is grossly wrong, or a temperature is
        missing.
    """
    require_sound(sensors)
    jig = sensors[0].design.jig
    equations = Equations(sensors)
    start = start_as_set(equations)
    require_determined(equations, start)
    if jig is not None:
        require_positions(equations, start, jig)
    solution = solved_at(equations, start)
    if solution.dof <= 0 or not (jig is None or equations.noise_unknown):
        solution = solved(equations, equations.stated, start)
    dof, chi_square = solution.dof, solution.chi_square
    estimated: dict[str, EstimatedVariance] = {}
    source = _not_stated(solution)
    if source:
        found, shown = with_estimated(solution, source)
        if source != THERMOMETER or found.errors.thermometer < LARGEST_THERMOMETER:
            solution, estimated[source] = found, shown
    if solution.errors.jig > LARGEST_JIG:
        errors = errors_as_set(equations, start)
        raise EstimateError(
            f"{wrong_position(equations, errors, LIKE_THE_REST * max(errors.values()))}: the residuals are larger than "
            "any error of the set angles explains; see that the positions are named right, and that the readings are "
            "plausible"
        )
    return _estimates(solution, estimated, dof, chi_square)


def _not_stated(solution: Solution) -> str:
    """Return the source of the variance that the residuals show; empty where all is stated, or nothing is left over."""
    from scipy.special import chdtrc

    equations, design = solution.equations, solution.equations.sensors[0].design
    if solution.dof <= 0:
        return ""
    if equations.noise_unknown:
        return ADC
    if design.jig is None:
        return JIG
    thermal = any(sensor.design.thermal for sensor in equations.sensors)
    if not thermal or design.thermometer is not None or equations.exact or solution.chi_square <= solution.dof:
        return ""
    beside = projected(solution, THERMOMETER)
    return THERMOMETER if not beside.count or chdtrc(beside.count, beside.rest) > IMPROBABLE else ""


def _estimates(
    solution: Solution, estimated: Mapping[str, EstimatedVariance], dof: int, chi_square: float
) -> tuple[Estimate, ...]:
    """Return the result of each sensor; ``dof`` and ``chi_square`` are those with all as it is stated."""
    from scipy.special import chdtrc

    equations, design = solution.equations, solution.equations.sensors[0].design
    attitudes = _attitudes(solution) if design.jig else ()
    residuals, row = equations.unexplained(solution.z), 0
    estimates = []
    for number, (sensor, uncertain) in enumerate(zip(equations.sensors, budgets(solution, estimated), strict=True)):
        channels = [channel for channel in equations.channels if channel.sensor == number]
        here = {observation.position for observation in sensor.observations}
        own = residuals[row : row + len(channels) * len(sensor.observations)]
        row += len(own)
        noise = sqrt(max(solution.errors.noise - 1.0, 0.0)) * float(channels[0].u[0])
        estimates.append(
            Estimate(
                coefficients=_coefficients(
                    sensor, np.concatenate([solution.z[channel.coefficients] for channel in channels])
                ),
                uncertain=uncertain,
                positions=tuple(observation.position for observation in sensor.observations),
                residuals=own.reshape(len(channels), -1).T,
                dof=dof,
                chi_square=chi_square if dof else None,
                p=float(chdtrc(dof, chi_square)) if dof else None,
                stated=design.jig is not None or not dof,
                attitudes=tuple(attitude for attitude in attitudes if attitude.position in here),
                estimated_jig=degrees(solution.errors.jig) if design.jig is None and dof else None,
                estimated_thermometer=solution.errors.thermometer or None if THERMOMETER in estimated else None,
                estimated_noise=noise if ADC in estimated else None,
                noise_dof=estimated[ADC].dof if ADC in estimated else None,
                notes=tuple(_notes(solution, estimated, dof)),
                not_covered=()
                if equations.errors["table"].stop > equations.errors["table"].start or design.table is not None
                else (LEAN,),
            )
        )
    return tuple(estimates)


def _notes(solution: Solution, estimated: Mapping[str, EstimatedVariance], dof: int) -> list[str]:
    """Return what limits the numbers, in words."""
    from scipy.special import chdtrc

    if not dof:
        return [NO_FREEDOM]
    notes = []
    jig = estimated.get(JIG)
    if jig is not None and jig.count and chdtrc(jig.count, jig.rest) < IMPROBABLE:
        notes.append(ABOVE_NOISE)
    if jig is not None and not jig.information:
        angles = solution.equations.errors[JIG]
        if np.any(solution.covariance[: len(solution.equations.names)] @ solution.near.normal[:, angles]):
            notes.append(JIG_NOT_SHOWN)
    return notes


def _attitudes(solution: Solution) -> tuple[AttitudeError, ...]:
    """Test each position's attitude error against the variance that its estimate has under the stated jig."""
    from scipy.special import chdtrc

    equations, jig, columns = solution.equations, solution.errors.jig, solution.equations.errors[JIG]
    own = solution.z[columns].reshape(-1, 2)
    covariance = solution.covariance[columns, columns].reshape(len(own), 2, len(own), 2)
    settings = np.arange(len(own))
    stated = (jig * equations.looser) ** 2
    values, vectors = np.linalg.eigh(stated[:, None, None] * np.eye(2) - covariance[settings, :, settings])
    seen = values > 1e-6 * stated[:, None]
    along = np.einsum("sij,si->sj", vectors, own)
    squares = np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1)
    count = seen.sum(axis=1)
    p = np.where(count > 0, chdtrc(np.maximum(count, 1), squares), 1.0)
    turns = rotation_vectors(equations.gravity, equations.basis, own[equations.settings])
    return tuple(
        AttitudeError(name, np.degrees(turn), float(squares[setting]), float(p[setting]))
        for name, turn, setting in zip(equations.places, turns, equations.settings, strict=True)
    )


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
