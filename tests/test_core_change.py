"""Two calibrations compared at one reference temperature."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.core.change import changes, referred
from tiltcal.core.model import Coefficients, Thermal

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


def test_an_unchanged_part_at_another_reference_has_not_changed() -> None:
    """Offset 1000 at 24 °C with 0.5 count/°C is offset 988 at 0 °C."""
    found = changes(part(24.0, [0.5], []), part(0.0, [0.5], [], offset=988.0), {}, {})
    assert {change.name: change.difference for change in found} == pytest.approx(
        {"offset.x": 0.0, "sensitivity.x.x": 0.0, "temperature.offset.x.1": 0.0}
    )


def test_the_ratio_is_the_change_over_its_uncertainty() -> None:
    found = changes(part(24.0, [0.5], []), part(24.0, [0.5], [], 1005.0), {"offset.x": 3.0}, {"offset.x": 4.0})
    by_name = {change.name: change for change in found}
    assert by_name["offset.x"].ratio == pytest.approx(1.0)
    assert by_name["sensitivity.x.x"].ratio is None
