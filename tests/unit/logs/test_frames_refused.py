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

from tiltcal.errors import TiltcalError
from tiltcal.library.calibration import Calibration, read
from tiltcal.library.recorded import match
from tiltcal.logs.frames import rows_of


def data(units: dict[str, str] | None = None, **more: Any) -> xarray.Dataset:
    """The readings and further columns as a Dataset that states units."""
    columns = READINGS | more
    return xarray.Dataset(
        {name: ("n", column, {"units": (units or {}).get(name, "1")}) for name, column in columns.items()}
    )


VECTOR = {"a": [20.0, 20.0], "b": [2.0, 2.0], "c": [1.0, 1.0]}
REFUSED: list[tuple[Any, dict[str, Any], str]] = [
    ({**READINGS, "temperature": 20.0}, {}, r"column 'temperature' has 0 dimensions .*: a log's columns have one"),
    ({**READINGS, "temperature": [[20.0, 21.0]]}, {}, r"column 'temperature' has 2 dimensions"),
    (
        xarray.Dataset({"x": ("a", READINGS["x"]), "y": ("b", READINGS["y"])}),
        {},
        "rows of different kinds: 'x' along 'a' and 'y' along 'b'",
    ),
    (
        data({"temperature": "K"}, temperature=[293.1, 293.2]),
        {},
        "column 'temperature' is in K, and temperatures in °C",
    ),
    (READINGS, {"columns": "y=x"}, "x and y are one column, 'x'"),
    (pd.DataFrame([[1.0, 2.0]], columns=["x", "x"]), {}, "the frame: two columns have one name"),
    (pa.table([[1.0], [2.0]], names=["x", "x"]), {}, "the frame: two columns have one name"),
    ({}, {}, "there are no columns"),
    (READINGS, {"unit": "V"}, "column 'x' is in V, and the calibration in count"),
    (data(dict.fromkeys("xy", "V")), {}, "column 'x' is in V, and the calibration in count"),
    (
        data({"b": "nT", "a": "uT"}, **VECTOR),
        {"magnetometer": "a,b,c"},
        "column 'b' is in nT, and 'a' in uT: convert one of them",
    ),
    (
        data({"heading": "rad"}, **VECTOR, heading=[0.0, 1.0]),
        {"velocity": "a,b,c"},
        "column 'heading' is in rad, and headings in degree",
    ),
    (READINGS, {"columns": {"x": "VoutX"}}, "the frame: there is no column 'VoutX'; the log has x, y"),
    (READINGS, {"columns": {"X": "x"}}, r"there is no role 'X' .*; the roles are x, y, temperature, time"),
    ({**READINGS, "x": ["a", "b"]}, {}, r"column 'x' holds .*, not numbers"),
    (pl.DataFrame({**READINGS, "x": ["a", "b"]}), {}, r"column 'x' holds .*, not numbers"),
    ({**READINGS, "x": [1.0]}, {}, "differ in length"),
    ({"x": [], "y": []}, {}, "no rows"),
    ({**READINGS, "g_x": [0.0, 0.0]}, {}, "column 'g_x' already"),
    *((frame, {}, "give a polars, pandas or pyarrow frame") for frame in (pl.LazyFrame(READINGS), 5, [1.0])),
]


@pytest.mark.parametrize(("frame", "options", "why"), REFUSED, ids=[why[:40] for _, _, why in REFUSED])
def test_it_is_refused(frame: Any, options: dict[str, Any], why: str, calibration: Calibration) -> None:
    with pytest.raises(TiltcalError, match=why):
        calibration.apply(frame, **options)


def test_columns_of_a_table_that_differ_in_length() -> None:
    for other in ([1.0], 1.0):
        with pytest.raises(TiltcalError, match="the table: the columns differ in length"):
            rows_of({"position": ["level", "x-45"], "x": other}, "the table")


def test_a_stage_angle_in_radians() -> None:
    turns = {"theta": np.linspace(0.0, 20.0, 400), **{f"a{k}": np.ones(400) for k in (1, 2, 3, 4)}}
    disk = xarray.Dataset({name: ("n", column) for name, column in turns.items()})
    disk["theta"].attrs["units"] = "rad"
    with pytest.raises(TiltcalError, match="column 'theta' is in rad, and the calibration in degree"):
        read(FIXTURES / "rotation.yaml").apply(disk)
    with pytest.raises(TiltcalError, match="column 'theta' is in rad, and stage angles in degree"):
        match(disk, [("a1", "a2", "a4")], phase="theta")
