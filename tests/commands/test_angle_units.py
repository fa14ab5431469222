"""Devices that print angles or slopes: exact for a zero, a scale and a turn, whatever unit and convention they have."""

import json
import shutil
from math import cos, degrees, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import tiltcal as run
from support.export_study import computed_in_c
from support.virtual_device import VirtualDevice

import tiltcal
from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.drivers import find_model
from tiltcal.drivers.model import OF_G, OF_TILT
from tiltcal.files.procedure import Positions, find_procedure

PRINTS = {
    "deg": lambda degrees: degrees,
    "mrad": lambda degrees: 1000.0 * np.radians(degrees),
    "mm/m": lambda degrees: 1000.0 * np.tan(np.radians(degrees)),
}
GRID = np.array([gravity_from_tilt({"x": x, "y": y}) for x in (-30, -12, 0, 30) for y in (-30, 0, 21)])


def test_the_units_of_a_small_tilt_and_of_gravity() -> None:
    assert [OF_G[unit] for unit in ("g", "mg", "m/s2", "mm/s2")] == [1.0, 1000.0, 9.80665, 9806.65]
    assert {unit: OF_TILT[unit] for unit in PRINTS} == pytest.approx(
        {name: of(degrees(1e-6)) * 1e6 for name, of in PRINTS.items()}
    )
    minutes = degrees(1.0) * 60
    assert [OF_TILT[unit] for unit in ("%", "arcmin", "arcsec")] == pytest.approx([100.0, minutes, 60 * minutes])


def device(up: np.ndarray, unit: str, angles: str, zero: tuple[float, float] = (3.0, -2.0)) -> np.ndarray:
    """What a device with a zero, a scale and a turn of 1.5° about the vertical prints, (n, 2), by the definitions."""
    turn = radians(1.5)
    across = up[:, 0] * sin(turn) + up[:, 1] * cos(turn)
    x = np.arcsin(up[:, 0] * cos(turn) - up[:, 1] * sin(turn))
    y = np.arcsin(across) if angles == "inclination" else np.arctan2(across, up[:, 2])
    return np.stack(
        [
            PRINTS[unit](scale * np.degrees(one) + off)
            for scale, one, off in zip((1.01, 0.98), (x, y), zero, strict=True)
        ]
    ).T


def table(procedure: str, unit: str, angles: str, u: float = 0.002) -> dict[str, object]:
    steps = find_procedure(procedure)
    assert isinstance(steps, Positions)
    readings = device(np.array([one.gravity for one in steps.positions]), unit, angles)
    names = [one.name for one in steps.positions]
    return {"position": names, "x": readings[:, 0], "y": readings[:, 1], "ux": [u] * len(names), "uy": [u] * len(names)}


def largest_error(cal: tiltcal.Calibration, unit: str, angles: str) -> float:
    readings = device(GRID, unit, angles)
    out = cal.apply({"x": readings[:, 0], "y": readings[:, 1]})
    tilts = np.stack([out["tilt_x"], out["tilt_y"]], axis=1)
    return float(np.abs(tilts - np.degrees(np.arcsin(GRID[:, :2]))).max())


@pytest.mark.parametrize("unit", PRINTS)
@pytest.mark.parametrize("angles", ["inclination", "euler"])
@pytest.mark.parametrize("procedure", ["plane", "zero-45", "multi-angle"])
def test_no_error_is_added(procedure: str, angles: str, unit: str, tmp_path: Path) -> None:
    cal = tiltcal.fit(procedure, table(procedure, unit, angles), serial="A", unit=unit, jig=0.01, angles=angles)
    cal.save(tmp_path / "a.yaml")
    again = tiltcal.read(tmp_path / "a.yaml")
    assert (again.sensor.reads, again.sensor.angles) == ("angle", angles)
    per_degree = 17.4533 if unit == "mrad" else 1.0
    assert again.sensitivity["x", "x"] == pytest.approx(1.01 * per_degree * cos(radians(1.5)), rel=1e-4)
    assert max(largest_error(cal, unit, angles), largest_error(again, unit, angles)) < 0.003
    module: dict[str, Any] = {}
    exec(run("export", "a.yaml", "--to", "python", cwd=tmp_path, code=0).stdout, module)
    found = [module["degrees"](row) for row in device(GRID, unit, angles).tolist()]
    assert np.array(found) == pytest.approx(np.degrees(np.arcsin(GRID[:, :2])), abs=0.003)
    x, y = device(np.array([[0.0, 0.0, 1.0]]), unit, angles, (4.0, -1.0))[0]
    seen = {"position": ["level"], "x": [x], "y": [y], "ux": [0.002], "uy": [0.002]}
    renewed = tiltcal.fit("level", seen, base=tmp_path / "a.yaml", serial="A", unit=unit, jig=0.01)
    change = {axis: renewed.offset[axis] - cal.offset[axis] for axis in "xy"}
    assert change == pytest.approx({"x": per_degree, "y": per_degree}, abs=0.003 * per_degree)


@pytest.mark.parametrize("unit", PRINTS)
def test_a_plan_foresees_what_a_fit_states_with_the_lean_that_is_stated(unit: str) -> None:
    data, stated = table("plane", unit, "inclination"), {"jig": 0.05, "alignment": 0.1}
    cal = tiltcal.fit("plane", data, serial="A", unit=unit, angles="inclination", **stated)
    address = f"sim:columns=x,y&unit={unit}&angles=inclination"
    planned = tiltcal.plan("plane", sensor="serial-columns", address=address, noise=0.02, **stated).uncertainty
    assert planned["sensitivity.x.z"] == pytest.approx({"mrad": 17.453}.get(unit, 1.0) * sin(radians(0.1)), rel=0.05)
    assert {name: cal.uncertainty[name] for name in planned} == pytest.approx(planned, rel=0.05)
    assert "(0.000° near level)" in str(cal)


def test_positions_show_the_convention_or_rows_in_which_it_counts_are_suspect() -> None:
    shown = tiltcal.fit("multi-angle", table("multi-angle", "deg", "euler"), serial="A", unit="deg", jig=0.01)
    said = "inclinations or Euler angles is not stated (--angles), and no position shows it: rows in which both axes "
    assert (shown.sensor.angles, [note for note in shown.fit.notes if note.startswith("incl")]) == ("euler", [])
    assert largest_error(shown, "deg", "euler") < 0.003
    unknown = tiltcal.fit("plane", table("plane", "deg", "euler"), serial="A", unit="deg", jig=0.01)
    assert unknown.fit.notes == (f"{said}exceed 5° are suspect",)
    out = unknown.apply({"x": [3.0, 13.0, 13.0], "y": [-2.0, -2.0, 8.0]})
    assert [*out["flag"]] == [1, 1, 3]
    assert [*out["reason"]] == [0, 0, 8]


def test_angles_wrap_and_end_at_a_right_angle() -> None:
    cal = tiltcal.fit(
        "plane", table("plane", "deg", "inclination"), serial="A", unit="deg", jig=0.01, angles="inclination"
    )
    offset, scale = cal.offset["x"], float(np.hypot(cal.sensitivity["x", "x"], cal.sensitivity["x", "y"]))
    out = cal.apply({"x": [offset + scale * angle for angle in (20.0, 380.0, 90.5, 95.0)], "y": [cal.offset["y"]] * 4})
    assert out["tilt_x"][:2] == pytest.approx([20.0, 20.0], abs=0.02)
    assert [*out["flag"][2:]] == [3, 4]
    assert out["reason"][2] & 1
    assert out["reason"][3] == 128
    assert np.isnan(out["tilt_x"][3])


def test_the_bench_the_replay_and_a_header_agree(tmp_path: Path) -> None:
    address = "sim:seed=3&columns=x,y&unit=mm/m&angles=euler"
    run(
        *("measure", "plane", "--sensor", "serial-columns", "--address", address, "--serial", "A-1", "--jig", "0.05"),
        *("--operator", "sim", "-o", "a.yaml"),
        cwd=tmp_path,
        code=0,
    )
    run("replay", "a.journal.jsonl", "--golden", "a.yaml", cwd=tmp_path, code=0)
    assert run("check", "a.yaml", cwd=tmp_path).stdout == "a.yaml: calibration, good\n"
    assert "takes components of gravity" in run("export", "a.yaml", "--to", "iio", cwd=tmp_path, code=2).stderr
    rows = [(10.0, 5.0), (-200.0, 250.0), (400.0, -100.0)]
    (tmp_path / "log.csv").write_text("x,y\n" + "".join(f"{x},{y}\n" for x, y in rows), encoding="utf-8")
    run("apply", "a.yaml", "log.csv", "-o", "tilt.csv", cwd=tmp_path, code=0)
    applied = [line.split(",")[4:6] for line in (tmp_path / "tilt.csv").read_text().splitlines()[1:]]
    module: dict[str, Any] = {}
    exec(run("export", "a.yaml", "--to", "python", cwd=tmp_path).stdout, module)
    for row, expected in zip(rows, applied, strict=True):
        assert module["degrees"](row) == pytest.approx([*map(float, expected)], abs=1e-9)
    assert np.isnan(module["degrees"]((np.nan, 5.0))).all()
    assert json.loads(run("export", "a.yaml", "--to", "json", cwd=tmp_path).stdout)["reads"] == "angle"
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    header = run("export", "a.yaml", "--to", "c", "--name", "c0", cwd=tmp_path, code=0).stdout
    (table,) = computed_in_c(tmp_path, [header], [(np.array([*rows, (np.nan, 5.0)]), np.full(4, 25.0))])
    assert np.isnan(table[3, 1::2]).all()
    assert table[:3, 1::2] == pytest.approx(np.array(applied, dtype=float), abs=1e-3)


def test_free_positions_and_a_convention_of_components_are_refused() -> None:
    readings = {axis: [0.1] * 20 for axis in "xyz"}
    with pytest.raises(tiltcal.TiltcalError, match="needs components of gravity"):
        tiltcal.fit("free", {"position": [f"p{n}" for n in range(20)], **readings}, serial="A", unit="deg")
    with pytest.raises(tiltcal.TiltcalError, match="is of readings that are angles, and sca100t-d02 reads count"):
        tiltcal.plan("plane", sensor="sca100t-d02", alignment=0.1)
    with pytest.raises(tiltcal.TiltcalError, match="is of readings that are angles"):
        tiltcal.fit("plane", table("plane", "deg", "euler"), serial="A", unit="V", angles="euler", jig=0.1)


@pytest.mark.parametrize(("stated", "y"), [("", 20.0), ("&angles=inclination", 20.0), ("&angles=euler", 21.344)])
def test_a_virtual_device_prints_in_its_convention(stated: str, y: float) -> None:
    ideal: dict[str, Any] = {"offset": {"x": 0.0, "y": 0.0}, "noise": {}, "drift": {}, "gain": {}}
    ideal["sensitivity"] = {axis: {axis: 57.29578} for axis in "xy"}
    device = VirtualDevice(find_model("serial-columns"), f"columns=x,y&unit=deg{stated}", **ideal)
    device.fixture.gravity = gravity_from_tilt({"x": 20.0, "y": 20.0})  # roll: atan2(0.34202, 0.87525)
    assert device.fresh().values == pytest.approx((20.0, y), abs=0.01)
