"""What `pip install tiltcal` brings is enough: the wheel in an environment that has the core dependencies alone."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
from importlib.metadata import Distribution, distribution
from importlib.util import find_spec
from pathlib import Path
from zipfile import ZipFile

import pytest
from support import ROOT

import tiltcal

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))

SESSION = [
    "measure plane --sensor sca100t-d02 --address sim:seed=1 --serial S-1 --operator sim --samples 20 -o S-1.yaml",
    "check S-1.yaml S-1.journal.jsonl",
    "record --sensor sca100t-d02 --address sim:seed=1 --rows 20 -o log.csv",
    "apply S-1.yaml log.csv -o tilt.csv",
    "fit plane means.csv --table --unit V --serial V-8 --jig 0.1 -o V-8.yaml",
]
MEANS = "position,x,y\nx-tilt1,3.5,2.5\nx-tilt2,1.5,2.5\ny-tilt1,2.5,3.5\ny-tilt2,2.5,1.5\n"


def name_of(requirement: str) -> str:
    return re.split(r"[<>=!~;\[\s(]", requirement)[0]


def with_what_they_need(names: list[str]) -> dict[str, Distribution]:
    """Return the installed distributions of these names and of all that they require without an extra."""
    found: dict[str, Distribution] = {}
    while names:
        name = re.sub(r"[-_.]+", "-", name_of(names.pop())).lower()
        if name not in found:
            found[name] = distribution(name)
            names += [one for one in found[name].requires or () if "extra ==" not in one and "sys_platform" not in one]
    return found


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy of the source, where setuptools may leave its traces."""
    pytest.importorskip("setuptools", minversion="77", reason="setuptools is too old to build the wheel")
    folder = tmp_path_factory.mktemp("wheel")
    for name in ("tiltcal", "drivers", "procedures"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, folder / "source" / name, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE", "MANIFEST.in"):
        shutil.copy(ROOT / name, folder / "source")
    build = "pip wheel -v --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir"
    done = subprocess.run(
        [sys.executable, "-m", *build.split(), folder, folder / "source"], check=True, capture_output=True, text=True
    )
    assert "Warning" not in done.stdout + done.stderr
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel's content and links to the core dependencies; its Python."""
    if sys.platform == "win32":
        pytest.skip("links need rights there")
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder / "venv", symlinks=True)
    (site,) = folder.glob("venv/lib/python*/site-packages")
    for one in with_what_they_need(list(PROJECT["project"]["dependencies"])).values():
        for top in {file.parts[0] for file in one.files or () if file.parts[0] not in ("..", "__pycache__")}:
            if not (site / top).exists():
                (site / top).symlink_to(Path(str(one.locate_file(top))))
    shutil.unpack_archive(wheel, site, "zip")
    return folder / "venv" / "bin" / "python"


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


def inside_tiltcal(path: Path) -> Path:
    """Where a file of the repository is in the import package."""
    return path if path.parts[0] == "tiltcal" else "tiltcal" / path


def test_the_extras_are_not_there(python: Path) -> None:
    extra = ["matplotlib", "jinja2", "h5py", "xarray", "distributed", "gpiod", "spidev", "vcd", "pytest", "pandas"]
    assert any(find_spec(name) for name in extra), "this environment has none of them: the test shows nothing"
    program = f"from importlib.util import find_spec; print([name for name in {extra} if find_spec(name)])"
    assert subprocess.run([python, "-c", program], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_a_session_needs_no_extra(python: Path, tmp_path: Path) -> None:
    (tmp_path / "means.csv").write_text(MEANS)
    program = (
        "import shlex, sys\n"
        "from tiltcal.cli.main import run\n"
        f"for line in {SESSION}:\n"
        "    code = run(shlex.split(line))\n"
        "    if code: sys.exit(f'{line}: exit code {code}')\n"
        "import serial, narwhals, tiltcal\n"
        "print(tiltcal.__file__)\n"
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([python, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith(str(python.parents[1]))
    assert len((tmp_path / "tilt.csv").read_text().splitlines()) == 21
