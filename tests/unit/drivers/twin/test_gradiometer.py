"""The twin of the four accelerometers is what the source says they are."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest
import scipy
from support import accelerometer_disk as disk

from tiltcal.drivers.twin.gradiometer import Accelerometer, Disk, Gradiometer

QUIET = Disk(noise=0.0)


def taken(made: Disk, count: int, seed: int = 0) -> disk.Record:
    samples = list(Gradiometer(made, seed).samples(count))
    return disk.Record(
        np.array([one.time for one in samples]),
        np.array([one.theta for one in samples]),
        np.array([one.readings for one in samples]),
    )


def test_eq_4_by_hand() -> None:
    part = Accelerometer(3.0, misalignment=0.02, offset=0.5, drift=0.001)
    made = replace(QUIET, accelerometers=(part,) * 4, inclination=radians(30.0))
    sample = Gradiometer(made).sample(70)  # 1.4 s at 50 Hz: 63° at 0.125 Hz
    assert sample.theta == pytest.approx(63.0)
    offset = 0.5 + 0.0014
    felt = 0.5 * (sin(radians(63)) + 0.02 * cos(radians(63)))
    assert sample.readings[0] == pytest.approx(offset + 3.0 * felt)
    assert sample.readings[1] == pytest.approx(offset - 3.0 * felt)
    assert sample.readings[2] == pytest.approx(offset + 1.5 * (cos(radians(63)) - 0.02 * sin(radians(63))))
    assert sample.readings[3] == pytest.approx(offset - 1.5 * (cos(radians(63)) - 0.02 * sin(radians(63))))


def test_a_gradient_turns_up_twice_a_turn_with_the_signs_of_eq_1() -> None:
    made = taken(replace(QUIET, inclination=0.0, gradient=(2e-6, 5e-7), accelerometers=(Accelerometer(1.0),) * 4), 4000)
    for index, sign in enumerate((1, 1, -1, -1)):
        assert disk.judged(made, made.readings[:, index], harmonic=2) == pytest.approx((sign * 1e-6, sign * 5e-7))


def test_a_second_order_term_turns_up_twice_a_turn_too() -> None:
    parts = (Accelerometer(1.0, second_order=0.1),) * 4
    made = taken(replace(QUIET, inclination=radians(30.0), accelerometers=parts), 4000)
    # 0.1 (0.5 sin)² = 0.0125 (1 - cos 2θ)
    assert disk.judged(made, made.readings[:, 0], harmonic=2) == pytest.approx((0.0, -0.0125), abs=1e-12)


def test_noise_has_the_density_and_the_corner_that_are_asked_for() -> None:
    made = Disk(accelerometers=(Accelerometer(1.0),) * 4, inclination=0.0, noise=1.5e-7, corner=0.2, rate=16.0)
    signal = taken(made, 30_000, seed=5).readings[:, 0]
    frequency, density = scipy.signal.welch(signal, 16.0, nperseg=4096)
    for low, high in ((0.02, 0.05), (0.05, 0.2), (0.2, 1.0), (2.0, 7.0)):
        band = (frequency > low) & (frequency < high)
        expected = 1.5e-7**2 * (1 + 0.2 / frequency[band])
        assert float(density[band].mean() / expected.mean()) == pytest.approx(1.0, abs=0.3)


def test_a_stream_begun_anywhere_is_the_same() -> None:
    noisy = Disk(corner=0.1, wander=0.02, encoder_noise=0.05)
    whole = list(Gradiometer(noisy, 7).samples(300))
    assert list(Gradiometer(noisy, 7).samples(50, start=250)) == whole[250:]
    assert whole != list(Gradiometer(noisy, 8).samples(300))
