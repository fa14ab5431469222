"""The step of rounded readings, and what rounding hides."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from support import coloured_noise as coloured

from tiltcal.core.quantisation import DifferentValues, ReadingStep, StepFinder, resolution
from tiltcal.core.samples import noise_under_rounding


def test_resolution_is_the_smallest_step_of_any_channel() -> None:
    assert resolution([np.array([3.0, 3.0]), np.array([1.0, 1.5, np.nan, 4.0])]) == 0.5
    assert resolution([np.array([0.3, 0.1 + 0.2])]) == 0.0


@pytest.mark.parametrize(("decimals", "block"), [(2, 700), (9, 700), (9, 50_000)])
def test_the_step_of_all_blocks_is_that_of_all_samples(decimals: int, block: int) -> None:
    samples = np.round(np.random.default_rng(4).normal(0.0, 1.0, 60_000), decimals)
    samples[3:9] = np.nan
    found = DifferentValues()
    for start in range(0, len(samples), block):
        found.add(samples[start : start + block])
    assert found.step() == resolution([samples])


def test_the_values_of_a_long_channel_take_little_memory() -> None:
    found, rng = DifferentValues(), np.random.default_rng(4)
    tracemalloc.start()
    for _ in range(16):
        found.add(rng.normal(0.0, 1.0, 1 << 16))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 16 << 20
    assert 0.0 < found.step() < 1e-6


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


class TestSteps:
    def step(self, samples: coloured.Samples) -> float:
        steps = StepFinder()
        steps.add(samples)
        return steps.result()

    def test_a_converter(self) -> None:
        volts = np.round(coloured.white(np.random.default_rng(1), 3000, 0.01) / 187.5e-6) * 187.5e-6
        assert self.step(np.round(volts, 7)) == pytest.approx(187.5e-6, rel=1e-3)

    def test_a_continuous_reading(self) -> None:
        assert self.step(coloured.white(np.random.default_rng(1), 3000, 1.0)) == 0.0
        assert self.step(coloured.white(np.random.default_rng(1), 30_000, 1.0)) == 0.0
