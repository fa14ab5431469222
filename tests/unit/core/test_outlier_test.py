"""Outliers among the values of many sensors, against Rosner's published example and their false-alarm rate."""

from __future__ import annotations

import numpy as np
import pytest

from tiltcal.core.outlier_test import extreme_values

ROSNER = [
    *(-0.25, 0.68, 0.94, 1.15, 1.20, 1.26, 1.26, 1.34, 1.38, 1.43, 1.49, 1.49, 1.55, 1.56, 1.58, 1.65, 1.69, 1.70),
    *(1.76, 1.77, 1.81, 1.91, 1.94, 1.96, 1.99, 2.06, 2.09, 2.10, 2.14, 2.15, 2.23, 2.24, 2.26, 2.35, 2.37, 2.40),
    *(2.47, 2.54, 2.62, 2.64, 2.90, 2.92, 2.92, 2.93, 3.21, 3.26, 3.30, 3.59, 3.68, 4.30, 4.64, 5.34, 5.42, 6.01),
]
"""Rosner (1983), in the NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.5.17.3: three outliers among 54."""


def test_the_published_example_has_three_outliers() -> None:
    values = np.array(ROSNER)
    assert values[extreme_values(values, 0.05)].tolist() == [6.01, 5.42, 5.34]


@pytest.mark.parametrize("n", [8, 20])
def test_of_fleets_without_outliers_five_per_cent_have_one(n: int) -> None:
    draw = np.random.default_rng(3)
    alarms = [bool(extreme_values(values, 0.05)) for values in draw.normal(size=(2000, n))]
    assert 0.035 < np.mean(alarms) < 0.07


def test_equal_values_and_too_few_have_none() -> None:
    assert extreme_values(np.ones(9), 0.05) == []
    assert extreme_values(np.array([1.0, 9.0]), 0.05) == []
