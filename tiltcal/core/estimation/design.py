"""The plan of a session: what its positions leave undetermined, which to add, and the uncertainty that it will reach.

The same equations as the estimator's, at nominal coefficients: their covariance needs no readings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from tiltcal.core.attitude import Vector, gravity_from_tilt
from tiltcal.core.estimation.equations import ChannelReadings, Equations
from tiltcal.core.estimation.free import UNKNOWNS, planned_uncertain
from tiltcal.core.estimation.positions import Design, Observation, SensorObservations, require_sound
from tiltcal.core.estimation.solve import UNDETERMINED, budgets, solved_at, undetermined
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.uncertain import Uncertain
from tiltcal.errors import EstimateError

MOST_POSITIONS = 3  # positions that may be proposed to be added to those that leave coefficients undetermined
WARMER = 20.0  # how much another temperature that is proposed differs, °C
WORTH = 0.8  # a position is proposed where it brings the largest uncertainty below this share of what it was

LEVEL = "level (+z up)"
CANDIDATES: dict[str, Vector] = {
    LEVEL: (0.0, 0.0, 1.0),
    "upside down (+z down)": (0.0, 0.0, -1.0),
    "+x straight up": (1.0, 0.0, 0.0),
    "+x straight down": (-1.0, 0.0, 0.0),
    "+y straight up": (0.0, 1.0, 0.0),
    "+y straight down": (0.0, -1.0, 0.0),
    **{f"{axis} at {angle:+}°": gravity_from_tilt({axis: float(angle)}) for axis in ("x", "y") for angle in (45, -45)},
}
"""Positions that may be proposed."""


# What is missing


def require_determined(equations: Equations, z: Array) -> None:
    """Refuse positions that leave a combination of coefficients free, whatever the jig.

    ``z`` are the unknowns near their minimum, shape (unknowns,). The EstimateError names the coefficients, and
    positions that would separate them.
    """
    for channel in equations.channels:
        u = equations.prior_u[channel.coefficients]
        moving = u > 0.0
        gravity = equations.gravity[channel.places] @ channel.orientation.T
        rows = channel.model.read(z[channel.coefficients], gravity, channel.dt).by_coefficient
        size = np.linalg.norm(rows, axis=0)
        rows = np.vstack([rows, np.diag(np.where(size > 0, size, 1.0))[np.isfinite(u)]])  # what is stated beside them
        mixed = undetermined(rows[:, moving], np.array(channel.model.coefficients)[moving].tolist())
        if not mixed:
            continue
        theta, certain = z[channel.coefficients], np.eye(len(u))[~moving]
        add = _positions_to_add(channel, theta, gravity, np.vstack([rows, certain]))
        advice = f"add the position{'' if len(add) == 1 else 's'} {_listed(add)}"
        advice = advice if add else "add positions that differ from these"
        if len(mixed) == 1:
            raise EstimateError(f"no position determines {mixed[0]}: {advice}")
        raise EstimateError(f"the {len(channel.dt)} positions do not separate {_listed(mixed)}: {advice}")


def _positions_to_add(channel: ChannelReadings, theta: Array, gravity: Array, rows: Array) -> list[str]:
    """Return the few positions that determine a channel beside some rows, (rows, coefficients), the best first."""
    sensitivities = slice(1, 1 + len(channel.model.axes))
    if not theta[sensitivities].any():
        # A gain has no effect before the sensitivity is known; any value will do to see whether a position shows it.
        theta = theta.copy()
        theta[sensitivities] = 1.0
    candidates = {
        name: channel.model.read(theta, np.array([up]), np.array([dt])).by_coefficient
        for name, up, dt in _candidates(channel, gravity)
    }
    add: list[str] = []
    while undetermined(rows, channel.model.coefficients) and len(add) < MOST_POSITIONS:
        add.append(max(candidates, key=lambda name: _strength(np.vstack([rows, candidates[name]]))))
        rows = np.vstack([rows, candidates.pop(add[-1])])
    return [] if undetermined(rows, channel.model.coefficients) else add


def _candidates(channel: ChannelReadings, gravity: Array) -> Iterator[tuple[str, Sequence[float], float]]:
    """Yield positions that may be added, in words, with up in the sensor frame and °C from the reference."""
    low, high = float(channel.dt.min()), float(channel.dt.max())
    for name, up in CANDIDATES.items():
        yield name, up, float(channel.dt[0])
    if not (channel.model.drift or channel.model.gain):
        return
    for words, dt in (
        ("at another, higher temperature", high + WARMER),
        ("at another, lower temperature", low - WARMER),
        ("at a third temperature between", (low + high) / 2 + 1.0),
    ):
        for met in {tuple(up) for up in gravity.tolist()}:
            in_words = "gravity [" + ", ".join(f"{component:.3g}" for component in met) + "]"
            name = next((name for name, up in CANDIDATES.items() if np.allclose(up, met)), in_words)
            yield f"{name} {words}", met, dt


def _strength(rows: Array) -> tuple[int, float]:
    """Return the rank, and the smallest singular value that counts."""
    size = np.linalg.norm(rows, axis=0)
    values = np.linalg.svd(rows / np.where(size > 0, size, 1.0), compute_uv=False)
    counted = values[values > UNDETERMINED * values[0]]
    return len(counted), round(float(counted[-1]), 9)


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


# What a plan will reach


@dataclass(frozen=True)
class PlannedPosition:
    """Position of a planned session: up in the sensor frame, g; °C; degrees; ``held`` stands as the one before."""

    name: str
    gravity: Vector
    temperature: float | None = None
    heading: float | None = None
    held: bool = False


@dataclass(frozen=True)
class Prediction:
    """Uncertainty that a planned session will reach in named coefficients, and degrees of freedom to check them.

    ``coefficients`` are the nominal ones. ``worth_adding`` has a position, the coefficient that it helps most, and the
    share of its uncertainty that is left, best first.
    """

    coefficients: Coefficients
    uncertain: Uncertain
    dof: int
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
    nominal = {
        **{f"sensitivity.{channel}.{channel}": sensitivity for channel in design.channels},
        **{f"temperature.offset.{channel}.1": drift for channel in design.channels},
    }
    u = max(float(np.hypot(noise, adc)), 1e-12 * abs(sensitivity))

    def reached(planned: Sequence[PlannedPosition]) -> tuple[Uncertain, int]:
        if design.free:
            gravity = np.array([position.gravity for position in planned])
            return planned_uncertain(gravity, u, sensitivity), len(planned) - UNKNOWNS
        plan = [_sensor(replace(design, jig=design.jig or 0.0), planned, u, adc)] * sensors
        require_sound(plan)
        equations = Equations(plan)
        z = np.zeros(equations.unknowns)
        z[: len(equations.names)] = [
            prior if np.isfinite(stated) else nominal.get(name, 0.0)
            for name, prior, stated in zip(equations.names, equations.prior_value, equations.prior_u, strict=True)
        ]
        require_determined(equations, z)
        solution = solved_at(equations, z)
        return budgets(solution, {})[0], solution.dof

    uncertain, dof = reached(positions)
    known = {name: prior.value for name, prior in design.priors.items()}
    theta = np.array([known.get(name, nominal.get(name, 0.0)) for name in design.names])
    return Prediction(
        coefficients=_sensor(design, positions, u, adc).coefficients(theta),
        uncertain=uncertain,
        dof=dof,
        worth_adding=_worth_adding(design, positions, lambda plan: reached(plan)[0].u, uncertain.u, level=level),
    )


def _sensor(design: Design, positions: Sequence[PlannedPosition], u: float, adc: float) -> SensorObservations:
    """Return a sensor whose readings in planned positions are 0, with their standard uncertainty, unit."""
    mean = np.zeros(len(design.channels))
    observations = [
        Observation(one.name, np.array(one.gravity), mean, mean + u, one.temperature, one.heading, one.held, adc=adc)
        for one in positions
    ]
    return SensorObservations(design, observations)


def _worth_adding(
    design: Design,
    positions: Sequence[PlannedPosition],
    reached: Callable[[Sequence[PlannedPosition]], Array],
    before: Array,
    *,
    level: bool,
) -> tuple[tuple[str, str, float], ...]:
    """Return positions, temperatures and turns that would make some coefficient much better known, best first."""
    first, met = positions[0], [one.temperature for one in positions if one.temperature is not None]
    usual = met[0] if met else None
    candidates = [
        PlannedPosition(name, gravity, usual, first.heading)
        for name, gravity in CANDIDATES.items()
        if any(abs(gravity[AXES.index(axis)]) > 0.0 for axis in design.axes) or not design.axes
    ]
    if design.thermal and met:
        candidates += [
            PlannedPosition(f"level at {temperature:g} °C", CANDIDATES[LEVEL], temperature, first.heading)
            for temperature in (max(met) + WARMER, min(met) - WARMER)
        ]
    candidates = [] if level else candidates
    if design.table is not None:
        turned, heading = f"{first.name} with the fixture turned by 180°", (first.heading or 0.0) + 180.0
        candidates.append(replace(first, name=turned, heading=heading, held=False))
    fixed = (before == 0.0) | np.array([name in design.priors for name in design.names])
    worth = []
    for candidate in candidates:
        share = np.where(fixed, 1.0, reached([*positions, candidate]) / np.where(before > 0.0, before, 1.0))
        most = int(np.argmin(np.round(share, 6)))
        if share[most] < WORTH:
            worth.append((candidate.name, design.names[most], round(float(share[most]), 3)))
    return tuple(sorted(worth, key=itemgetter(2)))
