"""Still, moved and stuck, against counts and probabilities worked out by hand and by scipy."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
import scipy

from tiltcal.core.detection import (
    LongRuns,
    Stillest,
    bursts,
    distances,
    identical_by_chance,
    is_still,
    jumps,
    outliers,
    repeated,
    runs,
    stuck_runs,
    stuck_spans,
    window_scatter,
    window_variances,
)

REST = np.random.default_rng(1).normal(0.0, 1.0, (2000, 2))


@pytest.mark.parametrize(
    ("mask", "expected"),
    [("", []), ("..", []), ("##", [(0, 2)]), ("#.#", [(0, 1), (2, 3)]), (".##.", [(1, 3)])],
)
def test_runs(mask: str, expected: list[tuple[int, int]]) -> None:
    assert runs(np.array([mark == "#" for mark in mask], dtype=bool)) == expected


def test_a_missing_value_repeats_nothing() -> None:
    samples = np.array([[1.0, np.nan], [1.0, np.nan], [2.0, 3.0]])
    assert repeated(samples, [1.0, 3.0]).tolist() == [[True, False], [True, False], [False, False]]


def test_a_run_counts_its_first_row() -> None:
    samples = REST[:20].copy()
    samples[5:10] = samples[5]
    assert stuck_runs(samples, 5) == [(5, 10)]
    assert stuck_runs(samples, 6) == []


class TestStuck:
    def test_identical_samples_of_a_noisy_reading(self) -> None:
        samples = np.rint(REST)  # noise of a whole step
        samples[100:140] = samples[100]
        assert stuck_spans(samples, 25) == [(100, 140)]

    def test_a_coarse_reading_that_hardly_changes_is_not_stuck(self) -> None:
        assert not stuck_spans(np.rint(0.3 + 0.08 * REST), 25)

    def test_identical_samples_and_their_probability(self) -> None:
        """No step holds more of normal noise than the middle one: its share to the power of the count."""
        step, noise = 1.0, 0.5
        share = scipy.stats.norm.cdf(0.5 * step / noise) - scipy.stats.norm.cdf(-0.5 * step / noise)
        most = int(np.log(1e-6) / np.log(share))
        assert identical_by_chance(most, noise, step)
        assert not identical_by_chance(most + 1, noise, step)


def test_variance_in_a_window_is_that_of_numpy() -> None:
    found = np.concatenate(list(window_variances(REST + 1e6, [(1000, 1001)], 50)), axis=1).T
    # Far from zero, beside rows that are lost.
    assert found[7] == pytest.approx(REST[7:57].var(axis=0, ddof=1), rel=1e-9)
    assert np.flatnonzero(np.isinf(found[:, 0])).tolist() == list(range(951, 1001))


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


def test_the_scatter_of_a_long_log_takes_little_memory() -> None:
    samples = np.asfortranarray(np.random.default_rng(1).normal(0.0, 1.0, (300_000, 3)))
    tracemalloc.start()
    rows = sum(len(piece) for (piece,) in window_scatter(samples, [], [100]))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rows == 300_000 - 99
    assert peak < 6 << 20  # of one piece


@pytest.mark.parametrize("n", [1, 3, 101, 150_000])
def test_the_stillest_part_is_the_quantile_of_numpy(n: int) -> None:
    """The scatter falls towards the end of the record, so what was kept first is not what counts."""
    scatter = np.random.default_rng(n).exponential(size=n) * np.linspace(2.0, 1.0, n)
    found = Stillest(n)
    for piece in np.array_split(scatter, 1 + n // 1000):
        found.add(piece)
    assert found.result() == np.quantile(scatter, 0.01)
    assert Stillest(n).result() is None


def test_long_runs_go_on_from_one_mask_to_the_next() -> None:
    mask = np.array([*"..###.##....######.#"]) == "#"
    for cuts in ([], [3], [4, 8, 14], [0, 5, 15, 19]):
        found = LongRuns(3)
        for piece in np.split(mask, cuts):
            found.add(piece)
        assert found.result() == [(2, 5), (12, 18)]
    assert LongRuns(3).result() == []
