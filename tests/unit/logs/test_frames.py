"""Frames of every kind give what ``tiltcal apply`` writes, to the last bit, and come back as their own kind."""

from __future__ import annotations

import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import xarray
from support import FIXTURES

from tiltcal.calibration.calibration import Calibration, read
from tiltcal.calibration.pair_calibration import PairCalibration
from tiltcal.errors import InputError, UsageError
from tiltcal.logs.apply import apply_frame, apply_log
from tiltcal.logs.compensation_kernel import RoleValues
from tiltcal.logs.formats import open_log
from tiltcal.logs.frames import rows_of
from tiltcal.logs.log import LogBlock
from tiltcal.logs.match import match
from tiltcal.logs.prepared_calibration import ApplyOptions, prepare

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


def array(frame: Any, name: str) -> np.ndarray[Any, Any]:
    column = frame[name]
    return np.asarray(column.values if isinstance(column, xarray.DataArray) else column)


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
    found = apply_frame(read(CAL), given, columns={"temperature": "T"}, uncertainty=True)
    assert type(found) is own
    assert set(written["flag"].to_list()) == {1, 3, 4, 9}
    for name in written.columns[4:]:
        expected = written[name].fill_null(np.nan).to_numpy()
        np.testing.assert_array_equal(array(found, name), expected, err_msg=name)
    assert array(found, "flag").dtype == array(found, "reason").dtype == np.uint8
    assert "tilt_x" not in given


def test_remarks_are_those_of_the_command(tmp_path: Path) -> None:
    """A heading without a declination, and a lag without a time."""
    frame = pl.DataFrame(READINGS | {"temperature": [20.0, 20.0], "mx": [20.0] * 2, "my": [0.0] * 2, "mz": [-40.0] * 2})
    frame.write_csv(tmp_path / "log.csv")
    of_log: list[str] = []
    of_frame: list[str] = []
    lagging = FIXTURES / "ramp.yaml"
    apply_log(lagging, tmp_path / "log.csv", tmp_path / "out.csv", magnetometer="mx,my,mz", say=of_log.append)
    apply_frame(read(lagging), frame, magnetometer="mx,my,mz", say=of_frame.append)
    assert of_frame == of_log
    assert [text.split(":")[0] for text in of_frame] == ["note"] * 2


@pytest.mark.parametrize("kind", KINDS)
def test_its_own_columns_stay(kind: str) -> None:
    made = KINDS[kind][1]
    found = apply_frame(read(CAL), made(log()), columns="temperature=T")
    given = made(log())
    for name in ("x", "y", "T"):
        np.testing.assert_array_equal(array(found, name), array(given, name))
    if kind == "pandas":
        assert found.index.tolist() == given.index.tolist()
    if kind == "xarray":
        assert found["site"] == "shed"
        assert found["tilt_x"].attrs["units"] == "degree"
        assert found["flag"].attrs["standard_name"] == "quality_flag"


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    found = read(CAL)
    assert isinstance(found, Calibration)
    return found


READINGS: dict[str, list[float]] = {"x": [1024.0, 1100.0], "y": [1024.0, 1000.0]}


class TestMissingValues:
    """What an array masks is missing, whatever stands below the mask."""

    @pytest.mark.parametrize("kind", [float, int])
    def test_a_masked_reading_is_missing(self, kind: type, calibration: Calibration) -> None:
        masked = np.ma.masked_array(np.array([1024, 1100], dtype=kind), mask=[True, False])
        found = apply_frame(calibration, READINGS | {"x": masked, "temperature": [20.0, 20.0]})
        assert np.isnan(found["tilt_x"]).tolist() == [True, False]
        assert found["flag"].tolist() == [9, 1]
        means = apply_frame(calibration, READINGS | {"x": masked, "temperature": [20.0, 20.0]}, average=2)
        assert means["count"].tolist() == [1]

    def test_a_masked_cell_of_a_table_is_missing(self) -> None:
        masked = {"position": ["level", "x-45"], "temperature": np.ma.masked_array([20.0, 999.0], mask=[False, True])}
        assert rows_of(masked, "the table") == [{"position": "level", "temperature": 20.0}, {"position": "x-45"}]


class TestPythonValues:
    """Numbers and moments of Python, in columns without a type of their own, count as those of arrays do."""

    COLUMNS: ClassVar[dict[str, list[Any]]] = READINGS | {"x": [1024, None], "temperature": [Decimal("20.5"), None]}
    SAME: ClassVar[dict[str, list[float]]] = READINGS | {"x": [1024.0, np.nan], "temperature": [20.5, np.nan]}

    @pytest.mark.parametrize(
        "made",
        [
            dict,
            lambda columns: {name: np.array(cells, object) for name, cells in columns.items()},
            lambda columns: pd.DataFrame(columns, dtype=object),
            lambda columns: pl.DataFrame({name: pl.Series(cells, dtype=pl.Object) for name, cells in columns.items()}),
            lambda columns: xarray.Dataset({name: ("row", np.array(c, object)) for name, c in columns.items()}),
        ],
        ids=["lists", "arrays", "pandas", "polars", "xarray"],
    )
    def test_numbers(self, made: Callable[[dict[str, Any]], Any], calibration: Calibration) -> None:
        expected = apply_frame(calibration, self.SAME)
        assert expected["flag"].tolist() == [1, 9]
        found = apply_frame(calibration, made(self.COLUMNS))
        for name in ("tilt_x", "tilt_y", "flag", "reason"):
            np.testing.assert_array_equal(array(found, name), expected[name])

    @pytest.mark.parametrize("made", [dict, pl.DataFrame, pd.DataFrame, pa.table])
    def test_a_column_without_a_value(self, made: Callable[[dict[str, Any]], Any], calibration: Calibration) -> None:
        """As an empty column of CSV: reason 16 of SPEC 10, temperature missing."""
        found = apply_frame(calibration, made(READINGS | {"temperature": [None, None]}))
        assert array(found, "reason").tolist() == [16, 16]

    @pytest.mark.parametrize("cells", [[True, False], ["1", None], [1.0, "2"], [[1.0], [2.0, 3.0]]])
    def test_what_is_no_number(self, cells: list[Any], calibration: Calibration) -> None:
        columns = READINGS | {"x": pd.Series(cells, dtype=object)}
        for frame in (columns, pd.DataFrame(columns)):
            with pytest.raises(InputError, match=r"column 'x' holds .*, not numbers"):
                apply_frame(calibration, frame)

    @pytest.mark.parametrize(
        "times",
        [
            [datetime(2026, 5, 1, 12, tzinfo=UTC), datetime(2026, 5, 1, 14, 0, 5, tzinfo=timezone(timedelta(hours=2)))],
            [datetime(2026, 5, 1, 12), datetime(2026, 5, 1, 12, 0, 5)],
            [pd.Timestamp("2026-05-01T12:00:00Z"), pd.Timestamp("2026-05-01T12:00:05Z")],
        ],
        ids=["zones", "no zone", "pandas"],
    )
    def test_moments(self, times: list[Any], calibration: Calibration) -> None:
        columns = READINGS | {"time": times}
        for how in ({"average": 2}, {"every": "10s"}):
            assert apply_frame(calibration, columns, **how)["time"] == [np.datetime64("2026-05-01T12:00:02.5")]

    def test_moments_in_a_polars_column_of_objects(self, calibration: Calibration) -> None:
        """They had the time of the first row."""
        times = pl.Series("time", [datetime(2026, 5, 1, 12), datetime(2026, 5, 1, 12, 0, 5)], pl.Object)
        found = apply_frame(calibration, pl.DataFrame(READINGS).with_columns(times), average=2)
        assert found["time"].to_list() == [datetime(2026, 5, 1, 12, 0, 2, 500_000)]

    @pytest.mark.parametrize("name", ["x", "other"])
    def test_decimals_of_256_bits(self, name: str, calibration: Calibration) -> None:
        """Polars has none: it panicked."""
        cells = [Decimal("1000.25"), Decimal("1001.25")]
        table = READINGS | {"temperature": [20.0, 20.0], name: pa.array(cells, pa.decimal256(40, 2))}
        found = apply_frame(calibration, pa.table(table), average=2)
        assert found.column(name).to_pylist() == [1000.75]

    def test_durations(self, calibration: Calibration) -> None:
        found = apply_frame(calibration, READINGS | {"time": [timedelta(0), timedelta(seconds=5)]}, every="10s")
        assert found["time"] == [np.timedelta64(2500, "ms")]

    def test_a_moment_that_is_missing(self, calibration: Calibration) -> None:
        times = [datetime(2026, 5, 1, 12), None]
        assert apply_frame(calibration, READINGS | {"time": times}, every="10s")["time"] == [np.datetime64(times[0])]


class TestNotes:
    """What a frame states about itself stays, as the serial number does by which a folder is searched."""

    @pytest.mark.parametrize("how", [{}, {"average": 2}])
    def test_they_stay(self, how: dict[str, int], calibration: Calibration) -> None:
        frame = pd.DataFrame(READINGS)
        frame.attrs["serial"] = "S-1"
        assert apply_frame(calibration, frame, **how).attrs == {"serial": "S-1"}
        table = pa.table(READINGS).replace_schema_metadata({"serial": "S-1"})
        assert apply_frame(calibration, table, **how).schema.metadata == {b"serial": b"S-1"}
        data = xarray.Dataset({name: ("row", column) for name, column in READINGS.items()}, attrs={"serial": "S-1"})
        assert apply_frame(calibration, data, **how).attrs == {"serial": "S-1"}


class TestIndexOfPandas:
    """One that has a name is a column, such as the time that ``resample`` needs there."""

    TIMES = pd.DatetimeIndex(["2026-05-01T12:00:00Z", "2026-05-01T12:00:05Z"], name="time")

    def test_it_holds_the_time(self, calibration: Calibration) -> None:
        frame = pd.DataFrame(READINGS | {"temperature": [20.0, 20.0]}, index=self.TIMES)
        found = apply_frame(calibration, frame, every="10s")
        assert found.index.tolist() == [pd.Timestamp("2026-05-01T12:00:02.5Z")]
        assert found["count"].tolist() == [2]
        assert found.index.name == "time"

    def test_it_stays(self, calibration: Calibration) -> None:
        found = apply_frame(calibration, pd.DataFrame(READINGS, index=self.TIMES))
        assert found.index.equals(self.TIMES)
        assert list(found.columns[:3]) == ["x", "y", "g_x"]

    @pytest.mark.parametrize("how", [{"average": 2}, {"every": "10s"}])
    def test_moments_without_a_name_are_the_time(self, how: dict[str, Any], calibration: Calibration) -> None:
        """As ``pandas.date_range`` makes them; means had the numbers of their rows for an index."""
        frame = pd.DataFrame(READINGS | {"temperature": [20.0, 20.0]}, index=self.TIMES.rename(None))
        found = apply_frame(calibration, frame, **how)
        assert found.index.equals(pd.DatetimeIndex([pd.Timestamp("2026-05-01T12:00:02.5Z")]))
        assert found.index.name is None
        assert "time" not in found

    def test_of_a_table_without_a_name_it_is_nothing(self) -> None:
        table = pd.DataFrame({"position": ["level"], "x": [1.0]}, index=self.TIMES[:1].rename(None))
        assert rows_of(table, "the table") == [{"position": "level", "x": 1}]

    def test_a_column_of_its_name_is_meant(self, calibration: Calibration) -> None:
        frame = pd.DataFrame(READINGS | {"time": [0.0, 5.0]}, index=self.TIMES)
        assert apply_frame(calibration, frame, every="10s")["time"].tolist() == [2.5]


class TestRowsOfATable:
    TABLE: ClassVar[dict[str, list[Any]]] = {"position": ["level", "x-45"], "x": [2.5, 3.0], "n": [100, None]}

    @pytest.mark.parametrize(
        "made",
        [
            pl.DataFrame,
            pd.DataFrame,
            lambda columns: pd.DataFrame(columns).convert_dtypes(),
            lambda columns: pd.DataFrame(columns, dtype=object),
            lambda columns: pd.DataFrame(columns).set_index("position"),
            pa.table,
            dict,
            lambda columns: columns | {"n": np.array([100, np.nan])},
            lambda columns: [dict(zip(columns, cells, strict=True)) for cells in zip(*columns.values(), strict=True)],
        ],
        ids=["polars", "pandas", "nullable", "objects", "index", "pyarrow", "dict", "arrays", "rows"],
    )
    def test_a_missing_whole_number_leaves_the_others_whole(self, made: Callable[[dict[str, Any]], Any]) -> None:
        rows = rows_of(made(self.TABLE), "the table")
        assert rows == [{"position": "level", "x": 2.5, "n": 100}, {"position": "x-45", "x": 3}]
        assert isinstance(rows[0]["n"], int)

    def test_numbers_of_numpy_are_those_of_python(self) -> None:
        row = {"position": "level", "x": np.float32(2.5), "y": np.float64(1.25), "z": Decimal("0.5"), "n": np.int64(9)}
        assert rows_of([row], "the table") == [{"position": "level", "x": 2.5, "y": 1.25, "z": 0.5, "n": 9}]
        (found,) = rows_of([row], "the table")
        assert {type(cell) for cell in found.values()} == {str, float, int}


class TestMeans:
    """Of two rows; what a column holds besides numbers is that of the first."""

    @pytest.mark.parametrize("kind", ["str", "string", "object"])
    def test_a_text_of_a_time_is_missing(self, kind: str, calibration: Calibration) -> None:
        frame = pd.DataFrame(READINGS | {"temperature": [20.0, 20.0]})
        frame["time"] = pd.Series(["2026-05-01T12:00:00Z", None], dtype=kind)
        for how in ({"average": 2}, {"every": "10s"}):
            found = apply_frame(calibration, frame, **how)
            assert found["time"].tolist() == ["2026-05-01T12:00:00Z"]
            assert found["count"].tolist() == [2]

    @pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
    def test_moments_of_every_unit(self, unit: str, calibration: Calibration) -> None:
        times = np.array(["2026-05-01T12:00:00", "2026-05-01T12:00:05"], "M8[s]").astype(f"M8[{unit}]")
        columns = READINGS | {"temperature": [20.0, 20.0]}
        data = xarray.Dataset({name: ("time", column) for name, column in columns.items()}, {"time": times})
        for frame in (columns | {"time": times}, data, columns | {"time": times - times[0]}):
            for how in ({"average": 2}, {"every": "10s"}, {"every": timedelta(seconds=10)}):
                found = np.asarray(apply_frame(calibration, frame, **how)["time"])
                assert found - np.asarray(frame["time"])[0] == [np.timedelta64(2500, "ms")]

    def test_a_masked_moment_is_missing(self, calibration: Calibration) -> None:
        times = np.ma.masked_array(np.array(["2026-05-01T12:00", "2036-05-01T12:00"], "M8[s]"), mask=[False, True])
        frame = READINGS | {"temperature": [20.0, 20.0], "time": times}
        found = apply_frame(calibration, frame, every="10s")
        assert found["count"].tolist() == [2]
        assert found["time"].tolist() == [times[0].astype(object)]

    @pytest.mark.parametrize(
        ("cells", "first"),
        [(["a", np.nan], "a"), ([np.nan, "a"], None), ([None, "a"], None), (["a", 1], "a"), ([1, "a"], 1)],
    )
    def test_text_beside_values_of_another_kind(self, cells: list[Any], first: Any, calibration: Calibration) -> None:
        columns = READINGS | {"temperature": [20.0, 20.0], "note": np.array(cells, object)}
        data = xarray.Dataset({name: ("row", column) for name, column in columns.items()})
        for frame in (columns, data, pd.DataFrame(columns)):
            (found,) = np.asarray(apply_frame(calibration, frame, average=2)["note"]).tolist()
            assert (None if found != found else found) == first

    @pytest.mark.parametrize(
        "frame",
        [
            pl.DataFrame(READINGS).with_columns(pl.Series("other", ["a", 1], pl.Object)),
            pd.DataFrame(READINGS | {"other": [1j, 2j]}),
            pd.DataFrame(READINGS | {"other": pd.arrays.SparseArray([0, 1])}),
            pd.DataFrame(READINGS | {"other": pd.period_range("2026-05", periods=2, freq="M")}),
            pa.table(READINGS | {"other": pa.array([(1, 2, 3), None], pa.month_day_nano_interval())}),
            xarray.Dataset({name: ("row", column) for name, column in READINGS.items()} | {5: ("row", [1.0, 2.0])}),
            READINGS | {"other": [[1.0], [2.0, 3.0]]},
            READINGS | {"other": [1.0, 2.0, 3.0]},
        ],
        ids=["mixed", "complex", "sparse", "period", "interval", "number for a name", "lists", "another length"],
    )
    def test_other_columns_do_not_matter(self, frame: Any, calibration: Calibration) -> None:
        expected = apply_frame(calibration, {name: [np.mean(column)] for name, column in READINGS.items()})
        assert array(apply_frame(calibration, frame), "flag").tolist() == [3, 3]
        means = apply_frame(calibration, frame, average=2)
        assert array(means, "tilt_x").tolist() == expected["tilt_x"].tolist()

    def test_a_masked_text_is_missing(self, calibration: Calibration) -> None:
        note = np.ma.masked_array(["a", "b"], mask=[True, False])
        found = apply_frame(calibration, READINGS | {"temperature": [20.0, 20.0], "note": note}, average=2)
        assert found["note"].tolist() == [None]


class TestPairs:
    READINGS: ClassVar[dict[str, list[float]]] = {
        "theta": [0.0, 90.0],
        **{f"a{number}": [0.1 * number, 0.2 * number] for number in (1, 2, 3, 4)},
    }

    def test_columns_of_other_names(self) -> None:
        pairs = read(FIXTURES / "rotation.yaml")
        assert isinstance(pairs, PairCalibration)
        renamed = {{"a1": "Q1"}.get(name, name): column for name, column in self.READINGS.items()}
        found, expected = pairs.apply(renamed, columns={"a1": "Q1"}), pairs.apply(self.READINGS)
        assert found["matched_a1_a2"].tolist() == expected["matched_a1_a2"].tolist()

    @pytest.mark.parametrize("option", [{"uncertainty": True}, {"average": 2}, {"mounting": "roll=180"}])
    def test_what_is_for_tilt(self, option: dict[str, Any]) -> None:
        with pytest.raises(UsageError, match="is for tilt calibrations; the calibration is of pairs"):
            read(FIXTURES / "rotation.yaml").apply(self.READINGS, **option)


class TestRefusals:
    @pytest.mark.parametrize("temperature", [20.0, [[20.0, 21.0]]])
    def test_a_column_without_rows(self, temperature: Any, calibration: Calibration) -> None:
        with pytest.raises(InputError, match=r"column 'temperature' has [02] dimensions .*: a log's columns have one"):
            apply_frame(calibration, READINGS | {"temperature": temperature})

    def test_columns_of_a_table_that_differ_in_length(self) -> None:
        for other in ([1.0], 1.0):
            with pytest.raises(InputError, match="the table: the columns differ in length"):
                rows_of({"position": ["level", "x-45"], "x": other}, "the table")

    def test_columns_along_different_dimensions(self, calibration: Calibration) -> None:
        with pytest.raises(InputError, match="rows of different kinds: 'x' along 'a' and 'y' along 'b'"):
            apply_frame(calibration, xarray.Dataset({"x": ("a", READINGS["x"]), "y": ("b", READINGS["y"])}))

    def test_a_temperature_in_kelvin(self, calibration: Calibration) -> None:
        warm = {"temperature": ("n", [293.1, 293.2], {"units": "K"})}
        data = xarray.Dataset({name: ("n", column) for name, column in READINGS.items()} | warm)
        with pytest.raises(InputError, match="column 'temperature' is in K, and temperatures in °C"):
            apply_frame(calibration, data)

    def test_one_column_for_two_readings(self, calibration: Calibration) -> None:
        with pytest.raises(InputError, match="x and y are one column, 'x'"):
            apply_frame(calibration, READINGS, columns="y=x")

    def test_two_columns_of_one_name(self, calibration: Calibration) -> None:
        for frame in (pd.DataFrame([[1.0, 2.0]], columns=["x", "x"]), pa.table([[1.0], [2.0]], names=["x", "x"])):
            with pytest.raises(InputError, match="the frame: two columns have one name"):
                apply_frame(calibration, frame)

    def test_numbers_for_names_of_columns(self, calibration: Calibration) -> None:
        frame = pd.DataFrame({0: READINGS["x"], 1: READINGS["y"]})
        found = apply_frame(calibration, frame, columns={"x": "0", "y": "1"})
        assert list(found.columns[:3]) == [0, 1, "g_x"]
        assert found["tilt_x"].tolist() == apply_frame(calibration, READINGS)["tilt_x"].tolist()

    def test_no_columns(self, calibration: Calibration) -> None:
        with pytest.raises(InputError, match="there are no columns"):
            apply_frame(calibration, {})

    def test_another_unit(self, calibration: Calibration) -> None:
        with pytest.raises(InputError, match="column 'x' is in V, and the calibration in count"):
            apply_frame(calibration, READINGS, unit="V")
        volts = xarray.Dataset({name: ("n", column, {"units": "V"}) for name, column in READINGS.items()})
        with pytest.raises(InputError, match="column 'x' is in V, and the calibration in count"):
            apply_frame(calibration, volts)

    @pytest.mark.parametrize(
        ("units", "option", "why"),
        [
            ({"b": "nT", "a": "uT"}, "magnetometer", "column 'b' is in nT, and 'a' in uT: convert one of them"),
            ({"c": "cm/s", "a": "m/s"}, "velocity", "column 'c' is in cm/s, and 'a' in m/s: convert one of them"),
            ({"heading": "rad"}, "velocity", "column 'heading' is in rad, and headings in degree"),
        ],
    )
    def test_units_of_a_vector_and_of_a_heading(
        self, units: dict[str, str], option: str, why: str, calibration: Calibration
    ) -> None:
        """2000 nT beside 20 µT are one field: a heading of both as they stand is 45° off."""
        columns = READINGS | {"a": [20.0, 20.0], "b": [2.0, 2.0], "c": [1.0, 1.0]}
        columns |= {} if option == "magnetometer" else {"heading": [0.0, 1.0]}
        data = xarray.Dataset({name: ("n", column) for name, column in columns.items()})
        assert len(apply_frame(calibration, data, **{option: "a,b,c"})["flag"]) == 2
        for name, unit in units.items():
            data[name].attrs["units"] = unit
        with pytest.raises(InputError, match=why):
            apply_frame(calibration, data, **{option: "a,b,c"})

    def test_a_stage_angle_in_radians(self) -> None:
        turns = {"theta": np.linspace(0.0, 20.0, 400), **{f"a{k}": np.ones(400) for k in (1, 2, 3, 4)}}
        data = xarray.Dataset({name: ("n", column) for name, column in turns.items()})
        data["theta"].attrs["units"] = "rad"
        with pytest.raises(InputError, match="column 'theta' is in rad, and the calibration in degree"):
            read(FIXTURES / "rotation.yaml").apply(data)
        with pytest.raises(InputError, match="column 'theta' is in rad, and stage angles in degree"):
            match(data, [("a1", "a2", "a4")], phase="theta")

    @pytest.mark.parametrize("unit", ["count", "counts", "Count", "1", "LSB"])
    def test_another_spelling_of_the_unit_is_none(self, unit: str, calibration: Calibration) -> None:
        assert apply_frame(calibration, READINGS, unit=unit)["flag"].tolist() == [3, 3]  # no temperature

    def test_a_column_that_is_not_there(self, calibration: Calibration) -> None:
        with pytest.raises(InputError, match="the frame: there is no column 'VoutX'; the log has x, y"):
            apply_frame(calibration, READINGS, columns={"x": "VoutX"})

    def test_a_role_that_is_none(self, calibration: Calibration) -> None:
        with pytest.raises(UsageError, match=r"there is no role 'X' .*; the roles are x, y, temperature, time"):
            apply_frame(calibration, READINGS, columns={"X": "x"})

    @pytest.mark.parametrize("frame", [{**READINGS, "x": ["a", "b"]}, pl.DataFrame({**READINGS, "x": ["a", "b"]})])
    def test_text_for_numbers(self, frame: Any, calibration: Calibration) -> None:
        with pytest.raises(InputError, match=r"column 'x' holds .*, not numbers"):
            apply_frame(calibration, frame)

    def test_columns_of_different_length(self, calibration: Calibration) -> None:
        with pytest.raises(InputError, match="differ in length"):
            apply_frame(calibration, {**READINGS, "x": [1.0]})

    def test_no_rows(self, calibration: Calibration) -> None:
        with pytest.raises(InputError, match="no rows"):
            apply_frame(calibration, {"x": [], "y": []})

    def test_a_frame_that_was_compensated(self, calibration: Calibration) -> None:
        with pytest.raises(UsageError, match="column 'g_x' already"):
            apply_frame(calibration, apply_frame(calibration, READINGS))

    @pytest.mark.parametrize("frame", [pl.LazyFrame(READINGS), 5, [1.0]])
    def test_what_is_no_frame(self, frame: Any, calibration: Calibration) -> None:
        with pytest.raises(UsageError, match="give a polars, pandas or pyarrow frame"):
            apply_frame(calibration, frame)


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


def test_csv_files_load_no_frames(tmp_path: Path) -> None:
    script = (
        f"import sys\nfrom tiltcal.logs.apply import apply_log\napply_log({str(CAL)!r}, 'log.csv', 'out.csv')\n"
        "print(*sys.modules)"
    )
    import subprocess

    (tmp_path / "log.csv").write_text("x,y\n1024,1024\n")
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "tiltcal.logs.formats.csv" in loaded
    unwanted = ("tiltcal.core.pair", "tiltcal.files.pair", "tiltcal.drivers", "tiltcal.logs.frames", "narwhals")
    assert not [name for name in loaded if name.startswith((*unwanted, "tiltcal.logs.formats.netcdf", "xarray"))]


def test_a_block_gives_readings_side_by_side() -> None:
    block = LogBlock({2: np.array([1.0, 2.0]), 0: np.array([3.0, 4.0])})
    assert block.readings([0, 2]).tolist() == [[3.0, 1.0], [4.0, 2.0]]
    assert len(block) == 2


@pytest.mark.parametrize("name", ["mavs", "six-face", "mounting", "temperature-sweep"])
def test_results_do_not_depend_on_where_blocks_end(name: str) -> None:
    """Files are cut into blocks, frames are not: sums in another order would differ in the last bit."""
    found = read(FIXTURES / f"{name}.yaml")
    assert isinstance(found, Calibration)
    kernel = prepare(found, ApplyOptions(uncertainty=True)).kernel
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
