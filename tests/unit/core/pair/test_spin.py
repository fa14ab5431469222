"""A stage without an encoder."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from support import accelerometer_disk as disk

from tiltcal.core.model import Array
from tiltcal.core.pair.spin import Spin, estimate_spin, followed_spin
from tiltcal.errors import EstimateError


class TestSpin:
    def test_frequency_and_phase_are_as_good_as_the_noise_allows(self) -> None:
        error = []
        sigma = 3e-4
        for seed in range(50):
            taken = disk.record(seconds=80, start=70.0, misalignment=(0.0,) * 4, wander=0.0, noise=sigma, seed=seed)
            spin = estimate_spin(taken.time, taken.readings)
            error.append(((spin.frequency - 0.125) * 80, spin.phase - 70 / 360))
        # The bound for a sine of known shape in four channels: 12 var / (n A² (2 pi T)²) * 2.
        bound = sigma / 3.4 * np.sqrt(24 / (4 * 4000)) / (2 * np.pi)
        assert 0.6 * bound < float(np.std(error, axis=0)[0]) < 1.4 * bound
        assert abs(float(np.mean(error, axis=0)[1])) < 1e-5

    def test_time_need_not_begin_at_zero_nor_be_even(self) -> None:
        taken = disk.record(seconds=80)
        jitter = np.random.default_rng(0).uniform(-0.005, 0.005, len(taken.time))
        kept = np.random.default_rng(1).random(len(taken.time)) < 0.9
        assert estimate_spin((taken.time + jitter)[kept] + 1e6, taken.readings[kept]).frequency == pytest.approx(
            0.125, abs=1e-5
        )

    def test_gaps_and_rates_that_change(self) -> None:
        """A seventh of the rows missing in one stretch, then another rate, then whole seconds at 50 Hz."""
        taken = disk.record(seconds=160)
        gap = (taken.time < 50.0) | (taken.time > 73.0)
        faster = np.where(taken.time < 80.0, 0, np.arange(len(taken.time)) % 3) == 0
        for rows in (gap, faster, gap & faster):
            assert estimate_spin(taken.time[rows], taken.readings[rows]).frequency == pytest.approx(0.125, abs=1e-5)
        assert estimate_spin(np.floor(taken.time), taken.readings).frequency == pytest.approx(0.125, abs=1e-3)

    def test_gaps_in_which_turns_cannot_be_counted(self) -> None:
        taken = disk.record(seconds=40)
        late = np.where(taken.time < 20.0, taken.time, taken.time + 3600.0)
        with pytest.raises(EstimateError, match="the gaps of the record are more than 7 times as long"):
            estimate_spin(late, taken.readings)

    @pytest.mark.parametrize("turns", [20.0, 20.25, 20.5, 20.75])
    def test_the_stronger_of_two_lines_is_the_spin_wherever_it_lies(self, turns: float) -> None:
        time = np.arange(4000) / 50.0
        spin, other = (np.sin(2 * np.pi * number * time[:, None] / 80.0 + disk.PHASES) for number in (turns, 51.0))
        assert estimate_spin(time, spin + 0.9 * other).frequency * 80.0 == pytest.approx(turns, abs=0.01)

    def test_it_is_the_least_squares_fit_of_all_channels(self) -> None:
        """Against scipy's, of frequency, amplitudes, offsets and drifts; readings far from zero lose no digits."""
        taken = disk.record(seconds=40, wander=0.0, noise=1e-3, start=100.0)
        readings = taken.readings + 1e4

        def rest(spin: Array) -> Array:
            angle = 2.0 * np.pi * spin[0] * taken.time
            columns = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle), taken.time - 20.0], axis=1)
            return np.asarray(readings - columns @ np.linalg.lstsq(columns, readings)[0]).ravel()

        (expected,) = least_squares(rest, [0.1251], x_scale=1e-3, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
        assert estimate_spin(taken.time, readings).frequency == pytest.approx(expected, abs=1e-9)

    def test_a_speed_that_changes_is_followed_from_rows_to_rows(self) -> None:
        """By a turn over 100, which a single frequency would take for no signal at all."""
        time = np.arange(40_000) / 50.0
        turned = 0.125 * time + (time / 800.0) ** 3
        readings = 3.4 * np.sin(2 * np.pi * turned[:, None] + disk.PHASES)
        spin, off = Spin(0.125, 0.0), []
        for start in range(0, 40_000, 2000):
            rows = slice(start, start + 2000)
            spin = followed_spin(spin, time[rows], readings[rows])
            away = spin.theta(time[rows]) / 360.0 - turned[rows]
            off.append(float(np.max(np.abs(away - np.round(away)))))
        assert max(off) < 2e-3

    def test_rows_that_do_not_say_keep_the_spin_before(self) -> None:
        known = Spin(0.125, 0.25)
        taken = disk.record(seconds=80)
        assert followed_spin(known, taken.time[:300], taken.readings[:300]) == known
        noise = np.random.default_rng(2).standard_normal(taken.readings.shape)
        assert abs(followed_spin(known, taken.time, noise).frequency - 0.125) < 0.5 / 80

    @pytest.mark.parametrize(
        ("taken", "said"),
        [
            (disk.record(seconds=80, scale=(0.0,) * 4), "no spectral line is above the noise"),
            (disk.record(seconds=10), "less than 2 turns"),
            (disk.record(seconds=0.2), "too short"),
        ],
    )
    def test_where_there_is_no_spin(self, taken: disk.Record, said: str) -> None:
        with pytest.raises(EstimateError, match=said):
            estimate_spin(taken.time, taken.readings)
