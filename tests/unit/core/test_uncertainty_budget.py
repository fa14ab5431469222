"""Central differences: exact for a polynomial of the second degree."""

import numpy as np
import pytest

from tiltcal.core.uncertainty_budget import central_differences, propagated


def test_the_derivatives_of_a_quadratic_are_exact() -> None:
    def function(x: np.ndarray) -> np.ndarray:
        return np.array([x[0] ** 2 + 3.0 * x[1], x[0] * x[1]])

    found = central_differences(function, np.array([2.0, 5.0]), np.array([0.5, 0.25]))
    assert found == pytest.approx(np.array([[4.0, 3.0], [5.0, 2.0]]), rel=1e-12)


def test_a_certain_parameter_has_a_column_of_zeros_and_none_has_no_column() -> None:
    assert central_differences(lambda x: 2.0 * x, np.ones(2), np.array([1.0, 0.0])).tolist() == [[2.0, 0.0], [0.0, 0.0]]
    assert central_differences(lambda x: np.ones(3), np.zeros(0), np.zeros(0)).shape == (3, 0)


@pytest.mark.parametrize("scale", [1.0, 1e-9])
def test_the_last_digit_of_a_covariance_turns_nothing(scale: float) -> None:
    """Beside equal variances it turns the principal axes by 45°, which a result with a corner near would follow."""

    def length(errors: np.ndarray) -> np.ndarray:
        return np.array([np.hypot(errors[0] / scale, errors[1])])

    units, at = np.array([scale, 1.0]), np.array([0.3 * scale, 0.2])
    found = [
        propagated(length, at, np.array([[1.0, off], [off, 1.0]]) * np.outer(units, units), np.full(2, 1.96))[0][0]
        for off in (0.0, 1e-15, -1e-15)
    ]
    assert found == pytest.approx([found[0]] * 3, rel=1e-12)


def test_what_follows_from_another_error_counts_once() -> None:
    """As in the GUM, 5.2.2: fully correlated errors add, and opposite ones cancel; an exact one adds none."""
    covariance = np.array([[4.0, -2.0, 0.0], [-2.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    u, _ = propagated(
        lambda x: np.array([x.sum(), x[0] - x[1], x[0] + 2.0 * x[1]]), np.zeros(3), covariance, np.full(3, 1.96)
    )
    assert u == pytest.approx([1.0, 3.0, 0.0], abs=1e-12)
