"""Mean, noise and uncertainty of a run of samples."""

import statistics
from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import linregress

from tiltcal.core.samples import ReadingStep, correlated_noise, drift, even_step, noise_under_rounding, summarise


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=50))
def test_mean_and_std_are_the_standard_librarys(samples: list[float]) -> None:
    summary = summarise(samples)
    assert summary.mean == pytest.approx(statistics.fmean(samples), rel=1e-12, abs=1e-9)
    assert summary.std == pytest.approx(statistics.stdev(samples), rel=1e-6, abs=1e-6)


def test_correlated_noise_does_not() -> None:
    """An autoregressive record: std/sqrt(n) would claim far too little, the block means do not."""
    rng = np.random.default_rng(2)
    runs = []
    for _ in range(200):
        noise = rng.normal(size=400)
        for i in range(1, 400):
            noise[i] += 0.9 * noise[i - 1]
        runs.append(summarise(noise.tolist()))
    scatter = np.std([run.mean for run in runs])
    claimed = np.sqrt(np.mean([run.u**2 for run in runs]))
    naive = np.mean([run.std for run in runs]) / sqrt(400)
    assert naive < 0.4 * scatter
    assert 0.7 * scatter < claimed < 1.3 * scatter
    slow = [summarise(run.tolist()) for run in lfilter([1.0], [1.0, -0.99], rng.normal(size=(20, 400)))]
    shown = correlated_noise(slow)  # its memory is 100 samples, and a block has 40
    assert shown is not None
    assert "sample each position at least" in shown.note


def test_the_uncertainty_is_that_of_ten_block_means() -> None:
    samples = np.random.default_rng(1).normal(7.0, 0.3, 240)
    means = samples.reshape(10, 24).mean(axis=1)
    assert summarise(samples.tolist()).u == pytest.approx(np.std(means, ddof=1) / sqrt(10), rel=1e-12)


def test_a_drift_is_that_of_the_regression_line() -> None:
    times = np.arange(12) * 0.5
    samples = 3.0 + 0.02 * times + np.random.default_rng(2).normal(0.0, 0.1, 12)
    line = linregress(times, samples)
    assert drift(times.tolist(), samples.tolist()) == pytest.approx((line.slope * 5.5, line.stderr * 5.5), rel=1e-9)


def test_a_reading_that_never_changes_is_uncertain_by_its_step() -> None:
    assert summarise([1024.0] * 100, resolution=1.0).u == pytest.approx(1 / sqrt(12))


@pytest.mark.parametrize("noise", [0.0, 0.1, 3.0])
def test_a_step_that_is_known_later_counts_as_if_it_had_been_known(noise: float) -> None:
    samples = np.rint(np.random.default_rng(5).normal(7.0, noise, 100)).tolist()
    later, known = summarise(samples).with_resolution(1.0), summarise(samples, 1.0)
    assert (later.u, later.quantisation) == pytest.approx((known.u, known.quantisation), rel=1e-12)
    assert later.resolution == known.resolution == 1.0


def test_dithered_quantisation_averages_out() -> None:
    """Noise of 0.6 step: means of rounded samples scatter about the truth as the stated uncertainty says."""
    rng = np.random.default_rng(3)
    errors, claimed = [], []
    for _ in range(400):
        truth = rng.uniform(0.0, 1.0)
        summary = summarise(np.round(rng.normal(truth, 0.6, 200)).tolist(), resolution=1.0)
        errors.append(summary.mean - truth)
        claimed.append(summary.u)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.sqrt(np.mean(np.square(claimed))), rel=0.25)


def test_identical_samples_have_no_scatter_at_all() -> None:
    """A hundred times 0.1 is not 10 in binary digits."""
    for value in (0.1, 107.123, 1 / 3):
        summary = summarise([value] * 97)
        assert (summary.mean, summary.std, summary.u) == (value, 0.0, 0.0)


# Rounding


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
