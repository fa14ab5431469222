"""What a log comes to, block by block, is what all its rows at once come to."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiltcal.core.column_statistics import STEP, STRETCHES, ColumnStatistics


def overview_of(*columns: np.ndarray, cuts: list[int]) -> ColumnStatistics:
    """Of rows that come in blocks: their time, angles, flag and reason."""
    found = ColumnStatistics([f"tilt_{k}" for k in range(columns[1].shape[1])])
    for low, high in pairwise([0, *sorted(cuts), len(columns[0])]):
        found.add(*(column[low:high] for column in columns))
    return found


@given(st.integers(1, 9000), st.lists(st.integers(0, 9000), max_size=6), st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_envelopes_and_flags_in_any_blocks(rows: int, cuts: list[int], seed: int) -> None:
    draw = np.random.default_rng(seed)
    time, angles = np.cumsum(draw.uniform(0.1, 2.0, rows)), draw.uniform(-90.0, 90.0, (rows, 2))
    angles[draw.random((rows, 2)) < 0.2] = np.nan
    flag = draw.choice(np.array([1, 3, 4, 9], np.uint8), rows)
    reason = draw.integers(0, 64, rows).astype(np.uint8)
    found = overview_of(time, angles, flag, reason, cuts=[min(cut, rows) for cut in cuts])
    count = len(found.time)
    assert found.rows == rows
    assert min(rows, STRETCHES) <= count <= 2 * STRETCHES
    length = next(2**k for k in range(20) if -(-rows // 2**k) == count)
    stretches = [slice(k * length, (k + 1) * length) for k in range(count)]
    for column in range(2):
        known = [part[np.isfinite(part)] for part in (angles[stretch, column] for stretch in stretches)]
        low, high = ([bound(part) if len(part) else np.nan for part in known] for bound in (np.min, np.max))
        assert np.array_equal(found.low[:, column], low, equal_nan=True)
        assert np.array_equal(found.high[:, column], high, equal_nan=True)
    assert np.array_equal(found.time, time[::length])
    flagged = [[np.mean(flag[stretch] == 3), np.mean(flag[stretch] >= 4)] for stretch in stretches]
    np.testing.assert_allclose(found.flagged, flagged, rtol=1e-6)
    assert [found.flags[value] for value in (1, 3, 4, 9)] == [int(np.sum(flag == value)) for value in (1, 3, 4, 9)]
    assert found.reasons[8] == np.count_nonzero(reason & 8)
    assert found.mean == pytest.approx(np.nanmean(angles, axis=0) if rows > 50 else found.mean, nan_ok=True)


@given(st.integers(3, 500), st.integers(1, 60), st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_histograms_hold_every_angle(rows: int, bins: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    angles = draw.normal(draw.uniform(-60.0, 60.0), draw.uniform(0.01, 30.0), (rows, 1)).clip(-180.0, 180.0)
    none = np.zeros(rows, np.uint8)
    ((edges, counts),) = overview_of(np.arange(float(rows)), angles, none + 1, none, cuts=[]).histogram(bins)
    assert len(counts) <= bins
    assert counts.sum() == rows
    assert edges[0] - STEP <= angles.min() <= angles.max() <= edges[-1] + STEP
    binned = np.rint((angles + 180.0) / STEP) * STEP - 180.0
    assert counts.tolist() == np.histogram(binned, edges)[0].tolist()
    none_at_all = overview_of(np.arange(3.0), np.full((3, 1), np.nan), none[:3], none[:3], cuts=[]).histogram(bins)
    assert [one.tolist() for one in none_at_all[0]] == [[0.0], []]
