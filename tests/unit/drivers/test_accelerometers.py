"""Two of Adafruit's drivers read our virtual parts on a bus of five methods."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.virtual import Fixture

UP = (0.48, -0.6, 0.64)

COUNTS = {"mpu6050": 16384 / 9.80665, "adxl345": 250 / 9.80665}
"""What their drivers divide by: counts to 1 m/s²."""


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


@pytest.mark.parametrize(
    ("name", "module", "kind"), [("mpu6050", "adafruit_mpu6050", "MPU6050"), ("adxl345", "adafruit_adxl34x", "ADXL345")]
)
def test_they_read_the_counts_of_our_virtual_parts(
    name: str, module: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for missing in ("busio", "circuitpython_typing", "circuitpython_typing.device_drivers", "digitalio", "micropython"):
        monkeypatch.setitem(sys.modules, missing, MagicMock(const=int))
    pytest.importorskip(module, reason=f"Adafruit's {module} is not installed")
    theirs = import_module(module)
    monkeypatch.setattr(theirs, "sleep", lambda seconds: None, raising=False)
    monkeypatch.setattr(theirs, "time", SimpleNamespace(sleep=lambda seconds: None), raising=False)
    model, clock = find_model(name), VirtualClock()
    fixture, truth = Fixture(clock, ambient=24.0), replace(model.default_truth(3), noise={})
    fixture.move(UP)
    sensor = getattr(theirs, kind)(FakeBus(model.twin(truth, fixture, clock)))
    if name == "adxl345":
        sensor.range = theirs.Range.RANGE_2_G  # which sets full resolution
    else:
        assert sensor.temperature == pytest.approx(24.0 + truth.thermometer_error, abs=0.01)
    counts = [truth.reading(channel, UP, 24.0) for channel in "xyz"]
    assert [value * COUNTS[name] for value in sensor.acceleration] == pytest.approx(counts, abs=0.51)
