"""Coefficients by their names, and at another reference temperature."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.core.model import Coefficients, Thermal, referred
from tiltcal.core.uncertain import Uncertain, uncertain_at

small = st.floats(-0.01, 0.01)


def part(reference: float, drift: list[float], gain: list[float], offset: float = 1000.0) -> Coefficients:
    thermal = Thermal(reference, None, np.array([drift]), np.array([gain]).reshape(1, len(gain)))
    return Coefficients(("x",), ("x",), np.array([offset]), np.array([[800.0]]), thermal)


@given(st.lists(small, max_size=3), st.lists(small, max_size=2), st.floats(-20, 20), st.floats(-30, 60))
def test_referred_coefficients_predict_the_same(drift, gain, shift, temperature) -> None:
    """Whatever the reference temperature, the model reads the same at every temperature."""
    one = part(24.0, drift, gain)
    other = referred(one, 24.0 + shift)
    gravity, at = np.array([[0.3, 0.0, 0.95]]), np.array([temperature])
    assert other.predict(gravity, at)[0, 0] == pytest.approx(one.predict(gravity, at)[0, 0], rel=1e-9)


def test_counted_from_another_reference_the_offset_takes_the_drifts_uncertainty_over() -> None:
    """By hand: offset' = offset + 10 drift, with covariance 0.02 between them: 1 + 100 * 0.01 + 2 * 10 * 0.02 = 2.4."""
    stated = Uncertain.errors(["offset.x", "temperature.offset.x.1"], np.array([[1.0, 0.02], [0.02, 0.01]]))
    moved = uncertain_at(part(24.0, [0.5], []), stated, 34.0)
    assert moved.by_name(moved.u) == pytest.approx({"offset.x": np.sqrt(2.4), "temperature.offset.x.1": 0.1})
    assert np.all(np.isinf(moved.dof))


def test_an_offset_at_another_reference_has_the_degrees_of_freedom_of_the_drift_too() -> None:
    """By hand: u² = 0.1² + (20 * 0.1)² = 4.01, of which 4 has 1 degree of freedom: 1 in all, and t = 12.7, not 1.96."""
    names, dof = ["offset.x", "temperature.offset.x.1"], np.array([np.inf, 1.0])
    moved = uncertain_at(part(20.0, [0.5], []), Uncertain.errors(names, np.diag([0.01, 0.01]), dof), 0.0)
    assert moved.u == pytest.approx([np.sqrt(4.01), 0.1])
    assert moved.factors == pytest.approx([12.7, 12.706], abs=0.1)
