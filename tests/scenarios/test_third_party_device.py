"""A third party adds a sensor model by an entry point: a driver of its own, or a row of facts, and a bus of its own."""

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

EXAMPLE = ROOT / "examples" / "driver"
PAGE = ROOT / "docs" / "add-a-device.md"
BLOCK = re.compile(r"^```\w+ (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """DFRobot's module and the row of the page, installed as pip installs them, in a folder of their own."""
    pytest.importorskip("setuptools", minversion="77", reason="an old setuptools cannot build the example package")
    folder = tmp_path_factory.mktemp("site")
    # Building leaves its traces beside the source.
    source = shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("source") / "example")
    page = tmp_path_factory.mktemp("page")
    for name, content in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        (page / name).write_text(content, encoding="utf-8")
    install = (sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index")
    where = ("--disable-pip-version-check", "--target", str(folder), str(source), str(page))
    subprocess.run([*install, *where], check=True, capture_output=True)
    return folder


def tiltcal(*args: str, site: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    return subprocess.run([*TILTCAL, *args], cwd=cwd, env=environment, text=True, capture_output=True, check=False)


def test_a_row_of_facts_takes_25_lines() -> None:
    blocks = dict(BLOCK.findall(PAGE.read_text(encoding="utf-8")))
    assert len(blocks["tiltcal_lis3dh.py"].splitlines()) <= 25


def test_it_is_listed_measured_and_replayed(site: Path, tmp_path: Path) -> None:
    listed = tiltcal("devices", site=site, cwd=tmp_path).stdout
    assert "DFRobot TOY0048 module" in listed
    assert "ST LIS3DH three-axis accelerometer" in listed
    for model, procedure in (("dfrobot-sca100t", "plane"), ("my-lis3dh", "six-face")):
        sensor = ("--sensor", model, "--address", "sim:", "--serial", model, "-o", f"{model}.yaml")
        measured = tiltcal("measure", procedure, *sensor, "--operator", "sim", site=site, cwd=tmp_path)
        assert measured.returncode == 0, measured.stderr
        assert read_calibration(tmp_path / f"{model}.yaml").sensor.model == model
    replayed = tiltcal("replay", ".", "--golden", ".", site=site, cwd=tmp_path)
    assert (replayed.returncode, "2 journals are replayed" in replayed.stdout) == (0, True), replayed.stderr


def test_the_journals_of_the_package_give_their_files(site: Path, tmp_path: Path) -> None:
    journals = EXAMPLE / "journals"
    replayed = tiltcal("replay", str(journals), "--golden", str(journals), site=site, cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr


def test_a_bus_of_its_own_is_opened_by_the_package(site: Path, tmp_path: Path) -> None:
    done = tiltcal("probe", "--sensor", "my-lis3dh", "--address", "package:/dev/bridge0", site=site, cwd=tmp_path)
    assert done.returncode == 3
    assert "the bridge /dev/bridge0 is not connected" in done.stderr
    unknown = tiltcal("probe", "--sensor", "sca100t-d02", "--address", "package:/dev/bridge0", site=site, cwd=tmp_path)
    assert unknown.returncode == 2
    assert "sca100t-d02 is reached by spi: or sim:" in unknown.stderr


def test_without_the_package_the_name_is_unknown(tmp_path: Path) -> None:
    result = tiltcal("probe", "--sensor", "dfrobot-sca100t", "--address", "sim:", site=tmp_path, cwd=tmp_path)
    assert result.returncode == 2
    assert "no sensor model is called 'dfrobot-sca100t'" in result.stderr
