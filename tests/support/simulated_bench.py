"""A bench in numbers alone: sensors, a jig, a thermometer and noise, drawn at random, for the tests of the estimator.

It knows nothing of the estimator's own model code: gravity is turned by scipy's rotations, a reading is written out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiltcal.core.estimation.positions import Design, Observation, SensorObservations
from tiltcal.core.samples import pooled

Array = NDArray[np.float64]

XYZ = ("x", "y", "z")
LEVEL = np.array([0.0, 0.0, 1.0])
FACES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
EDGES = np.array(
    [
        [a if k == i else b if k == j else 0.0 for k in range(3)]
        for i, j in ((0, 1), (0, 2), (1, 2))
        for a in (1, -1)
        for b in (1, -1)
    ]
) / np.sqrt(2)
CORNERS = np.array([[a, b, c] for a in (1, -1) for b in (1, -1) for c in (1, -1)]) / np.sqrt(3)
POSITIONS = {6: FACES, 12: EDGES, 18: np.vstack([FACES, EDGES]), 26: np.vstack([FACES, EDGES, CORNERS])}
"""The faces of a cube, its edges, both, and its corners too."""

BLOCK_DOF = 9.0


@dataclass(frozen=True)
class Plan:
    """What is done at the bench: positions, and standard deviations of what is set and read."""

    gravity: Array  # as set, shape (n, 3)
    temperature: Array  # °C, shape (n,)
    held: tuple[int, ...] = ()  # positions that stand as the one before them
    noise: float = 1e-4  # of a position's mean, g
    jig: float = 0.0  # of a set angle, degrees
    thermometer: float = 0.0  # of a temperature, °C
    drift: int = 0  # order of the offsets' temperature polynomials
    axes: tuple[str, ...] = XYZ  # of the sensors, as many as they have channels


@dataclass(frozen=True)
class Part:
    """A sensor of two or three channels: about 1 unit/g, 1 % cross-axis, offsets of 50 mg."""

    offset: Array  # (channels,)
    sensitivity: Array  # (channels, channels)
    drift: Array  # (channels, order)

    @property
    def truth(self) -> Array:
        """All coefficients in the estimator's order: channel by channel, offset, sensitivities, drift."""
        return np.hstack([self.offset[:, None], self.sensitivity, self.drift]).ravel()

    def reading(self, gravity: Array, dt: Array) -> Array:
        """Without noise, shape (n, 3)."""
        powers = dt[:, None] ** np.arange(1, self.drift.shape[1] + 1)
        return self.offset + gravity[:, : len(self.offset)] @ self.sensitivity.T + powers @ self.drift.T


def plan_of(count: int, *, noise: float, jig: float) -> Plan:
    """The positions of :data:`POSITIONS` at one temperature."""
    return Plan(POSITIONS[count], np.zeros(count), noise=noise, jig=jig)


def two_temperatures(noise: float, jig: float) -> Plan:
    """Return six faces, then level warm and, untouched, cold."""
    gravity = np.vstack([FACES, LEVEL, LEVEL])
    return Plan(gravity, np.array([0.0] * 7 + [-18.5]), (7,), noise, jig, thermometer=0.2, drift=1)


def sweep(noise: float, jig: float) -> Plan:
    """Return six faces, then level and untouched through nine temperatures."""
    warm = np.linspace(-25.0, 35.0, 9)
    gravity = np.vstack([FACES, np.tile(LEVEL, (9, 1))])
    held = tuple(range(7, 15))
    return Plan(gravity, np.concatenate([np.zeros(6), warm]), held, noise, jig, thermometer=0.1, drift=2)


def part(rng: Generator, drift: int = 0, channels: int = 3) -> Part:
    """A part of its kind."""
    scale = np.array([1e-3, 2e-5, 5e-7])[:drift]
    own, square = (channels,), (channels, channels)
    return Part(
        rng.normal(0.0, 0.05, own),
        np.diag(rng.normal(1.0, 0.01, own)) + rng.normal(0.0, 0.01, square) * (1 - np.eye(channels)),
        rng.normal(0.0, 1.0, (channels, drift)) * scale,
    )


def measured(rng: Generator, plan: Plan, parts: Sequence[Part], *, known_noise: bool = True) -> list[list[Observation]]:
    """What each part reads in every position of one session; the jig's errors are common to all.

    Where the noise is not known it is so from ten block means a position, as at a real bench.
    """
    n = len(plan.gravity)
    errors = np.radians(plan.jig) * rng.standard_normal((n, 3))
    for k in plan.held:
        errors[k] = errors[k - 1]
    gravity = Rotation.from_rotvec(errors).apply(plan.gravity)
    told = plan.temperature + plan.thermometer * rng.standard_normal(n)
    return [
        _observations(rng, plan, one.reading(gravity, plan.temperature), told, known_noise=known_noise) for one in parts
    ]


def design(plan: Plan, *, jig: float | None) -> Design:
    """What the estimator is told of a plan."""
    return Design(plan.axes, plan.axes, drift=plan.drift, jig=jig, thermometer=plan.thermometer)


def fixture(observations: Sequence[Sequence[Observation]], wanted: Design) -> list[SensorObservations]:
    """The sensors of one fixture."""
    return [SensorObservations(wanted, one) for one in observations]


def _observations(rng: Generator, plan: Plan, readings: Array, told: Array, *, known_noise: bool) -> list[Observation]:
    mean = readings + plan.noise * rng.standard_normal(readings.shape)
    u, dof = np.full(readings.shape, plan.noise), np.full(readings.shape, np.inf)
    if not known_noise:
        drawn = plan.noise**2 * rng.chisquare(BLOCK_DOF, readings.shape) / BLOCK_DOF
        for channel in range(readings.shape[1]):
            variance, freedom = pooled(drawn[:, channel], np.full(len(drawn), BLOCK_DOF))
            u[:, channel], dof[:, channel] = np.sqrt(variance), freedom
    return [
        Observation(f"p{k}", g, mean[k], u[k], float(told[k]), held=k in plan.held, dof=dof[k])
        for k, g in enumerate(plan.gravity)
    ]
