"""Three of Adafruit's drivers read our virtual parts on a bus of five methods, and are read by ``python:``."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

import tiltcal
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.virtual import Fixture

UP = (0.48, -0.6, 0.64)


class FakeBus:
    """A bus of CircuitPython with one chip."""

    def __init__(self, chip: Any) -> None:
        self._chip, self._pointer = chip, b"\0"

    def try_lock(self) -> bool:
        return True

    def unlock(self) -> None:
        pass

    def writeto(self, address: int, buffer: bytes, *, start: int = 0, end: int | None = None) -> None:
        out = bytes(buffer[start:end])
        self._pointer = out[:1] or self._pointer
        if len(out) > 1:
            self._chip.exchange(out)

    def readfrom_into(self, address: int, buffer: bytearray, *, start: int = 0, end: int | None = None) -> None:
        length = len(buffer[start:end])
        buffer[start : start + length] = self._chip.exchange(self._pointer, length)

    def writeto_then_readfrom(self, address: int, out: bytes, buffer: bytearray, **part: int) -> None:
        self.writeto(address, out, start=part["out_start"], end=part["out_end"])
        self.readfrom_into(address, buffer, start=part["in_start"], end=part["in_end"])


@pytest.fixture
def truths(monkeypatch: pytest.MonkeyPatch) -> dict[str, tuple[Any, list[float], float]]:
    """Each driver, with what its part reads (count) and its temperature."""
    for missing in ("busio", "circuitpython_typing", "circuitpython_typing.device_drivers", "digitalio", "micropython"):
        monkeypatch.setitem(sys.modules, missing, MagicMock(const=int))
    made = {}
    for name, options, module, kind in (
        ("mpu6050", "", "adafruit_mpu6050", "MPU6050"),
        ("adxl345", "", "adafruit_adxl34x", "ADXL345"),
        ("lis3dh", "rate=400", "adafruit_lis3dh", "LIS3DH_I2C"),
    ):
        pytest.importorskip(module, reason=f"Adafruit's {module} is not installed")
        theirs = import_module(module)
        for sleeping in ("sleep", "time"):
            if hasattr(theirs, sleeping):
                nothing = lambda seconds: None  # noqa: E731
                monkeypatch.setattr(
                    theirs, sleeping, nothing if sleeping == "sleep" else SimpleNamespace(sleep=nothing)
                )
        model, clock = find_model(name).at(parse_address(f"sim:{options}")), VirtualClock()
        fixture, truth = Fixture(clock, ambient=24.0), replace(model.drawn(3), noise={})
        fixture.move(UP)
        sensor = getattr(theirs, kind)(FakeBus(model.twin(truth, fixture, clock)))
        if name == "adxl345":
            sensor.range = theirs.Range.RANGE_2_G  # which sets full resolution
        counts = [truth.reading(channel, UP, 24.0) for channel in "xyz"]
        made[name] = sensor, counts, 24.0 + truth.thermometer_error
    return made


COUNTS = {"mpu6050": 16384 / 9.80665, "adxl345": 250 / 9.80665, "lis3dh": 16380 / 16 / 9.806}
"""What their drivers divide by: counts to 1 m/s²."""


def test_they_read_the_counts_of_our_virtual_parts(truths: dict[str, Any]) -> None:
    for name, (sensor, counts, _) in truths.items():
        read = [value * COUNTS[name] for value in sensor.acceleration]
        assert read == pytest.approx(counts, abs=0.51), name
    sensor, _, celsius = truths["mpu6050"]
    assert sensor.temperature == pytest.approx(celsius, abs=0.01)


def test_python_reads_them(truths: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    boards = SimpleNamespace(**{name: lambda sensor=sensor: sensor for name, (sensor, _, _) in truths.items()})
    monkeypatch.setitem(sys.modules, "boards", boards)
    for name, (_, counts, _) in truths.items():
        with tiltcal.open_sensor("python", f"python:boards:{name}") as sensor:
            read = [value * COUNTS[name] for value in sensor.read().values]
        assert read == pytest.approx(counts, abs=0.51), name
