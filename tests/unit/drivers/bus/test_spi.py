"""Opening an SPI address: options within the part's limits, and what each error of the system means at a bench.

Words through the real library are tested in ``realbus/test_spi_sca100t.py``.
"""

from __future__ import annotations

import errno
import grp
import os
import sys
from types import SimpleNamespace

import pytest

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.errors import BusError, HardwareError, UsageError

D02 = find_model("sca100t-d02")


class StubSpiDev:
    """python-spidev's class, failing where it is told to."""

    open_error: OSError | None = None
    transfer_error: OSError | None = None
    last: StubSpiDev

    def __init__(self) -> None:
        self.path, self.closed, self.mode, self.max_speed_hz = "", False, -1, -1
        StubSpiDev.last = self

    def open_path(self, path: str) -> None:
        if self.open_error is not None:
            raise self.open_error
        self.path = path

    def xfer2(self, out: list[int]) -> list[int]:
        if self.transfer_error is not None:
            raise self.transfer_error
        return [byte ^ 0xFF for byte in out]

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def spidev(monkeypatch: pytest.MonkeyPatch) -> type[StubSpiDev]:
    stub = type("Stub", (StubSpiDev,), {})
    monkeypatch.setitem(sys.modules, "spidev", SimpleNamespace(SpiDev=stub))
    return stub


def opened(address: str):
    return open_link(parse_address(address), D02)


def test_the_part_sets_mode_and_clock_where_the_address_does_not(spidev) -> None:
    link = opened("spi:///dev/spidev0.0")
    assert (spidev.last.path, spidev.last.mode, spidev.last.max_speed_hz) == ("/dev/spidev0.0", 0, 500_000)
    assert link.letter == "s"
    assert link.exchange(b"\x10\x00\x00") == b"\xef\xff\xff"


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("speed=500001", "500001 Hz is too fast for sca100t-d02 (at most speed=500000)"),
        ("speed=0", "option speed=0 is too small"),
        ("mode=1", "sca100t-d02 does not work in SPI mode 1 (it works in 0 and 3)"),
        ("mode=4", "option mode=4 is too large (at most 3)"),
        ("sped=1", "unknown option 'sped' (did you mean 'speed'?)"),
    ],
)
def test_an_option_beyond_the_part_is_refused_before_the_bus_is_touched(spidev, options: str, why: str) -> None:
    spidev.open_error = AssertionError("opened")
    with pytest.raises(UsageError) as error:
        opened(f"spi:///dev/spidev0.0?{options}")
    assert why in str(error.value)


@pytest.mark.parametrize("address", ["i2c:///dev/i2c-1?address=0x48", "sim:"])
def test_a_scheme_that_does_not_reach_the_model_is_refused(address: str) -> None:
    with pytest.raises(UsageError, match=r"sca100t-d02 is reached by spi: or sim: \(such as spi:///dev/spidev0.0\)"):
        opened(address)


def test_a_missing_package_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "spidev", None)
    with pytest.raises(HardwareError, match=r"pip install 'tiltcal\[spi\]'"):
        opened("spi:///dev/spidev0.0")


def owned_by(monkeypatch: pytest.MonkeyPatch, group: str) -> None:
    monkeypatch.setattr(os, "stat", lambda path: SimpleNamespace(st_gid=4711))
    monkeypatch.setattr(grp, "getgrgid", lambda number: {4711: SimpleNamespace(gr_name=group)}[number])


def test_no_permission_names_the_group_that_has_it(spidev, monkeypatch: pytest.MonkeyPatch) -> None:
    spidev.open_error = PermissionError(errno.EACCES, "Permission denied")
    with monkeypatch.context() as patch:
        owned_by(patch, "spi")
        with pytest.raises(BusError) as error:
            opened("spi:///dev/spidev0.0")
    assert "/dev/spidev0.0, which belongs to group spi" in str(error.value)
    assert "sudo usermod -aG spi $USER" in str(error.value)
    assert spidev.last.closed


def test_nobody_is_told_to_join_the_group_root(spidev, monkeypatch: pytest.MonkeyPatch) -> None:
    spidev.open_error = PermissionError(errno.EACCES, "Permission denied")
    with monkeypatch.context() as patch:
        owned_by(patch, "root")
        with pytest.raises(BusError) as error:
            opened("spi:///dev/spidev0.0")
    assert 'GROUP="spi"' in str(error.value)
    assert "usermod -aG root" not in str(error.value)


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOENT, "/dev/spidev9.9 does not exist"),
        (errno.EBUSY, "in use by another program"),
        (errno.ENOTTY, "is it an SPI device"),
        (errno.ENODEV, "plug the SPI adapter in again"),
        (errno.EIO, r"Input/output error\): check the wiring"),
    ],
)
def test_an_error_on_opening_says_what_to_try(spidev, number: int, advice: str) -> None:
    spidev.open_error = OSError(number, os.strerror(number))
    with pytest.raises(BusError, match=advice):
        opened("spi:///dev/spidev9.9")


def test_a_failed_transfer_leaves_a_link_that_can_be_closed(spidev) -> None:
    link = opened("spi:///dev/spidev0.0")
    spidev.transfer_error = OSError(errno.EIO, os.strerror(errno.EIO))
    with pytest.raises(BusError, match=r"transfer on /dev/spidev0\.0 failed"):
        link.exchange(b"\x00")
    link.close()
    assert spidev.last.closed
