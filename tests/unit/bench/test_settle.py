"""A sensor comes to rest, or it does not: drifts of known rate, with noise from a generator of its own."""

import re
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest

from tiltcal.bench.devices import SensorSet
from tiltcal.bench.settle import Unsettled, Window, movement, wait_until_still
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Reading
from tiltcal.journal.playback import Sample

SCA100T = find_model("sca100t-d02")
BEGUN = 7.0  # seconds since the session began
SOAK = Window(10.0, temperature_drift=0.3, target=5.5)


class Enough(Exception):
    """The test has seen what it wanted."""


class Drifting:
    """An SCA100T whose x drifts by mg/s, in whole counts with some counts of noise; its temperature is of the time."""

    models, interval = {"S-1": SCA100T}, SCA100T.interval

    def __init__(
        self, clock: VirtualClock, rate: float, seconds: float, seed: int, noise: float, celsius: Callable[[float], Any]
    ) -> None:
        self._clock, self._rate, self._seconds, self._sigma = clock, rate, seconds, noise
        self._noise, self._celsius = np.random.default_rng(seed), celsius

    def read(self, *, fresh: bool = False) -> Sample:
        assert fresh
        time = self._clock.now_ns() / 1e9 - BEGUN
        if time > self._seconds:
            raise Enough
        x = 1024.0 + self._rate * 1e-3 * SCA100T.sensitivity * time + self._noise.normal(0.0, self._sigma)
        y = 1024.0 + self._noise.normal(0.0, min(self._sigma, 0.6))
        return Sample({"S-1": Reading((round(x), round(y)), self._celsius(time))})


def settled(
    rate: float = 0.0, seed: int = 1, seconds: float = 1e6, window: Window = SOAK, noise: float = 0.6,
    celsius: Callable[[float], Any] = lambda time: 5.5,
) -> tuple[float, list[tuple[str, float]]]:  # fmt: skip
    """Seconds until a sensor with a drift in mg/s counts as still, and what was said meanwhile, once in a row."""
    clock, said = VirtualClock(), list[tuple[str, float]]()
    clock.sleep(BEGUN)
    sensors: Any = Drifting(clock, rate, seconds, seed, noise, celsius)

    def look(sample: Sample, why: str, left: float) -> None:
        assert sample.seconds == clock.now_ns() / 1e9
        phase = re.sub(r"for \d+ s of", "for some of", why)
        if phase not in dict(said):
            said.append((phase, left))

    wait_until_still(cast(SensorSet, sensors), clock, window, look)
    return clock.now_ns() / 1e9 - BEGUN, said


STILL, WAY, STEADY = "waiting until it is still", "on the way to 5.5 °C", "steady for some of 30 s"
LATE = "the thermometer is read for some of 60 s"


@pytest.mark.parametrize(
    ("window", "celsius", "after", "said"),
    [
        (Window(2.0), lambda time: 5.5, 2.0, [(STILL, 2.0)]),
        (Window(2.0), lambda time: None, 2.0, [(STILL, 2.0)]),
        (SOAK, lambda time: 5.5, 30.0, [(WAY, 30.0), (STEADY, 20.0)]),
        (SOAK, lambda time: 7.5, 30.0, [(WAY, 30.0), (STEADY, 20.0)]),
        # Not near: the whole of ten windows; as near as 2 °C only after 40 s.
        (SOAK, lambda time: 7.6, 100.0, [(WAY, 30.0)]),
        (SOAK, lambda time: 7.6 if time < 40.0 else 7.5, 40.0, [(WAY, 30.0)]),
        (SOAK, lambda time: None, 30.0, [(WAY, 30.0), (STEADY, 20.0)]),
        # Its thermometer has a window of its own, which is judged where it is read.
        (Window(10.0, 0.3, 5.5, 60.0), lambda time: 5.5, 60.0, [(WAY, 60.0), (STEADY, 50.0), (LATE, 30.0)]),
        (Window(10.0, 0.3, None, 60.0), lambda time: None, 30.0, [(STILL, 60.0), (STEADY, 50.0)]),
    ],
)  # fmt: skip
def test_when_a_steady_sensor_is_still_and_what_is_said_meanwhile(
    window: Window, celsius: Callable[[float], Any], after: float, said: list[tuple[str, float]]
) -> None:
    """A window, three of a soak, ten of one whose thermometer is not near; beside it the least seconds."""
    seconds, heard = settled(window=window, noise=0.0, celsius=celsius)
    assert seconds == pytest.approx(after, abs=window.seconds / 19)
    assert heard == [(phase, pytest.approx(left, abs=window.seconds / 19)) for phase, left in said]


@pytest.mark.parametrize(
    ("rate", "noise", "window", "why"),
    [
        (4.0, 0.3, Window(1.0), r"not still after 60 s: x drifts by \+"),
        (4.0, 0.3, Window(7.0), r"not still after 70 s: x drifts by \+"),
        (0.0, 300.0, Window(1.0), "not still after 60 s: x scatters by .*: hold it still"),
    ],
)
def test_what_is_not_still_before_a_position_is_sampled(rate: float, noise: float, window: Window, why: str) -> None:
    """4 mg in a window of 1 s, eight times the 0.5 mg that pass; a hand that shakes by 0.37 g."""
    with pytest.raises(Unsettled, match=why):
        settled(rate, window=window, noise=noise)


@pytest.mark.parametrize("rate", [-0.13, 0.1, -0.06])
def test_a_slow_drift_never_passes_as_still_while_it_is_judged_again_and_again(rate: float) -> None:
    """-0.13 mg/s moves 1.3 mg in one window of 10 s, 4 mg in three."""
    with pytest.raises(Enough):
        settled(rate, seconds=80.0)


@pytest.mark.parametrize(
    ("x", "y", "celsius", "options", "why"),
    [
        ([0, 0, 0, 0, 0], [0] * 5, [5.5] * 5, {}, None),
        ([0, 0.1, 0.2, 0.3, 0.4], [0] * 5, [5.5] * 5, {}, None),  # 0.41 counts are 0.5 mg
        ([0, 0.11, 0.22, 0.33, 0.44], [0] * 5, [5.5] * 5, {}, "x drifts by +0.44 count in 2 s"),
        ([0] * 5, [0, -1, -2, -3, -4], [5.5] * 5, {}, "y drifts by -4 count in 2 s"),
        ([0] * 5, [0, -1, -2, -3, -4], [5.5] * 5, {"still": 0.005}, None),
        # Its standard uncertainty is 0.24 counts; two of these from 0.41 leave nothing, and of 0.08 they leave 0.25.
        ([0, 0.3, 0, 0.3, 0.02], [0] * 5, [5.5] * 5, {}, None),
        ([0, 0.3, 0, 0.3, 0.02], [0] * 5, [5.5] * 5, {"shown": True}, "x drifts by +0.016 count in 2 s"),
        ([0, 0.1, 0, 0.1, 0.02], [0] * 5, [5.5] * 5, {"shown": True}, None),
        ([0, 100, 0, 100, 0], [0] * 5, [5.5] * 5, {}, None),
        ([0, 170, 0, 170, 0], [0] * 5, [5.5] * 5, {}, "x scatters by 83.28 count: hold it still"),
        ([0] * 5, [0] * 5, [5.5, 5.6, 5.7, 5.8, 5.9], {"temperature_drift": 0.3},
         "the temperature drifts by +0.40 °C in 2 s"),
        ([0] * 5, [0] * 5, [5.5, 5.6, 5.7, 5.8, 5.9], {"temperature_drift": 0.5}, None),
        ([0] * 5, [0] * 5, [5.5, 5.6, 5.7, 5.8, 5.9], {}, None),
        ([0] * 5, [0] * 5, [5.5, np.nan, 5.7, 5.8, 5.9], {"temperature_drift": 0.3}, None),
    ],
)  # fmt: skip
def test_what_moves_in_a_window(
    x: list[float], y: list[float], celsius: list[float], options: dict[str, float], why: str | None
) -> None:
    """Of two sensors the second one; 819 counts are 1 g."""
    rows = np.column_stack([np.arange(5) / 2, np.zeros((5, 3)), np.array(x) + 9, np.array(y) + 9, celsius])
    assert movement(rows, {"S-1": SCA100T, "S-2": SCA100T}, **options) == why  # type: ignore[arg-type]
