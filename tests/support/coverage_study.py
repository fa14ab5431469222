"""Simulated calibrations, and how often the stated interval holds the truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from support.simulated_bench import FACES, Part, Plan, design, fixture, measured, part, plan_of
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.compensation import Compensation
from tiltcal.core.estimation.estimate import Estimate, estimate_jointly
from tiltcal.core.gravity_direction import gravity_from_tilt
from tiltcal.core.uncertainty_inputs import UncertaintyInputs

Array = NDArray[np.float64]

LEVEL = np.array([0.0, 0.0, 1.0])

REACH = 60.0
"""Tilts that a calibration is tried on, degrees."""


@dataclass(frozen=True)
class Regime:
    """One bench, and what is said of it."""

    name: str
    plan: Plan
    sensors: int
    stated: bool


@dataclass
class Tally:
    """How often the truth was inside, and of how many, by class; one entry a session."""

    inside: dict[str, list[float]] = field(default_factory=dict)

    def add(self, name: str, hits: Array) -> None:
        """One session's hits."""
        self.inside.setdefault(name, []).append(float(np.mean(hits)))

    def percent(self, name: str) -> tuple[float, float]:
        """Share inside and its Monte Carlo error, %."""
        shares = np.array(self.inside[name])
        return 100.0 * float(shares.mean()), 100.0 * float(shares.std(ddof=1) / np.sqrt(len(shares)))


def regimes(noise: float) -> list[Regime]:
    """All benches that are tried."""
    found = [
        Regime(f"{count} positions", plan_of(count, noise=noise, jig=jig), sensors, stated)
        for jig, count, sensors, stated in product((0.0, 0.02, 0.5), (6, 12, 18, 26), (1, 6), (True, False))
    ]
    found += [
        Regime("two temperatures", two_temperatures(noise, jig), sensors, True)
        for jig, sensors in product((0.02, 0.5), (1, 6))
    ]
    found += [Regime("sweep", sweep(noise, jig), sensors, True) for jig, sensors in product((0.02, 0.5), (1, 6))]
    return found


def two_temperatures(noise: float, jig: float) -> Plan:
    """Six faces, then level warm and, untouched, cold."""
    gravity = np.vstack([FACES, LEVEL, LEVEL])
    return Plan(gravity, np.array([0.0] * 7 + [-18.5]), (7,), noise, jig, thermometer=0.2, drift=1)


def sweep(noise: float, jig: float) -> Plan:
    """Six faces, then level and untouched through nine temperatures."""
    warm = np.linspace(-25.0, 35.0, 9)
    gravity = np.vstack([FACES, np.tile(LEVEL, (9, 1))])
    held = tuple(range(7, 15))
    return Plan(gravity, np.concatenate([np.zeros(6), warm]), held, noise, jig, thermometer=0.1, drift=2)


def simulate(regime: Regime, calibrations: int, seed: int) -> Tally:
    """Many calibrations of one bench."""
    plan = regime.plan
    rng = np.random.default_rng([seed, len(plan.gravity), round(100 * plan.jig), regime.sensors, regime.stated])
    tally = Tally()
    for _ in range(max(calibrations // regime.sensors, 2)):
        parts = [part(rng, plan.drift) for _ in range(regime.sensors)]
        observations = measured(rng, plan, parts, known_noise=False)
        found = estimate_jointly(fixture(observations, design(plan, jig=plan.jig if regime.stated else None)))
        hits = np.array([_inside(one, truth) for one, truth in zip(found, parts, strict=True)])
        names = found[0].names
        for kind in dict.fromkeys(_kind(name) for name in names):
            tally.add(kind, hits[:, [k for k, name in enumerate(names) if _kind(name) == kind]])
        tally.add("tilt", np.array([_tilt_inside(rng, plan, *pair) for pair in zip(found, parts, strict=True)]))
    return tally


def _kind(name: str) -> str:
    words = name.split(".")
    if words[0] == "sensitivity":
        return "own" if words[1] == words[2] else "cross"
    return "drift" if words[0] == "temperature" else words[0]


def _inside(found: Estimate, truth: Part) -> NDArray[np.bool_]:
    """Whether each coefficient's interval holds the truth."""
    coefficients = found.coefficients
    thermal = coefficients.thermal.drift if coefficients.thermal is not None else np.zeros((3, 0))
    values = np.hstack([coefficients.offset[:, None], coefficients.sensitivity, thermal]).ravel()
    return np.asarray(np.abs(values - truth.truth) <= found.budget.factors * found.budget.u)


def _tilt_inside(rng: Generator, plan: Plan, found: Estimate, truth: Part) -> NDArray[np.bool_]:
    """Whether the tilts of a new reading, with noise of its own, are inside theirs."""
    x, y = rng.uniform(-REACH, REACH, 2)
    y = float(np.clip(y, -(90.0 - abs(x)), 90.0 - abs(x)))
    gravity = np.array([gravity_from_tilt({"x": x, "y": y})])
    dt = np.array([rng.uniform(plan.temperature.min(), plan.temperature.max())])
    readings = truth.reading(gravity, dt) + plan.noise * rng.standard_normal((1, 3))
    doubt = UncertaintyInputs(found.names, found.covariance, found.budget.factors, np.full(3, plan.noise))
    result = CompensationWithUncertainty(Compensation(found.coefficients), found.coefficients, doubt)(readings, dt)
    return np.asarray(np.abs(result.compensated.tilt[0, :2] - [x, y]) <= result.expanded[0, :2])
