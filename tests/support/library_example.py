"""Types of the library, which mypy checks as a user of ``mypy --strict`` would; nothing runs it."""

from typing import Any, assert_type

import polars
import xarray

import tiltcal


class Rig:
    """An operator in Python."""

    def position(self, ask: dict[str, Any]) -> dict[str, Any]:
        return {"answer": "ready", "tilt": ask["tilt"]}


def values(cal: tiltcal.Calibration) -> None:
    """Coefficients and records have types; an operator is any object."""
    assert_type(cal.offset["x"] + cal.sensitivity["x", "y"] + cal.uncertainty["offset.x"], float)
    assert_type(cal.provenance.ended, str | None)
    with tiltcal.open_sensor("sca100t-d02", "spi:///dev/spidev0.0") as sensor:
        print(sensor.read().values)
    tiltcal.measure("plane", sensor="sca100t-d02", address="sim:", serial="A-1", operator=Rig(), output="A-1.yaml")


def kinds(frame: polars.DataFrame, data: xarray.Dataset, lists: dict[str, list[float]], unknown: Any) -> None:
    """The same kind comes back; of columns by name, those that are added are arrays."""
    cal = tiltcal.fit("six-face", frame, serial="IMU1", unit="m/s2")
    assert_type(cal.apply(frame, columns={"x": "VoutX"}, uncertainty=True), polars.DataFrame)
    assert_type(cal.apply(data, every="10s"), xarray.Dataset)
    assert_type(cal.apply(lists, magnetometer="mx,my,mz"), dict[str, Any])
    assert_type(cal.apply(unknown), Any)
    pairs = tiltcal.match(frame, pairs=[("a1", "a2", "a4")], phase="theta")
    assert_type(pairs.apply(frame, columns={"a1": "Q1"}), polars.DataFrame)
    assert_type(pairs.apply(lists), dict[str, Any])
    folder = tiltcal.open_calibrations(".")
    assert_type(folder.apply(frame, serial="A-1", uncertainty=True), polars.DataFrame)
    assert_type(folder.apply(lists, start="2026-05-01", average=5), dict[str, Any])
