"""Wiring: from the devices of a plan to a rack of drivers, each on a link that goes through the tape."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial

from tiltcal.bench.plan import Place
from tiltcal.bench.rack import Bay, Rack
from tiltcal.bench.tape import Tape
from tiltcal.bench.virtual import VirtualBench
from tiltcal.drivers.bus import link_letter, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.bus.link import Link


def open_place(place: Place, virtual: VirtualBench) -> Link:
    """The live link of one device.

    Raises
    ------
    HardwareError
        It cannot be opened.
    """
    address = parse_address(place.address)
    return virtual.twin(place) if address.simulated else open_link(address, place.fitted)


@contextmanager
def wired(
    sensors: Sequence[Place], thermometer: Place | None, tape: Tape, clock: Clock, virtual: VirtualBench
) -> Iterator[Rack]:
    """A rack whose links are closed at the end of the block.

    Parameters
    ----------
    sensors : sequence of Place
    thermometer : Place or None
    tape : Tape
        Numbers the devices in their order, the thermometer last.
    clock : Clock
        What drivers wait on.
    virtual : VirtualBench
        Makes the twins of ``sim:`` addresses.

    Yields
    ------
    Rack
    """
    devices = (*sensors, thermometer) if thermometer is not None else tuple(sensors)
    links = [
        tape.link(partial(open_place, place, virtual), link_letter(parse_address(place.address), place.fitted), number)
        for number, place in enumerate(devices)
    ]
    drivers = [place.fitted.driver(link, clock) for place, link in zip(devices, links, strict=True)]
    bays = [
        Bay(place.fitted, place.serial, driver, place.orientation)
        for place, driver in zip(sensors, drivers, strict=False)
    ]
    try:
        yield Rack(bays, drivers[-1] if thermometer is not None else None)
    finally:
        for link in links:
            link.close()
