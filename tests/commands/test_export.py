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
    random_calibration,
    readings,
)

from tiltcal import __version__
from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Array, Coefficients, Limits, Mounting, Thermal
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.export.loss import calibrated_range, largest_error
from tiltcal.export.targets import TARGETS, Source, exported, terms
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.coefficients import Covariance, Uncertainty
from tiltcal.files.results import DerivedRecord, Provenance

compiling = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


@pytest.mark.parametrize("target", ["python", "json", "c-fixed", "fusion", "ros", "iio", "px4"])
def test_the_bound_is_never_exceeded_and_never_far_from_the_error(target: str) -> None:
    """Random calibrations at random attitudes and temperatures, which the bound has not seen."""
    shares = []
    for seed in range(60):
        record = random_calibration(seed, "m/s2" if target == "px4" else "count")
        if target in ("fusion", "ros", "px4") and len(record.sensor.channels) < 3:
            continue
        export = TARGETS[target](Source(record, record.limits))
        u, celsius = readings(record, 300, seed)
        if export.step:
            u, celsius = np.rint(u / export.step) * export.step, np.rint(celsius * 100.0) / 100.0
        bound = largest_error(record.coefficients, record.limits, export.formula, export.rounding, export.step)
        found = angles_apart(record, export.formula(u, celsius), u, celsius)
        assert found <= bound, seed
        if {*terms(record.coefficients)} <= {*export.holds}:
            assert bound < (1e-8 if target in ("python", "json") else 0.6 if target == "iio" else 0.002), seed
        else:
            shares.append(found / bound)
    assert shares == [] or 0.7 < np.median(shares) < 1.0


@pytest.mark.parametrize("roll", [0.0, np.pi])
def test_the_attitudes_that_are_tried_cover_the_range(roll: float) -> None:
    """4000 directions on a sphere, 65 angles of each channel, nine temperatures."""
    random, three = np.random.default_rng(2), three_axes("g").coefficients
    up, celsius = calibrated_range(three, Limits(temperature=(20.0, 25.0)))
    assert np.unique(celsius) == pytest.approx(np.linspace(24.0, 25.0, 9))
    assert len(np.unique(np.column_stack([up, celsius]), axis=0)) == len(up) == 9 * 4006
    assert np.linalg.norm(up, axis=1) == pytest.approx(np.ones(len(up)))
    assert up.T @ up / len(up) == pytest.approx(np.eye(3) / 3.0, abs=1e-3)
    anywhere = random.normal(size=(300, 3))
    nearest = np.max(anywhere / np.linalg.norm(anywhere, axis=1)[:, None] @ up[::9].T, axis=1)
    assert np.degrees(np.arccos(nearest.min())) < 2.5
    tilts = np.arcsin(calibrated_range(three, Limits(tilt={"x": (-0.5, 0.3)}))[0])
    found = [*tilts.min(axis=0), *tilts.max(axis=0)]
    assert found == pytest.approx([-0.5, -np.pi / 2, -np.pi / 2, 0.3, np.pi / 2, np.pi / 2], abs=0.03)
    limits = Limits(tilt={"x": (-0.5, 0.3), "y": (-0.2, 0.9)})
    for channels, numbers in (("x", (65, 1)), ("xy", (65, 65)), ("yx", (65, 65))):
        two = replace(ideal(channels, 1.0).coefficients, mounting=Mounting(roll) if len(channels) == 2 else None)
        up, celsius = calibrated_range(two, limits)
        tilts = np.arcsin(up[:, :2])
        for axis, (low, high), number in zip(range(2), limits.tilt.values(), numbers, strict=True):
            whole = np.linspace(low, high, number) if number > 1 else [0.0]
            assert np.unique(tilts[:, axis].round(9)) == pytest.approx(whole, abs=1e-8)
        assert set(celsius) == {25.0}
        assert up[:, 2] == pytest.approx(
            np.sqrt(1.0 - up[:, 0] ** 2 - up[:, 1] ** 2) * (-1.0 if two.mounting and roll else 1.0)
        )


@compiling
def test_the_header_computes_the_tilts_of_apply(tmp_path: Path) -> None:
    """Twenty random calibrations with all terms; benchmarks/export.py tries ten thousand."""
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


@compiling
def test_tilts_pitch_and_roll_are_defined_as_those_of_apply(tmp_path: Path) -> None:
    """Beyond 2 g there is no tilt; at 45° upside down roll is 180°; an arcsine of up to 1.02 is ±90°."""
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


@compiling
def test_the_header_takes_no_axis_below_the_horizon(tmp_path: Path) -> None:
    """A channel that reads 0.1 of z, and -1 g and a little more: as apply has it, z is 0 there."""
    axes = ("x", "y", "z")
    leaning = Coefficients(axes[:2], axes, np.zeros(2), np.array([[1.0, 0.0, 0.1], [0.0, 1.0, 0.0]]))
    record = CalibrationRecord(SensorIdentity("recorded", "L-1", "m/s2", axes[:2]), leaning)
    rows = np.array([[-1.0, 0.0], [-1.003, 0.0]]), np.full(2, 25.0)
    (table,) = computed_in_c(tmp_path, [exported(Source(record, record.limits, "c0"), "c").text], [rows])
    assert table[:, 0] == pytest.approx([-1.0, -1.003], abs=1e-6)
    assert table[:, 1] == pytest.approx([-90.0, -90.0], abs=1e-3)


@compiling
@pytest.mark.parametrize("unit", ["count", "V"])
def test_integers_compute_the_same(unit: str, tmp_path: Path) -> None:
    """180 readings at 40 temperatures, of a sensor that drifts, and of one that does not, in µV."""
    record, k = drifting(), np.arange(180)
    if unit == "V":
        known = record.coefficients
        known = replace(known, offset=known.offset * 1e-6, sensitivity=known.sensitivity * 1e-6, thermal=None)
        record = replace(record, sensor=record.sensor.replaced(unit=unit), coefficients=known)
    text = exported(Source(record, record.limits), "c-fixed").text
    assert ("in 1/1000000 of its unit" in text) is ("(void)centicelsius" in text) is (unit == "V")
    (tmp_path / "tilt.h").write_text(text)
    program = compiled(tmp_path, COUNTS.format(setup="", start="", end="", count=180, kind="int32_t", body=FIXED))
    run = subprocess.run([program], capture_output=True, text=True, check=True)
    computed = np.array(run.stdout.split(), dtype=float).reshape(180, 2) * 1e-6
    read = np.column_stack([200.0 + k % 1649, 1900.0 - (7 * k) % 1699]) * (1e-6 if unit == "V" else 1.0)
    expected = np.array(Compensation(record.coefficients)(read, k % 40 * 1.0).gravity)
    assert np.abs(computed - expected).max() < 3e-6
    foreseen = TARGETS["c-fixed"](Source(record, record.limits)).formula(read, k % 40 * 1.0)
    assert (np.rint(foreseen * 1e6) == np.rint(computed * 1e6)).all()


def directions() -> Array:
    up = np.random.default_rng(5).normal(size=(50, 3))
    return up / np.linalg.norm(up, axis=1)[:, None]


def three_axes(unit: str, cross: float = 0.01) -> CalibrationRecord:
    """Return a calibration of three axes with a drift, in counts, g or m/s²."""
    scale = {"count": 256.0, "g": 1.0, "m/s2": G}[unit]
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


def test_fusion_is_what_its_own_package_computes(tmp_path: Path) -> None:
    imufusion = pytest.importorskip("imufusion")
    record = three_axes("count")
    text = export(tmp_path, record, "fusion", allow="2")
    assert text.startswith(
        f"/* Calibration of recorded I-1, made by tiltcal {__version__}: readings in count, result in g."
    )
    found = [
        np.array(re.findall(r"(-?[\d.e+-]+)f", line.partition("{")[2]), dtype=float) for line in text.splitlines()[1:]
    ]
    matrix, sensitivity, offset = found[0].reshape(3, 3), *found[1:]
    result = [
        imufusion.model_inertial(row, matrix, sensitivity, offset) for row in record.coefficients.predict(directions())
    ]
    assert np.array(result) == pytest.approx(directions(), abs=3e-6)


@pytest.mark.parametrize("stated", [None, 9.79])
def test_ros_corrects_by_the_formula_of_imu_calib_and_states_the_covariance(
    stated: float | None, tmp_path: Path
) -> None:
    """``SM * raw - bias``: imu_calib, accel_calib.cpp; level, x reads offset.x + sensitivity.x.z."""
    gravity = stated or G
    covariance = Covariance(parameters=("offset.x", "sensitivity.x.z"), matrix=((4e-4, 1e-4), (1e-4, 9e-4)))
    noise = {"x": 0.03, "y": 0.04} | ({"z": 0.05} if stated else {})
    uncertainty = Uncertainty(single_reading=noise, covariance=covariance)
    record = replace(three_axes("m/s2"), uncertainty=uncertainty, derived=DerivedRecord(gravity_m_s2=stated))
    record = replace(record, provenance=Provenance(ended="2026-05-01T12:00:00Z"))
    text = export(tmp_path, replace(record, sensor=record.sensor.replaced(serial="µ*/1")), "ros")
    said = "# Calibration of 2026-05-01 of recorded ?* /1, made by tiltcal "
    assert text.splitlines()[0] == f"{said}{__version__}: readings in m/s2, result in m/s2."
    file = yaml.safe_load(text)
    corrected = record.coefficients.predict(directions()) @ np.array(file["SM"]).reshape(3, 3).T - file["bias"]
    assert corrected == pytest.approx(directions() * gravity, abs=1e-6)
    inverse = np.linalg.inv(record.coefficients.sensitivity) * gravity
    total = np.diag([0.03**2 + 4e-4 + 9e-4 + 2e-4, 0.04**2, 0.05**2 if stated else 0.0])
    found = np.array(file["linear_acceleration_covariance"]).reshape(3, 3)
    assert found == pytest.approx(inverse @ total @ inverse.T, rel=1e-6)


@pytest.mark.parametrize("unit", ["m/s2", "g"])
def test_autopilots_correct_each_axis_by_itself(unit: str, tmp_path: Path) -> None:
    """PX4: (raw - offset) scale, m/s², of tab-separated parameters; ArduPilot: the same, of NAME,VALUE."""
    record, px4, pilot = three_axes(unit, cross=0.0), [], []
    for axis, offset, share in zip("XYZ", (0.02, -0.03, 0.05), (1.01, 0.99, 1.02), strict=True):
        numbers = f"{offset * G:.9g}", f"{1.0 / share:.9g}"
        for end, number in zip(("OFF", "SCALE"), numbers, strict=True):
            px4.append(f"1\t1\tCAL_ACC0_{axis}{end}\t{number}\t9")
        pilot += [f"INS_ACCOFFS_{axis},{numbers[0]}", f"INS_ACCSCAL_{axis},{numbers[1]}"]
    for target, lines in (("px4", px4), ("ardupilot", pilot)):
        assert export(tmp_path, record, target).splitlines()[2:] == lines


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
    assert result.stderr.splitlines() == [f"the driver has no in_accel_{axis}_calibscale" for axis in "yz"]
    assert [(device / f"in_accel_{axis}_calibbias").read_text() for axis in "xyz"] == ["-5\n", "8\n", "-13\n"]
    assert float((device / "in_accel_x_calibscale").read_text()) == pytest.approx(G / 256.0 / 1.01 / 0.0383, rel=1e-5)


CROSS, DRIFT, BENT = "cross-axis sensitivity and mounting", "drift with temperature", "non-linearity"
THIRD, LAG = "the third component of gravity away from level", "thermal lag"
NO_DRIFT = np.zeros((3, 1))


def test_what_a_target_does_not_hold_is_named_and_bounded(tmp_path: Path) -> None:
    """A cross-axis sensitivity of 1 % is an angle of asin 0.01 = 0.57°."""
    plain = three_axes("m/s2", cross=0.0).coefficients
    thermal, bent = Thermal(25.0, None, NO_DRIFT, NO_DRIFT), np.array([[0.0], [0.001], [0.0]])
    assert plain.thermal is not None
    two = Coefficients(("x", "y"), ("x", "y"), np.zeros(2), np.eye(2))
    for changed, named in (
        (replace(plain, thermal=None, sensitivity=plain.sensitivity + np.eye(3, k=1)), [CROSS]),
        (plain, [DRIFT]),
        (replace(plain, thermal=replace(thermal, gain=NO_DRIFT + 1e-4)), [DRIFT]),
        (replace(plain, thermal=thermal, nonlinearity=bent), [BENT]),
        (replace(plain, thermal=replace(thermal, lag=9.0)), [LAG]),
        (replace(plain, thermal=thermal, nonlinearity=0.0 * bent), []),
        (replace(two, axes=("x", "y", "z"), sensitivity=np.eye(2, 3)), [THIRD]),
        (two, []),
    ):
        assert terms(changed) == named
    every = replace(plain, sensitivity=plain.sensitivity + np.eye(3, k=1), nonlinearity=bent)
    every = replace(every, thermal=replace(plain.thermal, lag=9.0))
    record = replace(three_axes("m/s2"), coefficients=every)
    for target, left_out in {
        "c": [LAG], "c-fixed": [BENT, LAG], "fusion": [DRIFT, BENT, LAG], "ros": [DRIFT, BENT, LAG],
        "px4": [CROSS, DRIFT, BENT, LAG], "ardupilot": [CROSS, DRIFT, BENT, LAG], "python": [], "json": [],
    }.items():  # fmt: skip
        assert list(exported(Source(record, record.limits), target).left_out) == left_out
    record = three_axes("m/s2", cross=0.0)
    record.coefficients.sensitivity[0, 1] = 0.01 * G
    (tmp_path / "cal.yaml").write_text(record.text)
    result = tiltcal("export", "cal.yaml", "--to", "px4", "-o", "out.params", cwd=tmp_path, code=2)
    assert result.stderr.startswith(f"px4 does not hold {CROSS}, {DRIFT}\ntiltcal: angles differ from those of apply ")
    stated = float(re.search(r"at most ([\d.]+)°", result.stderr).group(1))
    assert 0.57 < stated < 0.7
    assert result.stderr.endswith(
        "°, more than --allow 0.1: take another target, or allow it\n".replace("°", " calibrated range")
    )
    assert not (tmp_path / "out.params").exists()
    printed = tiltcal("export", "cal.yaml", "--to", "px4", "--allow", str(stated + 0.01), cwd=tmp_path, code=0)
    assert (printed.stdout[:14], printed.stderr.count("\n")) == ("# Calibration ", 2)


@pytest.mark.parametrize(
    ("old", "new", "options", "message"),
    [
        ("", "", "px4", "px4 corrects readings in m/s2, and this calibration is of readings in count"),
        ("unit: count", "unit: V", "iio", "iio corrects raw counts, and this calibration is of readings in V"),
        ("", "", "ros --fixed", "--fixed is for c; ros has one form: leave it out"),
        ("", "", "c --name 2tilt", "--name '2tilt' is no name in C"),
        ("", "", "c --allow nan", "--allow nan: it is at least 0 degrees"),
        ("", "", "c --allow -1", "--allow -1: it is at least 0 degrees"),
        ("", "", "c --allow 0", "more than --allow 0: take another target"),
        ("0.0512", "1e+13", "c --fixed", "a temperature term is too large for integers of 64 bits"),
        (None, PLAIN, "fusion", "fusion takes three axes, and S-1 has fewer: export to c"),
        (
            None,
            PLAIN + "  mounting: {roll: 90}\n",
            "json",
            "the mounting is on edge, where two channels leave the sign",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(
    tmp_path: Path, old: str | None, new: str, options: str, message: str
) -> None:
    text = three_axes("count").text
    assert old is None or old in text
    (tmp_path / "cal.yaml").write_text(new if old is None else text.replace(old, new, 1))
    refused = tiltcal("export", "cal.yaml", "--to", *options.split(), "-o", "out", cwd=tmp_path, code=2)
    assert message in refused.stderr
    assert not (tmp_path / "out").exists()


def test_python_holds_all_and_needs_no_numpy() -> None:
    """Random calibrations of two and three axes with drift, non-linearity and mounting, row by row."""
    for seed in range(20):
        record = random_calibration(seed, reach=0.7)
        exports = {target: exported(Source(record, record.limits), target) for target in ("python", "json")}
        offset = record.coefficients.offset
        assert all(one.bound < 0.001 and not one.left_out for one in exports.values())
        assert re.findall(r"import \w+", exports["python"].text) == ["import math"]
        namespace: dict[str, object] = {}
        exec(exports["python"].text, namespace)
        u, celsius = readings(record, 20, seed)
        found = [namespace["g"](*row) for row in zip(u.tolist(), celsius.tolist(), strict=True)]  # type: ignore[operator]
        true = Compensation(record.coefficients, record.limits)(u, celsius).gravity
        assert np.array(found) == pytest.approx(np.array(true), abs=1e-9)
        u = np.concatenate([offset + length * (u - offset) for length in (0.3, 0.6, 1.0, 1.9, 2.3)])
        angles = [namespace["degrees"](*row) for row in zip(u.tolist(), np.tile(celsius, 5).tolist(), strict=True)]  # type: ignore[operator]
        true = Compensation(record.coefficients)(u, np.tile(celsius, 5)).tilt
        assert np.array(angles) == pytest.approx(np.array(true), abs=1e-6, nan_ok=True)
        assert exports["json"].text.startswith('{\n "A": [')
        data = json.loads(exports["json"].text)
        assert {
            name: namespace[name]
            for name in data.keys() - {"A", "b", "unit", "bound", "formula", "lag", "drift", "reference"}
        }.items() <= data.items()


@pytest.mark.parametrize("lag", [0.9, -0.6])
def test_python_follows_the_lag_of_the_element(lag: float) -> None:
    record = three_axes("count")
    coefficients = record.coefficients
    assert coefficients.thermal is not None
    lagging = replace(record, coefficients=replace(coefficients, thermal=replace(coefficients.thermal, lag=lag)))
    namespace: dict[str, object] = {}
    exec(exported(Source(lagging, record.limits), "python").text, namespace)
    time = np.array([0.0, 0.1, 0.5, 3.0, 3.1, 40.0])
    celsius = 20.0 + 0.02 * time + np.sin(time)
    found = [namespace["element"](*row) for row in zip(time.tolist(), celsius.tolist(), strict=True)]  # type: ignore[operator]
    assert found == pytest.approx(ThermalLag(lag)(time, celsius), abs=1e-9)
