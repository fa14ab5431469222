"""Edge records, and GPIO lines through gpiod: which lines are asked for, what arrives, what each error means."""

from __future__ import annotations

import errno
import os
import sys
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.edges import RECORD, Edge, pack_edges, unpack_edges
from tiltcal.errors import BusError, HardwareError, UsageError

gpiod = pytest.importorskip("gpiod", reason="the gpiod package is not installed")

ADXL202 = find_model("adxl202").at(parse_address("gpio:///dev/gpiochip0?x=17&y=27"))


class StubRequest:
    """Stands for gpiod's request of two lines, since this machine may have no GPIO chip; notes what it is asked."""

    def __init__(self) -> None:
        self.waiting: list[SimpleNamespace] = []
        self.asked = self.timeout = self.open_error = self.error = None
        self.released = 0

    def request_lines(self, path: str, **options: object) -> StubRequest:
        self.asked = path, options
        if self.open_error is not None:
            raise self.open_error
        return self

    def edge(self, time_ns: int, line: int, rising: bool) -> None:
        kind = gpiod.EdgeEvent.Type.RISING_EDGE if rising else gpiod.EdgeEvent.Type.FALLING_EDGE
        number = len(self.waiting) + 1
        self.waiting.append(
            SimpleNamespace(event_type=kind, timestamp_ns=time_ns, line_offset=line, global_seqno=number, line_seqno=0)
        )

    def wait_edge_events(self, timeout: float) -> bool:
        if self.error is not None:
            raise self.error
        self.timeout = timeout
        return bool(self.waiting)

    def read_edge_events(self, count: int) -> list[SimpleNamespace]:
        taken, self.waiting = self.waiting[:count], self.waiting[count:]
        return taken

    def release(self) -> None:
        self.released += 1


@pytest.fixture
def chip(monkeypatch: pytest.MonkeyPatch) -> StubRequest:
    stub = StubRequest()
    monkeypatch.setattr(gpiod, "request_lines", stub.request_lines)
    return stub


def opened(address: str = "gpio:///dev/gpiochip0?x=17&y=27&timeout=0.5"):
    return open_link(parse_address(address), ADXL202)


EDGES = st.builds(Edge, st.integers(0, 2**64 - 1), st.integers(0, 1), st.booleans(), st.integers(0, 2**32 - 1))


@given(st.lists(EDGES, max_size=50))
def test_a_record_is_time_line_direction_number_in_little_endian(edges: list[Edge]) -> None:
    assert pack_edges([Edge(0x0102030405060708, 1, True, 0xA1B2C3D4)]).hex() == "08070605040302010101d4c3b2a1"
    assert list(unpack_edges(pack_edges(edges))) == edges
    with pytest.raises(BusError, match="names line 2"):
        list(unpack_edges(RECORD.pack(0, 2, 1, 1)))
    with pytest.raises(BusError, match="no whole number of edge records"):
        list(unpack_edges(b"\x00" * 15))


def test_events_of_both_lines_become_records_no_more_than_asked_for_and_none_lost(chip: StubRequest) -> None:
    link = opened()
    path, options = chip.asked
    ((lines, settings),) = options["config"].items()
    assert (path, lines, options["event_buffer_size"]) == ("/dev/gpiochip0", (17, 27), 1024)
    assert settings.edge_detection is gpiod.line.Edge.BOTH
    assert settings.event_clock is gpiod.line.Clock.MONOTONIC
    chip.edge(1000, 27, True)
    chip.edge(1500, 17, False)
    chip.edge(1600, 17, True)
    assert list(unpack_edges(link.exchange(b"", 2 * 14))) == [Edge(1000, 1, True, 1), Edge(1500, 0, False, 2)]
    assert list(unpack_edges(link.exchange(b"", 100 * 14))) == [Edge(1600, 0, True, 3)]
    chip.edge(2000, 17, True)
    assert link.exchange(b"", 0) == b""
    with pytest.raises(BusError, match=r"no edge on the lines of /dev/gpiochip0 for 0\.5 s.*powered"):
        link.exchange(b"", 14)
    assert chip.timeout == 0.5
    link.close()
    link.close()
    assert chip.released == 1


@pytest.mark.parametrize(
    ("number", "why"),
    [
        (errno.ENOENT, "does not exist"),
        (errno.EACCES, "no permission to use /dev/gpiochip0"),
        (errno.EBUSY, "in use by another program or by the kernel"),
        (errno.EINVAL, "refuses the lines"),
        (errno.EIO, "is gone: plug it in again, then resume"),
    ],
)
def test_what_each_error_means(chip: StubRequest, number: int, why: str) -> None:
    link = opened()
    chip.error = chip.open_error = OSError(number, os.strerror(number))
    with pytest.raises(BusError, match=why):
        opened()
    with pytest.raises(BusError, match=why):
        link.exchange(b"", 14)
    link.close()


@pytest.mark.parametrize(
    ("address", "kind", "why"),
    [
        ("gpio:///dev/gpiochip77?x=1&y=2", BusError, "/dev/gpiochip77 does not exist"),
        ("gpio:///dev/null?x=1&y=2", BusError, "/dev/null is no GPIO chip"),
        ("gpio:///dev/gpiochip0?x=17", UsageError, "option 'y' is missing"),
        ("gpio:///dev/gpiochip0?x=17&y=17", UsageError, "both line 17"),
        ("gpio:///dev/gpiochip0?x=17&y=-1", UsageError, "too small"),
        ("gpio:///dev/gpiochip0?x=17&y=4294967323", UsageError, "too large"),
    ],
)
def test_the_real_library_finds_no_such_chip_and_wrong_lines_are_refused(
    address: str, kind: type[Exception], why: str
) -> None:
    with pytest.raises(kind, match=why):
        opened(address)


def test_without_gpiod_or_with_an_old_one_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, why in (
        (None, r"pip install 'tiltcal\[gpio\]'"),
        (SimpleNamespace(Chip=object), r"older than version 2.*tiltcal\[gpio\]"),
    ):
        monkeypatch.setitem(sys.modules, "gpiod", module)
        with pytest.raises(HardwareError, match=why):
            opened()
