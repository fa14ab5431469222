"""Frames of every kind: results are those of the command, to the last bit; what cells may hold, and what is refused."""

import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import xarray
from support import FIXTURES

from tiltcal.errors import InputError, TiltcalError
from tiltcal.library.calibration import Calibration, read
from tiltcal.library.recorded import apply_log
from tiltcal.logs.formats import open_log
from tiltcal.logs.frames import rows_of

ROWS = 40_000  # more than a chunk of the kernel, and no multiple of one
CAL = FIXTURES / "mavs.yaml"
READINGS: dict[str, list[float]] = {"x": [1024.0, 1100.0], "y": [1024.0, 1000.0]}


def array(frame: Any, name: str) -> np.ndarray[Any, Any]:
    """Return a column of a frame of any kind."""
    column = frame[name]
    return np.asarray(column.values if isinstance(column, xarray.DataArray) else column)


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


def test_what_a_frame_states_about_itself_stays(calibration: Calibration) -> None:
    """As the serial number by which a folder is searched."""
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


TIMES = pd.DatetimeIndex(["2026-05-01T12:00:00Z", "2026-05-01T12:00:05Z"], name="time")


@pytest.mark.parametrize("name", ["time", None])
def test_an_index_of_pandas_with_moments_is_the_time(name: str | None, calibration: Calibration) -> None:
    """With a name, as ``resample`` needs it there, or without one, as ``pandas.date_range`` makes them."""
    frame = pd.DataFrame(READINGS | {"temperature": [20.0, 20.0]}, index=TIMES.rename(name))
    for how in ({"average": 2}, {"every": "10s"}):
        found = calibration.apply(frame, **how)
        assert found.index.tolist() == [pd.Timestamp("2026-05-01T12:00:02.5Z")]
        assert (found.index.name, found["count"].tolist(), "time" in found) == (name, [2], False)
    table = pd.DataFrame({"position": ["level"], "x": [1.0]}, index=TIMES[:1].rename(None))
    assert rows_of(table, "the table") == [{"position": "level", "x": 1}]


MOMENTS = ["2026-05-01T12:00:00.5Z", "2026-05-01T12:00:01.75Z"]


def test_a_frame_is_read_like_a_log() -> None:
    """2026-05-01T12:00:00Z is 1777636800 s after 1970 (`date -u -d … +%s`)."""
    stamps = pl.Series(MOMENTS).str.to_datetime(time_zone="UTC", time_unit="us")
    frame, zoneless = pl.DataFrame({"time": stamps, "x": [1, 2]}), [text[:-1] for text in MOMENTS]
    for given in (
        pl.DataFrame({"time": MOMENTS, "x": [1, 2]}),
        frame,
        frame.to_pandas(),
        frame.to_arrow(),
        {"time": np.array(zoneless, "M8[ms]"), "x": np.array([1, 2])},
        xarray.Dataset({"x": ("time", [1, 2])}, coords={"time": np.array(zoneless, "M8[ns]")}),
        {"time": [1777636800.5, 1777636801.75], "x": [1.0, 2.0]},
    ):
        with open_log(given) as reader:
            where = [reader.names.index(name) for name in ("time", "x")]
            (block,) = reader.rows(where, where[0])
            assert block.values[where[0]].tolist() == [1777636800.5, 1777636801.75], type(given)
            assert block.values[where[1]].tolist() == [1.0, 2.0]


def test_what_an_array_masks_is_missing(calibration: Calibration) -> None:
    for kind in (float, int):
        masked = np.ma.masked_array(np.array([1024, 1100], dtype=kind), mask=[True, False])
        frame = READINGS | {"x": masked, "temperature": [20.0, 20.0]}
        found = calibration.apply(frame)
        assert (np.isnan(found["tilt_x"]).tolist(), found["flag"].tolist()) == ([True, False], [9, 1])
        assert calibration.apply(frame, average=2)["count"].tolist() == [1]


class TestPythonValues:
    """Numbers and moments of Python, in columns without a type of their own, count as those of arrays do."""

    def test_numbers(self, calibration: Calibration) -> None:
        columns = READINGS | {"x": [1024, None], "y": [1024, 1000.5], "temperature": [20.5, None]}
        expected = calibration.apply(columns | {"x": [1024.0, np.nan], "temperature": [20.5, np.nan]})
        assert expected["flag"].tolist() == [1, 9]
        objects = {name: np.array(cells, object) for name, cells in columns.items()}
        for frame in (
            columns,
            objects,
            pd.DataFrame(columns, dtype=object),
            pl.DataFrame({name: pl.Series(cells, dtype=pl.Object) for name, cells in columns.items()}),
            xarray.Dataset({name: ("row", cells) for name, cells in objects.items()}),
        ):
            found = calibration.apply(frame)
            for name in ("tilt_x", "tilt_y", "flag", "reason"):
                np.testing.assert_array_equal(array(found, name), expected[name], err_msg=str(type(frame)))

    def test_a_column_without_a_value(self, calibration: Calibration) -> None:
        """As an empty column of CSV: reason 16 of SPEC 10, temperature missing."""
        for made in (dict, pl.DataFrame, pd.DataFrame, pa.table):
            found = calibration.apply(made(READINGS | {"temperature": [None, None]}))
            assert array(found, "reason").tolist() == [16, 16]

    def test_what_is_no_number(self, calibration: Calibration) -> None:
        for cells in ([True, False], ["1", None], [1.0, "2"], [[1.0], [2.0, 3.0]]):
            columns = READINGS | {"x": pd.Series(cells, dtype=object)}
            for frame in (columns, pd.DataFrame(columns)):
                with pytest.raises(InputError, match=r"column 'x' holds .*, not numbers"):
                    calibration.apply(frame)

    def test_moments(self, calibration: Calibration) -> None:
        east = timezone(timedelta(hours=2))
        for times in (
            [datetime(2026, 5, 1, 12, tzinfo=UTC), datetime(2026, 5, 1, 14, 0, 5, tzinfo=east)],
            [datetime(2026, 5, 1, 12), datetime(2026, 5, 1, 12, 0, 5)],
            [pd.Timestamp("2026-05-01T12:00:00Z"), pd.Timestamp("2026-05-01T12:00:05Z")],
        ):
            for how in ({"average": 2}, {"every": "10s"}):
                found = calibration.apply(READINGS | {"time": times}, **how)
                assert found["time"] == [np.datetime64("2026-05-01T12:00:02.5")]


def test_means_take_the_first_text_and_pass_columns_of_any_type_by(calibration: Calibration) -> None:
    for kind in ("str", "string", "object"):
        frame = pd.DataFrame(READINGS | {"temperature": [20.0, 20.0]})
        frame["time"] = pd.Series(["2026-05-01T12:00:00Z", None], dtype=kind)
        for how in ({"average": 2}, {"every": "10s"}):
            found = calibration.apply(frame, **how)
            assert (found["time"].tolist(), found["count"].tolist()) == (["2026-05-01T12:00:00Z"], [2])
    expected = calibration.apply({name: [np.mean(column)] for name, column in READINGS.items()})
    for frame in (
        pl.DataFrame(READINGS).with_columns(pl.Series("other", ["a", 1], pl.Object)),
        pd.DataFrame(READINGS | {"other": [1j, 2j]}),
        pd.DataFrame(READINGS | {"other": pd.period_range("2026-05", periods=2, freq="M")}),
        pa.table(READINGS | {"other": pa.array([(1, 2, 3), None], pa.month_day_nano_interval())}),
        xarray.Dataset({name: ("row", column) for name, column in READINGS.items()} | {5: ("row", [1.0, 2.0])}),
        READINGS | {"other": [1.0, 2.0, 3.0]},
    ):
        assert array(calibration.apply(frame), "flag").tolist() == [3, 3]
        assert array(calibration.apply(frame, average=2), "tilt_x").tolist() == expected["tilt_x"].tolist()


def test_a_missing_whole_number_of_a_table_leaves_the_others_whole() -> None:
    table: dict[str, list[Any]] = {"position": ["level", "x-45"], "x": [2.5, 3.0], "n": [100, None]}
    for made in (
        pl.DataFrame(table),
        pd.DataFrame(table),
        pd.DataFrame(table).convert_dtypes(),
        pd.DataFrame(table, dtype=object),
        pd.DataFrame(table).set_index("position"),
        pa.table(table),
        table,
        table | {"n": np.array([100, np.nan])},
        [dict(zip(table, cells, strict=True)) for cells in zip(*table.values(), strict=True)],
    ):
        rows = rows_of(made, "the table")
        assert rows == [{"position": "level", "x": 2.5, "n": 100}, {"position": "x-45", "x": 3}], type(made)
        assert isinstance(rows[0]["n"], int)
    with pytest.raises(TiltcalError, match="the table: the columns differ in length"):
        rows_of({"position": ["level", "x-45"], "x": [1.0]}, "the table")


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
        data({"temperature": "V"}, temperature=[293.1, 293.2]),
        {},
        "column 'temperature' is in V, and temperatures in °C",
    ),
    (pd.DataFrame([[1.0, 2.0]], columns=["x", "x"]), {}, "the frame: two columns have one name"),
    (pa.table([[1.0], [2.0]], names=["x", "x"]), {}, "the frame: two columns have one name"),
    ({}, {}, "there are no columns"),
    (READINGS, {"unit": "V"}, "column 'x' is in V, and the calibration in count"),
    (data(dict.fromkeys("xy", "V")), {}, "column 'x' is in V, and the calibration in count"),
    (
        data({"b": "nT", "a": "uT"}, **VECTOR),
        {"magnetometer": "a,b,c"},
        "column 'b' is in nT, and 'a' in uT: convert the readings",
    ),
    (
        data({"heading": "rad"}, **VECTOR, heading=[0.0, 1.0]),
        {"velocity": "a,b,c"},
        "column 'heading' is in rad, and headings in degree",
    ),
    (READINGS, {"columns": {"x": "VoutX"}}, "the frame: there is no column 'VoutX'; the log has x, y"),
    (READINGS, {"columns": {"X": "x"}}, r"columns has no role 'X' .*; the roles are x, y, temperature, time"),
    ({**READINGS, "x": ["a", "b"]}, {}, r"column 'x' holds .*, not numbers"),
    (pl.DataFrame({**READINGS, "x": ["a", "b"]}), {}, r"column 'x' holds .*, not numbers"),
    ({**READINGS, "x": [1.0]}, {}, "differ in length"),
    ({"x": [], "y": []}, {}, "no rows"),
    *((frame, {}, "give a polars, pandas or pyarrow frame") for frame in (pl.LazyFrame(READINGS), 5, [1.0])),
]


@pytest.mark.parametrize(("frame", "options", "why"), REFUSED, ids=[why[:40] for _, _, why in REFUSED])
def test_it_is_refused(frame: Any, options: dict[str, Any], why: str, calibration: Calibration) -> None:
    with pytest.raises(TiltcalError, match=why):
        calibration.apply(frame, **options)


WITHOUT_PYARROW = """
import sys


class WithoutPyarrow:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "pyarrow":
            raise ModuleNotFoundError(name)


sys.meta_path.insert(0, WithoutPyarrow())
from decimal import Decimal

import numpy as np
import pandas as pd
import tiltcal

cal, rows = tiltcal.read(sys.argv[1]), 40
x, y = np.linspace(900.0, 1100.0, rows), np.linspace(1000.0, 1050.0, rows)
plain = cal.apply({"x": x, "y": y, "temperature": np.full(rows, 24.0)})
moments = pd.date_range("2026-01-01", periods=rows, freq="1s", tz="Europe/Berlin")
for more in (
    {"note": "hello"},
    {"note": pd.Categorical(["a"] * rows)},
    {"x": [Decimal(str(value)) for value in x]},
    {"x": pd.array(x, dtype="Float64")},
    {"time": moments},
    {"note": pd.array([True, None] * (rows // 2), dtype="boolean")},
):
    made = cal.apply(pd.DataFrame({"x": x, "y": y, "temperature": 24.0}).assign(**more))
    np.testing.assert_allclose(made["tilt_x"], plain["tilt_x"])
faces = {"position": ["x-up", "x-down", "y-up", "y-down", "z-up", "z-down"]}
readings = dict(zip("xyz", 9.81 * np.array([[1, -1, 0, 0, 0, 0], [0, 0, 1, -1, 0, 0], [0, 0, 0, 0, 1, -1]]) + 0.1))
for kind in (float, str, lambda value: Decimal(str(value))):
    table = pd.DataFrame(faces | {axis: [kind(float(one)) for one in values] for axis, values in readings.items()})
    fitted = tiltcal.fit("six-face", table, serial="I-1", unit="m/s2", jig=0.1)
    np.testing.assert_allclose(list(fitted.offset.values()), 0.1, atol=1e-3)
"""


def test_pandas_needs_no_pyarrow() -> None:
    """Columns that numpy has no type for, and tables of positions; each fails with an ImportError of polars else."""
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_PYARROW, str(CAL)], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
