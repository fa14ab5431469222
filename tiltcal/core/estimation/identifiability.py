"""Identifiability: whether positions determine the coefficients, and which position to add where they do not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.linalg import svd
from numpy.typing import NDArray

from tiltcal.core.estimation.equations import Equations
from tiltcal.core.gravity_direction import Vector, gravity_from_tilt
from tiltcal.core.model import Array, ChannelModel
from tiltcal.errors import EstimateError

UNDETERMINED = 1e-9
"""A singular value below this share of the largest, with columns scaled to one, counts as zero."""

NAMED_PART = 0.1
"""Coefficients with at least this part in an undetermined combination are named."""

MOST_POSITIONS = 3
"""Positions that may be proposed to be added."""

WARMER = 20.0
"""How much another temperature that is proposed differs, °C."""

CANDIDATES: dict[str, Vector] = {
    "level (+z up)": (0.0, 0.0, 1.0),
    "upside down (+z down)": (0.0, 0.0, -1.0),
    "+x straight up": (1.0, 0.0, 0.0),
    "+x straight down": (-1.0, 0.0, 0.0),
    "+y straight up": (0.0, 1.0, 0.0),
    "+y straight down": (0.0, -1.0, 0.0),
    **{f"{angle:+}° of {axis}": gravity_from_tilt({axis: float(angle)}) for axis in ("x", "y") for angle in (45, -45)},
}
"""Positions that may be proposed."""


def require_determined(equations: Equations, z: Array) -> None:
    """Refuse positions that leave a combination of coefficients free, whatever the jig.

    Parameters
    ----------
    z : ndarray, shape (unknowns,)
        Where the coefficients are near their minimum.

    Raises
    ------
    EstimateError
        Names the coefficients, and a position that would separate them.
    """
    for channel in equations.channels:
        model, dt = channel.model, channel.dt
        gravity = equations.gravity[channel.places] @ channel.orientation.T
        theta, prior_u = z[channel.coefficients], equations.prior_u[channel.coefficients]
        rows = _with_priors(model.read(theta, gravity, dt).by_coefficient, prior_u)
        moving = prior_u > 0.0
        mixed = undetermined(rows[:, moving], np.array(model.coefficients)[moving].tolist())
        if not mixed:
            continue
        advice = _advice(model, theta, gravity, dt, rows, moving)
        if len(mixed) == 1:
            raise EstimateError(f"no position determines {mixed[0]}: {advice}")
        raise EstimateError(f"the {len(dt)} positions do not separate {_listed(mixed)}: {advice}")


def undetermined(jacobian: Array, names: Sequence[str]) -> list[str]:
    """Return the coefficients that a Jacobian, shape (rows, coefficients), leaves free: one, a combination, or none."""
    if not names:
        return []
    size = np.linalg.norm(jacobian, axis=0)
    unseen = [name for name, length in zip(names, size, strict=True) if length <= 1e-12 * size.max()]
    if unseen:
        return unseen[:1]
    _, values, vectors = svd(jacobian / size, full_matrices=True)
    rank = int(np.sum(values > UNDETERMINED * values[0]))
    if rank == len(names):
        return []
    return [name for name, part in zip(names, vectors[rank], strict=True) if abs(part) > NAMED_PART]


def _positions_to_add(model: ChannelModel, theta: Array, gravity: Array, dt: Array, rows: Array) -> list[str]:
    """Return positions that would determine all coefficients of a channel, in words, the most informative first.

    There is none where no few positions do.

    Parameters
    ----------
    theta : ndarray, shape (coefficients,)
    gravity : ndarray, shape (positions, 3)
        Up in the sensor frame, g.
    dt : ndarray, shape (positions,)
        Temperature of each position from the reference, °C.
    rows : ndarray, shape (rows, coefficients)
        What is there already: the positions' derivatives, and priors.
    """
    chosen: list[str] = []
    candidates = dict(_candidates(model, theta, gravity, dt))
    for _ in range(MOST_POSITIONS):
        if not undetermined(rows, model.coefficients):
            return chosen
        best = max(candidates, key=lambda name: _strength(np.vstack([rows, candidates[name]])))
        chosen.append(best)
        rows = np.vstack([rows, candidates.pop(best)])
    return [] if undetermined(rows, model.coefficients) else chosen


def _advice(
    model: ChannelModel, theta: Array, gravity: Array, dt: Array, rows: Array, moving: NDArray[np.bool_]
) -> str:
    held = np.vstack([rows, np.eye(len(theta))[~moving]])
    proposed = _positions_to_add(model, theta, gravity, dt, held)
    if not proposed:
        return "add positions that differ from these"
    return f"add the position{'' if len(proposed) == 1 else 's'} {_listed(proposed)}"


def _candidates(model: ChannelModel, theta: Array, gravity: Array, dt: Array) -> Iterator[tuple[str, Array]]:
    """Yield the row of the Jacobian for each position that may be proposed."""
    usual = float(dt[0]) if len(dt) else 0.0
    # A gain has no effect before the sensitivity is known; any value will do to see whether a position shows it.
    theta = theta.copy()
    own = model.split(theta)[0]
    if not np.any(own):
        theta[1 : 1 + len(own)] = 1.0
    for name, direction in CANDIDATES.items():
        yield name, model.read(theta, np.array([direction]), np.array([usual])).by_coefficient
    if not (model.drift or model.gain):
        return
    spread = [float(dt.max()) + WARMER, float(dt.min()) - WARMER, float(dt.min() + dt.max()) / 2 + 1.0]
    there = {tuple(row) for row in gravity.tolist()}
    for number, temperature in enumerate(spread):
        words = ("at another, higher temperature", "at another, lower temperature", "at a third temperature between")
        for row in there:
            known = next((name for name, g in CANDIDATES.items() if np.allclose(g, row)), f"{_direction(row)}")
            yield f"{known} {words[number]}", model.read(theta, np.array([row]), np.array([temperature])).by_coefficient


def _strength(rows: Array) -> tuple[int, float]:
    """Return the rank, and the smallest singular value that counts."""
    size = np.linalg.norm(rows, axis=0)
    values = svd(rows / np.where(size > 0, size, 1.0), compute_uv=False)
    counted = values[values > UNDETERMINED * values[0]]
    return len(counted), round(float(counted[-1]), 9)


def _with_priors(jacobian: Array, u: Array) -> Array:
    """Return the rows of a channel's readings and of its coefficients' priors, on a common scale."""
    size = np.linalg.norm(jacobian, axis=0)
    return np.vstack([jacobian, np.diag(np.where(size > 0, size, 1.0))[np.isfinite(u)]])


def _direction(row: Sequence[float]) -> str:
    return "gravity [" + ", ".join(f"{component:.3g}" for component in row) + "]"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
