"""The rise of a temperature in an interval of a log, and what is left of holds."""

import numpy as np
import pytest

from tiltcal.files.tables import Segment
from tiltcal.logs.columns import RecordedColumns
from tiltcal.logs.positions import rise, trimmed


def test_the_rise_is_that_of_the_line_less_its_scatter() -> None:
    """A slope of 0.01 per sample with little scatter, from numpy's fit."""
    values = 0.01 * np.arange(300.0) + np.random.default_rng(4).normal(0.0, 0.05, 300)
    (slope, _), covariance = np.polyfit(np.arange(300), values, 1, cov=True)
    assert rise(values) == pytest.approx(299 * (slope - 3.0 * np.sqrt(covariance[0, 0])), rel=1e-9)


def test_holds_of_one_position_count_each() -> None:
    """Four of twelve that are lost are a third, and not more."""
    draw, segments = (
        np.random.default_rng(5),
        [Segment("abcdef"[k % 6], 40 * k, 40 * k + 40, None, None) for k in range(12)],
    )
    readings = {channel: draw.normal(size=480) for channel in "xy"}
    for hold, channel in ((1, "x"), (2, "x"), (7, "y"), (9, "y")):
        readings[channel][40 * hold : 40 * hold + 40] = 0.5
    found = trimmed(RecordedColumns(readings, "log.csv", 0), "xy", segments, {}, 25)
    assert (found.holds, len(found.left_out), found.not_credible) == (12, 4, None)
