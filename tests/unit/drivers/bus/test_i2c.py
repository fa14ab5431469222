"""Opening an I2C address, and what each error of the system means at a bench.

Transactions through the real library are tested in ``realbus/test_sca3000.py``.
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

MODEL = find_model("sca3000-i2c")
PLACE = "i2c:///dev/i2c-1?address=0x1d&counts_per_g=1333"


class StubMessage:
    """smbus2's message: to an address either bytes to write, or as many as are read."""

    def __init__(self, address: int, content: bytes) -> None:
        self.address, self.content = address, content

    @classmethod
    def write(cls, address: int, content: bytes) -> StubMessage:
        return cls(address, bytes(content))

    @classmethod
    def read(cls, address: int, length: int) -> StubMessage:
        return cls(address, bytes(range(length)))

    def __bytes__(self) -> bytes:
        return self.content


class StubBus:
    """smbus2's bus, failing where it is told to."""

    open_error: OSError | None = None
    transfer_error: OSError | None = None
    last: StubBus

    def __init__(self) -> None:
        self.path, self.closed = "", False
        self.transactions: list[list[tuple[int, bytes]]] = []
        type(self).last = self

    def open(self, path: str) -> None:
        if self.open_error is not None:
            raise self.open_error
        self.path = path

    def i2c_rdwr(self, *messages: StubMessage) -> None:
        if self.transfer_error is not None:
            raise self.transfer_error
        self.transactions.append([(message.address, message.content) for message in messages])

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def smbus2(monkeypatch: pytest.MonkeyPatch) -> type[StubBus]:
    stub = type("Stub", (StubBus,), {})
    monkeypatch.setitem(sys.modules, "smbus2", SimpleNamespace(SMBus=stub, i2c_msg=StubMessage))
    return stub


def opened(address: str = PLACE):
    return open_link(parse_address(address), MODEL)


def test_an_exchange_is_one_transaction(smbus2) -> None:
    link = opened()
    assert (smbus2.last.path, link.letter) == ("/dev/i2c-1", "i")
    assert link.exchange(b"\x09", 6) == bytes(range(6))
    assert link.exchange(b"\x01\xc1\x83") == b""
    assert link.exchange(b"", 2) == b"\x00\x01"
    assert smbus2.last.transactions == [
        [(0x1D, b"\x09"), (0x1D, bytes(range(6)))],
        [(0x1D, b"\x01\xc1\x83")],
        [(0x1D, b"\x00\x01")],
    ]


def test_an_empty_exchange_asks_for_an_acknowledge(smbus2) -> None:
    assert opened().exchange(b"") == b""
    assert smbus2.last.transactions == [[(0x1D, b"")]]


def test_a_journal_knows_the_bus_by_its_letter() -> None:
    assert link_letter(parse_address(PLACE), MODEL) == "i"
    assert link_letter(parse_address("sim:"), MODEL) == "i"


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("", "option 'address' is missing (add address=...)"),
        ("?address=0x07", "option address=0x07 is too small"),
        ("?address=0x78", "option address=0x78 is too large"),
        ("?address=high", "option address=high is not a whole number"),
        ("?addres=0x1d", "unknown option 'addres' (did you mean 'address'?)"),
    ],
)
def test_a_wrong_address_is_refused_before_the_bus_is_touched(smbus2, options: str, why: str) -> None:
    smbus2.open_error = AssertionError("opened")
    with pytest.raises(UsageError) as error:
        opened(f"i2c:///dev/i2c-1{options}")
    assert why in str(error.value)


@pytest.mark.parametrize("address", ["spi:///dev/spidev0.0", "sim:"])
def test_a_scheme_that_does_not_reach_the_model_is_refused(address: str) -> None:
    with pytest.raises(UsageError, match="sca3000-i2c is reached by i2c: or sim:"):
        opened(address)


def test_a_missing_package_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "smbus2", None)
    with pytest.raises(HardwareError, match="pip install smbus2"):
        opened()


@pytest.mark.parametrize(
    ("group", "advice"), [("i2c", "sudo usermod -aG i2c $USER"), ("root", 'SUBSYSTEM=="i2c-dev", GROUP="i2c"')]
)
def test_no_permission_says_which_group_to_join(
    smbus2, monkeypatch: pytest.MonkeyPatch, group: str, advice: str
) -> None:
    smbus2.open_error = PermissionError(errno.EACCES, "Permission denied")
    with monkeypatch.context() as patch:
        patch.setattr(os, "stat", lambda path: SimpleNamespace(st_gid=4711))
        patch.setattr(grp, "getgrgid", lambda number: {4711: SimpleNamespace(gr_name=group)}[number])
        with pytest.raises(BusError) as error:
            opened()
    assert "no permission to use /dev/i2c-1" in str(error.value)
    assert advice in str(error.value)
    assert smbus2.last.closed


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOENT, "/dev/i2c-1 does not exist"),
        (errno.ENODEV, "plug the I2C adapter in again"),
        (errno.ENOTTY, "is it an I2C bus"),
        (errno.EMFILE, r"cannot be opened \(Too many open files\)"),
    ],
)
def test_an_error_on_opening_says_what_to_try(smbus2, number: int, advice: str) -> None:
    smbus2.open_error = OSError(number, os.strerror(number))
    with pytest.raises(BusError, match=advice):
        opened()
    assert smbus2.last.closed


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.EREMOTEIO, r"no device acknowledges at address 0x1d on /dev/i2c-1 .*'i2cdetect -y 1'"),
        (errno.ENXIO, "no device acknowledges at address 0x1d"),
        (errno.EIO, "no device acknowledges at address 0x1d"),
        (errno.ETIMEDOUT, "time-out at address 0x1d .* pull-up resistors"),
        (errno.EAGAIN, "another master has it"),
        (errno.EBUSY, "SDA or SCL is held low"),
        (errno.ENODEV, "plug the I2C adapter in again"),
        (errno.EOPNOTSUPP, "supports SMBus only"),
        (errno.EPROTO, r"failed \(Protocol error\): check the wiring"),
    ],
)
def test_a_failed_transaction_says_what_to_try_and_leaves_a_link_that_can_be_closed(
    smbus2, number: int, advice: str
) -> None:
    link = opened()
    smbus2.transfer_error = OSError(number, os.strerror(number))
    with pytest.raises(BusError, match=advice):
        link.exchange(b"\x09", 6)
    link.close()
    assert smbus2.last.closed
