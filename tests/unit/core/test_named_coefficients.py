"""Two calibrations compared at one reference temperature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.core.model import Coefficients, Thermal
from tiltcal.core.named_coefficients import KnownCoefficient, changes, known, referred, values

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
    one, other = {"offset.x": KnownCoefficient(3.0)}, {"offset.x": KnownCoefficient(4.0)}
    found = changes(part(24.0, [0.5], []), part(24.0, [0.5], [], 1005.0), one, other)
    by_name = {change.name: change for change in found}
    assert by_name["offset.x"].ratio == pytest.approx(1.0)
    assert by_name["sensitivity.x.x"].ratio is None


def test_counted_from_another_reference_the_offset_takes_the_drifts_uncertainty_over() -> None:
    """By hand: offset' = offset + 10 drift, with covariance 0.02 between them: 1 + 100 * 0.01 + 2 * 10 * 0.02 = 2.4."""
    names, covariance = ["offset.x", "temperature.offset.x.1"], np.array([[1.0, 0.02], [0.02, 0.01]])
    found = known(part(24.0, [0.5], []), names, covariance, np.full(2, 1.96), reference=34.0)
    assert found["offset.x"].u == pytest.approx(np.sqrt(2.4))
    assert found["temperature.offset.x.1"].u == pytest.approx(0.1)
    assert np.isinf(found["offset.x"].dof)


def test_a_difference_of_two_estimates_has_students_threshold() -> None:
    """Student's t at 97.5 %: 2.571 for 5 degrees of freedom; of two equal parts with 5 each there are 10, and 2.228."""
    one = known(part(24.0, [], []), ["offset.x"], np.array([[4.0]]), np.array([2.571]))
    assert one["offset.x"].dof == pytest.approx(5.0, rel=2e-3)
    (change, *_) = changes(part(24.0, [], []), part(24.0, [], [], 1005.0), one, one)
    assert change.dof == pytest.approx(10.0, rel=2e-3)
    assert change.threshold(0.95) == pytest.approx(2.228, abs=1e-3)


def test_a_non_linearity_is_compared_too() -> None:
    straight = Coefficients(("x",), ("x",), np.array([0.0]), np.array([[1.0]]), nonlinearity=np.array([[0.0, 0.01]]))
    bent = replace(straight, nonlinearity=np.array([[0.0, 0.02]]))
    by_name = {change.name: change.difference for change in changes(straight, bent, {}, {})}
    assert by_name["nonlinearity.x.3"] == pytest.approx(0.01)
    assert by_name["nonlinearity.x.2"] == 0.0


def test_a_small_variance_beside_a_large_one_is_kept() -> None:
    """Gains of 1e-6 beside sensitivities of 450 counts, correlated by 0.5: u is the root of the diagonal."""
    thermal = Thermal(24.0, None, np.full((2, 2), 0.5), np.full((2, 1), 1e-4))
    both = Coefficients(("x", "y"), ("x", "y", "z"), np.full(2, 1e3), np.full((2, 3), 256e3), thermal)
    names = list(values(both))
    u = np.array([{"offset": 20.0, "sensitivity": 450.0}.get(name.split(".")[0], 1e-6) for name in names])
    covariance = np.outer(u, u) * (0.5 + 0.5 * np.eye(14))
    found = known(both, names, covariance, np.full(14, 1.96))
    assert [found[name].u for name in names] == pytest.approx(u.tolist(), rel=1e-6)
