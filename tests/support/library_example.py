"""The example of the library, which mypy checks as a user of ``mypy --strict`` would; nothing runs it."""

from __future__ import annotations

from typing import Any, assert_type

import polars
import xarray

import tiltcal


class Rig:
    """An operator in Python."""

    def position(self, ask: dict[str, Any]) -> dict[str, Any]:
        return {"answer": "ready", "tilt": ask["tilt"]}


def example(frame: polars.DataFrame, table: polars.DataFrame, readings: polars.DataFrame) -> None:
    cal = tiltcal.read("S-0042.yaml")
    print(cal.offset["x"], cal.sensitivity["x", "y"], cal.uncertainty["offset.x"])
    print(cal.limits, cal.fit.residuals, cal.provenance.ended)
    out = cal.apply(frame)
    out = cal.apply(frame, columns={"x": "VoutX"}, uncertainty=True)
    print(out)
    tiltcal.apply_log(cal, "night.csv", "night-tilt.parquet", uncertainty=True)

    cal = tiltcal.fit("six-face", table, serial="IMU1", unit="m/s2", jig=0.1)
    cal = tiltcal.fit("free", readings, serial="IMU1", unit="m/s2", gravity=9.81744)
    cal.save("IMU1.yaml")
    cal.report("IMU1.html")
    print(cal)

    print(tiltcal.plan("zero-45", sensor="sca100t-d02", jig=0.1))
    print(tiltcal.compare(tiltcal.read("old.yaml"), cal))
    print(tiltcal.match(frame, pairs=[("a1", "a2", "a4")], phase="theta"))
    print(tiltcal.noise(readings, rate=102.4, unit="m/s2"))
    with tiltcal.open_sensor("sca100t-d02", "spi:///dev/spidev0.0") as sensor:
        print(sensor.read().values)
    measured = tiltcal.measure(
        "plane", sensor="sca100t-d02", address="sim:", serial="A-1", operator=Rig(), output="A-1.yaml"
    )
    measured.report("A-1.html")
    print(tiltcal.open_calibrations(".").at("A-1", "2026-05-01").offset)


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
