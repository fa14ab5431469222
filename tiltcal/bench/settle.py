"""Waiting until the sensors hold still, and until their temperature does."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from operator import mul

from tiltcal.bench.devices import SensorSet
from tiltcal.core.detection import is_still
from tiltcal.core.samples import drift
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.model import Model
from tiltcal.journal.playback import Sample

LOOKS, SOAK_LOOKS = 40, 200  # readings in one window: to see a movement, and to show that a slow drift is not there
FEWEST_SAMPLES = 5  # readings without which nothing can be said of a window
NEAR = 2.0  # the largest distance of a sensor's own thermometer from the temperature that was asked for, °C
LONG = 10
"""Windows that count as a long one. Over it a temperature must hold where the thermometer is not near the one asked
for, and a reading whose noise hides a slow drift over one window."""

SOAKS = 3
"""Windows over which a soaking sensor must not drift either. A window is judged again and again while the
sensor soaks, and by chance one of the judgements would let a slow drift pass."""

JUDGEMENTS = 20  # judgements of the readings in one window
SIGMAS = 4.0  # a drift below this many of its own standard uncertainties is noise
SHOWN_WITHIN = 2.0  # standard uncertainties within which a slow drift must be shown to be small
STILL = 0.0005  # a drift below this in one window is stillness whatever the noise, g (0.03° near level)
STEADY = 0.002  # a drift below this in one window is a sensor at its temperature, g (0.11° near level)
SOAKED = 0.001  # a drift below this over the soaking windows is a sensor at its temperature, g
SHAKING = 0.1  # scatter above this is a sensor in someone's hand, g
PATIENCE = 60.0  # time in which a position must become still, seconds
OVERNIGHT = 12 * 3600.0  # time in which a chamber must reach its temperature, seconds

Timed = tuple[float, Sample]
"""A sample with its time in seconds."""


class Unsettled(Exception):
    """The sensors did not come to rest, or were moved."""


@dataclass(frozen=True)
class Window:
    """The time over which readings must stand still, seconds.

    While a sensor soaks, its temperature may change by ``temperature_drift``, °C, in it, or in the seconds of
    ``thermometer``; ``target`` is the temperature that was asked for, None where the thermometer does not count.
    """

    seconds: float
    temperature_drift: float | None = None
    target: float | None = None
    thermometer: float | None = None

    @property
    def soaking(self) -> bool:
        """Whether temperature matters."""
        return self.temperature_drift is not None

    @property
    def shortest(self) -> float:
        """Seconds that waiting takes at least."""
        return max(SOAKS * self.seconds, self.thermometer or 0.0) if self.soaking else self.seconds

    @property
    def patience(self) -> float:
        """Seconds after which waiting ends."""
        return max(OVERNIGHT if self.soaking else PATIENCE, 10 * self.seconds)

    def near(self, sample: Sample) -> bool:
        """Return whether the thermometers are near the temperature that was asked for, where that matters."""
        return self.target is None or all(
            abs(reading.temperature - self.target) <= NEAR
            for reading in sample.values()
            if reading.temperature is not None
        )


def wait_until_still(
    sensors: SensorSet, clock: Clock, window: Window, look: Callable[[Sample, str, float], None]
) -> None:
    """Read until neither the readings nor, where it matters, the temperature change over a whole window.

    ``look`` is shown each sample, what is being waited for, and how many seconds are waited at least.

    Unsettled: they did not come to rest within the window's patience.
    SensorError: one of them failed.
    """
    models = sensors.models
    pause = max(window.seconds / (SOAK_LOOKS if window.soaking else LOOKS), sensors.interval)
    held: deque[Timed] = deque()
    began: float | None = None
    judged = 0.0
    why = "waiting until it is still" if window.target is None else f"on the way to {window.target:g} °C"
    while True:
        sample = sensors.read(fresh=True)
        now = clock.now_ns() / 1e9
        if began is None:
            began = judged = now
        held.append((now, sample))
        while len(held) > FEWEST_SAMPLES and now - held[1][0] >= max(window.seconds * LONG, window.thermometer or 0.0):
            held.popleft()
        if now >= judged + window.seconds / JUDGEMENTS:
            judged = now
            moving = _unsettled(held, models, window)
            if moving is None:
                return
            why = moving or why
        if now - began > window.patience:
            raise Unsettled(f"not still after {window.patience:.0f} s: {why}")
        look(sample, why, max(0.0, window.shortest - (now - began)))
        clock.sleep(pause)


def _unsettled(held: deque[Timed], models: Mapping[str, Model], window: Window) -> str | None:
    """Return what changes in the last samples, in words; None where nothing does, empty where it is early to judge."""
    now, sample = held[-1]
    # A thermometer with a window of its own is judged there.
    drift_in_window = window.temperature_drift if window.thermometer is None else None
    still = STEADY if window.soaking else STILL
    why = ""
    if len(held) >= FEWEST_SAMPLES and now - held[0][0] >= window.seconds and window.near(sample):
        start = next(index for index in range(len(held) - 1, -1, -1) if now - held[index][0] >= window.seconds)
        recent = list(islice(held, min(start, len(held) - FEWEST_SAMPLES), None))
        moving = movement(recent, models, drift_in_window, still=still, shown=window.soaking)
        if moving is None and window.soaking:
            moving = _drifting(held, models, SOAKS * window.seconds) or _warming(held, models, window)
        if moving is None:
            return None
        why = moving
    if window.soaking and now - held[0][0] >= window.seconds * LONG:
        return movement(held, models, drift_in_window, still=STEADY) or _warming(held, models, window)
    return why


def _drifting(held: deque[Timed], models: Mapping[str, Model], seconds: float) -> str | None:
    """Return what drifts over the last seconds, or that they have not passed yet; None where nothing does."""
    now = held[-1][0]
    if now - held[0][0] < seconds:
        return f"steady for {now - held[0][0]:.0f} s of {seconds:.0f} s"
    return movement([reading for reading in held if now - reading[0] <= seconds], models, still=SOAKED)


def _warming(held: deque[Timed], models: Mapping[str, Model], window: Window) -> str | None:
    """Return by how much thermometers that are read change over their window, or that it has not passed yet."""
    now = held[-1][0]
    if window.thermometer is None or all(reading.temperature is None for reading in held[-1][1].values()):
        return None
    if now - held[0][0] < window.thermometer:
        return f"the thermometer is read for {now - held[0][0]:.0f} s of {window.thermometer:.0f} s"
    recent = [reading for reading in held if now - reading[0] <= window.thermometer]
    return movement(recent, models, window.temperature_drift, still=SOAKED)


def movement(
    held: Sequence[Timed],
    models: Mapping[str, Model],
    temperature_drift: float | None = None,
    still: float = STILL,
    sigmas: float = SIGMAS,
    shown: bool = False,
) -> str | None:
    """Return what changes over a run of at least three samples, in words; None where nothing does.

    A change up to ``still``, g, or ``temperature_drift``, °C, is steady, and so is one below ``sigmas`` of its own
    standard uncertainties, unless the reading must be ``shown`` to be steady.
    """
    times = [time for time, _ in held]
    span = times[-1] - times[0]
    for serial, model in models.items():
        readings = [sample[serial] for _, sample in held]
        for place, channel in enumerate(model.channels):
            values = [reading.values[place] for reading in readings]
            change, uncertainty = drift(times, values)
            limit = still * model.sensitivity
            if not is_still(change, uncertainty, limit, sigmas=sigmas, shown=shown, coverage=SHOWN_WITHIN):
                return f"{channel} drifts by {change:+.4g} {model.unit} in {span:.3g} s"
            mean = sum(values) / len(values)
            deviations = [value - mean for value in values]
            scatter = (sum(map(mul, deviations, deviations)) / len(values)) ** 0.5
            if scatter > SHAKING * model.sensitivity:
                return f"{channel} scatters by {scatter:.4g} {model.unit}: hold it still"
        temperatures = [reading.temperature for reading in readings if reading.temperature is not None]
        if temperature_drift is not None and len(temperatures) == len(readings):
            change, uncertainty = drift(times, temperatures)
            if not is_still(change, uncertainty, temperature_drift, sigmas=sigmas):
                return f"the temperature drifts by {change:+.2f} °C in {span:.3g} s"
    return None
