"""Still, moved and stuck, against numpy, scipy and counts by hand."""

import numpy as np
import pytest
import scipy

from tiltcal.core.detection import identical_by_chance, is_still, moved_rows, stuck_spans, window_scatter

REST = np.random.default_rng(1).normal(0.0, 1.0, (2000, 2))


def test_identical_samples_and_their_probability() -> None:
    """No step holds more of normal noise than the middle one: its share to the power of the count."""
    step, noise = 1.0, 0.5
    share = scipy.stats.norm.cdf(0.5 * step / noise) - scipy.stats.norm.cdf(-0.5 * step / noise)
    most = int(np.log(1e-6) / np.log(share))
    assert identical_by_chance(most, noise, step)
    assert not identical_by_chance(most + 1, noise, step)


def test_a_step_and_a_knock_stand_out() -> None:
    blocks = REST.reshape(125, 16, 2).copy()
    blocks[20:, :, 0] += 5.0
    blocks[31, :, 1] = blocks[31, :, 1].mean() + 8.0 * (blocks[31, :, 1] - blocks[31, :, 1].mean())
    columns = list(blocks.reshape(2000, 2).T)
    assert moved_rows(columns, (0.0, 0.0)) == [(19 * 16, 21 * 16), (31 * 16, 32 * 16)]


@pytest.mark.parametrize(
    ("change", "uncertainty", "shown", "still"),
    [(0.9, 0.0, False, True), (1.1, 0.0, False, False), (1.1, 0.3, False, True), (0.5, 0.3, True, False)],
)
def test_still(change: float, uncertainty: float, shown: bool, still: bool) -> None:
    assert is_still(-change, uncertainty, 1.0, shown=shown) is still


def test_a_run_of_a_noisy_reading_is_stuck_and_of_a_coarse_one_not() -> None:
    samples = np.rint(REST)  # noise of a whole step
    samples[100:140] = samples[100]
    assert stuck_spans(samples.T, 40) == stuck_spans(samples.T, 25) == [(100, 140)]
    assert stuck_spans(samples.T, 41) == []
    assert not stuck_spans(np.rint(0.3 + 0.08 * REST).T, 25)


def test_small_noise_far_down_a_long_log_is_not_lost() -> None:
    rng = np.random.default_rng(4)
    log = np.repeat([[1e4, -1e4, 0.0]], 200_000, axis=0) + 1e-3 * rng.normal(size=(200_000, 3))
    scatter = window_scatter(log.T, np.zeros(200_000, dtype=bool), 100)
    assert scatter[-1] == pytest.approx(np.sqrt(np.sum(np.var(log[-100:], axis=0, ddof=1))), rel=1e-6)
    assert len(scatter) == 199_901
