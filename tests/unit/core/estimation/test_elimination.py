"""The joint solution with each sensor's unknowns eliminated, against the whole system written out as in a textbook.

The reference has one residual function of its own, takes its Jacobian by the complex step, and inverts JᵀJ.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from support.simulated_bench import POSITIONS, Part, Plan, design, fixture, measured, part

from tiltcal.core.estimation.attitude import tangent_basis
from tiltcal.core.estimation.covariance import stated_budgets
from tiltcal.core.estimation.design import Prior, SensorObservations
from tiltcal.core.estimation.elimination import linearised
from tiltcal.core.estimation.equation_assembly import system_of
from tiltcal.core.estimation.estimate import estimate_jointly
from tiltcal.core.estimation.gauss_newton import minimise
from tiltcal.core.estimation.second_order import second_order_bias

Array = NDArray[np.float64]

NOISE, JIG = 1e-4, 0.1


@dataclass(frozen=True)
class Whole:
    """The whole system of a fixture: the unknowns are the coefficients, then the errors in the order of the fields."""

    sensors: Sequence[SensorObservations]
    jig: float
    lean: float = 0.0
    heading: float = 0.0
    thermometer: float = 0.0
    own: bool = False

    @cached_property
    def sizes(self) -> list[int]:
        n, count = len(self.sensors[0].observations), len(self.sensors)
        thermometers = (count if self.own else 1) if self.thermometer else 0
        coefficients = sum(len(one.design.names) for one in self.sensors)
        return [
            coefficients,
            2 * n if self.jig else 0,
            2 if self.lean else 0,
            n if self.heading else 0,
            n * thermometers,
        ]

    @cached_property
    def told(self) -> list[tuple[Array, Array, Array]]:
        """Temperature from the reference, means and their standard uncertainties of each sensor."""
        return [
            (
                np.array([one.temperature for one in sensor.observations]) - sensor.design.reference,
                np.array([one.mean for one in sensor.observations]).T,
                np.array([one.u for one in sensor.observations]).T,
            )
            for sensor in self.sensors
        ]

    @cached_property
    def gravity(self) -> tuple[Array, Array]:
        """Gravity as set, and the two directions in which it can move."""
        gravity = np.array([one.gravity for one in self.sensors[0].observations])
        return gravity, tangent_basis(gravity)

    def residual(self, z: Array) -> Array:
        """All equations over their standard uncertainties, analytic in z, shape (..., unknowns)."""
        theta, angles, lean, heading, warm = np.split(z, np.cumsum(self.sizes)[:-1], axis=-1)
        seen, many = self.sensors[0].observations, z.shape[:-1]
        gravity, basis = self.gravity
        n, k = len(gravity), theta.shape[-1] // (3 * len(self.sensors))
        off = angles.reshape(*many, n, 2) if self.jig else np.zeros((*many, n, 2))
        if self.lean:
            turn = np.radians([one.heading for one in seen]) + (heading if self.heading else 0.0)
            cos, sin, (t1, t2) = np.cos(turn), np.sin(turn), np.moveaxis(lean[..., None], -2, 0)
            off = off + np.stack([cos * t1 + sin * t2, cos * t2 - sin * t1], axis=-1)
        s = np.sum(off**2, axis=-1)
        cos = sum((-s) ** m / factorial(2 * m) for m in range(9))
        sinc = sum((-s) ** m / factorial(2 * m + 1) for m in range(9))
        g = cos[..., None] * gravity + sinc[..., None] * np.einsum("nij,...nj->...ni", basis, off)
        rows = []
        by_sensor = np.moveaxis(theta.reshape(*many, -1, 3, k), -3, 0)
        for number, (sensor, own) in enumerate(zip(self.sensors, by_sensor, strict=True)):
            drift, gain = sensor.design.drift, sensor.design.gain
            told, means, u = self.told[number]
            if self.thermometer:
                told = told + warm.reshape(*many, -1, n)[..., number if self.own else 0, :]
            for row in range(3):
                c = np.moveaxis(own[..., row, :, None], -2, 0)
                value = c[0] + sum(c[4 + p] * told ** (p + 1) for p in range(drift))
                along = np.einsum("...ni,i...->...n", g, c[1:4, ..., 0])
                value = value + (1 + sum(c[4 + drift + p] * told ** (p + 1) for p in range(gain))) * along
                rows.append((means[row] - value) / u[row])
            flat = dict(zip(sensor.design.names, np.moveaxis(own.reshape(*many, -1, 1), -2, 0), strict=True))
            rows += [(prior.value - flat[name]) / prior.u for name, prior in sensor.design.priors.items()]
        for errors, u in ((angles, self.jig), (lean, self.lean), (heading, self.heading)):
            rows += [-errors / np.radians(u)] if u else []
        rows += [-warm / self.thermometer] if self.thermometer else []
        return np.concatenate(rows, axis=-1)

    def jacobian(self, z: Array) -> Array:
        """Of minus the residual."""
        return -self.residual(z + 1e-30j * np.eye(len(z))).imag.T / 1e-30

    def minimum(self, z: Array) -> Array:
        """Where Gauss-Newton's steps end: the last one moves all residuals together by less than 1e-12."""
        for _ in range(20):
            jacobian = self.jacobian(z)
            step = np.linalg.lstsq(jacobian, self.residual(z + 0j).real, rcond=1e-15)[0]
            z = z + step
            if np.linalg.norm(jacobian @ step) < 1e-12:
                break
        return z

    def bias(self, z: Array) -> Array:
        """Box's bias for each unknown, by second differences of the whole system."""
        jacobian, q = self.jacobian(z), np.radians(self.jig) ** 2
        inverse = np.linalg.pinv(jacobian)
        first, count = self.sizes[0], self.sizes[1]
        readings = len(jacobian) - sum(self.sizes[1:])
        total = np.zeros(len(z))
        for m in range(count):
            true = np.zeros(len(z))
            true[first + m] = 1.0
            moved = np.where(np.arange(len(jacobian)) < readings, jacobian @ true, 0.0)
            follows = inverse @ moved
            bent = [
                (self.jacobian(z + 1e-5 * one) - self.jacobian(z - 1e-5 * one)) @ one / 2e-5 for one in (true, follows)
            ]
            slope = (self.jacobian(z + 1e-5 * follows) - self.jacobian(z - 1e-5 * follows)) / 2e-5
            total += inverse @ (bent[0] - bent[1]) / 2.0 + inverse @ inverse.T @ (
                slope.T @ (moved - jacobian @ follows)
            )
        return q * total


def bench(drift: int = 0, seed: int = 1) -> tuple[list[Part], list[SensorObservations]]:
    """Three sensors in twelve positions."""
    rng = np.random.default_rng(seed)
    warm = np.linspace(-10.0, 20.0, 12) if drift else np.zeros(12)
    plan = Plan(POSITIONS[12], rng.permutation(warm), noise=NOISE, jig=JIG, thermometer=0.2 * bool(drift), drift=drift)
    parts = [part(rng, drift) for _ in range(3)]
    return parts, fixture(measured(rng, plan, parts, known_noise=False), design(plan, jig=JIG))


def changed(sensors: Sequence[SensorObservations], change: Callable, **of_design: object) -> list[SensorObservations]:
    """Other observations, by number of the sensor and of the position, and other values of the design."""
    return [
        replace(
            one,
            design=replace(one.design, **of_design),
            observations=[change(k, n, observation) for n, observation in enumerate(one.observations)],
        )
        for k, one in enumerate(sensors)
    ]


def same(k: int, n: int, observation):
    return observation


def plain():
    sensors = bench()[1]
    return sensors, Whole(sensors, JIG)


def perfect_jig():
    sensors = changed(bench()[1], same, jig=0.0)
    return sensors, Whole(sensors, 0.0)


def weights_and_priors():
    """Readings whose uncertainty differs by up to ten times, and sensitivities of which something is known."""
    rng = np.random.default_rng(3)
    factor = rng.uniform(1.0, 10.0, (3, 12, 3))
    parts, sensors = bench()
    sensors = changed(sensors, lambda k, n, one: replace(one, u=one.u * factor[k, n]))
    for k, one in enumerate(parts):
        priors = {
            "sensitivity.x.x": Prior(one.sensitivity[0, 0] + rng.normal(0.0, 0.004), 0.004),
            "sensitivity.y.z": Prior(one.sensitivity[1, 2] + rng.normal(0.0, 1e-3), 1e-3),
        }
        sensors[k] = replace(sensors[k], design=replace(sensors[k].design, priors=priors))
    return sensors, Whole(sensors, JIG)


def lean_and_headings():
    turned = changed(
        bench()[1], lambda k, n, one: replace(one, heading=(0.0, 90.0, 180.0)[n % 3]), table=0.2, heading=0.5
    )
    return turned, Whole(turned, JIG, lean=0.2, heading=0.5)


def one_thermometer():
    sensors = changed(bench(drift=2)[1], same, gain=1)
    return sensors, Whole(sensors, JIG, thermometer=0.2)


def own_thermometers():
    sensors = changed(bench(drift=1)[1], lambda k, n, one: replace(one, temperature=one.temperature + 0.01 * k), gain=1)
    return sensors, Whole(sensors, JIG, thermometer=0.2, own=True)


@pytest.mark.parametrize(
    "case", [plain, perfect_jig, weights_and_priors, lean_and_headings, one_thermometer, own_thermometers]
)
def test_the_solution_is_that_of_the_whole_system(case) -> None:
    """Coefficients, covariance, budget and chi-square, to 1e-9 of an uncertainty."""
    sensors, whole = case()
    system = system_of(sensors)
    count = system.coefficients
    start = np.zeros(sum(whole.sizes))
    start[:count] = np.concatenate([np.hstack([one.coefficients.vectors]).ravel() for one in estimate_jointly(sensors)])
    expected = whole.minimum(start)
    jacobian = whole.jacobian(expected)
    covariance = np.linalg.inv(jacobian.T @ jacobian)[:count, :count]
    u = np.sqrt(np.diag(covariance))

    z = np.zeros(system.unknowns)
    z[:count] = start[:count]
    z = minimise(system, z)
    np.testing.assert_allclose((z[:count] - expected[:count]) / u, 0.0, atol=1e-9)
    near = linearised(system, z)
    budgets = stated_budgets(near)
    k = count // 3
    for number, budget in enumerate(budgets):
        own = slice(number * k, number * k + k)
        size = np.outer(u[own], u[own])
        np.testing.assert_allclose((budget.covariance - covariance[own, own]) / size, 0.0, atol=1e-9)
        np.testing.assert_allclose(sum(budget.variance.values()), np.diag(budget.covariance), rtol=1e-9)
    squares = np.linalg.pinv(jacobian)[:count] ** 2
    jig = squares[:, len(jacobian) - sum(whole.sizes[1:]) :][:, : whole.sizes[1]].sum(axis=1)
    ours = np.concatenate([budget.variance.get("jig", np.zeros(k)) for budget in budgets])
    np.testing.assert_allclose(ours / u**2, jig / u**2, atol=1e-9)
    residual = whole.residual(expected + 0j).real
    assert near.equations.cost == pytest.approx(residual @ residual, rel=1e-9)
    assert system.degrees_of_freedom(near.unobservable_leans) == len(residual) - len(expected)


@pytest.mark.parametrize("case", [weights_and_priors])
def test_the_bias_of_second_order_is_that_of_the_whole_system(case) -> None:
    sensors = case()[0][:1]
    whole, system = Whole(sensors, JIG), system_of(sensors)
    z = np.zeros(system.unknowns)
    z[: system.coefficients] = np.concatenate([one.coefficients.vectors.ravel() for one in estimate_jointly(sensors)])
    z = minimise(system, z)
    near = linearised(system, z)
    expected = whole.bias(z)[: system.coefficients]
    u = np.concatenate([budget.u for budget in stated_budgets(near)])
    assert np.max(np.abs(expected / u)) > 1e-3
    np.testing.assert_allclose(second_order_bias(near, z) / u, expected / u, atol=1e-5)


@pytest.mark.parametrize("case", [plain, weights_and_priors, lean_and_headings, one_thermometer])
def test_a_jig_that_is_not_stated_is_the_most_likely_one(case) -> None:
    """The restricted likelihood written out with the covariance of all readings has its maximum there."""
    sensors, whole = case()
    found = estimate_jointly(changed(sensors, same, jig=None))
    wanted = replace(whole, jig=found[0].estimated_jig)
    z = wanted.minimum(
        np.concatenate([*(one.coefficients.vectors.ravel() for one in found), np.zeros(sum(wanted.sizes[1:]))])
    )
    jacobian, residual = wanted.jacobian(z), wanted.residual(z + 0j).real
    count, angles = wanted.sizes[:2]
    # Everything but the jig is an equation with variance 1; the attitudes are random and no equations.
    rows = np.ones(len(residual), dtype=bool)
    others = sum(wanted.sizes[2:])
    rows[len(residual) - others - angles : len(residual) - others] = False
    random = jacobian[rows][:, count : count + angles]
    fixed = jacobian[rows][:, np.r_[:count, count + angles : len(z)]]
    y = residual[rows] + random @ z[count : count + angles]

    def minus_likelihood(log_jig: float) -> float:
        v = np.eye(len(y)) + np.radians(np.exp(log_jig)) ** 2 * random @ random.T
        inverse = np.linalg.inv(v)
        information = fixed.T @ inverse @ fixed
        rest = y - fixed @ np.linalg.solve(information, fixed.T @ inverse @ y)
        return sum(np.linalg.slogdet(one)[1] for one in (v, information)) + rest @ inverse @ rest

    most = minimize_scalar(
        minus_likelihood, bounds=(np.log(0.01), np.log(1.0)), method="bounded", options={"xatol": 1e-7}
    )
    assert found[0].estimated_jig == pytest.approx(float(np.exp(most.x)), rel=1e-3)


@pytest.mark.parametrize("jig", [JIG, None])
def test_the_memory_grows_with_the_sensors_and_not_with_their_square(jig) -> None:
    """32 sensors in 40 positions: the inverse of the whole Jacobian alone would take 14 MB, the covariance of the
    readings 118 MB; ten sensors more take about their share of the memory."""
    rng = np.random.default_rng(4)
    gravity = rng.normal(size=(40, 3))
    plan = Plan(gravity / np.linalg.norm(gravity, axis=1)[:, None], np.zeros(40), noise=NOISE, jig=JIG)
    observations = measured(rng, plan, [part(rng) for _ in range(32)])
    peaks = []
    for sensors in (8, 32):
        seen = fixture(observations[:sensors], design(plan, jig=jig))
        tracemalloc.start()
        estimate_jointly(seen)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 20e6
    assert peaks[1] < 4.5 * peaks[0]
