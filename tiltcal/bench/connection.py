"""Wiring: from the devices of a plan to a rack of drivers, each on a link that goes through the tape."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial

from tiltcal.bench.event_log import EventLog
from tiltcal.bench.sensor_set import ConnectedSensor, SensorSet
from tiltcal.bench.session_plan import DeviceSetup
from tiltcal.bench.virtual import VirtualBench
from tiltcal.drivers.bus import link_letter, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.bus.link import Link


def open_device(place: DeviceSetup, virtual: VirtualBench) -> Link:
    """The live link of one device.

    Raises
    ------
    HardwareError
        It cannot be opened.
    """
    address = parse_address(place.address)
    return virtual.twin(place) if address.simulated else open_link(address, place.fitted)


@contextmanager
def connected(
    sensors: Sequence[DeviceSetup], thermometer: DeviceSetup | None, tape: EventLog, clock: Clock, virtual: VirtualBench
) -> Iterator[SensorSet]:
    """A rack whose links are closed at the end of the block.

    Parameters
    ----------
    sensors : sequence of DeviceSetup
    thermometer : DeviceSetup or None
    tape : EventLog
        Numbers the devices in their order, the thermometer last.
    clock : Clock
        What drivers wait on.
    virtual : VirtualBench
        Makes the twins of ``sim:`` addresses.

    Yields
    ------
    SensorSet
    """
    devices = (*sensors, thermometer) if thermometer is not None else tuple(sensors)
    links = [
        tape.link(partial(open_device, place, virtual), link_letter(parse_address(place.address), place.fitted), number)
        for number, place in enumerate(devices)
    ]
    drivers = [place.fitted.driver(link, clock) for place, link in zip(devices, links, strict=True)]
    bays = [
        ConnectedSensor(place.fitted, place.serial, driver, place.orientation)
        for place, driver in zip(sensors, drivers, strict=False)
    ]
    try:
        yield SensorSet(bays, drivers[-1] if thermometer is not None else None)
    finally:
        for link in links:
            link.close()
