"""Frames that cannot be compensated, and columns that are not there or in another unit; each is named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import xarray
from support import FIXTURES
from support.frames import READINGS

from tiltcal.errors import InputError, UsageError
from tiltcal.library.calibration import Calibration, read
from tiltcal.library.recorded import match
from tiltcal.logs.frames import rows_of


@pytest.mark.parametrize("temperature", [20.0, [[20.0, 21.0]]])
def test_a_column_without_rows(temperature: Any, calibration: Calibration) -> None:
    with pytest.raises(InputError, match=r"column 'temperature' has [02] dimensions .*: a log's columns have one"):
        calibration.apply(READINGS | {"temperature": temperature})


def test_columns_of_a_table_that_differ_in_length() -> None:
    for other in ([1.0], 1.0):
        with pytest.raises(InputError, match="the table: the columns differ in length"):
            rows_of({"position": ["level", "x-45"], "x": other}, "the table")


def test_columns_along_different_dimensions(calibration: Calibration) -> None:
    with pytest.raises(InputError, match="rows of different kinds: 'x' along 'a' and 'y' along 'b'"):
        calibration.apply(xarray.Dataset({"x": ("a", READINGS["x"]), "y": ("b", READINGS["y"])}))


def test_a_temperature_in_kelvin(calibration: Calibration) -> None:
    warm = {"temperature": ("n", [293.1, 293.2], {"units": "K"})}
    data = xarray.Dataset({name: ("n", column) for name, column in READINGS.items()} | warm)
    with pytest.raises(InputError, match="column 'temperature' is in K, and temperatures in °C"):
        calibration.apply(data)


def test_one_column_for_two_readings(calibration: Calibration) -> None:
    with pytest.raises(InputError, match="x and y are one column, 'x'"):
        calibration.apply(READINGS, columns="y=x")


def test_two_columns_of_one_name(calibration: Calibration) -> None:
    for frame in (pd.DataFrame([[1.0, 2.0]], columns=["x", "x"]), pa.table([[1.0], [2.0]], names=["x", "x"])):
        with pytest.raises(InputError, match="the frame: two columns have one name"):
            calibration.apply(frame)


def test_numbers_for_names_of_columns(calibration: Calibration) -> None:
    frame = pd.DataFrame({0: READINGS["x"], 1: READINGS["y"]})
    found = calibration.apply(frame, columns={"x": "0", "y": "1"})
    assert list(found.columns[:3]) == [0, 1, "g_x"]
    assert found["tilt_x"].tolist() == calibration.apply(READINGS)["tilt_x"].tolist()


def test_no_columns(calibration: Calibration) -> None:
    with pytest.raises(InputError, match="there are no columns"):
        calibration.apply({})


def test_another_unit(calibration: Calibration) -> None:
    with pytest.raises(InputError, match="column 'x' is in V, and the calibration in count"):
        calibration.apply(READINGS, unit="V")
    volts = xarray.Dataset({name: ("n", column, {"units": "V"}) for name, column in READINGS.items()})
    with pytest.raises(InputError, match="column 'x' is in V, and the calibration in count"):
        calibration.apply(volts)


@pytest.mark.parametrize(
    ("units", "option", "why"),
    [
        ({"b": "nT", "a": "uT"}, "magnetometer", "column 'b' is in nT, and 'a' in uT: convert one of them"),
        ({"c": "cm/s", "a": "m/s"}, "velocity", "column 'c' is in cm/s, and 'a' in m/s: convert one of them"),
        ({"heading": "rad"}, "velocity", "column 'heading' is in rad, and headings in degree"),
    ],
)
def test_units_of_a_vector_and_of_a_heading(
    units: dict[str, str], option: str, why: str, calibration: Calibration
) -> None:
    """2000 nT beside 20 µT are one field: a heading of both as they stand is 45° off."""
    columns = READINGS | {"a": [20.0, 20.0], "b": [2.0, 2.0], "c": [1.0, 1.0]}
    columns |= {} if option == "magnetometer" else {"heading": [0.0, 1.0]}
    data = xarray.Dataset({name: ("n", column) for name, column in columns.items()})
    assert len(calibration.apply(data, **{option: "a,b,c"})["flag"]) == 2
    for name, unit in units.items():
        data[name].attrs["units"] = unit
    with pytest.raises(InputError, match=why):
        calibration.apply(data, **{option: "a,b,c"})


def test_a_stage_angle_in_radians() -> None:
    turns = {"theta": np.linspace(0.0, 20.0, 400), **{f"a{k}": np.ones(400) for k in (1, 2, 3, 4)}}
    data = xarray.Dataset({name: ("n", column) for name, column in turns.items()})
    data["theta"].attrs["units"] = "rad"
    with pytest.raises(InputError, match="column 'theta' is in rad, and the calibration in degree"):
        read(FIXTURES / "rotation.yaml").apply(data)
    with pytest.raises(InputError, match="column 'theta' is in rad, and stage angles in degree"):
        match(data, [("a1", "a2", "a4")], phase="theta")


@pytest.mark.parametrize("unit", ["count", "counts", "Count", "1", "LSB"])
def test_another_spelling_of_the_unit_is_none(unit: str, calibration: Calibration) -> None:
    assert calibration.apply(READINGS, unit=unit)["flag"].tolist() == [3, 3]  # no temperature


def test_a_column_that_is_not_there(calibration: Calibration) -> None:
    with pytest.raises(InputError, match="the frame: there is no column 'VoutX'; the log has x, y"):
        calibration.apply(READINGS, columns={"x": "VoutX"})


def test_a_role_that_is_none(calibration: Calibration) -> None:
    with pytest.raises(UsageError, match=r"there is no role 'X' .*; the roles are x, y, temperature, time"):
        calibration.apply(READINGS, columns={"X": "x"})


@pytest.mark.parametrize("frame", [{**READINGS, "x": ["a", "b"]}, pl.DataFrame({**READINGS, "x": ["a", "b"]})])
def test_text_for_numbers(frame: Any, calibration: Calibration) -> None:
    with pytest.raises(InputError, match=r"column 'x' holds .*, not numbers"):
        calibration.apply(frame)


def test_columns_of_different_length(calibration: Calibration) -> None:
    with pytest.raises(InputError, match="differ in length"):
        calibration.apply({**READINGS, "x": [1.0]})


def test_no_rows(calibration: Calibration) -> None:
    with pytest.raises(InputError, match="no rows"):
        calibration.apply({"x": [], "y": []})


def test_a_frame_that_was_compensated(calibration: Calibration) -> None:
    with pytest.raises(UsageError, match="column 'g_x' already"):
        calibration.apply(calibration.apply(READINGS))


@pytest.mark.parametrize("frame", [pl.LazyFrame(READINGS), 5, [1.0]])
def test_what_is_no_frame(frame: Any, calibration: Calibration) -> None:
    with pytest.raises(UsageError, match="give a polars, pandas or pyarrow frame"):
        calibration.apply(frame)
