"""The step of rounded readings, and what rounding hides."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from tiltcal.core.samples import ReadingStep, even_step, noise_under_rounding, resolution


def test_resolution_is_the_smallest_step_of_any_channel() -> None:
    assert resolution([np.array([3.0, 3.0]), np.array([1.0, 1.5, np.nan, 4.0])]) == 0.5
    assert resolution([np.array([0.3, 0.1 + 0.2])]) == 0.0


def test_the_values_of_a_long_channel_take_little_memory() -> None:
    samples = np.random.default_rng(4).normal(0.0, 1.0, 1 << 20)
    tracemalloc.start()
    step = resolution([samples])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4 << 20
    assert 0.0 < step < 1e-6


@pytest.mark.parametrize("noise", [0.15, 0.4, 1.5])
def test_the_noise_before_rounding(noise: float) -> None:
    rng = np.random.default_rng(8)
    readings = np.rint(rng.uniform(0.0, 100.0, (4000, 1)) + noise * rng.standard_normal((4000, 50)))
    assert noise_under_rounding(float(np.mean(np.var(readings, axis=1, ddof=1))), 1.0) == pytest.approx(noise, 0.03)


def test_the_step_of_a_sensor_is_the_smallest_that_it_takes_within_a_position_else_the_stated_one() -> None:
    readings = ReadingStep()
    assert readings.step() == 0.0
    readings.add([np.array([1.25, 1.25]), np.array([2.5, 2.5])], 0.0)
    assert readings.step() == 0.0
    # From 1.25 to 7.25 is no step: the sensor was tilted between the positions.
    readings.add([np.array([7.25, 7.25]), np.array([2.5, 2.5])], 0.01)
    assert readings.step() == 0.01
    readings.add([np.array([1.25, 1.25]), np.array([3.0, 2.75])], 0.01)
    assert readings.step() == 0.25


def test_the_step_of_a_converter() -> None:
    volts = np.round(np.random.default_rng(1).normal(0.0, 0.01, 3000) / 187.5e-6) * 187.5e-6
    assert even_step(np.round(volts, 7)) == pytest.approx(187.5e-6, rel=1e-3)


def test_a_continuous_reading_has_no_step() -> None:
    for rows in (3000, 30_000):
        assert even_step(np.random.default_rng(1).normal(0.0, 1.0, rows)) == 0.0
