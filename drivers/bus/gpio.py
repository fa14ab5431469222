"""Edges of two digital lines: their records, and the GPIO lines of a Linux board.

Every edge travels as one record of 14 bytes, little-endian::

    time    8 bytes   nanoseconds on the capturing clock
    line    1 byte    0 is x, 1 is y
    rising  1 byte    1 where the line goes up, 0 where it goes down
    number  4 bytes   counts the edges of both lines as they were captured; a step of more than one is a loss
"""

from __future__ import annotations

import errno
from collections.abc import Iterable, Iterator
from struct import Struct
from time import sleep
from typing import Any, NamedTuple

from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.nodes import GONE, Node, import_library
from tiltcal.errors import BusError, HardwareError
from tiltcal.extras import how_to_add

RECORD = Struct("<QBBI")
TIMEOUT = 2.0  # seconds without an edge that are an error: two hundred of the part's longest periods
GATHER = 0.005  # seconds for which edges are collected into one answer: 20 edges at 4,000 per second
KERNEL_BUFFER = 1024  # edges that the kernel buffers for two lines before the oldest is lost; this is its maximum
MOST_LINES = 65_536  # no chip has as many lines
NODE = Node("gpio", ("gpiochip*",), "no GPIO chip is present", "a GPIO chip, as /dev/gpiochip0 is")
OPENING = ((errno.ENODEV, errno.ENOTTY), "{place} is no GPIO chip, as /dev/gpiochip0 is")
LINES = ((errno.EINVAL,), "{place} refuses the lines ({cause}): does it have them?"), ((errno.EIO,), GONE)


class Edge(NamedTuple):
    """One change of one line; the number counts the edges of both lines in the order of capture."""

    time_ns: int
    line: int
    rising: bool
    number: int


def pack_edges(edges: Iterable[Edge]) -> bytes:
    """Return edges as the records of a link's answer; a number past 32 bits starts again at 0."""
    return b"".join(RECORD.pack(edge.time_ns, edge.line, edge.rising, edge.number & 0xFFFFFFFF) for edge in edges)


def unpack_edges(records: bytes) -> Iterator[Edge]:
    """Iterate over the edges in a link's answer; a torn record, or one of a third line, is a BusError."""
    if len(records) % RECORD.size:
        raise BusError(f"{len(records)} bytes are no whole number of edge records of {RECORD.size} bytes")
    for time_ns, line, rising, number in RECORD.iter_unpack(records):
        if line not in (0, 1):
            raise BusError(f"an edge record names line {line}, where 0 is x and 1 is y")
        yield Edge(time_ns, line, bool(rising), number)


def open_gpio(address: Address) -> GpioLink:
    """Open a GPIO chip: options ``x`` and ``y`` are its lines, ``timeout`` the seconds without an edge."""
    x, y = (address.integer(name, low=0, high=MOST_LINES - 1) for name in ("x", "y"))
    if x == y:
        address.refuse(f"x and y are both line {x}; they are two wires")
    timeout = address.number("timeout", TIMEOUT, low=0.01, high=3600.0)
    return GpioLink(address.path, x, y, timeout)


class GpioLink:
    """Both lines of one sensor on one GPIO chip, with the kernel's monotonic timestamps; see :func:`open_gpio`."""

    letter = "e"

    def __init__(self, chip: str, x: int, y: int, timeout: float) -> None:
        self._chip = chip
        self._place = {x: 0, y: 1}
        self._timeout = timeout
        self._request: Any = None
        gpiod = _gpiod()
        settings = gpiod.LineSettings(
            direction=gpiod.line.Direction.INPUT,
            edge_detection=gpiod.line.Edge.BOTH,
            event_clock=gpiod.line.Clock.MONOTONIC,
        )
        self._rising = gpiod.EdgeEvent.Type.RISING_EDGE
        try:
            self._request = gpiod.request_lines(
                chip, consumer="tiltcal", config={(x, y): settings}, event_buffer_size=KERNEL_BUFFER
            )
        except (OSError, ValueError) as cause:
            raise self._error(cause, OPENING, *LINES) from cause

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Take the records of edges that have arrived; see :class:`~tiltcal.drivers.bus.Link`."""
        try:
            if not count:
                while self._request.wait_edge_events(0):
                    self._request.read_edge_events(KERNEL_BUFFER)
                return b""
            if not self._request.wait_edge_events(self._timeout):
                raise BusError(
                    f"no edge on the lines of {self._chip} for {self._timeout:g} s: is the sensor powered, and are "
                    "its outputs on the lines that the address names?"
                )
            sleep(GATHER)
            return pack_edges(map(self._edge, self._request.read_edge_events(max(count // RECORD.size, 1))))
        except (OSError, ValueError) as cause:
            raise self._error(cause, *LINES) from cause

    def close(self) -> None:
        """Release the lines; closing twice is allowed."""
        if self._request is not None:
            self._request.release()
            self._request = None

    def _edge(self, event: Any) -> Edge:
        rising = event.event_type is self._rising
        return Edge(event.timestamp_ns, self._place[event.line_offset], rising, event.global_seqno)

    def _error(self, cause: Exception, *texts: tuple[tuple[int, ...], str]) -> BusError:
        refused = OSError(errno.EINVAL, str(cause)) if isinstance(cause, ValueError) else cause
        return BusError(NODE.why(self._chip, refused, texts))


def _gpiod() -> Any:
    """Import gpiod; version 2 is needed to request both lines with an event clock."""
    install = "tiltcal[gpio]"
    gpiod = import_library("gpiod", "edges of GPIO lines need the Python package gpiod, for Linux only", install)
    if not hasattr(gpiod, "request_lines"):
        raise HardwareError(
            "the gpiod package here is older than version 2 (a distribution's package?): install it with  "
            f"{how_to_add(install)}"
        )
    return gpiod
