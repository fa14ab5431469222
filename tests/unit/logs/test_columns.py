"""Columns of a log as arrays, in memory and beyond it."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tiltcal.errors import UsageError
from tiltcal.logs import columns as columns_of_logs
from tiltcal.logs.formats import open_log
from tiltcal.units import split_unit


def test_columns_beyond_the_memory_are_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    columns = {"time": np.arange(150_000.0), "x": np.random.default_rng(1).normal(size=150_000)}
    pl.DataFrame(columns).write_parquet(tmp_path / "log.parquet")
    for memory in (256 << 20, 1 << 20):
        monkeypatch.setattr(columns_of_logs, "_MEMORY", memory)
        with open_log(tmp_path / "log.parquet") as log:
            found = columns_of_logs.read_columns(log, {"x": 1, "time": 0})
        assert len(found) == 150_000
        for role, column in columns.items():
            np.testing.assert_array_equal(found.by_role[role], column)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_folder_without_room_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pl.DataFrame({"x": np.zeros(10)}).write_parquet(tmp_path / "log.parquet")
    monkeypatch.setattr(columns_of_logs, "_MEMORY", 1)
    monkeypatch.setattr(columns_of_logs, "TemporaryFile", lambda: open("/dev/full", "w+b", buffering=0))  # noqa: SIM115
    with (
        open_log(tmp_path / "log.parquet") as log,
        pytest.raises(UsageError, match="No space left on device; make room"),
    ):
        columns_of_logs.read_columns(log, {"x": 0})


@pytest.mark.parametrize(
    ("role", "names"),
    [
        (
            "x",
            "x|X|ax|acc_x|accel_x|AccX|ACC_X|Acceleration_X|Accelerometer X|ACCELEROMETER X (m/s²)|a_x|gFx|x-axis (g)",
        ),
        ("x", "a_RS_S_x [m s^-2]|linear_acceleration.x|field.linear_acceleration.x|xacc|Shimmer_A5_Accel_LN_X_CAL"),
        ("x", "X Accel, g (LGR S/N: 1000, SEN S/N: 1001)|accelerometerAccelerationX(G)|Accel X (g)"),
        ("", "gx|g_x|Gyr_X|w_RS_S_x [rad s^-1]|angular_velocity.x|mag_x|Magnetometer X (μT)|AngleX(deg)|wx|mx|pos_x"),
        ("time", "time|Time (ms)|timestamp [ns]|Time since start in ms |epoc (ms)|time_us|seconds_elapsed|Date/Time"),
        ("temperature", "temperature|Temp (°F)|temp_C|Temperature [K]|imu_temp"),
    ],
)
def test_the_name_of_a_column_means_a_role(role: str, names: str) -> None:
    assert {name: columns_of_logs.meaning(split_unit(name)[0]) for name in names.split("|")} == dict.fromkeys(
        names.split("|"), role
    )


def test_a_linear_acceleration_is_taken_where_it_is_alone() -> None:
    for names, x in ((["linear_acceleration.x"], 0), (["linear_acc_x", "acc_x"], 1), (["acc_x", "user_acc_x"], 0)):
        assert columns_of_logs.column_names(names, "x", {}) == {"x": names[x]}
    assert columns_of_logs.column_names(["acc_x", "accel x"], "x", {}) == {}
    for name, bare, unit in (("a x (m/s^2)", "a x", "m/s^2"), ("x [V]", "x", "V"), ("x (left)", "x (left)", None)):
        assert split_unit(name) == (bare, unit)
        for named in (name, bare, "2"):
            assert columns_of_logs.column_names(["time", name], "x", {"x": named}) == {"x": name}


@pytest.mark.parametrize(("unit", "step"), [("ms", 10), ("us", 1e4), ("ns", 1e7), ("min", 1 / 6000), ("h", 1 / 3.6e5)])
def test_a_time_is_in_the_unit_of_its_name(unit: str, step: float, tmp_path: Path) -> None:
    pl.DataFrame({f"Time ({unit})": np.arange(50) * step, "x": np.zeros(50)}).write_csv(tmp_path / "log.csv")
    with open_log(tmp_path / "log.csv") as log:
        found = columns_of_logs.read_columns(log, {"x": 1, "time": 0})
        assert log.remarks == [f"column 'Time ({unit})' is in {unit}, by its name: seconds are used inside"]
    np.testing.assert_allclose(found.by_role["time"], np.arange(50) * 0.01, atol=1e-9)


@pytest.mark.parametrize(("factor", "step"), [(1, 0.01), (1e3, 0.01), (1e6, 0.01), (1e9, 0.01), (1, 3e5)])
def test_the_size_of_a_time_since_1970_shows_its_unit(factor: float, step: float, tmp_path: Path) -> None:
    """Where its step is one of a log too: a counter that has reached 1.77e9 is none."""
    times = (1_772_357_400 + np.arange(50) * step) * factor
    pl.DataFrame({"time": times, "x": np.zeros(50)}).write_csv(tmp_path / "log.csv")
    with open_log(tmp_path / "log.csv") as log:
        found = columns_of_logs.read_columns(log, {"x": 1, "time": 0})
    np.testing.assert_allclose(found.by_role["time"], times / factor, rtol=1e-15, atol=1e-6)
