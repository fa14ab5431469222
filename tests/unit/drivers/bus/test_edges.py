"""Edge records, and GPIO lines through gpiod: which lines are asked for, what arrives, what each error means."""

from __future__ import annotations

import errno
import os
import sys
from collections import deque
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
    """What gpiod gives for two lines: events that are waiting."""

    def __init__(self) -> None:
        self.waiting: deque[SimpleNamespace] = deque()
        self.timeouts: list[float] = []
        self.released = 0
        self.error: OSError | None = None

    def edge(self, time_ns: int, line: int, rising: bool) -> None:
        kind = gpiod.EdgeEvent.Type.RISING_EDGE if rising else gpiod.EdgeEvent.Type.FALLING_EDGE
        number = len(self.waiting) + 1
        self.waiting.append(
            SimpleNamespace(event_type=kind, timestamp_ns=time_ns, line_offset=line, global_seqno=number, line_seqno=0)
        )

    def wait_edge_events(self, timeout: float) -> bool:
        if self.error is not None:
            raise self.error
        self.timeouts.append(timeout)
        return bool(self.waiting)

    def read_edge_events(self, count: int) -> list[SimpleNamespace]:
        return [self.waiting.popleft() for _ in range(min(count, len(self.waiting)))]

    def release(self) -> None:
        self.released += 1


@pytest.fixture
def request_lines(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Stands for ``gpiod.request_lines``, since this machine may have no GPIO chip; keeps what it was asked."""
    stub = SimpleNamespace(asked=None, error=None, request=StubRequest())

    def request(path: str, **options: object) -> StubRequest:
        stub.asked = path, options
        if stub.error is not None:
            raise stub.error
        return stub.request

    monkeypatch.setattr(gpiod, "request_lines", request)
    return stub


def opened(address: str = "gpio:///dev/gpiochip0?x=17&y=27&timeout=0.5"):
    return open_link(parse_address(address), ADXL202)


def test_a_record_is_time_line_direction_number_in_little_endian() -> None:
    packed = pack_edges([Edge(0x0102030405060708, 1, True, 0xA1B2C3D4)])

    assert packed.hex() == "0807060504030201" + "01" + "01" + "d4c3b2a1"
    assert RECORD.size == 14


@given(
    st.lists(
        st.builds(Edge, st.integers(0, 2**64 - 1), st.integers(0, 1), st.booleans(), st.integers(0, 2**32 - 1)),
        max_size=50,
    )
)
def test_records_carry_edges_unchanged(edges: list[Edge]) -> None:
    assert list(unpack_edges(pack_edges(edges))) == edges


def test_a_torn_record_or_one_of_a_third_line_is_an_error() -> None:
    with pytest.raises(BusError, match="names line 2"):
        list(unpack_edges(RECORD.pack(0, 2, 1, 1)))
    with pytest.raises(BusError, match="no whole number of edge records"):
        list(unpack_edges(b"\x00" * 15))


def test_both_lines_are_asked_for_with_kernel_times(request_lines) -> None:
    link = opened()
    path, options = request_lines.asked
    ((lines, settings),) = options["config"].items()
    assert (path, lines) == ("/dev/gpiochip0", (17, 27))
    assert settings.edge_detection is gpiod.line.Edge.BOTH
    assert settings.event_clock is gpiod.line.Clock.MONOTONIC
    assert options["event_buffer_size"] == 1024
    link.close()
    link.close()
    assert request_lines.request.released == 1


def test_events_become_records_of_x_and_y_no_more_than_asked_for_and_none_lost(request_lines) -> None:
    link = opened()
    request_lines.request.edge(1000, 27, True)
    request_lines.request.edge(1500, 17, False)
    request_lines.request.edge(1600, 17, True)
    assert list(unpack_edges(link.exchange(b"", 2 * 14))) == [Edge(1000, 1, True, 1), Edge(1500, 0, False, 2)]
    assert list(unpack_edges(link.exchange(b"", 100 * 14))) == [Edge(1600, 0, True, 3)]
    request_lines.request.edge(2000, 17, True)
    assert link.exchange(b"", 0) == b""
    with pytest.raises(BusError, match=r"no edge on the lines of /dev/gpiochip0 for 0\.5 s.*powered"):
        link.exchange(b"", 14)
    assert request_lines.request.timeouts[-1] == 0.5


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
def test_what_each_error_means(request_lines, number: int, why: str) -> None:
    request_lines.error = OSError(number, os.strerror(number))
    with pytest.raises(BusError, match=why):
        opened()
    request_lines.error = None
    link = opened()
    request_lines.request.error = OSError(number, os.strerror(number))
    with pytest.raises(BusError, match=why):
        link.exchange(b"", 14)
    link.close()
    opened().close()


def test_the_real_library_finds_no_such_chip_and_no_chip_in_a_file() -> None:
    with pytest.raises(BusError, match="/dev/gpiochip77 does not exist"):
        opened("gpio:///dev/gpiochip77?x=1&y=2")
    with pytest.raises(BusError, match="/dev/null is no GPIO chip"):
        opened("gpio:///dev/null?x=1&y=2")


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("gpio:///dev/gpiochip0?x=17", "option 'y' is missing"),
        ("gpio:///dev/gpiochip0?x=17&y=17", "both line 17"),
        ("gpio:///dev/gpiochip0?x=17&y=-1", "too small"),
        ("gpio:///dev/gpiochip0?x=17&y=4294967323", "too large"),
        ("gpio:///dev/gpiochip0?x=17&y=27&z=1", "unknown option 'z'"),
    ],
)
def test_wrong_addresses(address: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        opened(address)


def test_without_gpiod_or_with_an_old_one_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gpiod", None)
    with pytest.raises(HardwareError, match=r"pip install 'tiltcal\[gpio\]'"):
        opened()
    monkeypatch.setitem(sys.modules, "gpiod", SimpleNamespace(Chip=object))
    with pytest.raises(HardwareError, match=r"older than version 2.*tiltcal\[gpio\]"):
        opened()
