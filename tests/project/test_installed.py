"""What `pip install tiltcal` brings is enough: the wheel is complete, and a session loads nothing of an extra."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from zipfile import ZipFile

import pytest
from support import ROOT
from support.command import loaded_by

import tiltcal

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))

SESSION = [
    "measure plane --sensor sca100t-d02 --address sim:seed=1 --serial S-1 --operator sim --samples 20 -o S-1.yaml",
    "check S-1.yaml S-1.journal.jsonl",
    "record --sensor sca100t-d02 --address sim:seed=1 --rows 20 -o log.csv",
    "apply S-1.yaml log.csv -o tilt.csv",
    "fit plane means.csv --table --unit V --serial V-8 --jig 0.1 -o V-8.yaml",
]
EXTRAS = {
    *("spidev", "gpiod", "vcd", "pymodbus", "jinja2", "matplotlib", "h5netcdf", "h5py", "xarray", "distributed"),
    *("rosbags", "pandas", "pyarrow", "pytest", "setuptools"),
}
"""What an extra brings."""
MEANS = "position,x,y\nx-tilt1,3.5,2.5\nx-tilt2,1.5,2.5\ny-tilt1,2.5,3.5\ny-tilt2,2.5,1.5\n"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy of the source, where setuptools may leave its traces."""
    pytest.importorskip("setuptools", minversion="77", reason="setuptools is too old to build the wheel")
    folder = tmp_path_factory.mktemp("wheel")
    for name in ("tiltcal", "drivers", "procedures"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, folder / "source" / name, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE", "MANIFEST.in"):
        shutil.copy(ROOT / name, folder / "source")
    build = "pip wheel -v --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir"
    done = subprocess.run(
        [sys.executable, "-m", *build.split(), folder, folder / "source"], check=True, capture_output=True, text=True
    )
    assert "Warning" not in done.stdout + done.stderr
    (built,) = folder.glob("*.whl")
    return built


def test_every_package_folder_is_listed() -> None:
    folders = {
        path.parent for root in ("tiltcal", "drivers", "procedures") for path in ROOT.glob(f"{root}/**/__init__.py")
    }
    shipped = {inside_tiltcal(folder.relative_to(ROOT)).as_posix().replace("/", ".") for folder in folders}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == shipped


def test_the_wheel_holds_tiltcal_alone(wheel: Path) -> None:
    held = set(ZipFile(wheel).namelist())
    assert {name.partition("/")[0] for name in held} == {"tiltcal", f"tiltcal-{tiltcal.__version__}.dist-info"}
    modules = [path for root in ("tiltcal", "drivers") for path in ROOT.glob(f"{root}/**/*.py")]
    wanted = [
        *modules,
        *ROOT.glob("procedures/*.yaml"),
        *ROOT.glob("tiltcal/report/templates/*"),
        *ROOT.glob("tiltcal/bench/page/*"),
    ]
    assert {inside_tiltcal(path.relative_to(ROOT)).as_posix() for path in wanted} <= held
    assert "tiltcal/py.typed" in held
    entries = ZipFile(wheel).read(f"tiltcal-{tiltcal.__version__}.dist-info/entry_points.txt").decode()
    assert "[pytest11]\ntiltcal = tiltcal.pytest_plugin" in entries


def inside_tiltcal(path: Path) -> Path:
    """Where a file of the repository is in the import package."""
    return path if path.parts[0] == "tiltcal" else "tiltcal" / path


def test_the_page_of_an_index_has_links_that_lead_somewhere(wheel: Path) -> None:
    metadata = ZipFile(wheel).read(f"tiltcal-{tiltcal.__version__}.dist-info/METADATA").decode()
    links = re.findall(r"\]\(([^)]*)\)", metadata)
    source = PROJECT["project"]["urls"]["Source"]
    assert f"{source}/raw/main/docs/tilt-error.svg" in links
    assert f"{source}/blob/main/docs/how-to/arduino.md" in links
    assert all(link.startswith(("https://", "#")) for link in links)


def test_a_session_needs_no_extra(tmp_path: Path) -> None:
    (tmp_path / "means.csv").write_text(MEANS)
    lines = [line.split() for line in SESSION]
    loaded = loaded_by(
        f"import os\nfrom tiltcal.cli.main import run\nos.chdir({str(tmp_path)!r})\n"
        f"assert [run(line) for line in {lines}] == [0] * {len(lines)}"
    )
    assert "polars" in loaded
    assert not loaded & EXTRAS
    assert len((tmp_path / "tilt.csv").read_text().splitlines()) == 21
