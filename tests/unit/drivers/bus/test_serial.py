"""Serial links through the real pyserial, on pseudo-terminals, sockets and loops, and what each error means."""

from __future__ import annotations

import errno
import os
import socket
import sys
import threading
import tty
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import link_letter, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.link import Link
from tiltcal.errors import BusError, HardwareError, UsageError

serial = pytest.importorskip("serial", reason="the pyserial package is not installed")

ADXL202 = find_model("adxl202")


def opened(address: str) -> Link:
    return open_link(parse_address(address), ADXL202)


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """The device's end of a pseudo-terminal, and the path of ours."""
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)
    yield master, path
    os.close(master)


def received(link: Link, count: int) -> bytes:
    got = b""
    while len(got) < count:
        got += link.exchange(b"", count - len(got))
    return got


def test_every_byte_passes_unchanged_and_what_queued_up_can_be_dropped(pty: tuple[int, str]) -> None:
    master, path = pty
    with closing(opened(f"serial://{path}?baudrate=921600&timeout=0.1")) as link:
        os.write(master, bytes(range(256)))
        assert link.exchange(b"", 4) == bytes(range(4))
        assert received(link, 252) == bytes(range(4, 256))
        link.exchange(bytes(range(256)))
        assert os.read(master, 256) == bytes(range(256))
        os.write(master, b"old")
        assert link.exchange(b"", 0) == b""
        with pytest.raises(BusError, match=r"silent for 0\.1 s.*powered.*baud rate"):
            link.exchange(b"", 1)
        # An error of the line is no error of the link: the device may begin to talk.
        os.write(master, b"new")
        assert received(link, 3) == b"new"
        assert link.letter == "r" == link_letter(parse_address("serial:///dev/ttyUSB0"), ADXL202)
        with pytest.raises(BusError, match="in use by another program"):
            opened(f"serial://{path}")
    with closing(opened(f"serial://{path}?timeout=0.05")) as link, pytest.raises(BusError, match="Write timeout"):
        link.exchange(bytes(1 << 20))


def test_an_unplugged_adapter_is_told() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    link = opened(f"serial://{os.ttyname(slave)}?timeout=0.1")
    os.close(slave)
    os.close(master)
    for count in (1, 0):
        with pytest.raises(BusError, match=r"is gone: plug it in again, then resume"):
            link.exchange(b"", count)
    link.close()
    link.close()
    with pytest.raises(BusError):
        link.exchange(b"", 1)


def test_a_device_behind_a_socket_and_a_loop() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def talk() -> None:
            connection, _ = server.accept()
            with connection:
                # What is sent before the port is open is dropped, as with any other port.
                connection.recv(1)
                connection.sendall(b"hello")
                connection.recv(1)

        talker = threading.Thread(target=talk)
        talker.start()
        with closing(opened(f"serial:socket://127.0.0.1:{port}?timeout=1")) as link:
            link.exchange(b"?")
            assert received(link, 5) == b"hello"
            link.exchange(b"!")
            talker.join()
            with pytest.raises(BusError, match="is gone"):
                link.exchange(b"", 1)
    with pytest.raises(BusError, match=r"no server answers at socket://127\.0\.0\.1"):
        opened(f"serial:socket://127.0.0.1:{port}")
    with closing(opened("serial:loop://?timeout=0.1")) as link:
        link.exchange(b"round")
        assert received(link, 5) == b"round"


def test_what_is_no_port_is_named(monkeypatch: pytest.MonkeyPatch, pty: tuple[int, str], tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text("text")
    for address, why in (
        ("serial:///dev/ttyUSB77", r"/dev/ttyUSB77 does not exist \(.*\)"),
        ("serial:hwgrep://nobody", r"hwgrep://nobody failed .no ports found .*: check the cable"),
        (f"serial://{path}", "no serial port"),
    ):
        with pytest.raises(BusError, match=why):
            opened(address)

    def refused(self: object) -> None:
        raise serial.SerialException(errno.EACCES, f"could not open port {pty[1]}")

    monkeypatch.setattr(serial.Serial, "open", refused)
    with pytest.raises(BusError, match=f"no permission to use {pty[1]}.*group"):
        opened(f"serial://{pty[1]}")
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(HardwareError, match="pip install pyserial"):
        opened("serial:///dev/ttyUSB0")


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("serial:///dev/ttyUSB0?baud=9600", "did you mean 'baudrate'"),
        ("serial:///dev/ttyUSB0?baudrate=fast", "not a whole number"),
        ("serial:///dev/ttyUSB0?parity=maybe", "none of N, E, O"),
        ("serial:///dev/ttyUSB0?stopbits=3", "none of 1, 1.5, 2"),
        ("serial:///dev/ttyUSB0?timeout=0", "too small"),
        ("serial:nosuch://somewhere", "cannot be used: name a port"),
        ("serial:hwgrep://(", "pyserial cannot use it .*unterminated subpattern"),
    ],
)
def test_wrong_addresses(address: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        opened(address)


def test_only_handlers_that_open_a_line_and_nothing_else_are_used(tmp_path: Path) -> None:
    """pyserial's spy:// opens any file for writing before anything is known of the port."""
    kept = tmp_path / "kept"
    kept.write_text("mine")
    urls = (f"spy:///dev/null%3Ffile={kept}", "alt:///dev/ttyUSB0", "SPY:///dev/null", "cp2110://0001")
    modbus = find_model("modbus-columns")
    for url in urls:
        with pytest.raises(UsageError, match="cannot be used: name a port, or socket://"):
            opened(f"serial:{url}")
        if not url.startswith("cp2110"):
            with pytest.raises(UsageError, match="cannot be used: name a port, or socket://"):
                open_link(parse_address(f"modbus:{url}?columns=x@0"), modbus)
    assert kept.read_text() == "mine"
