"""A third party adds a sensor model by an entry point, without touching this repository."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support import ROOT
from support.command import TILTCAL

from tiltcal.files.calibration import read_calibration

EXAMPLE = ROOT / "tests" / "support" / "example_device"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example package, installed as pip installs it, in a folder of its own."""
    pytest.importorskip("setuptools", minversion="77", reason="an old setuptools cannot build the example package")
    folder = tmp_path_factory.mktemp("site")
    # Building leaves its traces beside the source.
    source = shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("source") / "example")
    subprocess.run(
        [
            *(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"),
            *("--disable-pip-version-check", "--target", str(folder), str(source)),
        ],
        check=True,
        capture_output=True,
    )
    return folder


def tiltcal(*args: str, site: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    return subprocess.run([*TILTCAL, *args], cwd=cwd, env=environment, text=True, capture_output=True, check=False)


def test_it_is_listed(installed: Path, tmp_path: Path) -> None:
    listed = tiltcal("devices", site=installed, cwd=tmp_path).stdout
    assert re.search("^pendulum +Example pendulum", listed, re.MULTILINE)


def test_it_is_measured_and_replayed(installed: Path, tmp_path: Path) -> None:
    (tmp_path / "one-axis.yaml").write_text(
        "tiltcal: 1\nkind: procedure\nname: one-axis\ntitle: Two tilts of one axis\ndetermines: {axes: [x]}\n"
        "positions:\n  - {name: up, tilt: {x: 30}, prompt: Up}\n  - {name: down, tilt: {x: -30}, prompt: Down}\n"
    )
    measured = tiltcal(
        *("measure", "one-axis.yaml", "--sensor", "pendulum", "--address", "sim:", "--serial", "P-1"),
        *("-o", "P-1.yaml", "--operator", "sim"),
        site=installed,
        cwd=tmp_path,
    )
    assert measured.returncode == 0, measured.stderr
    found = read_calibration(tmp_path / "P-1.yaml").coefficients
    assert found.offset[0] == pytest.approx(0.05, abs=1e-4)
    assert found.sensitivity[0, 0] == pytest.approx(5.1, abs=2e-4)
    replayed = tiltcal("replay", "P-1.journal.jsonl", "--golden", "P-1.yaml", site=installed, cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr


def test_without_the_package_the_name_is_unknown(tmp_path: Path) -> None:
    result = subprocess.run(
        [*TILTCAL, "probe", "--sensor", "pendulum", "--address", "sim:"], capture_output=True, text=True, check=False
    )
    assert result.returncode == 2
    assert "pendulum" in result.stderr
