"""Simulated calibrations: how often the stated interval holds the truth, and how near the errors are to the bound.

Gravity is turned by scipy's rotations, correlated noise is filtered by scipy, and readings are written out. From the
same readings the estimator works with the jig stated and with the jig not stated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from math import inf, sqrt
from zlib import crc32

import numpy as np
import scipy
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.simulated_bench import (
    BLOCK_DOF,
    FACES,
    LEVEL,
    POSITIONS,
    Part,
    Plan,
    design,
    fixture,
    measured,
    part,
    plan_of,
    sweep,
    two_temperatures,
)
from support.uncertain_readings import uncertain_readings

from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.core.compensation import Compensation
from tiltcal.core.estimation.equations import Equations
from tiltcal.core.estimation.estimate import Estimate, estimate_jointly, with_hysteresis
from tiltcal.core.estimation.positions import Design, Observation
from tiltcal.core.estimation.solve import budgets, solved_at
from tiltcal.core.samples import SampleSummary, correlated_noise, noise_of_means, pooled, summarise

Array = NDArray[np.float64]
Sums = dict[str, list[float]]
"""By class of coefficient: the share of intervals that hold the truth, the mean square error, the bound's variance."""

NOISE, JIG = 1e-4, 0.02
"""Of a position's mean, g, and of a set angle, degrees, where nothing else is said."""

LEAN, HEADING = 0.2, 1.0
"""Standard deviations of the table's lean and of a heading, degrees."""

STEP, SAMPLES, LOOP = 1e-3, 50, 5e-4
"""Of a coarse converter, g; a position's samples, whose noise is a fifth of the step; width of the loop, g."""

REACH = 60.0
"""Tilts that a calibration is tried on, degrees."""

CROSS_OF_TILTS = ({}, {"x": 30.0}, {"x": -30.0}, {"y": 30.0}, {"y": -30.0})
SQUARE_OF_TILTS = tuple({"x": sx * 25.0, "y": sy * 25.0} for sx in (1, -1) for sy in (1, -1))


@dataclass(frozen=True)
class SimulatedSession:
    """What one session measured of each sensor, the design with everything stated, and the truth."""

    observations: list[list[Observation]]
    design: Design
    parts: list[Part]
    bounded: bool = True  # whether noise is normal and known to be NOISE or the plan's: there is a Cramér-Rao bound
    plan: Plan | None = None  # None where no tilt is tried on the calibration
    lean: tuple[float, ...] = (0.0, 0.0)  # of the table, radians: with none, a heading that is off does nothing


@dataclass(frozen=True)
class Regime:
    """One bench: what it is called, how a session there is drawn, and how many sensors it has."""

    name: str
    draw: Callable[[Generator], SimulatedSession]
    sensors: int = 1

    def rng(self, piece: int) -> Generator:
        """Return the random numbers of one piece of the study."""
        return np.random.default_rng([piece, self.sensors, crc32(self.name.encode())])


@dataclass
class Tally:
    """The results of many sessions, by class of coefficient."""

    sums: dict[str, list[list[float]]] = field(default_factory=dict)

    def add(self, sums: Sums) -> None:
        """Add one session."""
        for name, values in sums.items():
            self.sums.setdefault(name, []).append(values)

    def percent(self, name: str) -> tuple[float, float]:
        """Return the share of intervals that hold the truth and its Monte Carlo error, %."""
        shares = 100.0 * np.array([values[0] for values in self.sums[name]])
        return float(shares.mean()), float(shares.std(ddof=1) / sqrt(len(shares)))

    def efficiency(self, name: str) -> tuple[float, float]:
        """Return the Cramér-Rao bound over the mean square error and its Monte Carlo error; NaN without a bound."""
        _, squares, bounds = np.array(self.sums[name], dtype=float).T
        known = bounds[np.isfinite(bounds)]
        ratio = known.mean() / squares.mean() if len(known) else np.nan
        return float(ratio), float(ratio * squares.std(ddof=1) / squares.mean() / sqrt(len(squares)))


def regimes() -> list[Regime]:
    """Return all benches that are tried."""
    cubes = [(count, jig, 1, NOISE) for jig, count in product((0.0, 0.02, 0.1, 0.5), (6, 12, 26))]
    cubes += [(count, jig, 6, NOISE) for jig, count in product((0.02, 0.5), (6, 12))]
    cubes += [(count, jig, 1, 5 * NOISE) for jig, count in product((0.02, 0.1), (6, 12))]
    found = [
        Regime(
            f"{count} positions, jig {jig:g}°, noise {1e3 * noise:g} mg",
            partial(planned, plan=plan_of(count, noise=noise, jig=jig), sensors=sensors),
            sensors,
        )
        for count, jig, sensors, noise in cubes
    ]
    for tilts, jig in product((CROSS_OF_TILTS, CROSS_OF_TILTS + SQUARE_OF_TILTS), (0.0, 0.006, 0.02, 0.1)):
        name = f"2 axes, {2 * len(tilts) - 6} degrees of freedom, jig {jig:g}°"
        found.append(Regime(name, partial(planned, plan=two_axes(tilts, jig))))
    for make, jig in product((two_temperatures, sweep), (0.02, 0.5)):
        name = f"{make.__name__.replace('_', ' ')}, jig {jig:g}°"
        found.append(Regime(name, partial(planned, plan=make(NOISE, jig))))
    found += [Regime(name, draw) for name, draw in BENCH_ERRORS.items()]
    return found


def sessions(regime: Regime, piece: int, count: int, stated: tuple[bool, ...] = (True, False)) -> Iterator[list[Sums]]:
    """Simulate sessions and calibrate each with the jig stated and not; the bound is in those of the first piece."""
    rng = regime.rng(piece)
    for _ in range(count):
        session = regime.draw(rng)
        bound = _bound(session) if session.bounded and piece == 0 else None
        yield [_calibrated(rng, session, bound, one) for one in stated]


def simulate(regime: Regime, count: int, seed: int, *, stated: bool) -> Tally:
    """Simulate sessions of one bench."""
    tally = Tally()
    for (sums,) in sessions(regime, seed, count, (stated,)):
        tally.add(sums)
    return tally


# Sessions


def planned(rng: Generator, plan: Plan, sensors: int = 1) -> SimulatedSession:
    """Return a session of a plan, whose noise is known from ten block means a position."""
    parts = [part(rng, plan.drift, len(plan.axes)) for _ in range(sensors)]
    observations = measured(rng, plan, parts, known_noise=False)
    return SimulatedSession(observations, design(plan, jig=plan.jig), parts, plan=plan)


def two_axes(tilts: tuple[dict[str, float], ...], jig: float) -> Plan:
    """Return the plan of an inclinometer of two axes on a tilt table."""
    gravity = np.array([gravity_from_tilt(tilt) for tilt in tilts])
    return Plan(gravity, np.zeros(len(gravity)), noise=NOISE, jig=jig, axes=("x", "y"))


def leaning_table(rng: Generator) -> SimulatedSession:
    """Return twelve positions at one heading on a table whose lean is stated."""
    truth, lean = part(rng), np.radians(LEAN) * rng.standard_normal(2)
    mean = truth.reading(_seen(rng, lean, np.zeros(12)), np.zeros(12)) + NOISE * rng.standard_normal((12, 3))
    wanted = replace(design(plan_of(12, noise=NOISE, jig=JIG), jig=JIG), table_lean=LEAN)
    return SimulatedSession([_observed(rng, POSITIONS[12], mean, np.zeros(12))], wanted, [truth])


def wrong_headings(rng: Generator) -> SimulatedSession:
    """Return twelve positions at two headings, which are off, on a table of which nothing is said."""
    truth, lean = part(rng), np.radians(5.0 * LEAN) * rng.standard_normal(2)
    headings = np.tile([0.0, 180.0], 6)
    seen = _seen(rng, lean, headings + HEADING * rng.standard_normal(12))
    mean = truth.reading(seen, np.zeros(12)) + NOISE * rng.standard_normal((12, 3))
    wanted = replace(design(plan_of(12, noise=NOISE, jig=JIG), jig=JIG), heading=HEADING)
    return SimulatedSession([_observed(rng, POSITIONS[12], mean, headings)], wanted, [truth], lean=tuple(lean))


def coarse_converter(rng: Generator) -> SimulatedSession:
    """Return twelve positions sampled by a converter that is coarser than the noise."""
    truth, plan = part(rng), plan_of(12, noise=NOISE, jig=JIG)
    mean = truth.reading(_seen(rng, np.zeros(2), np.zeros(12)), np.zeros(12))
    samples = STEP * np.rint((mean + 0.2 * STEP * rng.standard_normal((SAMPLES, 12, 3))) / STEP)
    return SimulatedSession([_summarised(plan, samples, STEP)], design(plan, jig=JIG), [truth], bounded=False)


def hysteresis_loop(rng: Generator) -> SimulatedSession:
    """Return six faces, then level through a loop of temperatures; the truth is anywhere between its two ways."""
    warm = np.linspace(-20.0, 30.0, 6)
    temperature = np.concatenate([np.zeros(6), warm, warm[-2::-1]])
    plan = Plan(np.vstack([FACES, np.tile(LEVEL, (11, 1))]), temperature, tuple(range(7, 17)), NOISE, JIG, drift=2)
    truth, between = part(rng, 2), rng.uniform(0.0, 1.0, 3)
    way = np.concatenate([np.zeros(6), np.full(6, -1.0), np.ones(5)])[:, None]
    loop = LOOP * np.where(way < 0, -between, np.where(way > 0, 1.0 - between, 0.0))
    (observations,) = measured(rng, plan, [truth], known_noise=False)
    observations = [replace(one, mean=one.mean + off) for one, off in zip(observations, loop, strict=True)]
    return SimulatedSession([observations], design(plan, jig=JIG), [truth], bounded=False)


def correlated(rng: Generator, memory: float, samples: int) -> SimulatedSession:
    """Return twelve positions with a perfect jig and the noise of an autoregressive process of order one."""
    truth, plan = part(rng), plan_of(12, noise=NOISE, jig=0.0)
    mean = truth.reading(plan.gravity, np.zeros(12))
    white = rng.standard_normal((2000 + samples, 12, 3))
    noise = scipy.signal.lfilter([1.0], [1.0, -memory], white, axis=0)[2000:]
    # The variance of the mean of n samples of the process, exactly.
    lag = np.arange(1, samples)
    of_mean = (1.0 + 2.0 * np.sum((1.0 - lag / samples) * memory**lag)) / samples / (1.0 - memory**2)
    observations = _summarised(plan, mean + NOISE / sqrt(of_mean) * noise, 0.0)
    return SimulatedSession([observations], design(plan, jig=0.0), [truth])


BENCH_ERRORS: dict[str, Callable[[Generator], SimulatedSession]] = {
    f"table leans by {LEAN:g}°": leaning_table,
    f"headings off by {HEADING:g}°": wrong_headings,
    "noise 0.2 of a step": coarse_converter,
    "loop of 5 times the noise": hysteresis_loop,
    **{
        f"AR(1) {memory:g}, {samples} samples": partial(correlated, memory=memory, samples=samples)
        for memory, samples in ((0.9, 100), (0.9, 300), (0.98, 300), (0.995, 300))
    },
}


def _seen(rng: Generator, lean: Array, headings: Array) -> Array:
    """Up in the sensor's frame in twelve positions: the table's lean, the heading, the tilt, the jig's error."""
    up = Rotation.from_rotvec([-lean[1], lean[0], 0.0]).apply([0.0, 0.0, 1.0])
    on_table = Rotation.from_rotvec(np.radians(-headings)[:, None] * [0.0, 0.0, 1.0]).apply(up)
    axis = np.cross([0.0, 0.0, 1.0], POSITIONS[12])
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    tilt = Rotation.from_rotvec(axis / np.where(size > 0.0, size, 1.0) * np.arccos(POSITIONS[12][:, 2:]))
    jig = Rotation.from_rotvec(np.radians(JIG) * rng.standard_normal((12, 3)))
    return np.asarray(jig.apply(tilt.apply(on_table)))


def _observed(rng: Generator, gravity: Array, mean: Array, headings: Array) -> list[Observation]:
    """Positions whose noise is known from ten block means."""
    u, dof = np.empty(mean.shape), np.empty(mean.shape)
    for channel in range(mean.shape[1]):
        drawn = NOISE**2 * rng.chisquare(BLOCK_DOF, len(mean)) / BLOCK_DOF
        variance, dof[:, channel] = pooled(drawn, np.full(len(mean), BLOCK_DOF))
        u[:, channel] = np.sqrt(variance)
    return [
        Observation(f"p{k}", up, mean[k], u[k], heading=float(headings[k]), dof=dof[k]) for k, up in enumerate(gravity)
    ]


def _summarised(plan: Plan, samples: Array, step: float) -> list[Observation]:
    """Positions from samples of shape (samples, positions, channels), as a session summarises them."""
    summaries: list[list[SampleSummary]] = [
        [summarise(one, step) for one in samples[:, :, channel].T.tolist()] for channel in range(samples.shape[2])
    ]
    memory = correlated_noise([one for channel in summaries for one in channel])
    columns = []
    for channel in summaries:
        variance, dof, rounding = noise_of_means(channel, memory)
        columns.append((np.array([one.mean for one in channel]), np.sqrt(variance + rounding**2), dof, rounding))
    means, u, dof, adc = (np.stack(one, axis=1) for one in zip(*columns, strict=True))
    return [Observation(f"p{k}", up, means[k], u[k], dof=dof[k], adc=adc[k]) for k, up in enumerate(plan.gravity)]


# Calibrations


def _calibrated(rng: Generator, session: SimulatedSession, bound: Array | None, stated: bool) -> Sums:
    """Calibrate one session and compare with the truth."""
    wanted = session.design if stated else replace(session.design, jig=None)
    sensors = fixture(session.observations, wanted)
    found = [with_hysteresis(*one) for one in zip(estimate_jointly(sensors), sensors, strict=True)]
    values = np.array([_vector(one) for one in found])
    off = values - [one.truth for one in session.parts]
    inside = np.abs(off) <= [one.uncertain.factors * one.uncertain.u for one in found]
    kinds = np.array([_class(name) for name in found[0].uncertain.names])
    sums = {}
    for name in dict.fromkeys(kinds.tolist()):
        rows = kinds == name
        limit = float("nan") if bound is None else float(np.mean(bound[:, rows]))
        sums[name] = [float(np.mean(inside[:, rows])), float(np.mean(off[:, rows] ** 2)), limit]
    if session.plan is not None:
        hits = [_tilt_inside(rng, session.plan, *one) for one in zip(found, session.parts, strict=True)]
        sums["tilt"] = [float(np.mean(hits)), float("nan"), float("nan")]
    return sums


def _vector(found: Estimate) -> Array:
    coefficients = found.coefficients
    thermal = () if coefficients.thermal is None else (coefficients.thermal.drift,)
    return np.hstack([coefficients.offset[:, None], coefficients.sensitivity, *thermal]).ravel()


def _class(name: str) -> str:
    words = name.split(".")
    if words[0] == "sensitivity":
        return "own" if words[1] == words[2] else "cross"
    return "drift" if words[0] == "temperature" else words[0]


def _tilt_inside(rng: Generator, plan: Plan, found: Estimate, truth: Part) -> NDArray[np.bool_]:
    """Whether the tilts of a new reading, with noise of its own, are inside their intervals."""
    x, y = rng.uniform(-REACH, REACH, 2)
    y = float(np.clip(y, -(90.0 - abs(x)), 90.0 - abs(x)))
    gravity = np.array([gravity_from_tilt({"x": x, "y": y})])
    dt = np.array([rng.uniform(plan.temperature.min(), plan.temperature.max())])
    channels = len(truth.offset)
    readings = truth.reading(gravity, dt) + plan.noise * rng.standard_normal((1, channels))
    known = found.uncertain
    inputs = uncertain_readings(known.names, known.covariance, known.factors, np.full(channels, plan.noise))
    kernel = CompensationWithUncertainty(Compensation(found.coefficients), found.coefficients, inputs)
    compensated, (_, expanded) = kernel(readings, dt)
    return np.asarray(np.abs(compensated.tilt[0, :2] - [x, y]) <= expanded[:2, 0])


def _bound(session: SimulatedSession) -> Array:
    """The Cramér-Rao bound's variances, with everything stated and the noise known, shape (sensors, coefficients)."""
    noise = NOISE if session.plan is None else session.plan.noise
    known = [
        [replace(one, u=np.full_like(one.u, noise), dof=inf, adc=0.0) for one in sensor]
        for sensor in session.observations
    ]
    equations = Equations(fixture(known, session.design))
    z = np.zeros(equations.unknowns)
    z[: len(equations.names)] = np.concatenate([one.truth for one in session.parts])
    lean = equations.errors["table"]
    z[lean] = session.lean[: lean.stop - lean.start]
    return np.array([np.diag(one.covariance) for one in budgets(solved_at(equations, z))])
