"""Waiting until the sensors hold still, and until their temperature does."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np

from tiltcal.bench.devices import SensorSet
from tiltcal.core.model import Array
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


class Unsettled(Exception):
    """The sensors did not come to rest, or were moved."""


@dataclass(frozen=True)
class Window:
    """The time over which readings must stand still, seconds.

    While a sensor soaks, its temperature may change by ``temperature_drift``, °C, in it, or in the seconds of
    ``thermometer_seconds``; ``target`` is the temperature asked for, None where the thermometer does not count.
    """

    seconds: float
    temperature_drift: float | None = None
    target: float | None = None
    thermometer_seconds: float | None = None

    @property
    def soaking(self) -> bool:
        """Whether temperature matters."""
        return self.temperature_drift is not None

    @property
    def shortest(self) -> float:
        """Seconds that waiting takes at least."""
        return max(SOAKS * self.seconds, self.thermometer_seconds or 0.0) if self.soaking else self.seconds

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
    models, longest = sensors.models, max(window.seconds * LONG, window.thermometer_seconds or 0.0)
    rows = array("d")  # one row after the other
    began: float | None = None
    judged = 0.0
    why = "waiting until it is still" if window.target is None else f"on the way to {window.target:g} °C"
    while True:
        sample = sensors.read(fresh=True)
        sample.now_ns = clock.now_ns()
        now = sample.seconds
        if began is None:
            began = judged = now
        row = row_of(sample, models)
        rows.extend(row)
        while len(rows) > FEWEST_SAMPLES * len(row) and now - rows[len(row)] >= longest:
            del rows[: len(row)]
        if now >= judged + window.seconds / JUDGEMENTS:
            judged = now
            moving = _unsettled(np.array(rows).reshape(-1, len(row)), models, window, near=window.near(sample))
            if moving is None:
                return
            why = moving or why
        if now - began > window.patience:
            raise Unsettled(f"not still after {window.patience:.0f} s: {why}")
        look(sample, why, max(0.0, window.shortest - (now - began)))
        # A late thermometer has to hold for many windows: a slow drift is looked for in the last ones.
        drift_counts = window.soaking and now - began >= window.shortest - SOAKS * window.seconds
        clock.sleep(max(window.seconds / (SOAK_LOOKS if drift_counts else LOOKS), sensors.interval))


def row_of(sample: Sample, serials: Iterable[str]) -> list[float]:
    """Return the time of a sample, s, and of each sensor its readings and its temperature, °C, NaN for none."""
    row = [sample.seconds]
    for reading in map(sample.__getitem__, serials):
        row += [*reading.values, nan if reading.temperature is None else reading.temperature]
    return row


def _unsettled(rows: Array, models: Mapping[str, Model], window: Window, *, near: bool) -> str | None:
    """Return what changes in the last samples, in words; None where nothing does, empty where it is early to judge."""
    ago = rows[-1, 0] - rows[:, 0]
    # A thermometer with a window of its own is judged there.
    drift_in_window = window.temperature_drift if window.thermometer_seconds is None else None
    still = STEADY if window.soaking else STILL
    why = ""
    if len(rows) >= FEWEST_SAMPLES and ago[0] >= window.seconds and near:
        start = min(int(np.flatnonzero(ago >= window.seconds)[-1]), len(rows) - FEWEST_SAMPLES)
        moving = movement(rows[start:], models, drift_in_window, still=still, shown=window.soaking)
        if moving is None and window.soaking:
            moving = _drifting(rows, ago, models, SOAKS * window.seconds) or _warming(rows, ago, models, window)
        if moving is None:
            return None
        why = moving
    if window.soaking and ago[0] >= window.seconds * LONG:
        return movement(rows, models, drift_in_window, still=STEADY) or _warming(rows, ago, models, window)
    return why


def _drifting(rows: Array, ago: Array, models: Mapping[str, Model], seconds: float) -> str | None:
    """Return what drifts over the last seconds, or that they have not passed yet; None where nothing does."""
    if ago[0] < seconds:
        return f"steady for {ago[0]:.0f} s of {seconds:.0f} s"
    return movement(rows[ago <= seconds], models, still=SOAKED)


def _warming(rows: Array, ago: Array, models: Mapping[str, Model], window: Window) -> str | None:
    """Return by how much thermometers that are read change over their window, or that it has not passed yet."""
    temperatures = np.cumsum([1 + len(model.channels) for model in models.values()])
    if window.thermometer_seconds is None or np.isnan(rows[-1, temperatures]).all():
        return None
    if ago[0] < window.thermometer_seconds:
        return f"the thermometer is read for {ago[0]:.0f} s of {window.thermometer_seconds:.0f} s"
    return movement(rows[ago <= window.thermometer_seconds], models, window.temperature_drift, still=SOAKED)


def movement(
    rows: Array,
    models: Mapping[str, Model],
    temperature_drift: float | None = None,
    still: float = STILL,
    sigmas: float = SIGMAS,
    shown: bool = False,
) -> str | None:
    """Return what changes over at least three samples, a row each (:func:`row_of`), in words; None where nothing does.

    A change up to ``still``, g, or ``temperature_drift``, °C, is steady, and so is one below ``sigmas`` of its own
    standard uncertainties, unless the reading must be ``shown`` to be steady.
    """
    times, *columns = rows.T
    span, column = times[-1] - times[0], iter(columns)
    for model in models.values():
        limit = still * model.sensitivity
        for channel, values in [(channel, next(column)) for channel in model.channels]:
            change, uncertainty = drift(times, values)
            most = limit - SHOWN_WITHIN * uncertainty if shown else max(limit, sigmas * uncertainty)
            if not abs(change) <= most:
                return f"{channel} drifts by {change:+.4g} {model.unit} in {span:.3g} s"
            off = values - np.add.reduce(values) / len(values)  # std() takes four times as long
            scatter = sqrt(float(off @ off) / len(values))
            if scatter > SHAKING * model.sensitivity:
                return f"{channel} scatters by {scatter:.4g} {model.unit}: hold it still"
        temperatures = next(column)
        if temperature_drift is not None and not np.isnan(temperatures).any():
            change, uncertainty = drift(times, temperatures)
            if not abs(change) <= max(temperature_drift, sigmas * uncertainty):
                return f"the temperature drifts by {change:+.2f} °C in {span:.3g} s"
    return None
