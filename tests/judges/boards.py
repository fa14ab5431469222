"""The boards that drivers by other hands expect, with one of our virtual parts on their bus.

A driver sees the bus of its world: CircuitPython's, MicroPython's, that of smbus2 or of spidev. They carry bytes and
nothing else, so they judge no timing, no clock and no SPI mode. A pause of the driver moves the part's clock.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.virtual import Fixture, Truth

PACKAGES = Path(__file__).parent / "build" / "python"
UP = (0.36, -0.288, (1.0 - 0.36**2 - 0.288**2) ** 0.5)
"""Within ±0.49 g of x and y, where the narrowest range of an IIS2ICLX ends."""
G = 9.80665
COLD = -20.0
"""Far from where thermometers have their zeros, °C."""


class Board:
    """Every bus of every world, with one part on it."""

    def __init__(self, model: str, options: str = "", letter: str = "i") -> None:
        self.clock = VirtualClock()
        self.model = find_model(model).at(parse_address(f"sim:{options}"))
        self.truth: Truth = replace(self.model.default_truth(3), noise={})
        fixture = Fixture(self.clock, ambient=COLD)
        fixture.move(UP)
        self.part = self.model.twin(self.truth, fixture, self.clock)
        self.part.letter = letter
        self._out = b""

    def counts(self, channels: str = "") -> list[float]:
        """What the part's channels read, not rounded."""
        return [self.truth.reading(channel, UP, COLD) for channel in channels or self.model.channels]

    @property
    def celsius(self) -> float:
        return COLD + self.truth.thermometer_error

    def install(self, patch: pytest.MonkeyPatch) -> None:
        """Put the modules of a board in place of those that are not here."""
        names = ("busio", "board", "digitalio", "circuitpython_typing", "circuitpython_typing.device_drivers")
        for name in names:
            patch.setitem(sys.modules, name, MagicMock())
        message = SimpleNamespace(write=lambda address, data: bytes(data), read=lambda address, size: bytearray(size))
        bus = {"SMBus": lambda number: self, "i2c_msg": message}
        patch.setitem(sys.modules, "micropython", SimpleNamespace(const=lambda value: value))
        patch.setitem(sys.modules, "smbus", SimpleNamespace(**bus))
        patch.setitem(sys.modules, "smbus2", SimpleNamespace(**bus))
        patch.setitem(sys.modules, "spidev", SimpleNamespace(SpiDev=lambda: self))
        utils = SimpleNamespace(Constant=lambda value: SimpleNamespace(value=value))
        patch.setitem(sys.modules, "utils", SimpleNamespace(constant=utils))
        patch.setitem(sys.modules, "utils.constant", utils)
        patch.setattr(time, "sleep", self.sleep)

    def sleep(self, seconds: float) -> None:
        self.clock.sleep(seconds)
        assert self.clock.now_ns() < 30e9, "the driver waits for the part without end"

    # --- CircuitPython ---

    def try_lock(self) -> bool:
        return True

    def unlock(self) -> None:
        pass

    def configure(self, **settings: int) -> None:
        self._out = b""

    def writeto(self, address: int, buffer: bytes, *, start: int = 0, end: int | None = None) -> None:
        self.part.exchange(bytes(buffer[start:end]))

    def readfrom_into(self, address: int, buffer: bytearray, *, start: int = 0, end: int | None = None) -> None:
        buffer[start:end] = self.part.exchange(b"", len(buffer[start:end]))

    def writeto_then_readfrom(self, address: int, out: bytes, buffer: bytearray, **part: int) -> None:
        first, last = part.get("in_start", 0), part.get("in_end")
        out = bytes(out[part.get("out_start", 0) : part.get("out_end")])
        buffer[first:last] = self.part.exchange(out, len(buffer[first:last]))

    def write(self, buffer: bytes, *, start: int = 0, end: int | None = None) -> None:
        """Send while chip select is low; what is read then is of the same frame."""
        self._out = bytes(buffer[start:end])
        if end != 1:
            self.part.exchange(self._out)

    def readinto(self, buffer: bytearray, *, start: int = 0, end: int | None = None, write_value: int = 0) -> None:
        length = len(buffer[start:end])
        buffer[start:end] = self.part.exchange(self._out + bytes(length))[len(self._out) :]

    # --- MicroPython ---

    def readfrom_mem(self, address: int, register: int, length: int) -> bytes:
        return self.part.exchange(bytes([register]), length)

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        self.part.exchange(bytes([register]) + bytes(data))

    # --- smbus2 ---

    def read_byte_data(self, address: int, register: int) -> int:
        return self.read_i2c_block_data(address, register, 1)[0]

    def read_i2c_block_data(self, address: int, register: int, length: int) -> list[int]:
        # The compass in the same package is not modelled: it answers with zeros.
        compass = address == 0x0C
        return list(bytes(length) if compass else self.part.exchange(bytes([register]), length))

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        if address != 0x0C:
            self.part.exchange(bytes([register, value]))

    def i2c_rdwr(self, out: bytes, into: bytearray | None = None) -> None:
        answer = self.part.exchange(out, len(into or b""))
        if into is not None:
            into[:] = answer

    # --- spidev ---

    def open(self, bus: int, device: int) -> None:
        pass

    def xfer2(self, frame: Any, *settings: int) -> list[int]:
        return list(self.part.exchange(bytes(frame)))

    # --- adxl355 ---

    def read_register(self, register: int, length: int = 1) -> bytes:
        if self.part.letter == "i":
            return self.part.exchange(bytes([register]), length)
        return self.part.exchange(bytes([register << 1 | 1]) + bytes(length))[1:]

    def write_register(self, register: int, data: bytes) -> None:
        first = register if self.part.letter == "i" else register << 1
        self.part.exchange(bytes([first]) + bytes(data))

    def delay_ms(self, milliseconds: int) -> None:
        self.clock.sleep(milliseconds / 1000.0)


@contextmanager
def foreign(module: str) -> Iterator[ModuleType]:
    """Import a driver by another hand anew, or skip the test by its name; no driver stays imported."""
    before = set(sys.modules)
    sys.path.insert(0, str(PACKAGES))
    try:
        try:
            found = import_module(module)
        except ModuleNotFoundError as failure:
            pytest.skip(f"{module} is not here ({failure}): make test-judges installs it where it can be had")
        yield found
    finally:
        sys.path.remove(str(PACKAGES))
        for name in set(sys.modules) - before:
            del sys.modules[name]
