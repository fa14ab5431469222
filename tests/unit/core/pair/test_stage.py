"""The angle of a stage, followed from row to row."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.core.pair.stage import follow


@given(st.floats(-0.12, 0.4), st.floats(0.0, 1.0), st.integers(2, 60), st.integers(1, 59))
def test_wrapped_angles_are_followed_over_their_turns(step: float, start: float, count: int, cut: int) -> None:
    """In two blocks."""
    turns = start + step * np.arange(count)
    theta = turns * 360.0 % 360.0
    first = follow(theta[:cut])
    followed = np.concatenate([first, follow(theta[cut:], float(first[-1]))])
    assert followed - followed[0] == pytest.approx(turns - turns[0], abs=1e-9)


def test_an_angle_that_steps_back_across_zero_is_no_turn_more() -> None:
    turns = np.linspace(0.3, 40.3, 5000) + 0.01 * np.random.default_rng(2).uniform(-0.5, 0.5, 5000)
    assert follow(turns % 1.0 * 360.0) == pytest.approx(turns, abs=1e-9)


def test_a_jump_back_is_a_gap() -> None:
    angle = np.array([0.0, 10.0, 20.0, 240.0, 250.0])
    assert follow(angle) * 360.0 == pytest.approx(angle)


def test_after_a_million_turns_the_angle_is_as_exact_as_the_encoders() -> None:
    theta = np.tile([0.0, 120.0, 240.0], 1_000_000)
    assert float(np.max(np.abs(follow(theta) % 1.0 - theta / 360.0))) < 1e-9
