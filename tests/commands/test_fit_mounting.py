"""``tiltcal fit mounting``: how a calibrated sensor sits in its application, from a recorded log."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.command import tiltcal

from tiltcal.files.calibration import read_calibration

BASE = """tiltcal: 1
kind: tilt
sensor: {model: recorded, serial: M-1, unit: V, channels: [x, y, z]}
calibration:
  offset: {x: 2.5, y: 2.4, z: 2.6}
  sensitivity:
    x: {x: 2.0, y: 0.0, z: 0.0}
    y: {x: 0.0, y: 2.0, z: 0.0}
    z: {x: 0.0, y: 0.0, z: 2.0}
uncertainty: {}
"""
NAMES = ("level", "x-up", "x-down", "y-up", "y-down")
SIN, COS = 0.5, 3.0**0.5 / 2.0
APPLICATION = np.array([[0, 0, 1], [SIN, 0, COS], [-SIN, 0, COS], [0, SIN, COS], [0, -SIN, COS]])


def fitted(folder: Path, names: tuple[str, ...], *options: str, rotation: Rotation) -> subprocess.CompletedProcess[str]:
    """A log of the sensor in these positions of the application, 20 rows each, and the fit of it."""
    (folder / "base.yaml").write_text(BASE)
    rng = np.random.default_rng(3)
    rows, segments = ["x,y,z"], ["position,start,end"]
    for name in names:
        # a' = Rz(-yaw) Ry(-pitch) Rx(-roll) a leads from the sensor to the application.
        seen = rotation.inv().apply(APPLICATION[NAMES.index(name)])
        segments.append(f"{name},{len(rows) - 1},{len(rows) + 19}")
        readings = np.array([2.5, 2.4, 2.6]) + 2.0 * seen + rng.normal(0.0, 1e-4, (20, 3))
        rows += [",".join(f"{value:.6f}" for value in reading) for reading in readings]
    (folder / "log.csv").write_text("\n".join(rows) + "\n")
    (folder / "segments.csv").write_text("\n".join(segments) + "\n")
    return tiltcal(
        *("fit", "mounting", "log.csv", "--segments", "segments.csv", "--serial", "M-1", "-o", "out.yaml", *options),
        cwd=folder,
    )


@pytest.mark.parametrize("angles", [(12.0, -25.0, 40.0), (170.0, 40.0, -120.0)])
def test_the_rotation_that_the_log_was_made_with(angles: tuple[float, float, float], tmp_path: Path) -> None:
    roll, pitch, yaw = np.radians(angles)
    rotation = (
        Rotation.from_rotvec([0, 0, -yaw]) * Rotation.from_rotvec([0, -pitch, 0]) * Rotation.from_rotvec([-roll, 0, 0])
    )
    result = fitted(tmp_path, NAMES, "--base", "base.yaml", "--jig", "0.01", rotation=rotation)
    assert result.returncode == 0, result.stderr
    found = read_calibration(tmp_path / "out.yaml")
    mounting = found.coefficients.mounting
    assert mounting is not None
    assert np.degrees([mounting.roll, mounting.pitch, mounting.yaw]) == pytest.approx(angles, abs=0.02)
    assert found.coefficients.offset == pytest.approx([2.5, 2.4, 2.6], abs=0.0)
    assert found.provenance.made_by == "fit of a recorded log"
    assert "  roll " in result.stdout


def test_positions_that_were_exchanged_are_not_credible(tmp_path: Path) -> None:
    options = ("--base", "base.yaml", "--jig", "0.1")
    sound = fitted(tmp_path, NAMES, *options, rotation=Rotation.identity())
    assert "  degrees of freedom 7, uncertainty from stated jig, chi-square " in sound.stdout
    assert "not credible" not in sound.stdout
    named = (tmp_path / "segments.csv").read_text()
    (tmp_path / "segments.csv").write_text(named.replace("y-up", "y").replace("x-up", "y-up").replace("y,", "x-up,", 1))
    result = tiltcal(
        *("fit", "mounting", "log.csv", "--segments", "segments.csv", "-o", "out.yaml", *options), cwd=tmp_path
    )
    assert result.returncode == 0, result.stderr
    assert "with 7 degrees of freedom is not credible: the jig is worse than stated, a position" in result.stdout
    checked = tiltcal("check", "out.yaml", cwd=tmp_path)
    assert checked.returncode == 1
    assert "mounting: chi-square " in checked.stdout


def test_one_position_leaves_the_turn_about_gravity_undetermined(tmp_path: Path) -> None:
    result = fitted(tmp_path, ("level",), "--base", "base.yaml", rotation=Rotation.identity())
    assert result.returncode == 2
    assert "about" in result.stderr
    assert not (tmp_path / "out.yaml").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--unit", "V"), "mounting needs --base"),
        (("--base", "base.yaml", "--unit", "count"), "--unit count contradicts the --base, which has V"),
    ],
)
def test_refused_with_the_reason(options: tuple[str, ...], said: str, tmp_path: Path) -> None:
    result = fitted(tmp_path, NAMES, *options, rotation=Rotation.identity())
    assert result.returncode == 2
    assert said in result.stderr


def test_a_nominal_sensitivity_in_another_unit_stands_in_for_nothing(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("x,y\n" + "2.5,2.4\n2.51,2.41\n" * 20)
    (tmp_path / "seg.csv").write_text("position,start,end\nlevel-warm,0,20\nlevel-cold,20,40\n")
    result = tiltcal(
        *("fit", "two-temperature", "log.csv", "--segments", "seg.csv", "--sensor", "sca100t-d02", "--unit", "V"),
        *("--serial", "S-1", "-o", "out.yaml"),
        cwd=tmp_path,
    )
    assert result.returncode == 2
    assert "nominal sensitivity of sca100t-d02, which is per g in count and not in V" in result.stderr
