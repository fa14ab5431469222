"""The angle of a stage, followed from row to row, and estimated where there is no encoder."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from support import accelerometer_disk as disk

from tiltcal.core.model import Array
from tiltcal.core.pair.stage import estimate_spin, estimated_angle, follow


@given(st.floats(-0.12, 0.4), st.floats(0.0, 1.0), st.integers(2, 60), st.integers(1, 59))
def test_wrapped_angles_are_followed_over_their_turns(step: float, start: float, count: int, cut: int) -> None:
    """In two blocks."""
    turns = start + step * np.arange(count)
    theta = turns * 360.0 % 360.0
    first = follow(theta[:cut])
    followed = np.concatenate([first, follow(theta[cut:], float(first[-1]))])
    assert followed - followed[0] == pytest.approx(turns - turns[0], abs=1e-9)


def test_steps_back_across_zero_jumps_and_a_million_turns() -> None:
    turns = np.linspace(0.3, 40.3, 5000) + 0.01 * np.random.default_rng(2).uniform(-0.5, 0.5, 5000)
    assert follow(turns % 1.0 * 360.0) == pytest.approx(turns, abs=1e-9)
    gap = np.array([0.0, 10.0, 20.0, 240.0, 250.0])
    assert follow(gap) * 360.0 == pytest.approx(gap)
    theta = np.tile([0.0, 120.0, 240.0], 1_000_000)
    assert float(np.max(np.abs(follow(theta) % 1.0 - theta / 360.0))) < 1e-9


def test_the_spin_is_the_least_squares_fit_of_all_channels() -> None:
    """Against scipy's, of frequency, amplitudes, offsets and drifts; readings far from zero lose no digits."""
    taken = disk.record(seconds=40, wander=0.0, noise=1e-3, start=100.0)
    readings = taken.readings + 1e4

    def rest(spin: Array) -> Array:
        angle = 2.0 * np.pi * spin[0] * taken.time
        columns = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle), taken.time - 20.0], axis=1)
        return np.asarray(readings - columns @ np.linalg.lstsq(columns, readings)[0]).ravel()

    (expected,) = least_squares(rest, [0.1251], x_scale=1e-3, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    assert estimate_spin(taken.time, readings).frequency == pytest.approx(expected, abs=1e-9)


def test_the_spin_of_uneven_times_gaps_and_rates_that_change() -> None:
    taken = disk.record(seconds=160)
    draw, number = np.random.default_rng(0), np.arange(len(taken.time))
    gap = (taken.time < 50.0) | (taken.time > 73.0)
    faster = np.where(taken.time < 80.0, 0, number % 3) == 0
    jitter = taken.time + draw.uniform(-0.005, 0.005, len(number)) + 1e6
    for time, rows in ((taken.time, gap), (taken.time, faster), (taken.time, gap & faster), (jitter, number % 10 > 0)):
        assert estimate_spin(time[rows], taken.readings[rows]).frequency == pytest.approx(0.125, abs=1e-5)
    assert estimate_spin(np.floor(taken.time), taken.readings).frequency == pytest.approx(0.125, abs=1e-3)


def test_a_speed_that_changes_is_followed_where_rows_show_it() -> None:
    """By five turns over 1000, which no single frequency fits; a speed for 328 s misses by half of 6e-3."""
    time = np.arange(400_000) / 50.0
    turned = 0.125 * time + 5.0 * (time / 8000.0) ** 3
    readings = 3.4 * np.sin(2 * np.pi * turned[:, None] + disk.PHASES)
    readings[200_000:200_600] = 0.0
    away = estimated_angle(time, list(readings.T)) / 360.0 - turned
    assert np.max(np.abs(away - np.round(away))) < 6e-3
