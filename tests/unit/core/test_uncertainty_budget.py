"""Central differences: exact for a polynomial of the second degree."""

import numpy as np
import pytest

from tiltcal.core.uncertainty_budget import central_differences


def test_the_derivatives_of_a_quadratic_are_exact() -> None:
    def function(x: np.ndarray) -> np.ndarray:
        return np.array([x[0] ** 2 + 3.0 * x[1], x[0] * x[1]])

    found = central_differences(function, np.array([2.0, 5.0]), np.array([0.5, 0.25]))
    assert found == pytest.approx(np.array([[4.0, 3.0], [5.0, 2.0]]), rel=1e-12)


def test_a_certain_parameter_has_a_column_of_zeros_and_none_has_no_column() -> None:
    assert central_differences(lambda x: 2.0 * x, np.ones(2), np.array([1.0, 0.0])).tolist() == [[2.0, 0.0], [0.0, 0.0]]
    assert central_differences(lambda x: np.ones(3), np.zeros(0), np.zeros(0)).shape == (3, 0)
