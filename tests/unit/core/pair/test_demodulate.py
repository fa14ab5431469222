"""The columns of the demodulation, against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from tiltcal.core.pair.demodulate import harmonic_columns
from tiltcal.core.pair.stage import follow


def test_the_harmonics_are_sines_and_cosines_at_every_angle() -> None:
    angle = np.append(np.random.default_rng(7).uniform(-50.0, 50.0, 10_000), [0.0, 0.25, 0.5, 0.75, 0.5 - 1e-16])
    columns = harmonic_columns(angle, 4)
    phase = 2.0 * np.pi * (angle - np.floor(angle))
    for h in range(1, 5):
        assert columns[2 * h - 2 : 2 * h] == pytest.approx(np.array([np.sin(h * phase), np.cos(h * phase)]), abs=2e-14)
    assert np.all(columns[8] == 1.0)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_the_turns_go_on_from_block_to_block(noise: float) -> None:
    """With noise the angle steps back across zero, which is no turn more."""
    turns = np.linspace(0.3, 40.3, 5000) + noise * np.random.default_rng(2).uniform(-0.5, 0.5, 5000)
    followed: list[float] = []
    for part in np.split(turns % 1.0 * 360.0, [1, 700, 701, 3000]):
        followed += follow(part, followed[-1] if followed else None).tolist()
    assert followed == pytest.approx(turns, abs=1e-9)
