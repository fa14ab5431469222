"""Still, moved and stuck, against counts and probabilities worked out by hand and by scipy."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from tiltcal.core.detection import bursts, distances, identical_by_chance, is_still, jumps, outliers

REST = np.random.default_rng(1).normal(0.0, 1.0, (2000, 2))


def test_identical_samples_and_their_probability() -> None:
    """No step holds more of normal noise than the middle one: its share to the power of the count."""
    step, noise = 1.0, 0.5
    share = scipy.stats.norm.cdf(0.5 * step / noise) - scipy.stats.norm.cdf(-0.5 * step / noise)
    most = int(np.log(1e-6) / np.log(share))
    assert identical_by_chance(most, noise, step)
    assert not identical_by_chance(most + 1, noise, step)


def test_a_step_and_a_knock_stand_out() -> None:
    blocks = REST.reshape(50, 40, 2).copy()
    blocks[20:] += 5.0
    knocked = blocks[31, :, 1]
    blocks[31, :, 1] = knocked.mean() + 8.0 * (knocked - knocked.mean())
    assert np.flatnonzero(jumps(blocks.mean(axis=1)).any(axis=1)).tolist() == [19, 20]
    assert np.flatnonzero(bursts(blocks.std(axis=1))[:, 1]).tolist() == [31]


@pytest.mark.parametrize(
    ("change", "uncertainty", "shown", "still"),
    [(0.9, 0.0, False, True), (1.1, 0.0, False, False), (1.1, 0.3, False, True), (0.5, 0.3, True, False)],
)
def test_still(change: float, uncertainty: float, shown: bool, still: bool) -> None:
    assert is_still(-change, uncertainty, 1.0, shown=shown) is still


def test_one_sample_of_a_hundred_that_is_off() -> None:
    samples = np.rint(1024.0 + 0.6 * REST[:100, 0])
    assert len(outliers(samples, step=1.0)) == 0
    samples[37] += 578.0
    assert outliers(samples, step=1.0).tolist() == [37]


@pytest.mark.parametrize("decimals", [0, 1, 9])
@pytest.mark.parametrize("n", [9, 8192, 20_001])
def test_the_median_is_that_of_numpy(n: int, decimals: int) -> None:
    """Of noise on a drift, and of blocks that lie apart, of which a sample shows the wrong half."""
    noise = np.random.default_rng(n).normal(size=n)
    for samples in (noise + np.arange(n) / n, np.where(np.arange(n) % (n // 2048 or 1) == 0, 50.0, noise)):
        rounded = np.round(samples, decimals)
        assert distances(rounded)[2] == np.median(rounded)
