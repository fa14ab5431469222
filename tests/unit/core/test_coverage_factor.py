"""Effective degrees of freedom."""

from __future__ import annotations

import numpy as np
import pytest

from tiltcal.core.coverage_factor import welch_satterthwaite


def test_the_example_of_the_guide() -> None:
    """GUM, G.4.1: a product of three quantities, from 10, 5 and 15 readings; relative uncertainties in percent."""
    parts = [(np.array([0.25**2]), 9.0), (np.array([0.57**2]), 4.0), (np.array([0.82**2]), 14.0)]
    (dof,) = welch_satterthwaite(np.array([1.03**2]), parts)
    assert dof == pytest.approx(19.0, abs=0.05)


def test_a_part_without_weight_leaves_the_degrees_infinite() -> None:
    """Such a part came from a sensor whose noise was far below its jig."""
    tiny = np.array([1e-157, 0.0, 5.98e-157, 2.33e-160])
    assert np.all(np.isinf(welch_satterthwaite(np.full(4, 0.05), [(tiny, 1.0)])))
