"""Waiting until the sensors hold still, and until their temperature does."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tiltcal.core.statistics import drift
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.device import Model, Reading

LOOKS = 40
"""Readings in one window."""

FEWEST = 5
"""Readings without which nothing can be said of a window."""

NEAR = 2.0
"""How far a sensor's own thermometer may be from the temperature that was asked for, °C."""

FAR_WINDOWS = 10
"""Windows for which a temperature must hold where it is farther: a chamber on its way is not a chamber at rest."""

SIGMAS = 4.0
"""A drift below this many of its own standard uncertainties is noise."""

STILL = 0.0005
"""A drift below this in one window is stillness whatever the noise, g (0.03° near level)."""

SHAKING = 0.1
"""Scatter above this is a sensor in someone's hand, g."""

PATIENCE = 60.0
"""How long a position may take to become still, seconds."""

OVERNIGHT = 12 * 3600.0
"""How long a chamber may take to its temperature, seconds."""

Sample = tuple[Reading, ...]
"""One reading of each sensor."""

Timed = tuple[float, Sample]
"""A sample with its time in seconds."""


class Unsettled(Exception):
    """The sensors did not come to rest, or were moved."""


@dataclass(frozen=True)
class Window:
    """What the readings must hold over.

    Attributes
    ----------
    seconds : float
        Its length.
    temperature_drift : float or None
        The largest change of temperature in it, °C; None where temperature does not matter.
    target : float or None
        The temperature that was asked for, °C; None where the thermometer's word does not matter.
    """

    seconds: float
    temperature_drift: float | None = None
    target: float | None = None

    @property
    def patience(self) -> float:
        """Seconds after which waiting ends."""
        return max(PATIENCE if self.temperature_drift is None else OVERNIGHT, 10 * self.seconds)

    def needed(self, sample: Sample) -> float:
        """Seconds over which readings must hold, given what the thermometers say now."""
        if self.target is None:
            return self.seconds
        off = [abs(r.temperature - self.target) for r in sample if r.temperature is not None]
        return self.seconds * (FAR_WINDOWS if off and max(off) > NEAR else 1)


def wait_until_still(
    read: Callable[[], Sample],
    models: Sequence[Model],
    clock: Clock,
    window: Window,
    look: Callable[[Sample, str], None],
) -> None:
    """Read until neither the readings nor, where it matters, the temperature change over a whole window.

    Parameters
    ----------
    read : callable
        Takes one sample of every sensor.
    models : sequence of Model
        Of the sensors; their nominal sensitivities turn g into their units.
    clock : Clock
    window : Window
    look : callable
        Shown each sample, and what is being waited for.

    Raises
    ------
    Unsettled
        They did not come to rest within the window's patience.
    """
    pause = max(window.seconds / LOOKS, *(model.interval for model in models))
    held: deque[Timed] = deque()
    began: float | None = None
    why = "waiting until it is still"
    while True:
        sample = read()
        now = clock.now_ns() / 1e9
        began = now if began is None else began
        held.append((now, sample))
        while len(held) > FEWEST and now - held[1][0] >= window.seconds * FAR_WINDOWS:
            held.popleft()
        needed = window.needed(sample)
        within = [one for one in held if now - one[0] <= needed + pause]
        if len(within) >= FEWEST and now - within[0][0] >= needed:
            moving = movement(within, models, window.temperature_drift)
            if moving is None:
                return
            why = moving
        if now - began > window.patience:
            raise Unsettled(f"not still after {window.patience:.0f} s: {why}")
        look(sample, why)
        clock.sleep(pause)


def movement(
    held: Sequence[Timed],
    models: Sequence[Model],
    temperature_drift: float | None = None,
    still: float = STILL,
    sigmas: float = SIGMAS,
) -> str | None:
    """What changes over a run of samples, in words, or None.

    Parameters
    ----------
    held : sequence of (seconds, sample)
        At least three.
    models : sequence of Model
        Of the sensors in each sample.
    temperature_drift : float, optional
        The largest change of temperature that is still steady, °C.
    still : float
        The largest change of a reading that is still steady, g.
    sigmas : float
        A change below this many of its own standard uncertainties is noise.
    """
    times = [time for time, _ in held]
    span = times[-1] - times[0]
    for index, model in enumerate(models):
        readings = [sample[index] for _, sample in held]
        for place, channel in enumerate(model.channels):
            values = [reading.values[place] for reading in readings]
            change, uncertainty = drift(times, values)
            if abs(change) > max(still * model.sensitivity, sigmas * uncertainty):
                return f"{channel} drifts by {change:+.4g} {model.unit} in {span:.3g} s"
            mean = sum(values) / len(values)
            scatter = (sum((value - mean) ** 2 for value in values) / len(values)) ** 0.5
            if scatter > SHAKING * model.sensitivity:
                return f"{channel} scatters by {scatter:.4g} {model.unit}: hold it still"
        temperatures = [reading.temperature for reading in readings if reading.temperature is not None]
        if temperature_drift is not None and len(temperatures) == len(readings):
            change, uncertainty = drift(times, temperatures)
            if abs(change) > max(temperature_drift, sigmas * uncertainty):
                return f"the temperature drifts by {change:+.2f} °C in {span:.3g} s"
    return None
