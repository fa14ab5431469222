"""The plan of a session: what its positions leave undetermined, which to add, and the uncertainty that it will reach.

The same equations as the estimator's, at nominal coefficients: their covariance needs no readings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from tiltcal.core.angle_readings import reads_steep
from tiltcal.core.attitude import Vector, gravity_from_tilt
from tiltcal.core.estimation.equations import ChannelReadings, Equations
from tiltcal.core.estimation.free import UNKNOWNS, planned_uncertain
from tiltcal.core.estimation.positions import Design, Observation, SensorObservations
from tiltcal.core.estimation.solve import UNDETERMINED, budgets, solved_at, undetermined
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.uncertain import Uncertain
from tiltcal.errors import EstimateError

UNSEEN = 1e-12  # a derivative below this share of the largest is what rounding leaves of zero
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
        seen = size > UNSEEN * size.max(initial=0.0)
        rows = np.vstack([rows, np.diag(np.where(seen, size, 1.0))[np.isfinite(u)]])  # what is stated beside them
        mixed = undetermined(rows[:, moving], np.array(channel.model.coefficients)[moving].tolist())
        if not mixed:
            continue
        theta, certain = z[channel.coefficients], np.eye(len(u))[~moving]
        add = _positions_to_add(channel, theta, gravity, np.vstack([rows, certain]))
        advice = f"add the position{'' if len(add) == 1 else 's'} {listed(add)}"
        advice = advice if add else "add positions that differ from these"
        if len(mixed) == 1:
            raise EstimateError(f"no position determines {mixed[0]}: {advice}")
        raise EstimateError(f"the {len(channel.dt)} positions do not separate {listed(mixed)}: {advice}")


def _positions_to_add(channel: ChannelReadings, theta: Array, gravity: Array, rows: Array) -> list[str]:
    """Return the few positions that determine a channel beside some rows, (rows, coefficients), the best first."""
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
        if not reads_steep(channel.model.angles, up[AXES.index(channel.model.name)]):
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


def listed(names: Sequence[str], link: str = "and") -> str:
    """Return names in words."""
    return f" {link} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


# What a plan will reach


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


def predict_uncertainty(
    design: Design,
    positions: Sequence[Observation],
    *,
    sensitivity: float,
    drift: float = 0.0,
    sensors: int = 1,
    level: bool = False,
    proposing: bool = True,
) -> Prediction:
    """Compute the uncertainty that a planned session will reach for each of some equal sensors.

    A jig that is not stated counts as perfect. ``positions`` have the uncertainties of their means, whatever these are;
    ``sensitivity`` is nominal, unit/g; ``drift`` is that of a usual part, unit/°C, by which an error of the thermometer
    counts; of a ``level`` procedure no other direction is proposed, and nothing where not ``proposing``. An
    EstimateError names coefficients that the plan leaves undetermined, and a position that would determine them.
    """
    sensitivity = sensitivity if design.angles is None else design.angles.per_degree(sensitivity)
    nominal = {
        **{f"sensitivity.{channel}.{channel}": sensitivity for channel in design.channels},
        **{f"temperature.offset.{channel}.1": drift for channel in design.channels},
        **{name: prior.value for name, prior in design.priors.items()},
    }
    theta = np.array([nominal.get(name, 0.0) for name in design.names])
    as_stated = replace(design, jig=design.jig or 0.0)

    def reached(planned: Sequence[Observation]) -> tuple[Uncertain, int]:
        if design.free:
            gravity = np.array([position.gravity for position in planned])
            return planned_uncertain(gravity, float(planned[0].u[0]), sensitivity), len(planned) - UNKNOWNS
        equations = Equations([SensorObservations(as_stated, planned)] * sensors)
        z = np.zeros(equations.unknowns)
        z[: len(equations.names)] = np.tile(theta, sensors)
        require_determined(equations, z)
        solution = solved_at(equations, z)
        return budgets(solution)[0], solution.dof

    uncertain, dof = reached(positions)
    fixed = (uncertain.u == 0.0) | np.array([name in design.priors for name in design.names])
    worth = []
    for candidate in _worth_trying(design, positions, level=level) if proposing else ():
        u, _ = reached([*positions, candidate])
        share = np.where(fixed, 1.0, u.u / np.where(uncertain.u > 0.0, uncertain.u, 1.0))
        most = int(np.argmin(np.round(share, 6)))
        if share[most] < WORTH:
            worth.append((candidate.position, design.names[most], round(float(share[most]), 3)))
    coefficients = SensorObservations(design, positions).coefficients(theta)
    return Prediction(coefficients, uncertain, dof, tuple(sorted(worth, key=itemgetter(2))))


def _worth_trying(design: Design, positions: Sequence[Observation], *, level: bool) -> Iterator[Observation]:
    """Yield positions, temperatures and turns that may make some coefficient much better known."""
    first, met = positions[0], [one.temperature for one in positions if one.temperature is not None]
    first = replace(first, temperature=met[0] if met else None)
    for name, gravity in CANDIDATES.items():
        if any(reads_steep(design.angles, gravity[AXES.index(channel)]) for channel in design.channels):
            continue
        if not level and (any(gravity[AXES.index(axis)] for axis in design.axes) or not design.axes):
            yield replace(first, position=name, gravity=np.array(gravity))
    if design.thermal and met and not level:
        for temperature in (max(met) + WARMER, min(met) - WARMER):
            name = f"level at {temperature:g} °C"
            yield replace(first, position=name, gravity=np.array(CANDIDATES[LEVEL]), temperature=temperature)
    if design.table_lean is not None:
        turned = f"{first.position} with the fixture turned by 180°"
        yield replace(positions[0], position=turned, heading=(first.heading or 0.0) + 180.0)
