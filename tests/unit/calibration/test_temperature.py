"""The temperature sweep chooses its order. Readings are made here, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from support.measured import measured

from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement
from tiltcal.core.model import vector_of
from tiltcal.core.samples import SampleSummary
from tiltcal.drivers import find_model
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import Position, find_procedure

SENSOR = SensorIdentity("sca100t-d02", "S", "count", ("x", "y"))
NOMINAL = replace(find_model("sca100t-d02"), sensitivity_spread=2.4 / 819.0, rails=(101.0, 2047.0))
SWEEP = find_procedure("temperature-sweep")
NOISE = 0.06


def sweep(drift: tuple[float, ...], seed: int, loop: float = 0.0, noise: float = NOISE) -> list[Measurement]:
    """Readings along the shipped sweep of a part with this drift, higher by ``loop`` on the way up and back."""

    def read(position: Position) -> np.ndarray:
        curve = sum(k * (float(position.temperature or 0.0) - 24.0) ** n for n, k in enumerate(drift, start=1))
        return np.full(2, 1024.0 + curve + (0.0 if position.name.startswith("down") else loop))

    return measured(SWEEP.positions, read, np.random.default_rng(seed), noise)


def calibrated(positions: list[Measurement], jig: float | None = None) -> tuple[CalibrationRecord, int]:
    """The calibration, and the order that it chose."""
    (found,) = calibrate([MeasuredSensor(SENSOR, positions, NOMINAL)], SWEEP, BenchUncertainty(jig))
    return found, found.fit.cross_validation.order


@pytest.mark.parametrize(
    ("drift", "order"),
    [((0.2,), 1), ((0.2, 0.004), 2), ((-0.1, 0.003, 0.0004), 3), ((0.2, 0.0, 1e-4), 3)],
    ids=["a line", "a parabola", "a cubic", "a cubic of twice the noise at the ends, which are extrapolated"],
)
def test_the_order_is_the_parts_own(drift: tuple[float, ...], order: int) -> None:
    """Over four noisy sweeps, nearly always; the coefficients are the part's within four standard uncertainties."""
    found = [calibrated(sweep(drift, seed)) for seed in range(4)]
    assert [chosen for _, chosen in found].count(order) >= 3
    true = np.pad(drift, (0, 3 - len(drift)))
    for record, _ in found:
        u = np.array([record.uncertainty[f"temperature.offset.x.{power}"] for power in (1, 2, 3)])
        assert np.all(np.abs(record.coefficients.thermal.drift[0] - true) < 4.0 * u)


def test_terms_above_the_chosen_order_are_zero_with_the_uncertainty_of_a_cubic() -> None:
    """The line is numpy's, and so is the covariance of a cubic: the noise times the inverse of the normal equations."""
    positions = sweep((0.2,), seed=3)
    found, order = calibrated(positions, jig=0.0)
    dt = np.array([float(each.temperature or 0.0) for each in positions]) - 24.0
    line = np.polyfit(dt, [each.summaries["x"].mean for each in positions], 1)
    powers = np.vander(dt, 4, increasing=True)
    expected = NOISE * np.sqrt(np.diag(np.linalg.inv(powers.T @ powers)))
    assert order == 1
    assert found.coefficients.thermal.drift[0] == pytest.approx([line[0], 0.0, 0.0], abs=1e-5)
    names = ["offset.x", *(f"temperature.offset.x.{power}" for power in (1, 2, 3))]
    assert [found.uncertainty[name] for name in names] == pytest.approx(expected, rel=2e-3)


def test_the_interval_of_a_sweep_holds_both_ways_of_a_loop_that_jumps() -> None:
    """It held them in 42 % of sweeps where no jig was stated."""
    dt = np.linspace(-18.5, 16.0, 12)
    powers = np.vander(dt, 4, increasing=True)
    for seed in range(3):
        found, _ = calibrated(sweep((0.2, 0.004), seed, loop=2.0))
        names = ["offset.x", *(f"temperature.offset.x.{power}" for power in (1, 2, 3))]
        known = found.uncertain.named(names)
        expanded = 1.96 * np.sqrt(np.einsum("ij,jk,ik->i", powers, known.wide, powers))
        curve = powers @ vector_of(found.coefficients, names)
        for loop in (0.0, 2.0):
            assert np.all(np.abs(curve - (1024.0 + 0.2 * dt + 0.004 * dt**2 + loop)) < expanded)


def test_too_few_temperatures_to_leave_one_out() -> None:
    with pytest.raises(EstimateError, match="add"):
        calibrated(sweep((0.2,), 1)[:2])


@pytest.mark.parametrize(("jig", "loop"), [(None, 0.0), (0.0, 2.0), (0.01, 0.0), (0.01, 2.0)])
def test_exact_readings_whose_uncertainty_is_unknown_give_their_line(jig: float | None, loop: float) -> None:
    """By hand: 0.2 count/°C, and 2 count more on the way up and back; the residuals of a line without it are zero."""
    positions = []
    for one in sweep((0.2,), 1, loop, noise=0.0):
        means = {"x": one.summaries["x"].mean, "y": 1024.0}
        positions.append(replace(one, summaries={c: SampleSummary(mean, 0.0, 1, 0.0) for c, mean in means.items()}))
    thermal = calibrated(positions, jig)[0].coefficients.thermal
    assert thermal.drift[0, 0] == pytest.approx(0.2, abs=1e-9 if not loop else 0.1)
