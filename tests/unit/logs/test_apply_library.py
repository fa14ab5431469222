"""A folder of calibrations applied to a log: which calibration a row takes, and what is uncertain about it."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from support import FIXTURES, WITHOUT_PRIORS

import tiltcal
from tiltcal.core.model import Array, Mounting, Thermal
from tiltcal.errors import InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.coefficients import Uncertainty
from tiltcal.files.results import FitRecord, Provenance
from tiltcal.library.calibration import Calibration

LEVEL = read_calibration(WITHOUT_PRIORS)
START = datetime(2026, 1, 1, tzinfo=UTC)
SCALE = 819.0


def stamp(days: float) -> str:
    return (START + timedelta(days=days)).strftime("%Y-%m-%dT%H:%M:%SZ")


def calibrated(days: float, offset: tuple[float, float], u: float = 1.0, serial: str = "S-1") -> CalibrationRecord:
    """Return a calibration whose offset alone is uncertain, and whose readings have no noise."""
    coefficients = replace(LEVEL.coefficients, offset=np.array(offset), sensitivity=SCALE * np.eye(2))
    uncertainty = Uncertainty({"offset.x": u, "offset.y": u}, {"x": 0.0, "y": 0.0})
    return CalibrationRecord(
        LEVEL.sensor.replaced(serial=serial),
        coefficients,
        uncertainty,
        limits=LEVEL.limits,
        provenance=Provenance(started=stamp(days - 0.01), ended=stamp(days)),
    )


def kept(folder: Path, *records: CalibrationRecord) -> Path:
    for number, record in enumerate(records):
        Calibration(record).save(folder / f"{record.sensor.serial}-{number}.yaml")
    return folder


def seconds(days: Any) -> Array:
    return START.timestamp() + 86400.0 * np.asarray(days, dtype=float)


def test_between_two_the_offset_lies_on_the_line_and_outside_the_nearest_holds(tmp_path: Path) -> None:
    """100 days, 10 counts: at 25 days 2.5 counts of 819; the row before and the row behind are flagged."""
    records = [calibrated(*known) for known in ((0, (1000, 1000)), (100, (1010, 1000)), (140, (1030, 980)))]
    library = tiltcal.open_calibrations(kept(tmp_path, *records))
    days = [-5.0, 0.0, 25.0, 99.99, 100.0, 110.0, 140.0, 150.0]
    frame = {"time": seconds(days), "x": np.full(8, 1100.0), "y": np.full(8, 1000.0)}
    found = library.apply(frame)
    offset = np.array([1000.0, 1000.0, 1002.5, 1009.999, 1010.0, 1015.0, 1030.0, 1030.0])
    assert found["g_x"] == pytest.approx((1100.0 - offset) / SCALE, abs=1e-9)
    assert found["g_y"] == pytest.approx(np.array([0, 0, 0, 0, 0, 5.0, 20.0, 20.0]) / SCALE, abs=1e-9)
    assert found["flag"].tolist() == [3, 1, 1, 1, 1, 1, 1, 3]
    assert found["reason"].tolist() == [64, 0, 0, 0, 0, 0, 0, 64]


def changed(record: CalibrationRecord, days: float, **coefficients: Any) -> CalibrationRecord:
    ended = record.provenance.replaced(started=stamp(days - 0.01), ended=stamp(days))
    return replace(record, coefficients=replace(record.coefficients, **coefficients), provenance=ended)


@pytest.mark.parametrize("name", ["free", "multi-angle", "mounting"])
def test_between_two_gravity_is_interpolated_from_what_both_make_of_a_row(name: str, tmp_path: Path) -> None:
    """Three axes, a nonlinearity, a hidden z axis, a mounting; the worse flag counts."""
    first = replace(read_calibration(FIXTURES / f"{name}.yaml"), uncertainty=Uncertainty())
    old = first.coefficients
    new: dict[str, Any] = {"offset": old.offset + 20.0, "sensitivity": old.sensitivity * 1.05 + 3.0}
    if old.mounting is not None:
        new["mounting"] = replace(old.mounting, roll=old.mounting.roll + 0.02, pitch=old.mounting.pitch + 0.02)
    records = changed(first, 0), changed(first, 100, **new)
    draw, n = np.random.default_rng(3), 60
    share, temperature = draw.uniform(0.0, 1.0, n), draw.uniform(5.0, 20.0, n)
    up = np.column_stack([*draw.uniform(-0.6, 0.6, (2, n)), np.zeros(n)])
    up[:, 2] = np.sqrt(1.0 - (up**2).sum(axis=1))
    readings = dict(zip(old.channels, old.predict(up, np.full(n, 12.0)).T, strict=True))
    frame = {"time": seconds(100.0 * share), "temperature": temperature} | readings
    found = tiltcal.open_calibrations(kept(tmp_path, *records)).apply(frame)
    before, after = (Calibration(record).apply(frame) for record in records)
    gravity = {
        axis: (1.0 - share) * before[f"g_{axis}"] + share * after[f"g_{axis}"] for axis in "xyz" if f"g_{axis}" in found
    }
    for axis, component in gravity.items():
        others = [gravity[other] for other in gravity if other != axis]
        angle = np.arcsin(np.clip(component, -1, 1)) if len(gravity) < 3 else np.arctan2(component, np.hypot(*others))
        np.testing.assert_allclose(found[f"g_{axis}"], component, atol=1e-14)
        np.testing.assert_allclose(found[f"tilt_{axis}"], np.degrees(angle), atol=1e-11)
    assert found["flag"].tolist() == np.maximum(before["flag"], after["flag"]).tolist()
    assert found["reason"].tolist() == (before["reason"] | after["reason"]).tolist()


def test_a_heading_takes_the_short_way_between_both(tmp_path: Path) -> None:
    """A level sensor that points north by one mounting and 4° west of it by the next: 1° west after a quarter."""
    records = [calibrated(days, (1000, 1000)) for days in (0, 100)]
    turned = [
        replace(r, coefficients=replace(r.coefficients, mounting=Mounting(0.0, 0.0, np.radians(yaw))))
        for r, yaw in zip(records, (0.0, 4.0), strict=True)
    ]
    level = {"time": seconds([25.0]), "x": [1000.0], "y": [1000.0], "mx": [20.0], "my": [0.0], "mz": [-44.0]}
    found = tiltcal.open_calibrations(kept(tmp_path, *turned)).apply(level, magnetometer="mx,my,mz")
    after = Calibration(turned[1]).apply(level, magnetometer="mx,my,mz")["heading"][0]
    assert min(after, 360.0 - after) == pytest.approx(4.0)
    assert found["heading"] == pytest.approx([1.0 if after < 180.0 else 359.0])


def test_the_uncertainty_is_that_of_both_calibrations_and_of_a_stated_walk(tmp_path: Path) -> None:
    """At the middle of 100 days: half of each variance, and 0.5² mg² times 25; 20 days outside 0.5² mg² times 20."""
    library = tiltcal.open_calibrations(kept(tmp_path, calibrated(0, (1000, 1000)), calibrated(100, (1010, 1000))))
    frame = {"time": seconds([50.0, 120.0]), "x": np.full(2, 1005.0), "y": np.full(2, 1000.0)}
    u = library.apply(frame, uncertainty=True, stability=0.5)["u_tilt_y"]
    middle = np.hypot(np.sqrt(0.5) / SCALE, 0.0005 * 5.0)
    outside = np.hypot(1.0 / SCALE, 0.0005 * np.sqrt(20.0))
    assert u == pytest.approx(np.degrees([middle, outside]), rel=0.05)
    assert u[0] == pytest.approx(np.degrees(middle), rel=0.002)


def test_a_thermal_lag_goes_on_from_one_step_to_the_next(tmp_path: Path) -> None:
    """Two equal calibrations 64 days apart have steps of a day: what the second one gives alone holds throughout."""
    thermal = Thermal(20.0, None, np.array([[2.0], [-1.0]]), np.zeros((2, 1)), lag=600.0)
    records = [calibrated(d, (1000, 1000)) for d in (0, 64)]
    records = [replace(one, coefficients=replace(one.coefficients, thermal=thermal)) for one in records]
    library = tiltcal.open_calibrations(kept(tmp_path, *records))
    time = seconds(1.5) + np.arange(0.0, 86400.0, 60.0)
    warm = 20.0 + 5.0 * np.sin(np.arange(len(time)) / 40.0)
    frame = {"time": time, "x": np.full(len(time), 1100.0), "y": np.full(len(time), 900.0), "temperature": warm}
    assert library.apply(frame)["g_x"] == pytest.approx(Calibration(records[1]).apply(frame)["g_x"], abs=1e-12)


def test_all_sensors_of_a_bench_log_are_compensated_in_one_pass(tmp_path: Path) -> None:
    kept(tmp_path, calibrated(0, (1000, 1000), serial="A"), calibrated(0, (1010, 1020), serial="B-2"))
    time = seconds([1.0, 2.0])
    bench = {"time": time, "A_x": [1100.0, 1200.0], "A_y": [1000.0, np.nan], "B-2_x": [1110.0, 1210.0]}
    bench |= {"B-2_y": [1020.0, 1020.0], "C_x": [0.0, 0.0], "C_y": [0.0, 0.0]}
    library = tiltcal.open_calibrations(tmp_path)
    found = library.apply({name: np.asarray(column) for name, column in bench.items()})
    alone = library.apply(
        {"time": time, "x": np.array([1110.0, 1210.0]), "y": np.array([1020.0, 1020.0])}, serial="B-2"
    )
    for name in ("g_x", "tilt_y", "flag", "reason"):
        assert found[f"B-2_{name}"] == pytest.approx(alone[name])
    assert found["A_flag"].tolist() == [3, 9]
    assert "C_flag" not in found


def test_means_of_several_sensors_are_of_the_rows_of_each(tmp_path: Path) -> None:
    """Readings have a noise of 8 counts: the mean of four is uncertain by 8 / 2 of 819, 4 / 819 g."""
    for serial in ("A", "B"):
        record = calibrated(0, (1000, 1000), serial=serial)
        kept(tmp_path, replace(record, uncertainty=replace(record.uncertainty, single_reading={"x": 8.0, "y": 8.0})))
    library = tiltcal.open_calibrations(tmp_path)
    frame = {"time": seconds(np.zeros(4)), "A_y": np.full(4, 1000.0), "B_y": np.full(4, 1000.0)}
    frame |= {"A_x": np.full(4, np.nan), "B_x": np.array([1000.0, 1004.0, 996.0, 1008.0])}
    found = library.apply(frame, average=4, uncertainty=True)
    assert found["B_x"] == pytest.approx([1002.0])
    assert found["B_u_random_tilt_x"] == pytest.approx(np.degrees([4.0 / SCALE]), rel=0.002)
    assert found["count"].tolist() == [4]
    frame |= {"A_x": np.array([1000.0, 1010.0, np.nan, np.nan]), "A_temperature": np.array([20.0, np.nan, 22.0, 22.0])}
    found = library.apply(frame, average=4)
    assert (found["A_x"].tolist(), found["B_x"].tolist()) == ([1005.0], [1002.0])
    assert found["A_temperature"].tolist() == [20.0]


def test_each_column_of_several_sensors_has_its_unit(tmp_path: Path) -> None:
    library = tiltcal.open_calibrations(kept(tmp_path, calibrated(0, (1000, 1000), serial="A")))
    columns = {"A_x": 1000.0, "A_y": 1000.0, "A_temperature": 293.0, "time": seconds(0.0)}
    for name, unit, why in (("A_x", "V", "the calibration in count"), ("A_temperature", "V", "temperatures in °C")):
        log = xarray.Dataset({column: ("row", np.full(2, value)) for column, value in columns.items()})
        log[name].attrs["units"] = unit
        with pytest.raises(InputError, match=f"column '{name}' is in {unit}, and {why}"):
            library.apply(log)


def test_what_names_no_sensor_or_no_time_is_refused(tmp_path: Path) -> None:
    kept(tmp_path, calibrated(0, (1000, 1000), serial="A"), calibrated(0, (1010, 1020), serial="B"))
    library = tiltcal.open_calibrations(tmp_path)
    frame = {"time": np.array([0.0, 1.0]), "x": np.full(2, 1000.0), "y": np.full(2, 1000.0)}
    with pytest.raises(UsageError, match=r"names no sensor of .*: name it with serial; the folder has .* A, B"):
        library.apply(frame)
    with pytest.raises(UsageError, match="has no calibration of 'C'"):
        library.apply(frame, serial="C")
    with pytest.raises(InputError, match="no count of seconds since 1970: state when the log began, such as start"):
        library.apply(frame, serial="A")
    placed = library.apply(frame, serial="A", start=stamp(1.0))
    assert placed["reason"].tolist() == [64, 64]
    with pytest.raises(InputError, match="from the start that is stated: leave that out where times are dates"):
        library.apply(frame | {"time": seconds([0.0, 1.0])}, serial="A", start=stamp(0.0))
    del frame["time"]
    with pytest.raises(InputError, match="there is no column 'time'"):
        library.apply(frame, serial="A")
    assert library.apply(frame, serial="A", start=stamp(0.0))["reason"].tolist() == [0, 0]


def test_what_is_assumed_of_a_folder_is_said_in_whole_words(tmp_path: Path) -> None:
    """The half width of 10 counts has a variance of 100 / 3 after 25 days: √1.33 of 819 counts in a day are 1.4 mg."""
    said, a, b = (
        list[str](),
        "note: how far A wanders is not stated (--stability): ",
        "note: how far B wanders is not stated ",
    )
    exact = [
        "note: the file has no covariance: the coefficients count as uncorrelated",
        "note: no uncertainty is stated of sensitivity.x.x, sensitivity.x.y, sensitivity.y.x, sensitivity.y.y: they "
        "count as exact",
    ]
    bad = replace(
        calibrated(0, (1000, 1000), serial="A"), fit=FitRecord(chi_square=99.0, degrees_of_freedom=2, p_value=1e-9)
    )
    kept(tmp_path, bad, calibrated(100, (1010, 1000), serial="A"), calibrated(0, (1000, 1000), serial="B"))
    library = tiltcal.open_calibrations(tmp_path)
    frame = {"time": seconds([1.0, 2.0])} | {f"{name}_{axis}": np.full(2, 1000.0) for name in "AC" for axis in "xy"}
    library.apply(frame, uncertainty=True, say=said.append)
    assert said == [
        f"note: {tmp_path} has no calibration of 'C': its columns are left as they are",
        "note: A-0.yaml: chi-square 99 with 2 degrees of freedom (probability 1e-09) is not credible: noise, jig or "
        "thermometer are worse than stated, and the uncertainties are too small",
        f"{a}its whole change between two calibrations counts, which suggests 1.4",
        *exact,
    ]
    one = {"time": frame["time"], "x": frame["A_x"], "y": frame["A_y"]}
    said.clear()
    library.apply(one, serial="A", say=said.append)
    assert not [line for line in said if "wanders" in line]
    (tmp_path / "alone").mkdir()
    alone = tiltcal.open_calibrations(kept(tmp_path / "alone", calibrated(0, (1000, 1000), serial="B")))
    said.clear()
    alone.apply(one, uncertainty=True, say=said.append)
    only = f"note: the frame names no sensor; {tmp_path / 'alone'} has calibrations of B alone"
    assert said == [only, f"{b}(--stability): no wandering counts", *exact]
    noted = xarray.Dataset({name: ("row", column) for name, column in one.items()}, attrs={"serial": "B"})
    with pytest.raises(UsageError) as refused:
        library.apply(noted, serial="A")
    assert str(refused.value) == "the frame states the serial number 'B', and serial says 'A': leave one out"


def test_rows_without_any_time_are_refused_unless_they_have_no_readings(tmp_path: Path) -> None:
    library = tiltcal.open_calibrations(kept(tmp_path, calibrated(0, (1000, 1000)), calibrated(100, (1010, 1000))))
    frame = {"time": np.full(2, np.nan), "x": np.full(2, 1100.0), "y": np.full(2, 1000.0)}
    with pytest.raises(InputError, match=r"none of the first rows \(2\) has a time, which decides which calibration"):
        library.apply(frame)
    assert library.apply(frame | {"x": np.full(2, np.nan), "y": np.full(2, np.nan)})["flag"].tolist() == [9, 9]


def mounted(record: CalibrationRecord, roll: float) -> CalibrationRecord:
    return replace(record, coefficients=replace(record.coefficients, mounting=Mounting(np.radians(roll), 0.0, 0.0)))


def test_of_different_mountings_the_nearer_in_time_is_taken(tmp_path: Path) -> None:
    """Two mountings that are 180° apart: each holds on its side of the middle."""
    first, last = calibrated(0, (1000, 1000)), calibrated(100, (1000, 1000))
    frame = {"time": seconds([49.0, 51.0]), "x": np.full(2, 1100.0), "y": np.full(2, 1100.0)}
    (tmp_path / "near").mkdir()
    near = tiltcal.open_calibrations(kept(tmp_path / "near", mounted(first, 178.0), mounted(last, -178.0)))
    assert near.apply(frame)["g_y"] == pytest.approx(np.full(2, -100.0 / SCALE), abs=2e-3)
    (tmp_path / "far").mkdir()
    far = tiltcal.open_calibrations(kept(tmp_path / "far", mounted(first, 0.0), mounted(last, 180.0)))
    for options in ({}, {"uncertainty": True}):
        assert far.apply(frame, **options)["g_y"] == pytest.approx([100.0 / SCALE, -100.0 / SCALE])
    assert far.apply(frame, mounting="roll=180")["g_y"] == pytest.approx(np.full(2, -100.0 / SCALE))
    (tmp_path / "three").mkdir()
    records = mounted(first, 0.0), mounted(calibrated(60, (1000, 1010)), 0.0), mounted(last, 180.0)
    frame = {"time": seconds([30.0, 79.0, 81.0]), "x": np.full(3, 1100.0), "y": np.full(3, 1100.0)}
    found = tiltcal.open_calibrations(kept(tmp_path / "three", *records)).apply(frame)["g_y"]
    assert found == pytest.approx(np.array([95.0, 90.0, -100.0]) / SCALE)
    said, on_edge = list[str](), 1000.0 - SCALE * np.cos(np.radians(20.0))
    frame = {"time": seconds([10.0, 50.0, 120.0]), "x": np.full(3, 1000.0), "y": np.full(3, on_edge)}
    (tmp_path / "edge").mkdir()
    edge = tiltcal.open_calibrations(kept(tmp_path / "edge", mounted(first, 90.0), mounted(last, 90.0)))
    assert edge.apply(frame, uncertainty=True, stability=1.0, say=said.append)["flag"].tolist() == [4, 4, 4]
    assert said[-1].startswith("note: in 3 rows the sensor is more than 45° from level, mounted on edge: ")
    (tmp_path / "other").mkdir()
    turned = replace(last, coefficients=replace(last.coefficients, sensitivity=-SCALE * np.eye(2)))
    with pytest.raises(UsageError, match=r"0\.yaml and S-1-1\.yaml: the sensitivity of x differs"):
        tiltcal.open_calibrations(kept(tmp_path / "other", first, turned)).apply(frame)
