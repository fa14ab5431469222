"""The samples of intervals of a log, against numpy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from tiltcal.core.model import Array
from tiltcal.files.tables import Segment
from tiltcal.logs.columns import RecordedColumns
from tiltcal.logs.positions import StaticInterval, intervals_of, rise


def intervals(values: Array, segments: Sequence[Segment]) -> list[StaticInterval]:
    """Of channels x and y and, where there are three columns, a temperature."""
    record = RecordedColumns(dict(zip(("x", "y", "temperature"), values, strict=False)), "the log", 0)
    return intervals_of(record, ("x", "y"), segments, {}, file="the segments")


def segment(start: int, end: int, name: str = "level") -> Segment:
    return Segment(name, start, end, None, None)


def test_mean_scatter_and_uncertainty_are_those_of_all_samples() -> None:
    rng = np.random.default_rng(1)
    values = np.array([[2.5], [-2.4], [24.0]]) + np.cumsum(rng.normal(0.0, 1e-3, (3, 9000)), axis=1)
    found = intervals(values, [segment(15, 4003), segment(4103, 8994), segment(8994, 9000, "up")])[0]
    whole = np.concatenate([values[:, 15:4003], values[:, 4103:8994]], axis=1)
    for channel, samples in zip(("x", "y"), whole, strict=False):
        summary, size = found.measurement.summaries[channel], whole.shape[1] // 10
        means = samples[: 10 * size].reshape(10, size).mean(axis=1)
        assert summary.n == whole.shape[1]
        assert summary.mean == pytest.approx(samples.mean(), rel=1e-13)
        assert summary.std == pytest.approx(samples.std(ddof=1), rel=1e-12)
        assert summary.noise == pytest.approx(means.std(ddof=1) / np.sqrt(10), rel=1e-12)
    assert found.measurement.temperature == pytest.approx(whole[2].mean(), rel=1e-13)


def test_samples_far_off_are_left_out() -> None:
    values = np.random.default_rng(2).normal(0.0, 1.0, (2, 5000))
    values[0, [7, 1234, 4990]] += 50.0
    (found,) = intervals(values, [segment(0, 5000)])
    kept = np.delete(values, [7, 1234, 4990], axis=1)
    assert found.measurement.when["left_out"] == 3
    assert found.measurement.summaries["y"].mean == pytest.approx(kept[1].mean(), rel=1e-12)
    assert found.measurement.summaries["x"].std == pytest.approx(kept[0].std(ddof=1), rel=1e-12)


def test_the_rise_is_that_of_the_line_less_its_scatter() -> None:
    """A slope of 0.01 per sample with little scatter, from numpy's fit."""
    values = 0.01 * np.arange(300.0) + np.random.default_rng(4).normal(0.0, 0.05, 300)
    (slope, _), covariance = np.polyfit(np.arange(300), values, 1, cov=True)
    assert rise(values) == pytest.approx(299 * (slope - 3.0 * np.sqrt(covariance[0, 0])), rel=1e-9)
