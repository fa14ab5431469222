"""Fits that take the sensitivity of a user's own sensor from its calibration; readings are simulated here, by hand."""

from datetime import time
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import xarray

import tiltcal
from tiltcal.files.procedure import find_procedure
from tiltcal.library.recorded import fit

OWN = """\
tiltcal: 1
kind: tilt
sensor: {model: recorded, serial: S-7, unit: V, channels: [x, y]}
calibration:
  offset: {x: 2.5, y: 2.4}
  sensitivity: {x: {x: 2.05, y: 0.03}, y: {x: -0.02, y: 1.95}}
uncertainty:
  offset: {x: 0.01, y: 0.01}
  sensitivity: {x: {x: 0.004, y: 0.004}, y: {x: 0.004, y: 0.004}}
limits:
  reading: [0.1, 4.9]
"""
SENSITIVITY = np.array([[2.05, 0.03], [-0.02, 1.95]])
SENSOR: dict[str, Any] = {"serial": "S-7", "unit": "V"}
ROWS = 80


@pytest.fixture
def base(tmp_path: Path) -> Path:
    path = tmp_path / "S-7.yaml"
    path.write_text(OWN, encoding="utf-8")
    return path


def recorded(procedure: str, offset: tuple[float, float], drift: float = 0.0) -> dict[str, Any]:
    """Readings of a two-axis sensor in the positions of a procedure, and the rows of each."""
    rng = np.random.default_rng(1)
    blocks, temperatures, segments = [], [], []
    for number, position in enumerate(find_procedure(procedure).positions):
        temperature = 24.0 if position.temperature is None else position.temperature
        mean = np.array(offset) + SENSITIVITY @ position.gravity[:2] + drift * (temperature - 24.0)
        blocks.append(mean + rng.normal(0.0, 1e-4, (ROWS, 2)))
        temperatures.append(np.full(ROWS, temperature))
        segments.append({"position": position.name, "start": number * ROWS, "end": (number + 1) * ROWS})
    x, y = np.concatenate(blocks).T
    return {"data": {"x": x, "y": y, "temperature": np.concatenate(temperatures)}, "segments": segments}


def test_reversal_renews_the_offset_with_the_sensitivity_of_the_base(base: Path) -> None:
    found = tiltcal.fit("reversal", **recorded("reversal", (2.56, 2.38)), base=base, **SENSOR)
    assert list(found.offset.values()) == pytest.approx([2.56, 2.38], abs=2e-3)
    assert found.sensitivity["x", "x"] == pytest.approx(2.05, abs=1e-3)
    assert found.sensitivity["x", "y"] == pytest.approx(0.03, abs=1e-3)
    assert found.derived.assumed == ("sensitivity: of the base calibration",)
    assert found.limits.reading["x"] == (0.1, 4.9)


def test_a_sample_far_off_is_left_out_and_counted(base: Path) -> None:
    """One of 80 is 1 V off: it moved the mean by 12 mV, 6 mg, without a word."""
    readings, said = recorded("reversal", (2.56, 2.38)), []
    readings["data"]["x"][100] += 1.0
    found = tiltcal.fit("reversal", **readings, base=base, say=said.append, **SENSOR)
    assert found.offset["x"] == pytest.approx(2.56, abs=2e-3)
    assert [one.left_out for one in found.positions][:3] == [None, 1, None]
    assert said == [f"{found.positions[1].position}: 1 sample is far off the others or missing, and left out"]


@pytest.mark.parametrize("procedure", ["two-temperature", "temperature-sweep"])
def test_the_drift_of_a_users_own_sensor(procedure: str, base: Path) -> None:
    """2 mV/°C on both channels."""
    found = tiltcal.fit(procedure, **recorded(procedure, (2.5, 2.4), drift=0.002), base=base, **SENSOR)
    thermal = found.coefficients.thermal
    assert thermal is not None
    assert thermal.drift[:, 0] == pytest.approx([0.002, 0.002], abs=1e-4)
    assert found.sensor.model == "recorded"


def test_a_column_time_that_holds_none_is_left_alone(base: Path) -> None:
    """A time of day without a date."""
    readings = recorded("two-temperature", (2.5, 2.4), drift=0.002)
    frame = pl.DataFrame(readings["data"]).with_columns(time=pl.lit(time(12)))
    known = tiltcal.fit("two-temperature", **readings, base=base, **SENSOR)
    found = tiltcal.fit("two-temperature", frame, segments=readings["segments"], base=base, **SENSOR)
    assert found.offset == known.offset


@pytest.mark.parametrize("kind", ["frame", "log", "headerless", "table"])
def test_a_two_axis_sensor_of_no_known_model(kind: str, tmp_path: Path) -> None:
    """Cross-axis sensitivity is of both channels to three axes: no column z is needed. Against eq. 2."""
    readings, said = recorded("cross-axis", (2.5, 2.4)), list[str]()
    data, segments = readings["data"], readings["segments"]
    means = [[float(np.mean(data[c][row["start"] : row["end"]])) for c in "xy"] for row in segments]
    options: dict[str, Any] = {"segments": segments}
    if kind == "table":
        data = {"position": [row["position"] for row in segments]} | dict(zip("xy", np.transpose(means), strict=True))
        options = {"table": True}
    elif kind != "frame":
        rows = pl.DataFrame({"a": data["x"], "b": data["y"]})
        data = tmp_path / "log.csv"
        rows.write_csv(data, include_header=kind == "log")
        options["columns"] = "x=a,y=b" if kind == "log" else "x=1,y=2"
    if kind == "log":
        with pytest.raises(tiltcal.InputError, match="there is no column 'x'; the log has a, b"):
            fit("cross-axis", data, **SENSOR, segments=segments)
    found = fit("cross-axis", data, **SENSOR, **options, jig=0.01, say=said.append)
    assert found.sensor.channels == ("x", "y")
    assert found.sensor.columns == {"log": {"x": "a", "y": "b"}, "headerless": {"x": "1", "y": "2"}}.get(kind, {})
    assert said == ["there is no z: the sensor has x and y"]
    for row, channel in enumerate("xy"):
        for column, axis in enumerate("xyz"):
            up, down = (means[2 * column + side][row] for side in (0, 1))
            sine = 0.5 if axis != "z" else 1.0
            assert found.sensitivity[channel, axis] == pytest.approx((up - down) / (2 * sine), abs=1e-4)


def test_coordinates_of_a_dataset_are_columns_of_a_table(base: Path) -> None:
    """All but those that no table has, such as the index of the rows."""
    columns = {"position": ["level-warm", "level-cold"], "x": [2.5, 2.466], "y": [2.4, 2.366], "n": [80, 80]}
    columns |= {"ux": [1e-4, 1e-4], "uy": [1e-4, 1e-4], "temperature": [23.0, 6.0]}
    known = tiltcal.fit("two-temperature", columns, base=base, **SENSOR)
    rows = xarray.Dataset({key: ("row", cells) for key, cells in columns.items()}, {"row": [7, 9], "site": "shed"})
    for data in (rows.set_coords(["temperature", "n"]), rows.swap_dims(row="position").drop_vars("row")):
        found = tiltcal.fit("two-temperature", data, base=base, **SENSOR)
        assert found.positions == known.positions
    thermal = known.coefficients.thermal
    assert thermal is not None
    assert thermal.drift[:, 0] == pytest.approx([0.002, 0.002], abs=1e-6)
