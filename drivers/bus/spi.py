"""SPI through the Linux spidev driver."""

from __future__ import annotations

import os
import re
from typing import Any

from tiltcal.drivers.bus import Device
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.nodes import Node, import_library
from tiltcal.errors import BusError

FASTEST = 100_000_000
"""Highest clock of a part whose own is not known, Hz; spidev would take 2**32 and more for other clocks."""

NODE = Node(
    "spidev",
    ("spidev*",),
    "no SPI device is present; switch SPI on in the board's settings",
    "an SPI device, as /dev/spidev0.0 is",
)


def open_spi(address: Address, model: Device) -> SpiLink:
    """Open a ``spi:`` address; its options ``mode`` (0 to 3) and ``speed`` (Hz) are within those of the model."""
    port = model.spi
    if port is None:
        address.refuse(f"{model.name} has no SPI port")
    mode = address.integer("mode", port.modes[0], low=0, high=3)
    if mode not in port.modes:
        works = " and ".join(map(str, port.modes))
        address.refuse(f"{model.name} does not work in SPI mode {mode} (it works in {works})")
    speed = address.integer("speed", port.speed or port.fastest, low=1, high=FASTEST)
    if port.fastest is not None and speed > port.fastest:
        address.refuse(f"{speed} Hz is too fast for {model.name} (at most speed={port.fastest})")
    if speed < port.slowest:
        raise BusError(
            f"an SPI clock of {speed} Hz is too slow for {model.name}: a frame takes longer than the part allows, or "
            f"than its words last; set at least speed={port.slowest}"
        )
    return SpiLink(address.path, mode, speed)


class SpiLink:
    """One chip select of one SPI bus."""

    letter = "s"

    def __init__(self, device: str, mode: int, speed: int) -> None:
        self._device = device
        self._bus: Any = import_library(
            "spidev", "SPI needs the Python package spidev, for Linux only", "tiltcal[spi]"
        ).SpiDev()
        try:
            if numbers := re.fullmatch(r"/dev/spidev(\d+)\.(\d+)", os.path.realpath(device)):
                self._bus.open(*map(int, numbers.groups()))
            else:
                os.stat(device)
                self._bus.open_path(device)  # which spidev 3.6, that of Debian 12, does not have
            self._bus.mode = mode
            self._bus.max_speed_hz = speed
            self._bus.bits_per_word = 8
        except AttributeError:
            raise BusError(f"{device} is no link to {NODE.example}: name that device, or install spidev 3.8") from None
        except OSError as cause:
            self._bus.close()
            raise BusError(NODE.why(device, cause)) from cause

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Shift one frame out and in, chip select low throughout; see :class:`~tiltcal.drivers.bus.Link`."""
        try:
            return bytes(self._bus.xfer2(list(out)))
        except OSError as cause:
            raise BusError(NODE.why(self._device, cause)) from cause

    def close(self) -> None:
        """Release the device node, so that a new link can open it."""
        self._bus.close()
