"""A recorded log from the virtual bench: one virtual sensor taken through known tilts and temperatures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import asin, degrees, pi, radians, sin

from tiltcal.bench.device_setup import DeviceSetup
from tiltcal.bench.virtual_bench import VirtualBench
from tiltcal.core.gravity_direction import gravity_from_tilt
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.device import Model

PAUSE = 1.0
"""Seconds between rows."""


@dataclass(frozen=True)
class VirtualRow:
    """One row of the log.

    Attributes
    ----------
    time : float
        Seconds.
    values : tuple of float
        One reading per channel, unit.
    temperature : float or None
        The sensor's own thermometer, °C.
    tilt : dict of str to float
        True tilt of x and y, degrees.
    """

    time: float
    values: tuple[float, ...]
    temperature: float | None
    tilt: dict[str, float]


def sweep(
    address: Address, model: Model, *, rows: int, reach: float, temperatures: tuple[float, float]
) -> Iterator[VirtualRow]:
    """Sweep the tilt of both axes within ``±reach`` while the chamber goes from one temperature to the other.

    Parameters
    ----------
    address : Address
        A ``sim:`` address.
    reach : float
        Degrees.
    temperatures : tuple of float
        First and last, °C.
    """
    clock = VirtualClock()
    place = DeviceSetup(model.name, "", str(address))
    bench = VirtualBench(clock, [place])
    sensor = model.driver(bench.twin(place), clock)
    first, last = temperatures
    for number in range(rows):
        share = number / max(rows - 1, 1)
        asked = {"x": reach * sin(9 * 2 * pi * share), "y": reach * _both(reach) * sin(14 * 2 * pi * share)}
        bench.fixture.move(gravity_from_tilt(asked), first + (last - first) * share)
        clock.sleep(PAUSE)
        g_x, g_y, _ = bench.fixture.gravity
        reading = sensor.read()
        yield VirtualRow(
            clock.now_ns() / 1e9,
            reading.values,
            reading.temperature,
            {"x": degrees(asin(g_x)), "y": degrees(asin(g_y))},
        )


def _both(reach: float) -> float:
    """Return the share of the reach that y may take beside x: two tilts of more than 45° at once are no direction."""
    return min(1.0, degrees(asin((1 - sin(radians(reach)) ** 2) ** 0.5)) / reach * 0.9)
