"""Frames of every kind give what ``tiltcal apply`` writes, to the last bit, and come back as their own kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import xarray
from support import FIXTURES
from support.frames import READINGS, array

from tiltcal.library.calibration import Calibration, read
from tiltcal.library.recorded import apply_log
from tiltcal.logs.formats import open_log
from tiltcal.logs.frames import rows_of
from tiltcal.logs.kernel import RoleValues, prepare
from tiltcal.logs.options import ApplyOptions
from tiltcal.options import complete

ROWS = 40_000  # more than a chunk of the kernel, and no multiple of one
CAL = FIXTURES / "mavs.yaml"


def log() -> pl.DataFrame:
    """Readings that meet every flag: clipped, out of range, at the rail, without a temperature, missing."""
    draw, turn = np.random.default_rng(5), np.linspace(0.0, 30.0, ROWS)
    x = 1024.0 + 900.0 * np.sin(turn) + draw.normal(0.0, 0.6, ROWS)
    y = 1024.0 + 710.0 * np.cos(turn / 3.0) + draw.normal(0.0, 0.6, ROWS)
    temperature = 15.0 + 30.0 * np.sin(turn / 5.0)
    x[7], y[11], temperature[13], x[17] = np.nan, np.inf, np.nan, 2048.0
    return pl.DataFrame({"when": [f"row {k}" for k in range(ROWS)], "x": x, "y": y, "T": temperature}).with_columns(
        pl.col("x", "T").fill_nan(None)
    )


def dataset(frame: pl.DataFrame) -> xarray.Dataset:
    return xarray.Dataset(
        {name: ("time", frame[name].to_numpy(), {"units": "count"}) for name in ("x", "y")}
        | {"T": ("time", frame["T"].to_numpy(), {"units": "degree_Celsius"}), "site": "shed"},
        coords={"time": np.arange(len(frame))},
    )


KINDS: dict[str, tuple[type, Callable[[pl.DataFrame], Any]]] = {
    "polars": (pl.DataFrame, lambda frame: frame),
    "pandas": (pd.DataFrame, lambda frame: frame.to_pandas().set_index(pd.RangeIndex(100, 100 + ROWS))),
    "pyarrow": (pa.Table, lambda frame: frame.to_arrow()),
    "xarray": (xarray.Dataset, dataset),
    "dict": (dict, lambda frame: {name: frame[name].to_numpy() for name in frame.columns}),
}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    folder = tmp_path_factory.mktemp("log")
    log().write_csv(folder / "log.csv")
    apply_log(CAL, folder / "log.csv", folder / "out.csv", columns={"temperature": "T"}, uncertainty=True)
    return pl.read_csv(folder / "out.csv", infer_schema_length=None)


@pytest.mark.parametrize("kind", KINDS)
def test_results_are_those_of_the_command(kind: str, written: pl.DataFrame) -> None:
    own, made = KINDS[kind]
    given = made(log())
    found = read(CAL).apply(given, columns={"temperature": "T"}, uncertainty=True)
    assert type(found) is own
    assert set(written["flag"].to_list()) == {1, 3, 4, 9}
    for name in written.columns[4:]:
        expected = written[name].fill_null(np.nan).to_numpy()
        np.testing.assert_array_equal(array(found, name), expected, err_msg=name)
    assert (array(found, "flag").dtype, array(found, "reason").dtype) == (np.uint8, np.uint16)
    assert "tilt_x" not in given


def test_remarks_are_those_of_the_command(tmp_path: Path) -> None:
    """A heading without a declination, and a lag without a time."""
    frame = pl.DataFrame(READINGS | {"temperature": [20.0, 20.0], "mx": [20.0] * 2, "my": [0.0] * 2, "mz": [-40.0] * 2})
    frame.write_csv(tmp_path / "log.csv")
    of_log: list[str] = []
    of_frame: list[str] = []
    lagging = FIXTURES / "ramp.yaml"
    apply_log(lagging, tmp_path / "log.csv", tmp_path / "out.csv", magnetometer="mx,my,mz", say=of_log.append)
    read(lagging).apply(frame, magnetometer="mx,my,mz", say=of_frame.append)
    assert of_frame == of_log
    assert [text.split(":")[0] for text in of_frame] == ["note"] * 2


class TestNotes:
    """What a frame states about itself stays, as the serial number does by which a folder is searched."""

    def test_they_stay(self, calibration: Calibration) -> None:
        frame = pd.DataFrame(READINGS)
        frame.attrs["serial"] = "S-1"
        assert calibration.apply(frame).attrs == {"serial": "S-1"}
        table = pa.table(READINGS).replace_schema_metadata({"serial": "S-1"})
        assert calibration.apply(table).schema.metadata == {b"serial": b"S-1"}
        data = xarray.Dataset({name: ("row", column) for name, column in READINGS.items()}, attrs={"serial": "S-1"})
        assert calibration.apply(data, average=2).attrs == {"serial": "S-1"}


def test_coordinates_of_a_dataset_stay_coordinates_of_its_means(calibration: Calibration) -> None:
    """The times and the depths along them, and a place of its own; the readings stay variables."""
    columns = {name: ("time", values, {"units": "count"}) for name, values in READINGS.items()}
    coords = {"time": [0.0, 1.0], "depth": ("time", [10.0, 12.0], {"units": "m"}), "site": 4.0}
    found = calibration.apply(xarray.Dataset(columns, coords), average=2)
    assert set(found.coords) == {*coords}
    assert {"x", "y", "tilt_x", "count"} <= set(found.data_vars)
    assert (found["time"].values.tolist(), found["depth"].values.tolist()) == ([0.5], [11.0])
    assert found["depth"].attrs == {"units": "m"}


class TestIndexOfPandas:
    """One that has a name is a column, such as the time that ``resample`` needs there."""

    TIMES = pd.DatetimeIndex(["2026-05-01T12:00:00Z", "2026-05-01T12:00:05Z"], name="time")

    def test_it_holds_the_time(self, calibration: Calibration) -> None:
        frame = pd.DataFrame(READINGS | {"temperature": [20.0, 20.0]}, index=self.TIMES)
        found = calibration.apply(frame, every="10s")
        assert found.index.tolist() == [pd.Timestamp("2026-05-01T12:00:02.5Z")]
        assert found["count"].tolist() == [2]
        assert found.index.name == "time"

    @pytest.mark.parametrize("how", [{"average": 2}, {"every": "10s"}])
    def test_moments_without_a_name_are_the_time(self, how: dict[str, Any], calibration: Calibration) -> None:
        """As ``pandas.date_range`` makes them; means had the numbers of their rows for an index."""
        frame = pd.DataFrame(READINGS | {"temperature": [20.0, 20.0]}, index=self.TIMES.rename(None))
        found = calibration.apply(frame, **how)
        assert found.index.equals(pd.DatetimeIndex([pd.Timestamp("2026-05-01T12:00:02.5Z")]))
        assert found.index.name is None
        assert "time" not in found

    def test_of_a_table_without_a_name_it_is_nothing(self) -> None:
        table = pd.DataFrame({"position": ["level"], "x": [1.0]}, index=self.TIMES[:1].rename(None))
        assert rows_of(table, "the table") == [{"position": "level", "x": 1}]


MOMENTS = ["2026-05-01T12:00:00.5Z", "2026-05-01T12:00:01.75Z"]
STAMPS = pl.Series(MOMENTS).str.to_datetime(time_zone="UTC", time_unit="us")


@pytest.mark.parametrize(
    "frame",
    [
        pl.DataFrame({"time": MOMENTS, "x": [1, 2]}),
        pl.DataFrame({"time": STAMPS, "x": [1, None]}).fill_null(2),
        pl.DataFrame({"time": STAMPS, "x": [1, 2]}).to_pandas(),
        pl.DataFrame({"time": STAMPS, "x": [1, 2]}).to_arrow(),
        {"time": np.array([text[:-1] for text in MOMENTS], "M8[ms]"), "x": np.array([1, 2])},
        xarray.Dataset({"x": ("time", [1, 2])}, coords={"time": np.array([text[:-1] for text in MOMENTS], "M8[ns]")}),
        {"time": [1777636800.5, 1777636801.75], "x": [1.0, 2.0]},
    ],
    ids=["text", "polars", "pandas", "pyarrow", "dict", "xarray", "seconds"],
)
def test_a_frame_is_read_like_a_log(frame: Any) -> None:
    """2026-05-01T12:00:00Z is 1777636800 s after 1970 (`date -u -d … +%s`)."""
    with open_log(frame) as reader:
        where = [reader.names.index(name) for name in ("time", "x")]
        (block,) = reader.rows(where, where[0])
        assert block.values[where[0]].tolist() == [1777636800.5, 1777636801.75]
        assert block.values[where[1]].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("name", ["mavs", "six-face", "mounting", "temperature-sweep"])
def test_results_do_not_depend_on_where_blocks_end(name: str) -> None:
    """Files are cut into blocks, frames are not: sums in another order would differ in the last bit."""
    found = read(FIXTURES / f"{name}.yaml")
    assert isinstance(found, Calibration)
    kernel = prepare(found.record, complete(ApplyOptions, {"uncertainty": True})).sensors[0].kernel
    draw = np.random.default_rng(2)
    span = abs(np.diag(found.coefficients.sensitivity)).max()
    channels = len(found.coefficients.channels)
    readings = np.asfortranarray(found.coefficients.offset + span * draw.uniform(-0.9, 0.9, (50_001, channels)))
    temperature = draw.uniform(0.0, 30.0, len(readings))
    whole = kernel(RoleValues(readings, temperature))
    for rows in (slice(0, 7), slice(7, 20_011), slice(20_011, None)):
        part = kernel(RoleValues(np.stack(readings[rows].T).T, temperature[rows]))
        for column, values in part.items():
            np.testing.assert_array_equal(values, whole[column][rows], err_msg=column)
