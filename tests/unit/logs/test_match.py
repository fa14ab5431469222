"""Frames of accelerometer pairs that cannot be matched."""

from __future__ import annotations

import numpy as np
import pytest

from tiltcal.errors import EstimateError, InputError
from tiltcal.logs.match import match

THETA = np.arange(0.0, 20 * 360.0, 7.0)
PAIRS = [("a1", "a2", "a4")]


def disk(scale: float) -> dict[str, np.ndarray]:
    """Readings of a turning stage, times a scale."""
    turn, noise = np.radians(THETA), np.random.default_rng(5).normal(0.0, 1e-4, (3, THETA.size))
    waves = np.array([np.sin(turn), -1.01 * np.sin(turn), np.cos(turn)]) + noise
    return {"theta": THETA, "time": THETA / 36.0} | dict(zip(("a1", "a2", "a4"), scale * waves, strict=True))


@pytest.mark.parametrize("scale", [1e-130, 1e-9, 1e9, 1e130])
@pytest.mark.parametrize("phase", ["theta", None])
def test_the_unit_of_readings_does_not_matter(scale: float, phase: str | None) -> None:
    (found,), (usual,) = (match(disk(by), PAIRS, phase=phase).matchings for by in (scale, 1.0))
    assert (found.p, found.u_p, found.u_q) == pytest.approx((usual.p, usual.u_p, usual.u_q), rel=1e-6)


@pytest.mark.parametrize("scale", [1e-300, 1e-170])
@pytest.mark.parametrize("online", [False, True])
def test_readings_whose_squares_vanish_are_no_signal(scale: float, online: bool) -> None:
    """They divided by zero."""
    with pytest.raises(EstimateError, match=r"a1 has no clear signal at the spin frequency \(1e-"):
        match(disk(scale), PAIRS, phase="theta", online=online)


@pytest.mark.parametrize("scale", [1e-300, 1e-170])
def test_readings_whose_squares_vanish_have_no_spin(scale: float) -> None:
    with pytest.raises(EstimateError, match="no spectral line is above the noise"):
        match(disk(scale), PAIRS)


@pytest.mark.parametrize("phase", ["theta", None])
def test_readings_whose_squares_overflow_are_no_measurement(phase: str | None) -> None:
    """Their uncertainty was NaN."""
    with pytest.raises(InputError, match=r"column 'a1' has a reading of .*e\+200, which is no measurement"):
        match(disk(1e200), PAIRS, phase=phase)


def test_a_stage_angle_in_the_column_of_times() -> None:
    """It ended in a KeyError; the angle is what the column holds."""
    readings = disk(1.0)
    turned = {**readings, "time": readings["theta"]}
    assert str(match(turned, PAIRS, phase="time")) == str(match(readings, PAIRS, phase="theta"))
