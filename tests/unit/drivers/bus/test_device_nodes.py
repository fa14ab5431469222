"""SPI and I2C: what is sent through their libraries, and what each error of the system means at a bench.

Words through the real libraries are tested in ``realbus``.
"""

from __future__ import annotations

import errno
import grp
import os
import sys
from types import SimpleNamespace

import pytest

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import link_letter, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.errors import BusError, HardwareError, UsageError

PLACES = {
    "spi": ("sca100t-d02", "spi:///dev/spidev0.0"),
    "i2c": ("sca3000-i2c", "i2c:///dev/i2c-1?address=0x1d&counts_per_g=1333"),
}


class StubMessage:
    """smbus2's message: to an address either bytes to write, or as many as are read."""

    def __init__(self, address: int, content: object) -> None:
        self.address, self.content = address, bytes(content)

    write = classmethod(lambda cls, address, content: cls(address, content))
    read = classmethod(lambda cls, address, length: cls(address, range(length)))

    def __bytes__(self) -> bytes:
        return self.content


class Stub:
    """The bus of either library, failing where it is told to."""

    def __init__(self) -> None:
        self.open_error = self.transfer_error = None
        self.path, self.closed, self.sent = "", 0, []

    def open_path(self, path: str) -> None:
        if self.open_error:
            raise self.open_error
        self.path = path

    open = open_path

    def xfer2(self, out: list[int]) -> list[int]:
        self.i2c_rdwr()
        return [byte ^ 0xFF for byte in out]

    def i2c_rdwr(self, *messages: StubMessage) -> None:
        if self.transfer_error:
            raise self.transfer_error
        self.sent.append([(message.address, message.content) for message in messages])

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Stub:
    stub = Stub()
    monkeypatch.setitem(sys.modules, "spidev", SimpleNamespace(SpiDev=lambda: stub))
    monkeypatch.setitem(sys.modules, "smbus2", SimpleNamespace(SMBus=lambda: stub, i2c_msg=StubMessage))
    return stub


def opened(kind: str, address: str = ""):
    model, place = PLACES[kind]
    return open_link(parse_address(address or place), find_model(model))


def test_the_part_sets_mode_and_clock_of_spi_where_the_address_does_not(bus: Stub) -> None:
    link = opened("spi")
    assert (bus.path, bus.mode, bus.max_speed_hz, link.letter) == ("/dev/spidev0.0", 0, 500_000, "s")
    assert link.exchange(b"\x10\x00\x00") == b"\xef\xff\xff"
    opened("spi", "spi:///dev/spidev0.0?mode=3&speed=125000")
    assert (bus.mode, bus.max_speed_hz) == (3, 125_000)


def test_an_exchange_on_i2c_is_one_transaction(bus: Stub) -> None:
    link = opened("i2c")
    for out, count, answer in (
        (b"\x09", 6, bytes(range(6))),
        (b"\x01\xc1", 0, b""),
        (b"", 2, b"\x00\x01"),
        (b"", 0, b""),
    ):
        bus.sent.clear()
        assert link.exchange(out, count) == answer
        assert bus.sent == [[(0x1D, out)] * bool(out or not count) + [(0x1D, answer)] * bool(count)]
    assert (bus.path, link_letter(parse_address("sim:"), find_model("sca3000-i2c"))) == ("/dev/i2c-1", link.letter)


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("spi:///dev/spidev0.0?speed=500001", "500001 Hz is too fast for sca100t-d02 (at most speed=500000)"),
        ("spi:///dev/spidev0.0?speed=0", "option speed=0 is too small"),
        ("spi:///dev/spidev0.0?mode=1", "sca100t-d02 does not work in SPI mode 1 (it works in 0 and 3)"),
        ("spi:///dev/spidev0.0?sped=1", "unknown option 'sped' (did you mean 'speed'?)"),
        ("i2c:///dev/i2c-1", "option 'address' is missing (add address=...)"),
        ("i2c:///dev/i2c-1?address=0x07", "option address=0x07 is too small"),
        ("i2c:///dev/i2c-1?address=0x78", "option address=0x78 is too large"),
    ],
)
def test_an_option_beyond_the_part_is_refused_before_the_bus_is_touched(bus: Stub, address: str, why: str) -> None:
    bus.open_error = AssertionError("opened")
    with pytest.raises(UsageError) as error:
        opened(address[:3], address)
    assert why in str(error.value)


def test_a_clock_that_lets_the_words_change_while_they_are_read_is_refused(bus: Stub) -> None:
    """Seven bytes are 56 bits, and the D01 has a new word each 4 ms: at least 14,000 Hz."""
    model = find_model("sca3000-d01")
    open_link(parse_address("spi:///dev/spidev0.0?speed=14000"), model)
    with pytest.raises(BusError, match=r"13999 Hz is too slow for sca3000-d01: .* at least speed=14000"):
        open_link(parse_address("spi:///dev/spidev0.0?speed=13999"), model)


@pytest.mark.parametrize(("kind", "how"), [("spi", r"pip install 'tiltcal\[spi\]'"), ("i2c", "pip install smbus2")])
def test_a_missing_package_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch, kind: str, how: str) -> None:
    monkeypatch.setitem(sys.modules, {"spi": "spidev", "i2c": "smbus2"}[kind], None)
    with pytest.raises(HardwareError, match=how):
        opened(kind)


@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("group", ["bench", "root"])
def test_no_permission_names_the_group_that_has_it(
    bus: Stub, monkeypatch: pytest.MonkeyPatch, kind: str, group: str
) -> None:
    """Nobody is told to join the group root."""
    bus.open_error = PermissionError(errno.EACCES, "Permission denied")
    with monkeypatch.context() as patch:
        patch.setattr(os, "stat", lambda path: SimpleNamespace(st_gid=4711))
        patch.setattr(grp, "getgrgid", lambda number: {4711: SimpleNamespace(gr_name=group)}[number])
        with pytest.raises(BusError, match="no permission to use /dev/") as error:
            opened(kind)
    advice = "sudo usermod -aG bench $USER" if group == "bench" else f'GROUP="{kind}"'
    assert advice in str(error.value)
    assert "usermod -aG root" not in str(error.value)
    assert bus.closed


@pytest.mark.parametrize(
    ("kind", "when", "number", "advice"),
    [
        ("spi", "open", errno.ENOENT, "/dev/spidev0.0 does not exist"),
        ("spi", "open", errno.EBUSY, "in use by another program"),
        ("spi", "open", errno.ENOTTY, "is it an SPI device"),
        ("spi", "open", errno.ENODEV, "plug the SPI adapter in again"),
        ("spi", "transfer", errno.EIO, r"transfer on /dev/spidev0\.0 failed \(Input/output error\): check the wiring"),
        ("i2c", "open", errno.ENOENT, "/dev/i2c-1 does not exist"),
        ("i2c", "open", errno.ENODEV, "plug the I2C adapter in again"),
        ("i2c", "open", errno.ENOTTY, "is it an I2C bus"),
        ("i2c", "open", errno.EMFILE, r"cannot be opened \(Too many open files\)"),
        (
            "i2c",
            "transfer",
            errno.EREMOTEIO,
            r"no device acknowledges at address 0x1d on /dev/i2c-1 .*'i2cdetect -y 1'",
        ),
        ("i2c", "transfer", errno.ENXIO, "no device acknowledges at address 0x1d"),
        ("i2c", "transfer", errno.EIO, "no device acknowledges at address 0x1d"),
        ("i2c", "transfer", errno.ETIMEDOUT, "time-out at address 0x1d .* pull-up resistors"),
        ("i2c", "transfer", errno.EAGAIN, "another master has it"),
        ("i2c", "transfer", errno.EBUSY, "SDA or SCL is held low"),
        ("i2c", "transfer", errno.ENODEV, "plug the I2C adapter in again"),
        ("i2c", "transfer", errno.EOPNOTSUPP, "supports SMBus only"),
        ("i2c", "transfer", errno.EPROTO, r"failed \(Protocol error\): check the wiring"),
    ],
)
def test_an_error_of_the_system_says_what_to_try(bus: Stub, kind: str, when: str, number: int, advice: str) -> None:
    link = opened(kind)
    setattr(bus, f"{when}_error", OSError(number, os.strerror(number)))
    with pytest.raises(BusError, match=advice):
        opened(kind) if when == "open" else link.exchange(b"\x09", 6)
    link.close()
    assert bus.closed
