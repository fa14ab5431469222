"""A sensor comes to rest, or it does not: drifts of known rate, with noise from a generator of its own."""

from typing import Any, cast

import numpy as np
import pytest

from tiltcal.bench.devices import SensorSet
from tiltcal.bench.settle import Unsettled, Window, wait_until_still
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Reading
from tiltcal.journal.playback import Sample

SCA100T = find_model("sca100t-d02")
SOAK = Window(10.0, temperature_drift=0.3, target=5.5)


class Enough(Exception):
    """The test has seen what it wanted."""


class Drifting:
    """An SCA100T in a chamber at 5.5 °C whose x drifts, in whole counts with some counts of noise."""

    models, interval = {"S-1": SCA100T}, SCA100T.interval

    def __init__(self, clock: VirtualClock, rate: float, seconds: float, seed: int, noise: float = 0.6) -> None:
        self._clock, self._rate, self._seconds, self._sigma = clock, rate, seconds, noise
        self._noise = np.random.default_rng(seed)

    def read(self, *, fresh: bool = False) -> Sample:
        time = self._clock.now_ns() / 1e9
        if time > self._seconds:
            raise Enough
        x = 1024.0 + self._rate * 1e-3 * SCA100T.sensitivity * time + self._noise.normal(0.0, self._sigma)
        return Sample({"S-1": Reading((round(x), round(1024.0 + self._noise.normal(0.0, 0.6))), 5.5)})


def settled(rate: float, seed: int, seconds: float = 80.0, window: Window = SOAK, noise: float = 0.6) -> float:
    """Seconds until a sensor with a drift in mg/s counts as still."""
    clock = VirtualClock()
    sensors: Any = Drifting(clock, rate, seconds, seed, noise)
    wait_until_still(cast(SensorSet, sensors), clock, window, lambda sample, why, left: None)
    return clock.now_ns() / 1e9


def test_a_steady_sensor_takes_three_windows() -> None:
    assert [settled(0.0, seed) for seed in range(2)] == pytest.approx([30.0] * 2, abs=8.0)


def test_a_thermometer_that_is_not_near_has_to_hold_ten_windows() -> None:
    assert settled(0.0, 1, 130.0, Window(10.0, temperature_drift=0.3, target=8.0)) == pytest.approx(100.0, abs=8.0)


@pytest.mark.parametrize(
    ("rate", "noise", "why"), [(4.0, 0.3, r"x drifts by \+"), (0.0, 300.0, "x scatters by .*: hold it still")]
)
def test_what_is_not_still_before_a_position_is_sampled(rate: float, noise: float, why: str) -> None:
    """4 mg in a window of 1 s, eight times the 0.5 mg that pass; a hand that shakes by 0.37 g."""
    with pytest.raises(Unsettled, match=f"not still after 60 s: {why}"):
        settled(rate, 1, window=Window(1.0), noise=noise)


@pytest.mark.parametrize("rate", [-0.13, 0.1, -0.06])
def test_a_slow_drift_never_passes_as_still_while_it_is_judged_again_and_again(rate: float) -> None:
    """-0.13 mg/s moves 1.3 mg in one window of 10 s, 4 mg in three."""
    with pytest.raises(Enough):
        settled(rate, 1)
