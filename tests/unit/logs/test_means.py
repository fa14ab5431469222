"""Means of rows: what belongs into one, what is left out, and that their stated uncertainty holds."""

from datetime import UTC, datetime
from math import hypot, nan, radians
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import xarray
from support.applied import PLAIN

from tiltcal.dialect import Dialect
from tiltcal.errors import InputError
from tiltcal.library.calibration import Calibration, read
from tiltcal.library.recorded import apply_log
from tiltcal.logs.formats.csv import ColumnTypes
from tiltcal.logs.formats.csv_rows import RowGrammar

CAL = (
    PLAIN
    + """\
uncertainty:
  offset: {x: 0.003, y: 0.003}
  sensitivity: {x: {x: 0.002, y: 0.001}, y: {x: 0.001, y: 0.002}}
  single_reading: {x: 0.04, y: 0.04}
limits:
  reading: {x: [0.0, 5.0], y: [0.0, 5.0]}
"""
)


@pytest.fixture
def cal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Calibration:
    monkeypatch.chdir(tmp_path)
    Path("cal.yaml").write_text(CAL)
    found = read("cal.yaml")
    assert isinstance(found, Calibration)
    return found


def rows(**columns: Any) -> dict[str, Any]:
    number = len(next(iter(columns.values())))
    return {"x": np.full(number, 2.5), "y": np.full(number, 2.5), **columns}


class TestGroups:
    def test_so_many_rows_each_and_the_last_may_have_fewer(self, cal: Calibration) -> None:
        """Readings are averaged and not angles: of those of the last two rows the mean is 45°."""
        found = cal.apply(rows(x=[2.5, 2.7, 2.6, 2.9, 2.5, 4.5, 3.1]), average=2)
        assert found["count"].tolist() == [2, 2, 2, 1]
        assert found["x"] == pytest.approx([2.6, 2.75, 3.5, 3.1])
        assert found["g_x"] == pytest.approx([0.05, 0.125, 0.5, 0.3])
        assert found["tilt_x"][2] == pytest.approx(30.0)

    def test_times_that_are_text_get_their_mean(self, cal: Calibration) -> None:
        for times, means in (
            (["2026-05-01 12:00", "2026-05-01T12:00:03Z", "2026-05-01"], ["12:00:01.500Z", "00:00:00Z"]),
            (["8", "9.5", "11"], ["8.75", "11.0"]),
            (["noon", "noon", "one"], ["noon", "one"]),
        ):
            found = cal.apply(pl.DataFrame(rows(x=[2.5, 2.7, 2.6], time=times)), average=2)["time"].to_list()
            assert [time.removeprefix("2026-05-01T") for time in found] == means

    def test_so_much_time_each_on_the_clock_of_the_log(self, cal: Calibration) -> None:
        time = [7.0, 9.0, 10.0, nan, 19.9, 41.0]
        found = cal.apply(rows(time=time), every="10s")
        assert found["count"].tolist() == [2, 3, 1]
        assert found["time"] == pytest.approx([8.0, (10.0 + 19.9) / 2, 41.0])
        again = cal.apply(rows(time=[6.0, 7.0, 8.0, 9.0, 1.0, 2.0, 3.0]), every="10s")  # of a logger that was restarted
        assert again["count"].tolist() == [4, 3]
        with pytest.raises(InputError, match=r"the frame: none of the first rows \(2\) has a time, which .* mean"):
            cal.apply(rows(time=[nan, nan]), every="10s")

    def test_a_row_on_a_border_begins_its_mean(self, cal: Calibration) -> None:
        """Dates in seconds have errors of 0.1 µs; all three begin on a border, as 1767225600 is a multiple of 30 ms."""
        for interval, every, count in ((0.02, "100ms", 5), (0.01, "30ms", 3), (1 / 3000, "1ms", 3)):
            for begin in (0.0, 1767225600.0):
                time = begin + np.round(np.arange(900) * interval, 6)
                assert set(cal.apply(rows(time=time), every=every)["count"].tolist()) == {count}, (every, begin)

        # 0.0079 s is 7900.000000000001 µs in floating point.
        assert set(cal.apply(rows(time=np.arange(0, 900) * 3950 / 1e6), every="7.9ms")["count"].tolist()) == {2}

    def test_missing_rows_are_left_out_and_not_counted(self, cal: Calibration) -> None:
        log = rows(x=[2.5, nan, 2.7, nan, nan], y=[2.5, 9.0, 2.9, 2.5, 2.7], n=[1, 2, 4, 6, 8])
        found = cal.apply(log, average=3)
        means = {"count": [2, 0], "x": [2.6, nan], "y": [2.7, nan], "n": [2.5, 7.0], "g_y": [0.1, nan]}
        for name, expected in means.items():
            assert found[name] == pytest.approx(expected, nan_ok=True)
        assert (found["flag"].tolist(), found["reason"].tolist()) == ([1, 9], [0, 32])
        assert cal.apply(rows(temperature=[20.0, nan, 21.0]), average=3)["temperature"] == pytest.approx([20.5])

    def test_a_row_at_the_rail_fails_its_mean(self, cal: Calibration) -> None:
        found = cal.apply(rows(x=[2.5, 5.0, 2.5, 2.6]), average=2)
        assert (found["flag"].tolist(), found["reason"].tolist()) == ([4, 1], [4, 0])

    def test_headings_are_averaged_as_directions_and_flagged_where_they_cancel(self, cal: Calibration) -> None:
        for headings, mean, flag, reason in (
            ([359.0, 3.0], 1.0, 1, 0),
            ([350.0, 10.0], 0.0, 1, 0),  # the cosine of 10° is 0.985
            ([340.0, 20.0], 0.0, 3, 128),  # and that of 20° is 0.940
            ([10.0, 189.0], 99.5, 3, 128),
        ):
            flow = {"heading": headings, "u": [1.0, 1.0], "v": [0.0, 0.0], "w": [0.0, 0.0]}
            found = cal.apply(rows(**flow), average=2, velocity="u,v,w")
            assert found["heading"] == pytest.approx([mean])
            assert found["v_east"] == pytest.approx([np.sin(radians(mean))])
            assert (found["flag"].tolist(), found["reason"].tolist()) == ([flag], [reason])


def test_blocks_of_a_file_and_a_frame_give_the_same(cal: Calibration) -> None:
    """A CSV block is 4 MB: 150,000 rows are several."""
    draw = np.random.default_rng(1)
    log = pl.DataFrame(
        {"time": np.arange(150_000.0), "x": draw.uniform(1.0, 4.0, 150_000), "y": 2.5, "who": "a somewhat longer text"}
    )
    log.write_csv("log.csv")
    for options in ({"average": 70_001}, {"every": "7s"}):
        apply_log(cal, "log.csv", "out.csv", **options)
        whole = cal.apply(log, **options)
        found = pl.read_csv("out.csv")
        assert found.columns == whole.columns
        assert found["count"].to_list() == whole["count"].to_list()
        np.testing.assert_allclose(found["tilt_x"], whole["tilt_x"], atol=1e-9)
        assert found["who"].to_list() == whole["who"].to_list()


def test_rows_that_cannot_be_parsed_are_counted_over_all_means(cal: Calibration) -> None:
    Path("log.csv").write_text("x,y\n" + "2.5,2.5\n2.6,oops\n2.7,2.5\n" * 3)
    found = apply_log(cal, "log.csv", "out.csv", average=3, skip_bad_rows=True)
    assert found.as_data() == {"rows": 3, "flags": {"1": 3}, "reasons": {}, "bad_rows": 3}
    assert pl.read_csv("out.csv")["count"].to_list() == [2, 2, 2]


def test_shares_are_those_worked_out_by_hand(cal: Calibration) -> None:
    degree = np.degrees(1.0 / 2.0)
    for number, random in ((100, 0.004), (1, 0.04)):
        found = cal.apply(rows(x=np.full(number, 2.5)), average=number, uncertainty=True)
        assert found["u_common_tilt_x"] == pytest.approx([0.003 * degree], rel=1e-3)
        assert found["u_random_tilt_x"] == pytest.approx([random * degree], rel=1e-3)
        assert found["u_tilt_x"] == pytest.approx([hypot(0.003, random) * degree], rel=1e-3)


def test_netcdf_of_means_keeps_what_it_states(cal: Calibration) -> None:
    log = xarray.Dataset(
        {name: ("time", values) for name, values in rows(x=np.full(7, 2.6)).items()}, attrs={"site": "A"}
    )
    log["time"] = ("time", np.arange(7.0), {"units": "seconds since 2026-01-01"})
    log.to_netcdf("log.nc", engine="h5netcdf")
    apply_log(cal, "log.nc", "out.nc", average=3, uncertainty=True)
    with xarray.open_dataset("out.nc", engine="h5netcdf", decode_times=False) as found:
        assert found["count"].values.tolist() == [3, 3, 1]
        assert found["time"].values.tolist() == [1.0, 4.0, 6.0]
        assert found["time"].attrs["units"] == "seconds since 2026-01-01"
        assert found.attrs["site"] == "A"
        assert found["u_common_tilt_x"].attrs["long_name"] == "standard uncertainty of tilt_x, common to all rows"


def test_the_time_of_a_csv_log_keeps_what_it_holds_in_columns_with_types() -> None:
    """As in Parquet and in means; numbers of 16 digits and more stay text."""
    dialect = Dialect(("time", "n"))
    for cells, typed in {
        ("1767225600000000001", ""): ["1767225600000000001", None],
        ("12.5", "13.5"): [12.5, 13.5],
        ("13:00", "noon"): ["13:00", "noon"],
        ("2026-05-01 12:00", "noon"): [datetime(2026, 5, 1, 12, tzinfo=UTC), None],
    }.items():
        data = "".join(f"{cell},1\n" for cell in cells).encode()
        block = RowGrammar(dialect, (0,), 0, (0, 1)).by_line(data)
        frame = ColumnTypes(dialect, (0,), 0, file="log.csv").typed(block).framed()
        assert frame["time"].to_list() == typed
