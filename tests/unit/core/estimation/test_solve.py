"""What is said of an uncertainty is true: against formulas by hand, and against many simulated benches."""

from math import cos, radians, sin, sqrt

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation
from support.simulated_bench import Plan, design, fixture, measured, part, plan_of, sweep, two_temperatures

from tiltcal.core.estimation.equations import Equations
from tiltcal.core.estimation.estimate import estimate, estimate_jointly
from tiltcal.core.estimation.positions import Design, Observation, Prior, SensorObservations
from tiltcal.core.estimation.solve import budgets, solved_at, start_as_set
from tiltcal.errors import EstimateError

LEVEL = np.array([0.0, 0.0, 1.0])


class TestBudgetByHand:
    """One channel of 819 count/g, worked with a pencil."""

    S, NOISE, STEP, JIG = 819.0, 0.12, 0.05, 0.1

    def test_one_position_and_a_sensitivity_that_is_known_before(self) -> None:
        """The reading and what is known before share the change by their variances."""
        t, known, jig = radians(30.0), 20.0, radians(self.JIG) * self.S * cos(radians(30.0))
        priors = {"offset.x": Prior(1024.0), "sensitivity.x.x": Prior(self.S, known)}
        design = Design(("x",), ("x",), jig=self.JIG, priors=priors)
        u, adc = np.array([np.hypot(self.NOISE, self.STEP)]), np.array([self.STEP])
        mean, up = np.array([1024.0 + self.S * sin(t)]), np.array([sin(t), 0.0, cos(t)])
        reading = Observation("p", up, mean, u, dof=np.array([9.0]), adc=adc)
        equations = Equations([SensorObservations(design, [reading])])
        budget = budgets(solved_at(equations, start_as_set(equations)))[0]
        by_reading = known**2 * sin(t) / (self.NOISE**2 + self.STEP**2 + (known * sin(t)) ** 2 + jig**2)
        by_hand = {
            "noise": (by_reading * self.NOISE) ** 2,
            "adc": (by_reading * self.STEP) ** 2,
            "assumed": ((1.0 - by_reading * sin(t)) * known) ** 2,
            "jig": (by_reading * jig) ** 2,
        }
        assert {source: part[1] for source, part in budget.sources.items()} == pytest.approx(by_hand, rel=1e-6)
        total = known**2 * (1.0 - by_reading * sin(t))
        assert sum(by_hand.values()) == pytest.approx(total, rel=1e-9)
        assert budget.covariance[1, 1] == pytest.approx(total, rel=1e-9)
        # Noise alone was estimated, of 9 degrees of freedom: it alone has a wider interval.
        normal, student = scipy.stats.norm.ppf(0.975), scipy.stats.t.ppf(0.975, 9)
        half = sqrt(normal**2 * (total - by_hand["noise"]) + student**2 * by_hand["noise"])
        assert budget.factors[1] * budget.u[1] == pytest.approx(half, rel=1e-6)

    def test_residuals_smaller_than_the_noise_are_the_noise(self) -> None:
        """Eight readings alike, ±0.05 about their means where noise is stated as 0.1, of a jig that is not stated.

        S = (mean up - mean down) / (2 sin 30°), so its variance is s² (1 / 4 + 1 / 4), with s² of 8 - 2 residuals.
        """
        observations = [
            Observation(f"{sign}{k}", np.array([sign / 2, 0.0, cos(radians(30))]), np.array([mean]), np.array([0.1]))
            for sign in (1, -1)
            for k, mean in enumerate(1024.0 + sign * self.S / 2 + 0.05 * np.array([1, -1, 1, -1]))
        ]
        budget = estimate(observations, Design(("x",), ("x",))).uncertain
        by_hand = 8 * 0.05**2 / 6 / 2
        assert budget.sources["noise"][1] == pytest.approx(by_hand, rel=1e-4)
        assert budget.covariance[1, 1] == pytest.approx(by_hand, rel=1e-4)
        assert budget.factors[1] == pytest.approx(scipy.stats.t.ppf(0.975, 6), rel=1e-4)


def test_a_position_set_wrong_by_degrees_is_named() -> None:
    """One of eighteen positions is 1.5° off, the jig is stated as 0.2°; 3° off it is refused."""
    rng = np.random.default_rng(43)
    plan = plan_of(18, noise=1e-4, jig=0.2)
    one = part(rng)
    observations = measured(rng, plan, [one])[0]

    def off(angle: float) -> list[Observation]:
        wrong = Rotation.from_rotvec([0.0, radians(angle), 0.0]).apply(plan.gravity[4])
        moved = Observation("p4", plan.gravity[4], one.offset + one.sensitivity @ wrong, np.full(3, 1e-4))
        return [*observations[:4], moved, *observations[5:]]

    with pytest.raises(EstimateError, match=r"^p4 is wrong: .* a jig of 0\.2° is stated"):
        estimate(off(3.0), design(plan, jig=0.2))
    found = estimate(off(1.5), design(plan, jig=0.2))
    assert found.p is not None
    assert found.p < 1e-4
    assert found.suspects[0].position == "p4"
    assert found.suspects[0].off == pytest.approx(1.5, abs=0.7)


@pytest.mark.parametrize(
    ("plan", "sensors", "stated", "sessions"),
    [
        (plan_of(6, noise=1e-4, jig=0.5), 1, True, 70),
        (plan_of(6, noise=1e-4, jig=0.5), 1, False, 70),
        (plan_of(6, noise=1e-4, jig=0.0), 1, False, 70),
        (plan_of(12, noise=1e-4, jig=0.02), 6, True, 20),
        (two_temperatures(1e-4, 0.5), 1, True, 60),
        (sweep(1e-4, 0.02), 1, True, 60),
    ],
    ids=["stated", "not stated", "perfect, not stated", "six sensors", "two temperatures", "sweep"],
)
def test_the_truth_is_in_95_percent_of_the_intervals(plan: Plan, sensors: int, stated: bool, sessions: int) -> None:
    """93 to 97 % within three Monte Carlo standard deviations; `benchmarks/accuracy.py` is the long run."""
    rng, shares = np.random.default_rng(7), []
    for _ in range(sessions):
        parts = [part(rng, plan.drift) for _ in range(sensors)]
        observations = measured(rng, plan, parts, known_noise=False)
        found = estimate_jointly(fixture(observations, design(plan, jig=plan.jig if stated else None)))
        half = np.array([one.uncertain.factors * one.uncertain.u for one in found])
        off = np.array([one.coefficients.vectors.ravel() for one in found]) - [one.truth for one in parts]
        for one in found:
            np.testing.assert_allclose(sum(one.uncertain.sources.values()), one.uncertain.u**2, rtol=1e-7)
        shares.append(100.0 * np.mean(np.abs(off) <= half))
    error = np.std(shares, ddof=1) / sqrt(sessions)
    assert 93.0 - 3 * error <= np.mean(shares) <= 97.0 + 3 * error
