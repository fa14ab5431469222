"""``tiltcal export``: each target computes what ``apply`` does, within the bound that it states."""

from __future__ import annotations

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
from support.command import tiltcal

from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Array, Coefficients, Limits, Mounting, Thermal
from tiltcal.export.loss import largest_error
from tiltcal.export.targets import TARGETS, Source, exported
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, dump_calibration

COMPILERS = {
    "gcc": ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror"],
    "avr-gcc": ["avr-gcc", "-mmcu=atmega328p", "-Os", "-std=c99", "-Wall", "-Wextra", "-Werror"],
}
G = 9.80665


def random_calibration(seed: int, unit: str = "count", reach: float = 1.2) -> CalibrationRecord:
    """Return a calibration of one to three channels with every term that there is, or without some."""
    random = np.random.default_rng(seed)
    channels = ("x", "y", "z")[: random.integers(1, 4)]
    axes = channels if len(channels) != 2 or random.random() < 0.5 else ("x", "y", "z")
    scale = 800.0 if unit == "count" else G
    sensitivity = scale * (np.eye(len(channels), len(axes)) + 0.02 * random.normal(size=(len(channels), len(axes))))
    thermal = mounting = bent = None
    if random.random() < 0.7:
        drift = random.normal(size=(len(channels), 3)) * [1e-3, 1e-5, 1e-7] * scale
        gain = random.normal(size=(len(channels), 2)) * [1e-4, 1e-6]
        thermal = Thermal(25.0, (-20.0, 60.0), drift, gain)
    if random.random() < 0.4:
        bent = random.normal(size=(len(channels), 2)) * [0.002, 0.002]
    if len(channels) > 1 and random.random() < 0.5:
        mounting = Mounting(*random.uniform(-0.5, 0.5, 3))
    offset = random.normal(scale, scale / 10.0, len(channels))
    limits = Limits(tilt=dict.fromkeys(channels, (-reach, reach)) if len(channels) < 3 else {})
    return CalibrationRecord(
        SensorIdentity("recorded", f"R-{seed}", unit, channels),
        Coefficients(channels, axes, offset, sensitivity, thermal, mounting, bent),
        limits=limits,
    )


def readings(record: CalibrationRecord, count: int, seed: int) -> tuple[Array, Array]:
    """Return readings and temperatures within the calibrated range, by the forward model alone."""
    random, coefficients = np.random.default_rng(seed), record.coefficients
    up = random.normal(size=(count, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    if len(coefficients.channels) < 3:
        up[:, 2] = np.abs(up[:, 2])
        up[:, 1] *= len(coefficients.channels) == 2
        up[:, :2] *= np.sin(record.limits.tilt["x"][1])
        up[:, 2] = np.sqrt(1.0 - up[:, 0] ** 2 - up[:, 1] ** 2)
    temperature = random.uniform(-20.0, 60.0, count) if coefficients.thermal else np.full(count, 25.0)
    return coefficients.predict(up, temperature), temperature


def angles_apart(record: CalibrationRecord, gravity: Array, u: Array, celsius: Array) -> float:
    """Return the largest difference of an angle from that of the whole calibration, degrees."""
    true = Compensation(record.coefficients, record.limits)(u, celsius)
    if gravity.shape[1] == 3:
        cosine = np.sum(gravity * true.gravity, axis=1)
        sine = np.linalg.norm(np.cross(gravity, true.gravity), axis=1)
        return float(np.degrees(np.arctan2(sine, cosine)).max())
    return float(np.abs(np.degrees(np.arcsin(np.clip(gravity, -1.0, 1.0))) - true.tilt).max())


def compiled(folder: Path, program: str, compiler: str = "gcc") -> Path:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    (folder / "main.c").write_text(program)
    binary = folder / "main"
    subprocess.run([*COMPILERS[compiler], "main.c", "-lm", "-o", "main"], cwd=folder, check=True)
    return binary


@pytest.mark.parametrize("target", ["python", "json", "c-fixed", "fusion", "ros", "iio", "px4"])
def test_the_bound_is_never_exceeded(target: str) -> None:
    """Random calibrations at random attitudes and temperatures, which the bound has not seen."""
    judged = 0
    for seed in range(150):
        record = random_calibration(seed, "m/s2" if target == "px4" else "count")
        if target in ("fusion", "ros", "px4") and len(record.sensor.channels) < 3:
            continue
        source = Source(record, record.limits)
        export = TARGETS[target].export(source)
        u, celsius = readings(record, 300, seed)
        if export.step:
            u, celsius = np.rint(u / export.step) * export.step, np.rint(celsius * 100.0) / 100.0
        bound = largest_error(record.coefficients, record.limits, export.formula, export.rounding, export.step)
        assert angles_apart(record, export.formula(u, celsius), u, celsius) <= bound, seed
        judged += 1
    assert judged > 30


MAIN = """\
#include <stdio.h>
{headers}
int main(void)
{{
    double celsius;
    int which;
    while (scanf("%d %lf", &which, &celsius) == 2) {{
        switch (which) {{
{cases}
        }}
    }}
    return 0;
}}
"""
SINGLE = """\
        case {k}: {{ float u[c{k}_CHANNELS], g[c{k}_AXES], degrees[c{k}_AXES];
            for (int i = 0; i < c{k}_CHANNELS; ++i) if (scanf("%f", &u[i]) != 1) return 1;
            c{k}_g(u, (float)celsius, g);
            c{k}_degrees(u, (float)celsius, degrees);
            for (int i = 0; i < c{k}_AXES; ++i) printf("%.9g %.9g ", (double)g[i], (double)degrees[i]);
            printf("\\n"); break; }}
"""


def test_the_header_computes_the_tilts_of_apply(tmp_path: Path) -> None:
    """Twenty random calibrations with all terms, compiled with gcc and run."""
    records = [random_calibration(seed, reach=0.7) for seed in range(20)]
    bounds, headers, cases, rows = [], [], [], []
    for k, record in enumerate(records):
        result = exported(Source(record, record.limits, f"c{k}"), "c")
        (tmp_path / f"c{k}.h").write_text(result.text)
        bounds.append(result.bound)
        headers.append(f'#include "c{k}.h"')
        cases.append(SINGLE.format(k=k))
        rows.append(readings(record, 200, k))
    binary = compiled(tmp_path, MAIN.format(headers="\n".join(headers), cases="".join(cases)))
    lines = [
        f"{k} {t:.6f} {' '.join(f'{value:.9g}' for value in row)}"
        for k, (u, celsius) in enumerate(rows)
        for row, t in zip(u, celsius, strict=True)
    ]
    run = subprocess.run([binary], input="\n".join(lines), capture_output=True, text=True, check=True)
    printed = iter(run.stdout.splitlines())
    for record, bound, (u, celsius) in zip(records, bounds, rows, strict=True):
        table = np.array([next(printed).split() for _ in u], dtype=float)
        true = Compensation(record.coefficients, record.limits)(u, celsius)
        assert bound <= 0.002
        assert angles_apart(record, table[:, ::2], u, celsius) <= bound
        assert np.abs(table[:, 1::2] - true.tilt).max() <= bound


def test_the_header_is_clean_for_a_small_processor(tmp_path: Path) -> None:
    for number, fixed in enumerate([[], ["--fixed"]]):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert (
            tiltcal(
                "export",
                ROOT / "fixtures/cross-axis.yaml",
                "--to",
                "c",
                *fixed,
                "--allow",
                "1",
                "-o",
                folder / "tilt.h",
            ).returncode
            == 0
        )
        compiled(folder, '#include "tilt.h"\nint main(void) { return 0; }\n', "avr-gcc")


AVR = """\
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <stdio.h>
#include "tilt.h"
static int put(char c, FILE *f) {{ (void)f; while (!(UCSR0A & (1 << UDRE0))) {{ }} UDR0 = c; return 0; }}
static FILE serial = FDEV_SETUP_STREAM(put, NULL, _FDEV_SETUP_WRITE);
int main(void)
{{
    UCSR0B = 1 << TXEN0;
    stdout = &serial;
    for (int32_t k = 0; k < {count}; ++k) {{
        {body}
    }}
    cli();
    sleep_mode();
    return 0;
}}
"""
AVR_BODY = {
    "float": "float u[2] = {200 + 8 * k, 1900 - 9 * k}, g[2]; tilt_g(u, k % 40, g); "
    'printf("%ld %ld\\n", (long)(g[0] * 1e6f), (long)(g[1] * 1e6f));',
    "fixed": "int32_t u[2] = {200 + 8 * k, 1900 - 9 * k}, g[2]; tilt_g_fixed(u, (k % 40) * 100, g); "
    'printf("%ld %ld\\n", (long)g[0], (long)g[1]);',
}


@pytest.mark.parametrize("kind", ["float", "fixed"])
def test_an_arduino_computes_the_same(tmp_path: Path, kind: str) -> None:
    """An ATmega328P under simavr, at 180 readings and 40 temperatures, of a sensor that drifts."""
    if shutil.which("simavr") is None or shutil.which("avr-gcc") is None:
        pytest.skip("simavr or avr-gcc is not installed (Debian: apt install simavr gcc-avr avr-libc)")
    drift = np.array([[0.9, 4e-3], [-0.6, 2e-3]])
    thermal = Thermal(20.0, (0.0, 40.0), drift, np.array([[2e-4], [-1e-4]]))
    matrix = np.array([[819.0, 11.0], [-9.0, 822.0]])
    record = random_calibration(0)
    record = replace(
        record,
        sensor=SensorIdentity("recorded", "A-1", "count", ("x", "y")),
        coefficients=Coefficients(("x", "y"), ("x", "y"), np.array([1024.0, 1021.0]), matrix, thermal),
        limits=Limits(tilt={"x": (-1.2, 1.2), "y": (-1.2, 1.2)}),
    )
    target = "c-fixed" if kind == "fixed" else "c"
    (tmp_path / "tilt.h").write_text(exported(Source(record, record.limits), target).text)
    elf = compiled(tmp_path, AVR.format(count=180, body=AVR_BODY[kind]), "avr-gcc")
    command = ["simavr", "-m", "atmega328p", "-f", "16000000", str(elf)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    numbers = re.findall(r"(-?\d+) (-?\d+)\.", run.stdout + run.stderr)
    k = np.arange(180)
    u = np.column_stack([200.0 + 8.0 * k, 1900.0 - 9.0 * k])
    expected = Compensation(record.coefficients)(u, k % 40 * 1.0).gravity * 1e6
    assert np.abs(np.array(numbers, dtype=float) - expected).max() < 3.0


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


def export(folder: Path, record: CalibrationRecord, target: str, *, allow: str = "0.1") -> str:
    (folder / "cal.yaml").write_text(dump_calibration(record))
    result = tiltcal("export", "cal.yaml", "--to", target, "--allow", allow, "-o", "out", cwd=folder)
    assert result.returncode == 0, result.stderr
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
    (tmp_path / "cal.yaml").write_text(dump_calibration(record))
    result = tiltcal("export", "cal.yaml", "--to", "px4", "-o", "out.params", cwd=tmp_path)
    assert result.returncode == 2
    assert "px4 does not hold cross-axis sensitivity" in result.stderr
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
    (tmp_path / "cal.yaml").write_text(dump_calibration(three_axes(unit)))
    result = tiltcal("export", "cal.yaml", *options, cwd=tmp_path)
    assert (result.returncode, message in result.stderr) == (2, True), result.stderr


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


def test_json_and_python_say_the_same(tmp_path: Path) -> None:
    record = three_axes("count")
    data = json.loads(export(tmp_path, record, "json"))
    assert (data["unit"], data["reference"]) == ("count", 25.0)
    assert data["bound"] < 0.001
    u = record.coefficients.predict(directions())
    assert (u - data["b"]) @ np.transpose(data["A"]) == pytest.approx(directions(), abs=1e-9)
    namespace: dict[str, object] = {}
    exec(export(tmp_path, record, "python"), namespace)
    warm = record.coefficients.predict(directions(), np.full(50, 26.0))
    assert namespace["gravity"](warm, np.full(50, 26.0)) == pytest.approx(directions(), abs=1e-9)  # type: ignore[operator]


def test_show_prints_coefficients_tilts_and_the_map(tmp_path: Path) -> None:
    """Of a file without uncertainty the map alone; A and b turn the readings of the model back into gravity."""
    record = three_axes("count")
    (tmp_path / "cal.yaml").write_text(dump_calibration(record))
    lines = tiltcal("show", "cal.yaml", "--matrix", cwd=tmp_path).stdout.splitlines()
    rows = np.array([line.split()[-3:] for line in lines[-4:]], dtype=float)
    assert (record.coefficients.predict(directions()) - rows[3]) @ rows[:3].T == pytest.approx(directions(), abs=1e-6)
    shown = tiltcal("show", ROOT / "fixtures/cross-axis.yaml").stdout
    assert re.search(r"offset x +1026\.\d+ ± 0\.\d+ count", shown)
    assert re.search(r"tilt x within  ± 0\.0\d+° near level, 0\.0\d+° at -30°, 0\.0\d+° at 30°", shown)
    assert "p = " in tiltcal("show", ROOT / "fixtures/rotation.yaml").stdout
