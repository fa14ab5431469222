"""``tiltcal export``: each target computes what ``apply`` does, within the bound that it states."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from support import ROOT
from support.applied import PLAIN
from support.command import tiltcal
from support.export_study import (
    COUNTS,
    FIXED,
    G,
    angles_apart,
    compiled,
    computed_in_c,
    drifting,
    of_counts,
    random_calibration,
    readings,
)

from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Array, Coefficients, Thermal
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.export.loss import largest_error
from tiltcal.export.targets import TARGETS, Source, exported
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity


def require(*programs: str) -> None:
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")


@pytest.mark.parametrize("target", ["python", "json", "c-fixed", "fusion", "ros", "iio", "px4"])
def test_the_bound_is_never_exceeded(target: str) -> None:
    """Random calibrations at random attitudes and temperatures, which the bound has not seen."""
    judged = 0
    for seed in range(60):
        record = random_calibration(seed, "m/s2" if target == "px4" else "count")
        if target in ("fusion", "ros", "px4") and len(record.sensor.channels) < 3:
            continue
        source = Source(record, record.limits)
        export = TARGETS[target](source)
        u, celsius = readings(record, 300, seed)
        if export.step:
            u, celsius = np.rint(u / export.step) * export.step, np.rint(celsius * 100.0) / 100.0
        bound = largest_error(record.coefficients, record.limits, export.formula, export.rounding, export.step)
        assert angles_apart(record, export.formula(u, celsius), u, celsius) <= bound, seed
        judged += 1
    assert judged > 12


def test_the_header_computes_the_tilts_of_apply(tmp_path: Path) -> None:
    """Twenty random calibrations with all terms; benchmarks/export.py tries ten thousand."""
    require("gcc")
    records = [random_calibration(seed, reach=0.7) for seed in range(20)]
    headers = [exported(Source(record, record.limits, f"c{k}"), "c") for k, record in enumerate(records)]
    rows = [readings(record, 200, k) for k, record in enumerate(records)]
    tables = computed_in_c(tmp_path, [header.text for header in headers], rows)
    for record, header, table, (u, celsius) in zip(records, headers, tables, rows, strict=True):
        true = Compensation(record.coefficients, record.limits)(u, celsius)
        assert header.bound <= 0.002
        assert angles_apart(record, table[:, ::2], u, celsius) <= header.bound
        assert np.abs(table[:, 1::2] - true.tilt).max() <= header.bound


LIMITS = """
#include "three.h"
#include "two.h"
#include <stdio.h>
int main(void)
{
    const float u[3][3] = {{10.6f, 0, 0}, {0, 0, 20.0f}, {9.81f, 0, -9.81f}};
    for (int k = 0; k < 3; ++k) {
        float degrees[THREE_AXES], pitch, roll;
        three_degrees(u[k], NAN, degrees);
        three_pitch_roll(u[k], NAN, &pitch, &roll);
        printf("%.3f %.3f %.3f\\n", (double)degrees[0], (double)pitch, (double)roll);
    }
    const float beyond[2] = {1.015f, -1.025f};
    float degrees[TWO_AXES];
    two_degrees(beyond, NAN, degrees);
    printf("%.3f %.3f\\n", (double)degrees[0], (double)degrees[1]);
    return 0;
}
"""


def ideal(channels: str, scale: float) -> CalibrationRecord:
    axes, n = tuple(channels), len(channels)
    coefficients = Coefficients(axes, axes, np.zeros(n), scale * np.eye(n))
    return CalibrationRecord(SensorIdentity("recorded", "I-1", "m/s2", axes), coefficients)


def test_tilts_pitch_and_roll_are_defined_as_those_of_apply(tmp_path: Path) -> None:
    """Beyond 2 g there is no tilt; at 45° upside down roll is 180°; an arcsine of up to 1.02 is ±90°."""
    require("gcc")
    for name, record in (("three", ideal("xyz", G)), ("two", ideal("xy", 1.0))):
        export(tmp_path, record, "c", name=name)
        (tmp_path / "out").rename(tmp_path / f"{name}.h")
    run = subprocess.run([compiled(tmp_path, LIMITS)], capture_output=True, text=True, check=True)
    straight, beyond, turned, clipped = ([float(one) for one in line.split()] for line in run.stdout.splitlines())
    assert straight == pytest.approx([90.0, 90.0, 0.0], abs=1e-3)
    assert np.isnan(beyond).all()
    assert turned == pytest.approx([45.0, 45.0, 180.0], abs=1e-3)
    assert clipped[0] == 90.0
    assert np.isnan(clipped[1])


def test_the_header_takes_no_axis_below_the_horizon(tmp_path: Path) -> None:
    """A channel that reads 0.1 of z, and -1 g and a little more: as apply has it, z is 0 there."""
    require("gcc")
    axes = ("x", "y", "z")
    leaning = Coefficients(axes[:2], axes, np.zeros(2), np.array([[1.0, 0.0, 0.1], [0.0, 1.0, 0.0]]))
    record = CalibrationRecord(SensorIdentity("recorded", "L-1", "m/s2", axes[:2]), leaning)
    rows = np.array([[-1.0, 0.0], [-1.003, 0.0]]), np.full(2, 25.0)
    (table,) = computed_in_c(tmp_path, [exported(Source(record, record.limits, "c0"), "c").text], [rows])
    assert table[:, 0] == pytest.approx([-1.0, -1.003], abs=1e-6)
    assert table[:, 1] == pytest.approx([-90.0, -90.0], abs=1e-3)


def test_integers_compute_the_same(tmp_path: Path) -> None:
    """180 readings at 40 temperatures, of a sensor that drifts; benchmarks/export.py computes them on an Arduino."""
    require("gcc")
    (tmp_path / "tilt.h").write_text(exported(Source(drifting(), drifting().limits), "c-fixed").text)
    program = compiled(tmp_path, COUNTS.format(setup="", start="", end="", count=180, kind="int32_t", body=FIXED))
    run = subprocess.run([program], capture_output=True, text=True, check=True)
    computed = np.array(run.stdout.split(), dtype=float).reshape(180, 2) * 1e-6
    assert np.abs(computed - of_counts(180)).max() < 3e-6


def test_fusion_is_what_its_own_package_computes(tmp_path: Path) -> None:
    imufusion = pytest.importorskip("imufusion")
    record = three_axes("count")
    text = export(tmp_path, record, "fusion", allow="2")
    numbers = {
        name: [float(one) for one in re.findall(r"(-?[\d.e+-]+)f", line)]
        for name, line in (re.search(r"accelerometer(\w+) = \{(.*)\}", line).groups() for line in text.splitlines()[1:])
    }
    matrix = np.array(numbers["Misalignment"]).reshape(3, 3)
    u, celsius = readings(record, 100, 1)
    celsius[:] = 25.0
    u = record.coefficients.predict(directions(), celsius[: len(directions())])
    result = np.array(
        [
            imufusion.model_inertial(row, matrix, np.array(numbers["Sensitivity"]), np.array(numbers["Offset"]))
            for row in u
        ]
    )
    assert result == pytest.approx(directions(), abs=3e-6)


def directions() -> Array:
    up = np.random.default_rng(5).normal(size=(50, 3))
    return up / np.linalg.norm(up, axis=1)[:, None]


def three_axes(unit: str, cross: float = 0.01) -> CalibrationRecord:
    """Return a calibration of three axes with a drift, in counts or in m/s²."""
    scale = 256.0 if unit == "count" else G
    matrix = scale * (np.diag([1.01, 0.99, 1.02]) + cross * np.array([[0, 1, -1], [0.5, 0, 0.3], [-0.2, 0.4, 0]]))
    thermal = Thermal(25.0, (24.0, 26.0), np.full((3, 1), 2e-4 * scale), np.zeros((3, 0)))
    coefficients = Coefficients(
        ("x", "y", "z"), ("x", "y", "z"), scale * np.array([0.02, -0.03, 0.05]), matrix, thermal
    )
    return CalibrationRecord(SensorIdentity("recorded", "I-1", unit, ("x", "y", "z")), coefficients)


def export(folder: Path, record: CalibrationRecord, target: str, *, allow: str = "0.1", name: str = "tilt") -> str:
    (folder / "cal.yaml").write_text(record.text)
    options = ("--to", target, "--allow", allow, "--name", name, "-o", "out")
    tiltcal("export", "cal.yaml", *options, cwd=folder, code=0)
    return (folder / "out").read_text()


def test_ros_corrects_by_the_formula_of_imu_calib(tmp_path: Path) -> None:
    """``SM * raw - bias``: imu_calib, accel_calib.cpp."""
    record = three_axes("m/s2")
    file = yaml.safe_load(export(tmp_path, record, "ros"))
    raw = record.coefficients.predict(directions())
    corrected = raw @ np.array(file["SM"]).reshape(3, 3).T - file["bias"]
    assert corrected == pytest.approx(directions() * G, abs=1e-6)
    assert len(file["linear_acceleration_covariance"]) == 9


def test_autopilots_correct_each_axis_by_itself(tmp_path: Path) -> None:
    """PX4: (raw - offset) scale, of tab-separated parameters; ArduPilot: the same, of NAME,VALUE."""
    record = three_axes("m/s2", cross=0.0)
    raw = record.coefficients.predict(directions())
    px4 = dict(line.split("\t")[2:4] for line in export(tmp_path, record, "px4").splitlines() if line[0] != "#")
    pilot = dict(line.split(",") for line in export(tmp_path, record, "ardupilot").splitlines() if line[0] != "#")
    for k, axis in enumerate("XYZ"):
        for offset, scale in (
            (px4[f"CAL_ACC0_{axis}OFF"], px4[f"CAL_ACC0_{axis}SCALE"]),
            (pilot[f"INS_ACCOFFS_{axis}"], pilot[f"INS_ACCSCAL_{axis}"]),
        ):
            assert (raw[:, k] - float(offset)) * float(scale) == pytest.approx(directions()[:, k] * G, abs=1e-6)


def test_what_an_autopilot_cannot_hold_is_refused(tmp_path: Path) -> None:
    """A cross-axis sensitivity of 1 % is an angle of asin 0.01 = 0.57°."""
    record = three_axes("m/s2", cross=0.0)
    record.coefficients.sensitivity[0, 1] = 0.01 * G
    (tmp_path / "cal.yaml").write_text(record.text)
    result = tiltcal("export", "cal.yaml", "--to", "px4", "-o", "out.params", cwd=tmp_path, code=2)
    assert "px4 does not hold cross-axis sensitivity and mounting, drift with temperature" in result.stderr
    stated = float(re.search(r"at most ([\d.]+)°", result.stderr).group(1))
    assert 0.56 < stated < 0.7
    assert not (tmp_path / "out.params").exists()


@pytest.mark.parametrize(
    ("unit", "options", "message"),
    [
        ("count", ["--to", "px4"], "readings in m/s2, and this calibration is of readings in count"),
        ("m/s2", ["--to", "iio"], "iio corrects raw counts"),
        ("count", ["--to", "ros", "--fixed"], "--fixed is for c"),
        ("count", ["--to", "c", "--name", "2tilt"], "is no name in C"),
    ],
)
def test_what_does_not_go_together_is_refused(tmp_path: Path, unit: str, options: list[str], message: str) -> None:
    (tmp_path / "cal.yaml").write_text(three_axes(unit).text)
    assert message in tiltcal("export", "cal.yaml", *options, cwd=tmp_path, code=2).stderr


def test_the_script_sets_what_the_driver_has(tmp_path: Path) -> None:
    """The corrected reading (raw + calibbias) calibscale scale is m/s² along each axis; a folder stands for sysfs."""
    record = three_axes("count", cross=0.0)
    text = export(tmp_path, record, "iio", allow="1").replace("/sys/bus/iio/devices", str(tmp_path))
    device = tmp_path / "iio:device0"
    device.mkdir()
    for axis in "xyz":
        (device / f"in_accel_{axis}_calibbias").write_text("0")
    (device / "in_accel_x_calibscale").write_text("1")
    (device / "in_accel_scale").write_text("0.0383")
    result = subprocess.run(["sh", "-s"], input=text, text=True, capture_output=True, check=True)
    assert "the driver has no in_accel_y_calibscale" in result.stderr
    bias, scale = (float((device / f"in_accel_x_{name}").read_text()) for name in ("calibbias", "calibscale"))
    raw = record.coefficients.predict(np.array([[1.0, 0.0, 0.0]]))[0, 0]
    assert (raw + bias) * scale * 0.0383 == pytest.approx(G, abs=0.5 / 256.0 * G)


def test_python_holds_all_and_needs_no_numpy() -> None:
    """Random calibrations of two and three axes with drift, non-linearity and mounting, row by row."""
    for seed in range(20):
        record = random_calibration(seed, reach=0.7)
        exports = {target: exported(Source(record, record.limits), target) for target in ("python", "json")}
        assert all(one.bound < 0.001 and not one.left_out for one in exports.values())
        assert re.findall(r"import \w+", exports["python"].text) == ["import math"]
        namespace: dict[str, object] = {}
        exec(exports["python"].text, namespace)
        u, celsius = readings(record, 20, seed)
        found = [namespace["g"](*row) for row in zip(u.tolist(), celsius.tolist(), strict=True)]  # type: ignore[operator]
        true = Compensation(record.coefficients, record.limits)(u, celsius).gravity
        assert np.array(found) == pytest.approx(np.array(true), abs=1e-9)
        data = json.loads(exports["json"].text)
        assert {
            name: namespace[name]
            for name in data.keys() - {"A", "b", "unit", "bound", "formula", "lag", "drift", "reference"}
        }.items() <= data.items()


@pytest.mark.parametrize("lag", [90.0, -60.0])
def test_python_follows_the_lag_of_the_element(lag: float) -> None:
    record = three_axes("count")
    coefficients = record.coefficients
    assert coefficients.thermal is not None
    lagging = replace(record, coefficients=replace(coefficients, thermal=replace(coefficients.thermal, lag=lag)))
    namespace: dict[str, object] = {}
    exec(exported(Source(lagging, record.limits), "python").text, namespace)
    time = np.array([0.0, 1.0, 5.0, 30.0, 31.0, 400.0])
    celsius = 20.0 + 0.02 * time + np.sin(time)
    found = [namespace["element"](*row) for row in zip(time.tolist(), celsius.tolist(), strict=True)]  # type: ignore[operator]
    assert found == pytest.approx(ThermalLag(lag)(time, celsius), abs=1e-9)


def test_show_prints_coefficients_tilts_and_the_map(tmp_path: Path) -> None:
    """Of a file without uncertainty the map alone; A and b turn the readings of the model back into gravity."""
    record = three_axes("count")
    (tmp_path / "cal.yaml").write_text(record.text)
    lines = tiltcal("show", "cal.yaml", "--matrix", cwd=tmp_path).stdout.splitlines()
    rows = np.array([line.split()[-3:] for line in lines[-4:]], dtype=float)
    assert (record.coefficients.predict(directions()) - rows[3]) @ rows[:3].T == pytest.approx(directions(), abs=1e-6)
    # Two channels read g_z as well: b is what they read at level.
    leaning = PLAIN.replace("y: 0.0}, y", "y: 0.0, z: 0.05}, y").replace("y: 2.0}", "y: 2.0, z: -0.03}")
    (tmp_path / "cal.yaml").write_text(leaning)
    level = tiltcal("show", "cal.yaml", "--matrix", cwd=tmp_path).stdout.splitlines()[-1]
    assert level.split()[-2:] == ["2.55", "2.47"]
    shown = tiltcal("show", ROOT / "fixtures/cross-axis.yaml").stdout
    assert re.search(r"offset x +1026\.\d+ ± 0\.\d+ count", shown)
    assert re.search(r"tilt x within  ± 0\.0\d+° near level, 0\.0\d+° at -30°, 0\.0\d+° at 30°", shown)
    assert "p = " in tiltcal("show", ROOT / "fixtures/rotation.yaml").stdout
