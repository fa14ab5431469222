"""Errors of a bench that all positions share, and noise that block means do not show, against simulations of their own.

Gravity is turned by scipy's rotations, correlated noise is filtered by scipy, readings are written out.
"""

from dataclasses import replace
from math import cos, radians, sin, sqrt

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.core.estimation.design import predict_uncertainty
from tiltcal.core.estimation.estimate import Estimate, estimate, with_hysteresis
from tiltcal.core.estimation.positions import Design, InstrumentErrors, Observation, Prior, SensorObservations

Array = NDArray[np.float64]

PLANE = tuple({axis: sign * 30.0} for axis in "xy" for sign in (1, -1))
NOISE = 1e-4
LEVEL = np.array([0.0, 0.0, 1.0])


def at_temperatures(errors: Array, *, slope: float = 2.5) -> tuple[Array, list[Observation]]:
    """One channel at level: temperatures, and readings at temperatures that are off by some errors, °C."""
    told = np.linspace(-20.0, 40.0, len(errors))
    read = 1024.0 + slope * (told + errors) + 0.05 * np.random.default_rng(4).standard_normal(len(told))
    u = np.array([0.05])
    return told, [Observation(f"{t}", LEVEL, np.array([one]), u, t) for t, one in zip(told, read, strict=True)]


def test_a_thermometer_that_is_not_stated_is_shown_by_the_residuals() -> None:
    """All positions weigh alike: the textbook's straight line, whose residuals have Student's t of 10 for 12 points."""
    told, observations = at_temperatures(0.2 * np.random.default_rng(3).standard_normal(12))
    wanted = Design(("x",), (), drift=1, jig=0.0, thermometer=None)
    found = estimate(observations, wanted)
    line = scipy.stats.linregress(told, [one.mean[0] for one in observations])
    name = "temperature.offset.x.1"
    assert found.uncertainty()[name] == pytest.approx(line.stderr, rel=0.01)
    factor = found.uncertain.by_name(found.uncertain.factors)[name]
    assert factor == pytest.approx(scipy.stats.t.ppf(0.975, 10), rel=0.01)
    left = [one.mean[0] for one in observations] - (line.intercept + line.slope * told)
    assert found.estimated_thermometer == pytest.approx(sqrt(left @ left / 10 - 0.05**2) / line.slope, rel=0.01)
    exact = estimate(observations, replace(wanted, thermometer=0.0))
    assert found.chi_square == exact.chi_square == pytest.approx(left @ left / 0.05**2, rel=1e-6)


@pytest.mark.parametrize(("slope", "noise"), [(2.5, 1.5), (1e-3, 0.1)], ids=["noise alone", "no drift"])
def test_a_thermometer_that_explains_nothing_is_not_invented(slope: float, noise: float) -> None:
    """Residuals smaller than the noise, or ten times as large with so little drift that no thermometer makes them."""
    _, observations = at_temperatures(np.zeros(12), slope=slope)
    observations = [replace(one, u=noise * one.u) for one in observations]
    found = estimate(observations, Design(("x",), (), drift=1, jig=0.0, thermometer=None))
    assert found.estimated_thermometer is None


def test_plan_counts_a_lean_and_says_what_a_heading_brings() -> None:
    """The offset takes up about the mean of cos 30° and 1 of it."""
    wanted, up = Design(("x", "y"), ("x", "y"), jig=0.1, table_lean=0.2), [gravity_from_tilt(tilt) for tilt in PLANE]
    planned = [
        Observation(f"p{k}", np.array(one), np.zeros(2), np.full(2, NOISE), heading=0.0) for k, one in enumerate(up)
    ]
    plan = predict_uncertainty(wanted, planned, sensitivity=1.0)
    by_lean = radians(0.2) * (1 + cos(radians(30))) / 2
    assert plan.uncertain.u[0] == pytest.approx(by_lean, rel=0.12)
    name, _, share = plan.worth_adding[0]
    assert name == "p0 with the fixture turned by 180°"
    assert share < 0.6


@pytest.mark.parametrize("thermal", [False, True])
def test_what_is_worth_adding_makes_a_coefficient_better_known(thermal: bool) -> None:
    """Least squares of numpy with each position that may help: below 0.8 of the uncertainty, the best first."""
    design = Design(("x",), ("x",), drift=int(thermal), reference=20.0, jig=0.0)
    met = [(sin(radians(x)), t) for x, t in ((20.0, 20.0), (-20.0, 20.0), (15.0, 30.0), (-15.0, 30.0))]
    half = sqrt(0.5)
    more = {"+x straight up": 1.0, "+x straight down": -1.0, "x at +45°": half, "x at -45°": -half}
    candidates = {name: (x, 20.0) for name, x in more.items()}
    candidates |= {"level at 50 °C": (0.0, 50.0), "level at 0 °C": (0.0, 0.0)} if thermal else {}

    def u(points: list[tuple[float, float]]) -> Array:
        x, t = np.transpose(points)
        columns = np.stack([np.ones(len(x)), x, t - 20.0][: 2 + thermal], axis=1)
        return np.asarray(0.01 * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns))))

    seen = [
        Observation(f"p{k}", np.array([x, 0.0, sqrt(1.0 - x * x)]), np.zeros(1), np.array([0.01]), t)
        for k, (x, t) in enumerate(met)
    ]
    plan, names = predict_uncertainty(design, seen, sensitivity=1.0), design.names
    shares = {name: u([*met, one]) / u(met) for name, one in candidates.items()}
    best = [(name, names[np.argmin(each.round(6))], round(float(each.min()), 3)) for name, each in shares.items()]
    assert plan.worth_adding == tuple(sorted((one for one in best if one[2] < 0.8), key=lambda one: one[2]))
    assert (plan.uncertain.u, plan.dof) == (pytest.approx(u(met)), 2 - thermal)


TEMPERATURES = (0.0, 20.0, 40.0, 20.5, 0.5)


def looped(jig: float, *, held: bool) -> Estimate:
    """Level at 0, 20 and 40 °C on the way up, 0.4 more on the way down."""
    design = Design(("x",), ("x",), drift=1, jig=jig, priors={"sensitivity.x.x": Prior(1.0)})
    met = [
        Observation(f"p{k}", LEVEL, np.array([0.01 * t + 0.4 * (k > 2)]), np.array([0.03]), t, held=held and k > 0)
        for k, t in enumerate(TEMPERATURES)
    ]
    return with_hysteresis(estimate(met, design), SensorObservations(design, met))


def test_a_loop_that_noise_and_jig_do_not_explain_is_in_offset_and_drift() -> None:
    """A straight line through five temperatures, of which the middle one is met once: by numpy's pseudo-inverse.

    Set anew each time with a jig of 10°, it is explained.
    """
    assert "hysteresis" not in looped(10.0, held=False).uncertain.sources
    assert "hysteresis" in looped(10.0, held=True).uncertain.sources
    for held in (True, False):
        found = looped(0.0, held=held)
        drift, offset = np.linalg.pinv(np.vander(TEMPERATURES, 2))
        loop = max(found.residuals[3, 0] - found.residuals[1, 0], found.residuals[4, 0] - found.residuals[0, 0])
        assert loop == pytest.approx(0.4, abs=0.01)
        # All of a setting that shows it at once, and what was met once by itself; settings of their own by themselves.
        by_setting = [np.sum(by) ** 2 + by[2] ** 2 if held else np.sum(by[[0, 1, 3, 4]] ** 2) for by in (offset, drift)]
        added = dict(zip(found.uncertain.names, found.uncertain.sources["hysteresis"], strict=True))
        assert [added["offset.x"], added["temperature.offset.x.1"]] == pytest.approx(
            [loop**2 / 3.0 * square for square in by_setting], rel=1e-6
        )


def test_the_errors_of_a_reference_are_the_same_in_all_positions() -> None:
    """Its zero, scale and alignment do not average out: numpy's least squares on the covariance of all readings."""
    instrument = InstrumentErrors(("x", "y"), zero=0.02, scale=0.001, alignment=0.3, unread=0.0)
    design = Design(("x", "y"), ("x", "y"), jig=0.01, instrument=instrument)
    truth, offset = np.array([[1000.0, 20.0], [-10.0, 990.0]]), np.array([50.0, -30.0])
    said = np.radians([(0, 0), (25, 3), (-20, 5), (4, 22), (-3, -25), (15, 15), (-17, 12), (10, -18)])
    sizes = np.array([*[radians(0.02)] * 2, 0.001, 0.001, radians(0.3), *[radians(0.01)] * 16])

    def read(errors: Array) -> Array:
        tilts = (said + errors[5:].reshape(8, 2)) * (1.0 + errors[2:4]) + errors[:2]
        up = Rotation.from_rotvec([0.0, 0.0, errors[4]]).apply(np.pad(np.sin(tilts), ((0, 0), (0, 1))))[:, :2]
        return np.asarray((offset + up @ truth.T).ravel())

    draw = np.random.default_rng(1)
    means = read(sizes * draw.normal(size=21)) + draw.normal(0.0, 0.05, 16)
    up = np.column_stack([np.sin(said), np.sqrt(1.0 - np.sum(np.sin(said) ** 2, axis=1))])
    seen = [
        Observation(f"{k}", *pair, np.full(2, 0.05)) for k, pair in enumerate(zip(up, means.reshape(8, 2), strict=True))
    ]
    found = estimate(seen, design)
    by_error = np.stack([(read(h) - read(-h)) / 2.0 for h in np.diag(sizes)], axis=1)
    weight = np.linalg.inv(by_error @ by_error.T + 0.05**2 * np.eye(16))
    columns = np.kron(np.column_stack([np.ones(8), up[:, :2]]), np.eye(2))[:, [0, 2, 4, 1, 3, 5]]
    covariance = np.linalg.inv(columns.T @ weight @ columns)
    values = np.column_stack([found.coefficients.offset, found.coefficients.sensitivity]).ravel()
    assert values == pytest.approx(covariance @ columns.T @ weight @ means, rel=1e-4, abs=0.02)
    assert found.uncertain.u == pytest.approx(np.sqrt(np.diag(covariance)), rel=0.01)
    # The offset is off by all of the zero, whatever the number of positions.
    assert found.uncertain.u[0] == pytest.approx(1000.0 * radians(0.02), rel=0.1)
    planned = predict_uncertainty(design, seen, sensitivity=1000.0).uncertain
    assert planned.u == pytest.approx(found.uncertain.u, rel=0.05)
    # A tilt that it does not read is as uncertain as the jig, and only that.
    half = replace(instrument, axes=("x",), zero=0.0, scale=0.0, alignment=0.0, unread=0.2)
    blind = predict_uncertainty(replace(design, instrument=half), seen, sensitivity=1000.0).uncertain
    one, both = (
        predict_uncertainty(replace(design, instrument=None, jig=u), seen, sensitivity=1000.0) for u in (0.01, 0.2)
    )
    assert blind.u[0] == pytest.approx(one.uncertain.u[0], rel=0.02)
    assert blind.u[3] == pytest.approx(both.uncertain.u[3], rel=0.02)
