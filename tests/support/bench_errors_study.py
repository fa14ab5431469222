"""Simulated calibrations with the errors of a bench that all positions share, and readings that are coarse or lag.

Gravity is turned by scipy's rotations: up in the table's frame, by its lean, the heading, the tilt and the jig's error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from support.simulated_bench import BLOCK_DOF, FACES, POSITIONS, XYZ, Part, part
from tiltcal.calibration.joint_fit import with_hysteresis
from tiltcal.core.estimation.covariance import stated_budgets
from tiltcal.core.estimation.design import Design, Observation, SensorObservations
from tiltcal.core.estimation.elimination import linearised
from tiltcal.core.estimation.estimate import estimate
from tiltcal.core.estimation.fixture_equations import system_of
from tiltcal.core.estimation.pooling import noise_of_means, pooled
from tiltcal.core.statistics import summarise

Array = NDArray[np.float64]

NOISE, JIG = 1e-4, 0.02
"""Of a position's mean, g, and of a set angle, degrees."""

LEAN, HEADING = 0.2, 1.0
"""Standard deviations of the table's lean and of a heading, degrees."""

STEP, SAMPLES, LOOP = 1e-3, 50, 5e-4
"""Of a coarse converter, g; a position's samples, whose noise is a fifth of the step; width of the loop, g."""

KINDS = ("lean", "heading", "coarse converter", "loop")


@dataclass(frozen=True)
class Regime:
    """One bench: which error it has, and whether the jig is stated."""

    kind: str
    stated: bool


REGIMES = tuple(Regime(*one) for one in product(KINDS, (True, False)))


def calibrated(rng: Generator, regime: Regime) -> tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]]]:
    """One calibration: by class, the share of intervals that hold the truth and 1; squares of the errors and bounds."""
    truth = part(rng, 2 if regime.kind == "loop" else 0)
    observations, wanted = _measured(rng, regime.kind, truth)
    found = estimate(observations, wanted if regime.stated else replace(wanted, jig=None))
    if regime.kind == "loop":
        found = with_hysteresis(found, observations)
    values = found.coefficients.vectors.ravel() - truth.truth
    inside = np.abs(values) <= found.budget.factors * found.budget.u
    bound = _bound(observations, wanted, truth) if regime.kind in ("lean", "heading") else np.full(len(values), np.nan)
    kinds = np.array([_class(name) for name in found.names])
    shares, squares = {}, {}
    for name in dict.fromkeys(kinds.tolist()):
        rows = kinds == name
        shares[name] = (float(inside[rows].mean()), 1.0)
        squares[name] = (float(np.sum(values[rows] ** 2)), float(np.sum(bound[rows])))
    return shares, squares


def _class(name: str) -> str:
    words = name.split(".")
    if words[0] == "sensitivity":
        return "own" if words[1] == words[2] else "cross"
    return "drift" if words[0] == "temperature" else words[0]


def _measured(rng: Generator, kind: str, truth: Part) -> tuple[list[Observation], Design]:
    """The readings of one session, and the design with everything stated."""
    wanted = Design(XYZ, XYZ, jig=JIG)
    if kind == "loop":
        warm = np.linspace(-20.0, 30.0, 6)
        gravity = np.vstack([FACES, np.tile(FACES[4], (11, 1))])
        temperature = np.concatenate([np.zeros(6), warm, warm[-2::-1]])
        real = Rotation.from_rotvec(np.radians(JIG) * rng.standard_normal((7, 3))[[*range(6), *[6] * 11]]).apply(
            gravity
        )
        # The truth is anywhere between the two ways.
        between = rng.uniform(0.0, 1.0, 3)
        way = np.concatenate([np.zeros(6), np.full(6, -1.0), np.ones(5)])
        loop = LOOP * np.where(way[:, None] < 0, -between, np.where(way[:, None] > 0, 1.0 - between, 0.0))
        mean = truth.reading(real, temperature) + loop + NOISE * rng.standard_normal((17, 3))
        observations = _observed(rng, gravity, mean, temperature=temperature)
        return [replace(one, held=k > 6) for k, one in enumerate(observations)], replace(wanted, drift=2)
    gravity = POSITIONS[12]
    lean, headings, off = np.zeros(2), np.zeros(12), np.zeros(12)
    if kind in ("lean", "heading"):
        lean = np.radians(LEAN) * rng.standard_normal(2)
        wanted = replace(wanted, table=LEAN)
    if kind == "heading":
        headings = np.tile([0.0, 180.0], 6)
        off = HEADING * rng.standard_normal(12)
        wanted = replace(wanted, table=None, heading=HEADING)
        lean *= 5.0
    up = Rotation.from_rotvec([-lean[1], lean[0], 0.0]).apply([0.0, 0.0, 1.0])
    on_table = Rotation.from_rotvec(np.radians(-(headings + off))[:, None] * [0.0, 0.0, 1.0]).apply(up)
    axis = np.cross([0.0, 0.0, 1.0], gravity)
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    tilted = Rotation.from_rotvec(axis / np.where(size > 0.0, size, 1.0) * np.arccos(gravity[:, 2:]))
    jig = Rotation.from_rotvec(np.radians(JIG) * rng.standard_normal((12, 3)))
    mean = truth.reading(jig.apply(tilted.apply(on_table)), np.zeros(12))
    if kind == "coarse converter":
        return _rounded(rng, gravity, mean), wanted
    return _observed(rng, gravity, mean + NOISE * rng.standard_normal(mean.shape), headings=headings), wanted


def _observed(
    rng: Generator, gravity: Array, mean: Array, *, headings: Array | None = None, temperature: Array | None = None
) -> list[Observation]:
    """Positions whose noise is known from ten block means."""
    u, dof = np.empty(mean.shape), np.empty(mean.shape)
    for channel in range(mean.shape[1]):
        drawn = NOISE**2 * rng.chisquare(BLOCK_DOF, len(mean)) / BLOCK_DOF
        variance, dof[:, channel] = pooled(drawn, np.full(len(mean), BLOCK_DOF))
        u[:, channel] = np.sqrt(variance)
    return [
        Observation(
            f"p{k}",
            up,
            mean[k],
            u[k],
            None if temperature is None else float(temperature[k]),
            None if headings is None else float(headings[k]),
            dof=dof[k],
        )
        for k, up in enumerate(gravity)
    ]


def _rounded(rng: Generator, gravity: Array, mean: Array) -> list[Observation]:
    """Positions sampled by a converter that is coarser than the noise."""
    noise = 0.2 * STEP * rng.standard_normal((SAMPLES, *mean.shape))
    samples = STEP * np.rint((mean + noise) / STEP)
    columns = []
    for channel in range(mean.shape[1]):
        summaries = [summarise(one, STEP) for one in samples[:, :, channel].T.tolist()]
        variance, dof, rounding = noise_of_means(summaries)
        columns.append((np.array([one.mean for one in summaries]), np.sqrt(variance + rounding**2), dof, rounding))
    means, u, dof, adc = (np.stack(one, axis=1) for one in zip(*columns, strict=True))
    return [Observation(f"p{k}", up, means[k], u[k], dof=dof[k], adc=adc[k]) for k, up in enumerate(gravity)]


def _bound(observations: list[Observation], wanted: Design, truth: Part) -> Array:
    """The Cramér-Rao bound's variances, with everything stated and the noise known."""
    known = [replace(one, u=np.full(3, NOISE), dof=None) for one in observations]
    system = system_of([SensorObservations(wanted, known)])
    z = np.zeros(system.unknowns)
    z[: system.coefficients] = truth.truth
    return np.asarray(np.diag(stated_budgets(linearised(system, z))[0].covariance))
