"""What the cells of a frame may hold: missing values, values of Python, times, texts, and what no array has."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import xarray
from support.frames import READINGS, array

from tiltcal.errors import InputError
from tiltcal.library.calibration import Calibration
from tiltcal.logs.frames import rows_of


class TestMissingValues:
    """What an array masks is missing, whatever stands below the mask."""

    @pytest.mark.parametrize("kind", [float, int])
    def test_a_masked_reading_is_missing(self, kind: type, calibration: Calibration) -> None:
        masked = np.ma.masked_array(np.array([1024, 1100], dtype=kind), mask=[True, False])
        found = calibration.apply(READINGS | {"x": masked, "temperature": [20.0, 20.0]})
        assert np.isnan(found["tilt_x"]).tolist() == [True, False]
        assert found["flag"].tolist() == [9, 1]
        means = calibration.apply(READINGS | {"x": masked, "temperature": [20.0, 20.0]}, average=2)
        assert means["count"].tolist() == [1]


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
        expected = calibration.apply(self.SAME)
        assert expected["flag"].tolist() == [1, 9]
        found = calibration.apply(made(self.COLUMNS))
        for name in ("tilt_x", "tilt_y", "flag", "reason"):
            np.testing.assert_array_equal(array(found, name), expected[name])

    @pytest.mark.parametrize("made", [dict, pl.DataFrame, pd.DataFrame, pa.table])
    def test_a_column_without_a_value(self, made: Callable[[dict[str, Any]], Any], calibration: Calibration) -> None:
        """As an empty column of CSV: reason 16 of SPEC 10, temperature missing."""
        found = calibration.apply(made(READINGS | {"temperature": [None, None]}))
        assert array(found, "reason").tolist() == [16, 16]

    @pytest.mark.parametrize("cells", [[True, False], ["1", None], [1.0, "2"], [[1.0], [2.0, 3.0]]])
    def test_what_is_no_number(self, cells: list[Any], calibration: Calibration) -> None:
        columns = READINGS | {"x": pd.Series(cells, dtype=object)}
        for frame in (columns, pd.DataFrame(columns)):
            with pytest.raises(InputError, match=r"column 'x' holds .*, not numbers"):
                calibration.apply(frame)

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
            assert calibration.apply(columns, **how)["time"] == [np.datetime64("2026-05-01T12:00:02.5")]


class TestMeans:
    """Of two rows; what a column holds besides numbers is that of the first."""

    @pytest.mark.parametrize("kind", ["str", "string", "object"])
    def test_a_text_of_a_time_is_missing(self, kind: str, calibration: Calibration) -> None:
        frame = pd.DataFrame(READINGS | {"temperature": [20.0, 20.0]})
        frame["time"] = pd.Series(["2026-05-01T12:00:00Z", None], dtype=kind)
        for how in ({"average": 2}, {"every": "10s"}):
            found = calibration.apply(frame, **how)
            assert found["time"].tolist() == ["2026-05-01T12:00:00Z"]
            assert found["count"].tolist() == [2]

    @pytest.mark.parametrize(
        "frame",
        [
            pl.DataFrame(READINGS).with_columns(pl.Series("other", ["a", 1], pl.Object)),
            pd.DataFrame(READINGS | {"other": [1j, 2j]}),
            pd.DataFrame(READINGS | {"other": pd.arrays.SparseArray([0, 1])}),
            pd.DataFrame(READINGS | {"other": pd.period_range("2026-05", periods=2, freq="M")}),
            pa.table(READINGS | {"other": pa.array([(1, 2, 3), None], pa.month_day_nano_interval())}),
            xarray.Dataset({name: ("row", column) for name, column in READINGS.items()} | {5: ("row", [1.0, 2.0])}),
            READINGS | {"other": [1.0, 2.0, 3.0]},
        ],
        ids=["mixed", "complex", "sparse", "period", "interval", "number for a name", "another length"],
    )
    def test_other_columns_do_not_matter(self, frame: Any, calibration: Calibration) -> None:
        expected = calibration.apply({name: [np.mean(column)] for name, column in READINGS.items()})
        assert array(calibration.apply(frame), "flag").tolist() == [3, 3]
        means = calibration.apply(frame, average=2)
        assert array(means, "tilt_x").tolist() == expected["tilt_x"].tolist()


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
