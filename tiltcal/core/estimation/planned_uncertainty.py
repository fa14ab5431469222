"""Planned uncertainty: the covariance of every coefficient from the plan alone, before anything is measured.

The same system of equations as the estimator's, at nominal coefficients and with readings that fit exactly: its
covariance needs no readings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from math import inf
from operator import itemgetter

import numpy as np

from tiltcal.core.estimation.covariance import scaled_budgets, stated_budgets
from tiltcal.core.estimation.design import Design, Observation, SensorObservations, require_sound
from tiltcal.core.estimation.elimination import linearised
from tiltcal.core.estimation.equation_assembly import system_of
from tiltcal.core.estimation.identifiability import CANDIDATES, WARMER, require_determined
from tiltcal.core.estimation.joint_equations import System
from tiltcal.core.estimation.unit_gravity import require_spread, triangular_gauge
from tiltcal.core.gravity_direction import Vector
from tiltcal.core.model import AXES, Array
from tiltcal.core.uncertainty_budget import Budget

STRONG = 0.9
"""A correlation from here on is named."""

WORTH = 0.8
"""A position is proposed where it brings the largest uncertainty below this share of what it was."""


@dataclass(frozen=True)
class PlannedPosition:
    """Position of a planned session.

    Attributes
    ----------
    gravity : tuple of float
        Up in the sensor frame, g.
    temperature : float or None
        °C.
    heading : float or None
        Degrees.
    held : bool
        The fixture stands as in the position before.
    """

    name: str
    gravity: Vector
    temperature: float | None = None
    heading: float | None = None
    held: bool = False


@dataclass(frozen=True)
class Prediction:
    """Uncertainty that a planned session will reach.

    Attributes
    ----------
    names : tuple of str
        Of the coefficients.
    budget : Budget
        Their covariance and its sources.
    dof : int
        Degrees of freedom that are left to check the result.
    correlations : tuple of (str, str, float)
        Pairs of coefficients that the plan hardly separates, the strongest first.
    worth_adding : tuple of (str, str, float)
        A position, the coefficient that it helps most, and the share of its uncertainty that is left; best first.
    """

    names: tuple[str, ...]
    budget: Budget
    dof: int
    correlations: tuple[tuple[str, str, float], ...]
    worth_adding: tuple[tuple[str, str, float], ...]

    def uncertainty(self) -> dict[str, float]:
        """Return the predicted standard uncertainty of each coefficient."""
        return dict(zip(self.names, self.budget.u.tolist(), strict=True))


def predict_uncertainty(
    design: Design,
    positions: Sequence[PlannedPosition],
    noise: float,
    *,
    sensitivity: float = 1.0,
    drift: float = 0.0,
    adc: float = 0.0,
    sensors: int = 1,
    level: bool = False,
) -> Prediction:
    """Compute the uncertainty that a planned session will reach for each of the sensors, at nominal coefficients.

    Parameters
    ----------
    design : Design
        With the jig, the thermometer and the table as they are stated; a jig that is not stated counts as perfect, and
        what is predicted is then what noise alone leaves.
    noise : float
        Standard uncertainty of a position's mean reading, in the sensor's unit.
    sensitivity : float
        Nominal, unit/g.
    drift : float
        Of the offset of a usual part, unit/°C: an error of the thermometer moves a reading by so much.
    adc : float
        Standard uncertainty that quantisation leaves in a mean, same unit as the noise.
    sensors : int
        How many alike sit on the fixture and are estimated together.
    level : bool
        Every position has to be level, so none in another direction is proposed.

    Raises
    ------
    EstimateError
        The plan leaves coefficients undetermined; they are named, and a position that would determine them.
    """
    equations = partial(_system, design, noise=noise, sensitivity=sensitivity, drift=drift, adc=adc, sensors=sensors)
    system, z = equations(positions)
    near = linearised(system, z)
    if design.free:
        require_spread(near)
    else:
        require_determined(system, z)
    own = stated_budgets(near)[0]
    names = design.names
    return Prediction(
        names=names,
        budget=own,
        dof=system.degrees_of_freedom(near.unobservable_leans),
        correlations=strong_correlations(names, own.covariance),
        worth_adding=_worth_adding(design, positions, equations, own.u, level=level),
    )


def strong_correlations(names: Sequence[str], covariance: Array) -> tuple[tuple[str, str, float], ...]:
    """Return pairs of coefficients that a covariance, shape (k, k), correlates strongly, the strongest first."""
    u = np.sqrt(np.diag(covariance))
    found = [
        (names[i], names[j], round(float(covariance[i, j] / (u[i] * u[j])), 3))
        for i, j in combinations(range(len(names)), 2)
        if u[i] * u[j] > 0.0 and abs(covariance[i, j]) >= STRONG * u[i] * u[j]
    ]
    return tuple(sorted(found, key=lambda pair: -abs(pair[2])))


def _system(
    design: Design,
    positions: Sequence[PlannedPosition],
    *,
    noise: float,
    sensitivity: float,
    drift: float,
    adc: float,
    sensors: int,
) -> tuple[System, Array]:
    """Return the equations of a plan, without readings, and all unknowns as in the data sheet."""
    stated = replace(design, jig=design.jig or 0.0)
    zero = np.zeros(len(design.channels))
    u = np.full(len(design.channels), max(np.hypot(noise, adc), 1e-12 * abs(sensitivity)))
    observations = [
        Observation(
            position.name,
            np.array(position.gravity),
            zero,
            u,
            position.temperature,
            position.heading,
            position.held,
            adc=adc,
        )
        for position in positions
    ]
    plan = [SensorObservations(stated, observations)] * sensors
    require_sound(plan)
    system = system_of(plan)
    z = _nominal(design, system, sensitivity, drift)
    return triangular_gauge(system, z) if design.free else (system, z)


def _nominal(design: Design, system: System, sensitivity: float, drift: float) -> Array:
    """Return the coefficients of a usual part: each channel senses its own axis alone."""
    nominal: Mapping[str, float] = {
        **{f"sensitivity.{channel}.{channel}": sensitivity for channel in design.channels},
        **{f"temperature.offset.{channel}.1": drift for channel in design.channels},
    }
    z = system.start()
    for column, name in enumerate(system.names):
        if name in nominal and not np.isfinite(system.prior_u[column]):
            z[column] = nominal[name]
    return z


def _worth_adding(
    design: Design,
    positions: Sequence[PlannedPosition],
    equations: Callable[[Sequence[PlannedPosition]], tuple[System, Array]],
    before: Array,
    *,
    level: bool,
) -> tuple[tuple[str, str, float], ...]:
    """Return positions that would make some coefficient much better known."""
    found = []
    assumed = np.array([name in design.priors for name in design.names])
    usual = next((position.temperature for position in positions if position.temperature is not None), None)
    candidates = [
        PlannedPosition(name, gravity, temperature, positions[0].heading)
        for name, gravity, temperature in ([] if level else _candidates(design, positions, usual))
    ]
    if design.table is not None:
        first = positions[0]
        turned = f"{first.name} with the fixture turned by 180°"
        candidates.append(replace(first, name=turned, heading=(first.heading or 0.0) + 180.0, held=False))
    for candidate in candidates:
        after = scaled_budgets(linearised(*equations([*positions, candidate])), 1.0, inf)[0].u
        share = after / np.where(before > 0.0, before, np.inf)
        share[(before == 0.0) | assumed] = 1.0
        most = int(np.argmin(np.round(share, 6)))
        if share[most] < WORTH:
            found.append((candidate.name, design.names[most], round(float(share[most]), 3)))
    return tuple(sorted(found, key=itemgetter(2)))


def _candidates(
    design: Design, positions: Sequence[PlannedPosition], usual: float | None
) -> list[tuple[str, Vector, float | None]]:
    """Return positions that may be proposed: directions that the sensor can be set to, and other temperatures."""
    found: list[tuple[str, Vector, float | None]] = [
        (name, gravity, usual)
        for name, gravity in CANDIDATES.items()
        if any(abs(gravity[AXES.index(axis)]) > 0.0 for axis in design.axes) or not design.axes
    ]
    if design.thermal and usual is not None:
        temperatures = [position.temperature for position in positions if position.temperature is not None]
        level = CANDIDATES["level (+z up)"]
        found.append((f"level at {max(temperatures) + WARMER:g} °C", level, max(temperatures) + WARMER))
        found.append((f"level at {min(temperatures) - WARMER:g} °C", level, min(temperatures) - WARMER))
    return found
