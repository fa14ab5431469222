"""Every bus: what passes through its library, which addresses it refuses, and what each error of the system means.

SPI, I2C and GPIO have stubs here; their real libraries are used in ``realbus`` and ``kernel``.
"""

from __future__ import annotations

import errno
import grp
import os
import select
import socket
import sys
import threading
import tty
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import Link, link_letter, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.gpio import RECORD, Edge, pack_edges, unpack_edges
from tiltcal.errors import BusError, HardwareError, UsageError

gpiod = pytest.importorskip("gpiod", reason="the gpiod package is not installed")
serial = pytest.importorskip("serial", reason="the pyserial package is not installed")

MODELS = {
    "spi": "sca100t-d02",
    "i2c": "sca3000-i2c",
    "gpio": "adxl202",
    "serial": "adxl202",
    "modbus": "modbus-columns",
}
SPI, I2C = "spi:///dev/spidev0.0", "i2c:///dev/i2c-1?address=0x1d&counts_per_g=1333"
GPIO, COM = "gpio:///dev/gpiochip0?x=17&y=27&timeout=0.5", "serial:///dev/ttyUSB0"


def opened(address: str) -> Link:
    where = parse_address(address)
    model = find_model(MODELS[where.scheme])
    return open_link(where, model if where.scheme in ("spi", "i2c") else model.at(where))


class StubMessage:
    """smbus2's message: to an address either bytes to write, or as many as are read."""

    def __init__(self, address: int, content: Any) -> None:
        self.address, self.content = address, bytes(content)

    write = classmethod(lambda cls, address, content: cls(address, content))
    read = classmethod(lambda cls, address, length: cls(address, range(length)))

    def __bytes__(self) -> bytes:
        return self.content


class Stub:
    """The bus of spidev, smbus2 or gpiod, failing where it is told to; notes what it is asked."""

    def __init__(self) -> None:
        self.open_error = self.transfer_error = None
        self.path, self.closed, self.sent, self.edges = "", 0, [], []

    def open(self, path: str | int, *chip_select: int, **options: object) -> Stub:
        if self.open_error:
            raise self.open_error
        self.path, self.options = f"bus {path}.{chip_select[0]}" if chip_select else path, options
        return self

    request_lines = open

    def i2c_rdwr(self, *messages: StubMessage) -> None:
        if self.transfer_error:
            raise self.transfer_error
        self.sent.append([(message.address, message.content) for message in messages])

    def xfer2(self, out: list[int]) -> list[int]:
        self.i2c_rdwr()
        return [byte ^ 0xFF for byte in out]

    def wait_edge_events(self, timeout: float) -> bool:
        self.i2c_rdwr()
        self.timeout = timeout
        return bool(self.edges)

    def read_edge_events(self, count: int) -> list[SimpleNamespace]:
        taken, self.edges = self.edges[:count], self.edges[count:]
        return taken

    def close(self) -> None:
        self.closed += 1

    release = close


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Stub:
    stub = Stub()
    monkeypatch.setitem(sys.modules, "spidev", SimpleNamespace(SpiDev=lambda: stub))
    monkeypatch.setitem(sys.modules, "smbus2", SimpleNamespace(SMBus=lambda: stub, i2c_msg=StubMessage))
    monkeypatch.setattr(gpiod, "request_lines", stub.request_lines)
    return stub


def test_an_spi_device_with_its_usual_name_needs_no_newer_spidev(bus: Stub, tmp_path: Path) -> None:
    """The package of Debian 12, 3.6, opens a bus and a chip select, and has no open_path for other names."""
    link, other = tmp_path / "tilt", tmp_path / "other"
    link.symlink_to("/dev/spidev1.12")
    opened(f"spi:{link}")
    assert bus.path == "bus 1.12"
    with pytest.raises(BusError, match="other does not exist"):
        opened(f"spi:{other}")
    other.touch()
    with pytest.raises(BusError, match=r"is no link to an SPI device, as /dev/spidev0\.0 is: .* install spidev 3\.8"):
        opened(f"spi:{other}")
    bus.open_path = bus.open
    opened(f"spi:{other}")
    assert bus.path == str(other)


def test_an_exchange_on_i2c_is_one_transaction(bus: Stub) -> None:
    link = opened(I2C)
    for out, count, answer in ((b"\x09", 6, bytes(range(6))), (b"\x01\xc1", 0, b""), (b"", 2, b"\0\1"), (b"", 0, b"")):
        bus.sent.clear()
        assert link.exchange(out, count) == answer
        assert bus.sent == [[(0x1D, out)] * bool(out or not count) + [(0x1D, answer)] * bool(count)]
    assert (bus.path, link_letter(parse_address("sim:"), find_model("sca3000-i2c"))) == ("/dev/i2c-1", link.letter)


def test_a_record_of_an_edge_is_time_line_direction_number_in_little_endian() -> None:
    edges = [Edge(0, 0, False, 0), Edge(2**64 - 1, 1, True, 2**32 - 1)]
    assert pack_edges([Edge(0x0102030405060708, 1, True, 0xA1B2C3D4)]).hex() == "08070605040302010101d4c3b2a1"
    assert list(unpack_edges(pack_edges(edges))) == edges
    with pytest.raises(BusError, match="names line 2"):
        list(unpack_edges(RECORD.pack(0, 2, 1, 1)))
    with pytest.raises(BusError, match="no whole number of edge records"):
        list(unpack_edges(b"\x00" * 15))


def test_events_of_both_lines_become_records_no_more_than_asked_for_and_none_lost(bus: Stub) -> None:
    def edge(time_ns: int, line: int, rising: bool) -> None:
        kind = gpiod.EdgeEvent.Type.RISING_EDGE if rising else gpiod.EdgeEvent.Type.FALLING_EDGE
        event = {"event_type": kind, "timestamp_ns": time_ns, "line_offset": line, "global_seqno": len(bus.edges) + 1}
        bus.edges.append(SimpleNamespace(**event, line_seqno=0))

    link = opened(GPIO)
    opened(GPIO.replace("x=17", "x=0")).close()
    link, bus.closed = opened(GPIO), 0
    ((lines, settings),) = bus.options["config"].items()
    assert (bus.path, lines, bus.options["event_buffer_size"]) == ("/dev/gpiochip0", (17, 27), 1024)
    assert settings.edge_detection is gpiod.line.Edge.BOTH
    assert settings.event_clock is gpiod.line.Clock.MONOTONIC
    edge(1000, 27, True)
    edge(1500, 17, False)
    edge(1600, 17, True)
    assert list(unpack_edges(link.exchange(b"", 2 * 14))) == [Edge(1000, 1, True, 1), Edge(1500, 0, False, 2)]
    assert list(unpack_edges(link.exchange(b"", 100 * 14))) == [Edge(1600, 0, True, 3)]
    edge(2000, 17, True)
    assert link.exchange(b"", 0) == b""
    with pytest.raises(BusError, match=r"no edge on the lines of /dev/gpiochip0 for 0\.5 s.*powered"):
        link.exchange(b"", 14)
    link.close()
    link.close()
    assert (bus.timeout, bus.closed) == (0.5, 1)


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


def test_every_byte_of_a_serial_line_passes_and_what_queued_up_can_be_dropped(pty: tuple[int, str]) -> None:
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
        os.write(master, b"new")
        assert received(link, 3) == b"new"
        assert link.letter == "r" == link_letter(parse_address(COM), find_model("adxl202"))
        with pytest.raises(BusError, match="in use by another program"):
            opened(f"serial://{path}")
    with closing(opened(f"serial://{path}?timeout=0.05")) as link, pytest.raises(BusError, match="Write timeout"):
        link.exchange(bytes(1 << 20))


def test_an_unplugged_serial_adapter_is_told() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    link = opened(f"serial://{os.ttyname(slave)}?timeout=0.1")
    os.close(slave)
    os.close(master)
    for count in (1, 0):
        with pytest.raises(BusError, match=r"is gone: plug it in again, then resume"):
            link.exchange(b"", count)
    link.close()


def test_a_device_behind_a_socket() -> None:
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


REFUSED = (
    ("modbus:tcp://host:65536?columns=x@0", "'65536' is no port number"),
    ("serial:nosuch://somewhere", "cannot be used: name a port"),
    ("serial:hwgrep://(", "pyserial cannot use it .*unterminated subpattern"),
    ("modbus:tcp://host:99999?columns=x@0", "'99999' is no port number"),
    (f"modbus:tcp://host:{'9' * 5000}?columns=x@0", "'99999999999999999999' is no port number"),
    ("modbus:tcp://:502?columns=x@0", "names no host"),
    ("modbus:tcp://host?columns=x@0&baudrate=9600", "option 'baudrate' is of a serial line"),
)


def test_a_wrong_address_is_refused_before_the_bus_is_touched(bus: Stub) -> None:
    bus.open_error = AssertionError("opened")
    for address, why in REFUSED:
        with pytest.raises(UsageError, match=why):
            opened(address)
    # Seven bytes are 56 bits, and the D01 has a new word each 4 ms: at least 14,000 Hz.
    with pytest.raises(BusError, match=r"13999 Hz is too slow for sca3000-d01: .* at least speed=14000"):
        open_link(parse_address(f"{SPI}?speed=13999"), find_model("sca3000-d01"))


def test_only_handlers_that_open_a_line_and_nothing_else_are_used(tmp_path: Path) -> None:
    """pyserial's spy:// opens any file for writing before anything is known of the port."""
    kept = tmp_path / "kept"
    kept.write_text("mine")
    spying = f"spy:///dev/null%3Ffile={kept}"
    for url in (f"serial:{spying}", f"modbus:{spying}?columns=x@0", "serial:alt:///dev/ttyUSB0", "serial:SPY:///dev/x"):
        with pytest.raises(UsageError, match="cannot be used: name a port, or socket://"):
            opened(url)
    assert kept.read_text() == "mine"


def test_a_missing_package_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for address, module, how in (
        (SPI, "spidev", r"pip install 'tiltcal\[spi\]'"),
        (I2C, "smbus2", "pip install smbus2"),
        (GPIO, "gpiod", r"pip install 'tiltcal\[gpio\]'"),
        (COM, "serial", "pip install pyserial"),
    ):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(HardwareError, match=how):
            opened(address)
    for prefix, advice in (
        ("/home/me/.local/share/pipx/venvs/tiltcal", r"pipx install --force 'tiltcal\[spi\]'"),
        ("/home/me/.local/share/uv/tools/tiltcal", r"uv tool install 'tiltcal\[spi\]'"),
        ("/home/me/.cache/uv/archive-v0/uZ3kq", r"uvx --from 'tiltcal\[spi\]' tiltcal"),
    ):
        with monkeypatch.context() as elsewhere:
            elsewhere.setattr(sys, "prefix", prefix)
            with pytest.raises(HardwareError, match=advice):
                opened(SPI)
    monkeypatch.setitem(sys.modules, "gpiod", SimpleNamespace(Chip=object))
    with pytest.raises(HardwareError, match=r"older than version 2.*tiltcal\[gpio\]"):
        opened(GPIO)


@pytest.mark.parametrize(("address", "usual"), [(SPI, "spi"), (I2C, "i2c"), (COM, "tty"), (GPIO, "gpio")])
def test_no_permission_names_the_group_that_has_it(
    bus: Stub, monkeypatch: pytest.MonkeyPatch, address: str, usual: str
) -> None:
    """Nobody is told to join the group root."""
    bus.open_error = PermissionError(errno.EACCES, "Permission denied")

    def refused(self: object) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port")

    monkeypatch.setattr(serial.Serial, "open", refused)
    for group, advice in (
        ("bench", "sudo usermod -aG bench $USER"),
        ("root", f'GROUP="{usual}"'),
        ("", "ask the owner of this machine for it"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(os, "stat", lambda path: SimpleNamespace(st_gid=4711))
            patch.setattr(
                grp,
                "getgrgid",
                lambda number, group=group: {4711 * bool(group): SimpleNamespace(gr_name=group)}[number],
            )
            with pytest.raises(BusError, match="no permission to use /dev/") as error:
                opened(address)
        assert advice in str(error.value)
        assert "usermod -aG root" not in str(error.value)
    monkeypatch.setitem(sys.modules, "grp", None)  # as on Windows
    with pytest.raises(BusError, match="another program has it, or this user may not use it"):
        opened(address)


ERRORS = (
    # What all nodes say in the same words
    (SPI, "open", errno.ENOENT, "/dev/spidev0.0 does not exist"),
    (SPI, "open", errno.EBUSY, "in use by another program"),
    (SPI, "open", errno.ENOTTY, "is it an SPI device, as /dev/spidev0.0 is"),
    (SPI, "open", errno.ENODEV, "is gone: plug it in again"),
    (SPI, "transfer", errno.EIO, r"/dev/spidev0\.0 failed \(Input/output error\): check the wiring"),
    # and what means something else on one of them.
    (I2C, "open", errno.EMFILE, r"failed \(Too many open files\)"),
    (I2C, "transfer", errno.EREMOTEIO, r"no device acknowledges at address 0x1d on /dev/i2c-1 .*'i2cdetect -y 1'"),
    (I2C, "transfer", errno.ENXIO, "no device acknowledges at address 0x1d"),
    (I2C, "transfer", errno.EIO, "no device acknowledges at address 0x1d"),
    (I2C, "transfer", errno.ETIMEDOUT, "time-out at address 0x1d .* pull-up resistors"),
    (I2C, "transfer", errno.EAGAIN, "another master has it"),
    (I2C, "transfer", errno.EOPNOTSUPP, "supports SMBus only"),
    (GPIO, "open", errno.EINVAL, "refuses the lines"),
    (GPIO, "open", errno.ENODEV, "/dev/gpiochip0 is no GPIO chip"),
    (GPIO, "transfer", errno.EIO, "is gone: plug it in again, then resume"),
)


def test_an_error_of_the_system_says_what_to_try(bus: Stub) -> None:
    for address, when, number, advice in ERRORS:
        bus.open_error = bus.transfer_error = None
        link = opened(address)
        setattr(bus, f"{when}_error", OSError(number, os.strerror(number)))
        with pytest.raises(BusError, match=advice):
            opened(address) if when == "open" else link.exchange(b"\x09", 6)
        bus.closed = 0
        link.close()
        assert bus.closed, address


def test_what_a_server_says_at_once_is_read_and_can_be_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    connect = socket.create_connection
    with socket.create_server(("localhost", 0)) as server:

        def greeted(*where: object, **options: object) -> socket.socket:
            client = connect(*where, **options)
            stack.enter_context(server.accept()[0]).sendall(b"Grbl 1.1h")
            assert select.select([client], [], [], 5.0)[0]
            return client

        monkeypatch.setattr(socket, "create_connection", greeted)
        address = f"serial:socket://localhost:{server.getsockname()[1]}?timeout=0.05"
        with ExitStack() as stack:
            link = stack.enter_context(closing(opened(address)))
            assert link.exchange(b"", 9) == b"Grbl 1.1h"
            dropped = stack.enter_context(closing(opened(address)))
            dropped.exchange(b"")
            with pytest.raises(BusError, match="was silent"):
                dropped.exchange(b"", 1)


def test_what_is_not_there_or_no_port_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text("text")
    for address, why in (
        ("gpio:///dev/gpiochip77?x=1&y=2", "/dev/gpiochip77 does not exist"),
        ("gpio:///dev/null?x=1&y=2", "/dev/null is no GPIO chip"),
        ("serial:///dev/ttyUSB77", r"/dev/ttyUSB77 does not exist \(.*\)"),
        ("serial:hwgrep://nobody", r"hwgrep://nobody failed .no ports found .*: check the wiring"),
        (f"serial://{path}", "no serial port"),
        ("modbus:tcp://127.0.0.1?columns=x@0", r"no Modbus server answers at tcp://127\.0\.0\.1: is it running"),
        ("modbus:tcp://127.0.0.1:65535?columns=x@0", r"no Modbus server answers at tcp://127\.0\.0\.1:65535"),
        ("modbus:/dev/null?columns=x@0", "/dev/null cannot be opened: is it a serial port"),
        ("modbus:tcp://a..b:1?columns=x@0", "no Modbus server answers at tcp://"),
        (f"modbus:tcp://{'a' * 64}:1?columns=x@0", "no Modbus server answers at tcp://"),
        ("modbus:/dev/ttyNONE?columns=x@0", "/dev/ttyNONE does not exist"),
    ):
        with pytest.raises(BusError, match=why):
            opened(address)
