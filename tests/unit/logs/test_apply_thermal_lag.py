"""A calibration with a thermal lag, applied to logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import FIXTURES

from tiltcal.errors import InputError
from tiltcal.library.apply import apply_log
from tiltcal.library.calibration import Calibration, read
from tiltcal.logs.apply import NO_TIME

LAG = 120.0


def lagging(lag: float) -> Calibration:
    calibration = read(FIXTURES / "mavs.yaml")
    coefficients = calibration.coefficients
    thermal = replace(coefficients.thermal, lag=lag)
    return Calibration(replace(calibration.record, coefficients=replace(coefficients, thermal=thermal)))


@pytest.fixture
def ramp():
    """Time, thermometer and element on a ramp of 2 °C/min, by the solution of the differential equation."""
    seconds = np.arange(0.0, 600.0, 5.0)
    pace = 2.0 / 60.0
    return seconds, 6.0 + pace * seconds, 6.0 + pace * (seconds - LAG * (1.0 - np.exp(-seconds / LAG)))


def write(path, columns):
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    return path


def tilts(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def test_the_log_is_compensated_with_the_temperature_of_the_element(tmp_path, ramp):
    seconds, thermometer, element = ramp
    readings = {"x": np.full_like(seconds, 1300.0), "y": np.full_like(seconds, 900.0)}
    late = write(tmp_path / "late.csv", {"time": seconds, **readings, "temperature": thermometer})
    true = write(tmp_path / "true.csv", {"time": seconds, **readings, "temperature": element})
    apply_log(lagging(LAG), late, tmp_path / "late-tilt.csv")
    apply_log(lagging(0.0), true, tmp_path / "true-tilt.csv")
    found, expected = tilts(tmp_path / "late-tilt.csv"), tilts(tmp_path / "true-tilt.csv")
    assert found["tilt_x"] == pytest.approx(expected["tilt_x"], abs=1e-9)
    assert found["flag"].tolist() == expected["flag"].tolist()


def test_without_times_rows_are_suspect_and_a_remark_names_the_column(tmp_path, ramp):
    seconds, thermometer, _ = ramp
    readings = {"x": np.full_like(seconds, 1300.0), "y": np.full_like(seconds, 900.0)}
    log = write(tmp_path / "log.csv", {**readings, "temperature": thermometer})
    remarks: list[str] = []
    apply_log(lagging(LAG), log, tmp_path / "lag.csv", say=remarks.append)
    apply_log(lagging(0.0), log, tmp_path / "none.csv")
    found = tilts(tmp_path / "lag.csv")
    assert remarks == [NO_TIME]
    assert all(int(reason) & 16 for reason in found["reason"])
    assert 1.0 not in set(found["flag"])
    assert found["tilt_x"] == pytest.approx(tilts(tmp_path / "none.csv")["tilt_x"])


def test_a_row_without_a_time_is_suspect(ramp):
    seconds, thermometer, _ = ramp
    time = seconds.copy()
    time[7] = np.nan
    frame = {"t": time, "x": np.full_like(time, 1300.0), "y": np.full_like(time, 900.0), "temperature": thermometer}
    found = lagging(LAG).apply(frame, columns={"time": "t"})
    assert np.flatnonzero(found["reason"] == 16).tolist() == [7]


def test_a_missing_reading_has_no_other_reason():
    found = lagging(LAG).apply({"x": [1300.0, np.nan], "y": [900.0, 900.0], "temperature": [10.0, 10.0]})
    assert (found["flag"].tolist(), found["reason"].tolist()) == ([3, 9], [16, 32])


def test_the_lag_is_kept_in_the_file(tmp_path):
    lagging(-35.5).save(tmp_path / "cal.yaml")
    assert read(tmp_path / "cal.yaml").coefficients.thermal.lag == -35.5
    assert "lag" not in (FIXTURES / "mavs.yaml").read_text()


def test_a_lag_that_is_no_number_is_refused(tmp_path):
    lagging(35.5).save(tmp_path / "cal.yaml")
    (tmp_path / "bad.yaml").write_text((tmp_path / "cal.yaml").read_text().replace("lag: 35.5", "lag: soon"))
    with pytest.raises(InputError, match="lag"):
        read(tmp_path / "bad.yaml")


@pytest.mark.parametrize(
    ("place", "time", "how"), [(7, 30.0, "stands still at row 7"), (7, 12.0, "goes back at row 7"), (1, 0.0, "row 1")]
)
def test_times_that_do_not_go_on_are_refused_with_their_row(tmp_path, ramp, place, time, how):
    """Without a pace there is no lag: such logs were compensated as if the temperature began anew there."""
    seconds, thermometer, _ = ramp
    times = seconds.copy()
    times[place] = time
    readings = {"x": np.full_like(seconds, 1300.0), "y": np.full_like(seconds, 900.0), "temperature": thermometer}
    log = write(tmp_path / "log.csv", {"time": times, **readings})
    with pytest.raises(InputError, match=rf"log\.csv: time .*{how}.*--columns time=NAME"):
        apply_log(lagging(LAG), log, tmp_path / "tilt.csv")
    assert not (tmp_path / "tilt.csv").exists()
    with pytest.raises(InputError, match=how):
        lagging(LAG).apply({"time": times, **readings})
    apply_log(lagging(0.0), log, tmp_path / "tilt.csv")


def test_a_row_without_a_time_is_no_step_back(tmp_path, ramp):
    seconds, thermometer, _ = ramp
    times = seconds.copy()
    times[5] = np.nan
    readings = {"x": np.full_like(seconds, 1300.0), "y": np.full_like(seconds, 900.0), "temperature": thermometer}
    found = lagging(LAG).apply({"time": times, **readings})
    assert np.flatnonzero(np.asarray(found["reason"]) & 16).tolist() == [5]
