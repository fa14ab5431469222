"""Still, moved and stuck, against numpy, scipy and counts by hand."""

import numpy as np
import pytest
import scipy

from tiltcal.core import detection
from tiltcal.core.samples import SampleSummary

REST = np.random.default_rng(1).normal(0.0, 1.0, (2000, 2))


def test_identical_samples_and_their_probability() -> None:
    """No step holds more of normal noise than the middle one: its share to the power of the count."""
    step, noise = 1.0, 0.5
    share = scipy.stats.norm.cdf(0.5 * step / noise) - scipy.stats.norm.cdf(-0.5 * step / noise)
    most = int(np.log(1e-6) / np.log(share))
    assert detection.identical_by_chance(most, noise, step)
    assert not detection.identical_by_chance(most + 1, noise, step)


def test_a_step_and_a_knock_stand_out() -> None:
    blocks = REST.reshape(125, 16, 2).copy()
    blocks[20:, :, 0] += 5.0
    blocks[31, :, 1] = blocks[31, :, 1].mean() + 8.0 * (blocks[31, :, 1] - blocks[31, :, 1].mean())
    columns = list(50.0 + blocks.reshape(2000, 2).T + 0.02 * np.arange(2000))
    assert detection.moved_rows(columns, (0.0, 0.0)) == [(19 * 16, 21 * 16), (31 * 16, 32 * 16)]
    assert detection.moved_rows([column[: 8 * 16 - 1] for column in columns], (0.0, 0.0)) == []
    # Of a reading in steps nothing stands out below what rounding gives, 1/√12.
    quiet = np.zeros(64 * 16)
    for height, rows in ((1.1, []), (1.25, [(8 * 16 - 16, 8 * 16 + 16)])):
        quiet[8 * 16 :] = height * 8.0 / np.sqrt(12.0) / 1.2
        assert detection.moved_rows([quiet], (1.0,)) == rows
    long = np.tile(REST[:, 0], 600)
    long[999_999] = 1e6  # the mean of its block differs from both neighbours'
    long[777_760:777_791] = np.nan  # one sample of a block shows no scatter
    assert detection.moved_rows([long], (0.0,)) == [(31_248 * 32, 31_251 * 32)]


def test_samples_that_stand_out() -> None:
    """By six deviations: of the median, or of the nearest 90 % where more than half are in one step; and two steps."""
    samples = REST[:200, 0].copy()
    samples[[7, 11]] = 99.0, -99.0
    middle, spread = np.median(samples), scipy.stats.median_abs_deviation(samples, scale="normal")
    nearest = np.sort(np.abs(samples - middle))[:180]
    limit = 6.0 * max(spread, 1.267 * np.sqrt(np.mean(nearest**2)))
    samples[[7, 11]] = middle + 1.001 * limit, middle - 0.999 * limit
    assert detection.outliers(samples).tolist() == [7]
    assert detection.outliers(samples, 0.51 * limit).tolist() == []
    assert detection.outliers(samples, 0.49 * limit).tolist() == [7]
    assert detection.outliers([0.0] * 7 + [9.0]).tolist() == [7]
    assert detection.outliers([0.0] * 6 + [9.0]).tolist() == []
    steps = np.repeat([0.0, 1.0, 3.0], [60, 30, 10])  # a third of the nearest 90 are 1: 6 * 1.267 * √(1/3) = 4.39
    for far, found in ((4.3, []), (4.5, [99])):
        steps[99] = far
        assert detection.outliers(steps, 1.0).tolist() == found


def test_the_noise_of_positions_is_that_before_rounding() -> None:
    def noise(step: float, *stds: float) -> float:
        return detection.noise_of_positions([SampleSummary(0.0, std, 10, 0.1) for std in stds], step)

    assert noise(0.0, 1.0, 2.0) == pytest.approx(np.sqrt(0.9 * 2.5))
    # A reading that flickers between two values scatters by half a step at most, which shows no noise.
    assert noise(2.0, 1.05, 1.05, 9.0) == 0.0
    assert noise(2.0, 1.06, 1.06, 9.0) == pytest.approx(np.sqrt(0.9 * (2 * 1.06**2 + 81.0) / 3.0 - 4.0 / 12.0))


def test_a_run_of_a_noisy_reading_is_stuck_and_of_a_coarse_one_not() -> None:
    samples = np.rint(REST)  # noise of a whole step
    samples[100:140] = samples[100]
    assert detection.stuck_spans(samples.T, 40) == detection.stuck_spans(samples.T, 25) == [(100, 140)]
    assert detection.stuck_spans(samples.T, 41) == []
    assert not detection.stuck_spans(np.rint(0.3 + 0.08 * REST).T, 25)
    assert detection.stuck_spans([np.full(30, 2.0)], 25) == [(0, 30)]  # nothing else shows the noise


def test_small_noise_far_down_a_long_log_is_not_lost() -> None:
    rng = np.random.default_rng(4)
    log = np.repeat([[1e4, -1e4, 0.0]], 200_000, axis=0) + 1e-3 * rng.normal(size=(200_000, 3))
    scatter = detection.window_scatter(log.T, np.zeros(200_000, dtype=bool), 100)
    assert scatter[-1] == pytest.approx(np.sqrt(np.sum(np.var(log[-100:], axis=0, ddof=1))), rel=1e-6)
    assert (len(scatter), len(detection.window_scatter(log[:9].T, np.zeros(9, dtype=bool), 11))) == (199_901, 0)
    lost = np.zeros(20, dtype=bool)
    lost[[3, 4, 19]] = True
    scatter = detection.window_scatter([np.append(REST[:19, 0], np.nan), REST[:20, 1]], lost, 5)
    for start, found in enumerate(scatter):
        part = REST[start : start + 5]
        expected = np.inf if start < 5 or start > 14 else np.sqrt(np.var(part, axis=0, ddof=1).sum())
        assert found == pytest.approx(expected)
    assert detection.stillest(scatter) == pytest.approx(np.quantile(scatter[5:15], 0.01))
    zero = np.append(scatter, np.zeros(99))
    assert (detection.stillest(zero), detection.stillest(scatter[:5])) == (0.0, None)
    assert detection.stillest(zero, varying=True) == detection.stillest(scatter)
