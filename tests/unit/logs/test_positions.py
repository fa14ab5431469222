"""The rise of a temperature in an interval of a log."""

from __future__ import annotations

import numpy as np
import pytest

from tiltcal.logs.positions import rise


def test_the_rise_is_that_of_the_line_less_its_scatter() -> None:
    """A slope of 0.01 per sample with little scatter, from numpy's fit."""
    values = 0.01 * np.arange(300.0) + np.random.default_rng(4).normal(0.0, 0.05, 300)
    (slope, _), covariance = np.polyfit(np.arange(300), values, 1, cov=True)
    assert rise(values) == pytest.approx(299 * (slope - 3.0 * np.sqrt(covariance[0, 0])), rel=1e-9)
