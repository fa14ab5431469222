"""Uncertain quantities: against the examples of the GUM and calculations by hand."""

import numpy as np
import pytest
import scipy

from tiltcal.core.uncertain import Uncertain, weighted_sum


def errors(covariance: list[list[float]] | np.ndarray, dof: float = np.inf) -> Uncertain:
    matrix = np.asarray(covariance, dtype=float)
    return Uncertain.errors([f"q{k}" for k in range(len(matrix))], matrix, dof, source="noise")


def test_few_degrees_of_freedom_widen_what_they_are_of_and_nothing_else() -> None:
    """The noise of a slope, of 2 degrees of freedom, beside a known error that cancels between offset and slope."""
    known, noise = errors([[100.0, -100.0], [-100.0, 100.0]]), errors([[0.0, 0.0], [0.0, 1.0]], 2.0)
    level, beside = (known + noise).through(np.array([[1.0, 1.0], [1.0, 0.0]]), "ab").factors
    assert level == pytest.approx(scipy.stats.t.ppf(0.975, 2))
    assert beside == pytest.approx(scipy.stats.norm.ppf(0.975))


def test_a_linear_function_has_j_c_j_and_the_factor_of_the_one_variance_that_was_estimated() -> None:
    matrix = np.array([[1.0, -2.0], [0.5, 3.0], [0.0, 1.0]])
    known = errors([[2.0, 0.7], [0.7, 1.0]], 6.0)
    for found in (known.through(matrix, "abc"), known.through_function("abc", lambda v: matrix @ v)):
        np.testing.assert_allclose(found.covariance, matrix @ known.covariance @ matrix.T, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(found.factors, np.full(3, scipy.stats.t.ppf(0.975, 6)), rtol=1e-6)


def test_what_follows_from_another_error_counts_once() -> None:
    """As in the GUM, 5.2.2: fully correlated errors add, and opposite ones cancel; an exact one adds none."""
    known = errors([[4.0, -2.0, 0.0], [-2.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    found = known.through_function("abc", lambda x: np.array([x.sum(), x[0] - x[1], x[0] + 2.0 * x[1]]))
    assert found.u == pytest.approx([1.0, 3.0, 0.0], abs=1e-12)


def test_a_shared_error_is_one_error_in_a_weighted_sum() -> None:
    """Two offsets read anew, o_i = -S / 2 + e_i, with one S of u = 4 and e_i of 3 and 1.

    By hand: their difference has 3² + 1²; halfway between them S keeps its 4, and the offset has 2² + (3² + 1²) / 4.
    """
    first, second = (errors([[4.0 + e**2, -8.0], [-8.0, 16.0]]) for e in (3.0, 1.0))
    change = weighted_sum(first, second, (-1.0, 1.0), ("q1",))
    assert change.u == pytest.approx([np.sqrt(10.0), 0.0])
    halfway = weighted_sum(first, second, (0.5, 0.5), ("q1",))
    assert halfway.u == pytest.approx([np.sqrt(4.0 + 10.0 / 4.0), 4.0])
    assert weighted_sum(first, second, (0.5, 0.5), ()).u[1] == pytest.approx(4.0 / np.sqrt(2.0))
