"""Runs, stuck rows and the scatter in windows, against numpy and counts by hand."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tiltcal.core.model import Array
from tiltcal.core.rows import (
    LongRuns,
    Stillest,
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


def test_variance_in_a_window_is_that_of_numpy() -> None:
    found = np.concatenate(list(window_variances(REST + 1e6, [(1000, 1001)], 50)), axis=1).T
    # Far from zero, beside rows that are lost.
    assert found[7] == pytest.approx(REST[7:57].var(axis=0, ddof=1), rel=1e-9)
    assert np.flatnonzero(np.isinf(found[:, 0])).tolist() == list(range(951, 1001))


@settings(max_examples=40, deadline=None)
@given(
    values=arrays(float, (60, 3), elements=st.integers(-800, 800).map(lambda eighths: eighths / 8)),
    window=st.integers(2, 60),
    level=st.sampled_from([0.0, 1e5]),
)
def test_the_scatter_is_the_standard_deviation(values: Array, window: int, level: float) -> None:
    ((found, _),) = window_scatter(values + level, [], [window, 7])
    expected = [np.sqrt(np.sum(np.var(values[start : start + window], axis=0, ddof=1))) for start in range(61 - window)]
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-4)


def test_small_noise_far_down_a_long_log_is_not_lost() -> None:
    rng = np.random.default_rng(4)
    log = np.repeat([[1e4, -1e4, 0.0]], 200_000, axis=0) + 1e-3 * rng.normal(size=(200_000, 3))
    scatter = np.concatenate([piece for (piece,) in window_scatter(log, [], [100])])
    assert scatter[-1] == pytest.approx(np.sqrt(np.sum(np.var(log[-100:], axis=0, ddof=1))), rel=1e-6)
    assert len(scatter) == 199_901


def test_a_window_with_a_lost_row_is_never_still() -> None:
    ((scatter,),) = window_scatter(np.zeros((50, 3)), [(20, 21)], [10])
    assert np.flatnonzero(np.isinf(scatter)).tolist() == list(range(11, 21))


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
