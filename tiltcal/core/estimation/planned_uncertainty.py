"""Planned uncertainty: the covariance of every coefficient from the plan alone, before anything is measured.

The same system of equations as the estimator's, at nominal coefficients and with readings that fit exactly: its
covariance needs no readings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from operator import itemgetter

import numpy as np

from tiltcal.core.estimation.budget import budgets
from tiltcal.core.estimation.design import Design, Observation, SensorObservations, require_sound
from tiltcal.core.estimation.equations import Equations
from tiltcal.core.estimation.free import UNKNOWNS, planned_uncertain
from tiltcal.core.estimation.identifiability import CANDIDATES, WARMER, require_determined
from tiltcal.core.estimation.solve import solved_at
from tiltcal.core.gravity_direction import Vector
from tiltcal.core.model import AXES, Array
from tiltcal.core.uncertain import Uncertain

STRONG = 0.9
"""A correlation from here on is named."""

WORTH = 0.8
"""A position is proposed where it brings the largest uncertainty below this share of what it was."""


@dataclass(frozen=True)
class PlannedPosition:
    """Position of a planned session: up in the sensor frame, g; °C; degrees; the fixture stands as before."""

    name: str
    gravity: Vector
    temperature: float | None = None
    heading: float | None = None
    held: bool = False


@dataclass(frozen=True)
class Prediction:
    """Uncertainty that a planned session will reach in the coefficients, and degrees of freedom to check them.

    ``correlations`` are pairs that the plan hardly separates, the strongest first; ``worth_adding`` has a position, the
    coefficient that it helps most, and the share of its uncertainty that is left, best first.
    """

    uncertain: Uncertain
    dof: int
    correlations: tuple[tuple[str, str, float], ...]
    worth_adding: tuple[tuple[str, str, float], ...]

    def uncertainty(self) -> dict[str, float]:
        """Return the predicted standard uncertainty of each coefficient."""
        return self.uncertain.by_name(self.uncertain.u)


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
    """Compute the uncertainty that a planned session will reach for each of some equal sensors.

    A jig that is not stated counts as perfect. ``noise`` and ``adc`` are standard uncertainties of a position's mean,
    unit; ``sensitivity`` is nominal, unit/g; ``drift`` is that of a usual part, unit/°C, by which an error of the
    thermometer counts; of a ``level`` procedure no other direction is proposed. An EstimateError names coefficients
    that the plan leaves undetermined, and a position that would determine them.
    """
    budget = partial(_budget, design, noise=noise, sensitivity=sensitivity, drift=drift, adc=adc, sensors=sensors)
    own, dof = budget(positions)
    return Prediction(
        uncertain=own,
        dof=dof,
        correlations=strong_correlations(design.names, own.covariance),
        worth_adding=_worth_adding(design, positions, budget, own.u, level=level),
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


def _budget(
    design: Design,
    positions: Sequence[PlannedPosition],
    *,
    noise: float,
    sensitivity: float,
    drift: float,
    adc: float,
    sensors: int,
) -> tuple[Uncertain, int]:
    """Return the uncertainty that a plan leaves, and its degrees of freedom, with all unknowns as in the data sheet."""
    if design.free:
        gravity = np.array([position.gravity for position in positions])
        return planned_uncertain(gravity, float(np.hypot(noise, adc)), sensitivity), len(positions) - UNKNOWNS
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
    equations = Equations(plan)
    z = _nominal(design, equations, sensitivity, drift)
    require_determined(equations, z)
    solution = solved_at(equations, z)
    return budgets(solution, {})[0], solution.dof


def _nominal(design: Design, equations: Equations, sensitivity: float, drift: float) -> Array:
    """Return the coefficients of a usual part: each channel senses its own axis alone."""
    nominal: Mapping[str, float] = {
        **{f"sensitivity.{channel}.{channel}": sensitivity for channel in design.channels},
        **{f"temperature.offset.{channel}.1": drift for channel in design.channels},
    }
    z = equations.start()
    for column, name in enumerate(equations.names):
        if name in nominal and not np.isfinite(equations.prior_u[column]):
            z[column] = nominal[name]
    return z


def _worth_adding(
    design: Design,
    positions: Sequence[PlannedPosition],
    budget: Callable[[Sequence[PlannedPosition]], tuple[Uncertain, int]],
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
        after = budget([*positions, candidate])[0].u
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
