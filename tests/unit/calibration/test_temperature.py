"""The temperature sweep chooses its order; the reversal cancels the table's lean. Readings are made here, by hand."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest

from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.joint_fit import fit_jointly
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement
from tiltcal.calibration.temperature import choose_order, swept, with_order
from tiltcal.core.samples import SampleSummary
from tiltcal.drivers import find_model
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import Procedure, find_procedure

SENSOR = SensorIdentity("sca100t-d02", "S", "count", ("x", "y"))
NOMINAL = replace(find_model("sca100t-d02"), sensitivity_spread=2.4 / 819.0, rails=(101.0, 2047.0))
NOISE = 0.06


def measurement(name: str, temperature: float | None, x: float, y: float, heading: float | None = None) -> Measurement:
    summaries = {c: SampleSummary(value, 0.6, 100, NOISE, 0.0, 9.0) for c, value in (("x", x), ("y", y))}
    return Measurement(name, (0.0, 0.0, 1.0), {"x": 0.0, "y": 0.0}, temperature, summaries, heading=heading)


def calibrated(procedure: Procedure, measured: list[Measurement], jig: float) -> CalibrationRecord:
    return fit_jointly([MeasuredSensor(SENSOR, measured, NOMINAL)], procedure, BenchUncertainty(jig))[0]


def sweep(drift: tuple[float, ...], seed: int, loop: float = 0.0) -> tuple[Procedure, list[Measurement]]:
    """Readings along the shipped sweep of a part with this drift; on the way up they are higher by ``loop``."""
    rng = np.random.default_rng(seed)
    procedure = find_procedure("temperature-sweep")
    measured = []
    for position in procedure.positions:
        dt = float(position.temperature or 0.0) - 24.0
        curve = sum(k * dt**power for power, k in enumerate(drift, start=1))
        curve += loop if position.name.startswith("up") else 0.0
        values = 1024.0 + curve + rng.normal(0.0, NOISE, 2)
        measured.append(measurement(position.name, position.temperature, *values))
    return procedure, measured


@pytest.mark.parametrize(
    ("drift", "order"),
    [((0.2,), 1), ((0.2, 0.004), 2), ((-0.1, 0.003, 0.0004), 3)],
    ids=["a line", "a parabola", "a cubic"],
)
def test_the_order_is_the_parts_own(drift: tuple[float, ...], order: int) -> None:
    """Over six noisy sweeps, nearly always."""
    chosen = []
    for seed in range(6):
        procedure, measured = sweep(drift, seed)
        chosen.append(choose_order([MeasuredSensor(SENSOR, measured, NOMINAL)], procedure, BenchUncertainty()).order)
    assert chosen.count(order) >= 5
    assert min(chosen) >= order, "an order that is too low leaves the curve"


def test_the_chosen_coefficients_are_the_parts() -> None:
    procedure, measured = sweep((0.2, 0.004), seed=3)
    found = calibrated(with_order(procedure, 2), measured, jig=0.0)
    thermal = found.coefficients.thermal
    assert thermal is not None
    u = [found.uncertainty[f"temperature.offset.x.{power}"] for power in (1, 2)]
    assert thermal.drift[0] == pytest.approx([0.2, 0.004], abs=4 * max(u))


def test_terms_above_the_chosen_order_are_zero_with_the_uncertainty_of_a_cubic() -> None:
    """The line is numpy's, and so is the covariance of a cubic: the noise times the inverse of the normal equations."""
    procedure, measured = sweep((0.2,), seed=3)
    (found,) = calibrate([MeasuredSensor(SENSOR, measured, NOMINAL)], procedure, BenchUncertainty(0.0))
    dt = np.array([float(each.temperature or 0.0) for each in measured]) - 24.0
    line = np.polyfit(dt, [each.summaries["x"].mean for each in measured], 1)
    powers = np.vander(dt, 4, increasing=True)
    expected = NOISE * np.sqrt(np.diag(np.linalg.inv(powers.T @ powers)))
    thermal = found.coefficients.thermal
    assert thermal is not None
    assert found.fit.cross_validation is not None
    assert found.fit.cross_validation.order == 1
    assert thermal.drift[0] == pytest.approx([line[0], 0.0, 0.0], abs=1e-5)
    names = ["offset.x", *(f"temperature.offset.x.{power}" for power in (1, 2, 3))]
    assert [found.uncertainty[name] for name in names] == pytest.approx(expected, rel=2e-3)


def test_an_order_is_not_refused_because_the_ends_are_extrapolated() -> None:
    """A cubic of twice the noise at the ends: a line leaves it, and a cubic without an end predicts that end badly."""
    chosen = []
    for seed in range(8):
        procedure, measured = sweep((0.2, 0.0, 1e-4), seed)
        chosen.append(choose_order([MeasuredSensor(SENSOR, measured, NOMINAL)], procedure, BenchUncertainty()).order)
    assert np.mean(np.array(chosen) == 3) > 0.7


def test_hysteresis_is_reported() -> None:
    procedure, measured = sweep((0.2,), 1, loop=2.0)
    subject = MeasuredSensor(SENSOR, measured, NOMINAL)
    choice = choose_order([subject], procedure, BenchUncertainty())
    found = calibrated(with_order(procedure, choice.order), measured, jig=0.0)
    loop = swept(found, measured, choice).fit.hysteresis["x"]
    assert abs(loop.difference) == pytest.approx(2.0, abs=0.4)
    assert sorted(name.split("-")[0] for name in loop.between) in (["back", "up"], ["down", "up"])


def test_means_without_an_uncertainty_choose_an_order_too() -> None:
    """A table may leave it out; the orders are then compared by how far off they foretell."""
    procedure, measured = sweep((0.2, 0.02), seed=5)
    bare = [
        replace(one, summaries={c: SampleSummary(summary.mean, 0.0, 1, 0.0) for c, summary in one.summaries.items()})
        for one in measured
    ]
    assert choose_order([MeasuredSensor(SENSOR, bare, NOMINAL)], procedure, BenchUncertainty()).order == 2


def test_too_few_temperatures_to_leave_one_out() -> None:
    procedure, measured = sweep((0.2,), 1)
    with pytest.raises(EstimateError, match="add"):
        choose_order([MeasuredSensor(SENSOR, measured[:2], NOMINAL)], procedure, BenchUncertainty())


@pytest.mark.parametrize("lean", [0.0, 0.5, 2.0])
def test_reversal_cancels_the_lean_of_the_table(lean: float) -> None:
    """The table leans about an axis of its own; turned by its heading the sensor feels it from all sides."""
    rng = np.random.default_rng(4)
    tilt, toward = sin(radians(lean)), radians(35.0)
    measured = []
    for position in find_procedure("reversal").positions:
        heading = radians(position.heading or 0.0)
        g_x, g_y = tilt * cos(toward - heading), tilt * sin(toward - heading)
        x, y = 1026.0 + 819.0 * g_x + rng.normal(0, NOISE), 1019.0 + 819.0 * g_y + rng.normal(0, NOISE)
        measured.append(measurement(position.name, None, x, y, position.heading))
    found = calibrated(find_procedure("reversal"), measured, jig=0.001)
    assert found.coefficients.offset == pytest.approx([1026.0, 1019.0], abs=0.15)


@pytest.mark.parametrize("jig", [None, 0.0, 0.01])
@pytest.mark.parametrize("loop", [0.0, 2.0])
def test_exact_readings_whose_uncertainty_is_unknown_give_their_line(jig: float | None, loop: float) -> None:
    """By hand: 0.2 count/°C, and 2 count more on the way up and back; the residuals of a line without it are zero."""
    procedure = find_procedure("temperature-sweep")
    measured = []
    for position in procedure.positions:
        temperature = float(position.temperature or 0.0)
        later = loop * (not position.name.startswith("down"))
        summaries = {
            "x": SampleSummary(1024.0 + 0.2 * (temperature - 24.0) + later, 0.0, 1, 0.0),
            "y": SampleSummary(1024.0, 0.0, 1, 0.0),
        }
        level = {"x": 0.0, "y": 0.0}
        measured.append(Measurement(position.name, (0.0, 0.0, 1.0), level, temperature, summaries))
    sensors = [MeasuredSensor(SENSOR, measured, NOMINAL)]
    order = choose_order(sensors, procedure, BenchUncertainty(jig)).order
    found = fit_jointly(sensors, with_order(procedure, order), BenchUncertainty(jig))[0]
    thermal = found.coefficients.thermal
    assert thermal is not None
    assert thermal.drift[0, 0] == pytest.approx(0.2, abs=1e-9 if not loop else 0.1)
