"""Numbers, dates, files and variables that no bench has: exit code 2 and what is wrong, never a traceback or a wait."""

import os
import platform
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from support import FIXTURES
from support.command import tiltcal, tiltcal_process

from tiltcal import __version__
from tiltcal.cli.main import run
from tiltcal.cli.talk import end_unforeseen

LOG = "time,x,y,temperature\n2000-01-02T00:00:00Z,1024,1030,20\n"


def changed(pattern: str, replacement: str, name: str = "plane.yaml") -> str:
    text, count = re.subn(pattern, replacement, (FIXTURES / name).read_text(), flags=re.MULTILINE)
    assert count
    return text


def test_a_calibration_that_no_bench_gives(tmp_path: Path) -> None:
    """A main sensitivity of 0 ended `level`, `verify` and `report` in a division by zero."""
    (tmp_path / "log.csv").write_text(LOG)
    for pattern, replacement, said in (
        (r"^    x: \{x: \d{3}(\.\d+)?, ", "    x: {x: 0, ", "x does not sense axis x"),
        (r'^  started: ".*"', '  started: "9999-12-31T23:59:59Z"', "is no date"),
    ):
        (tmp_path / "S.yaml").write_text(changed(pattern, replacement))
        for command in ("check S.yaml", "report S.yaml -o out.html", "fit level log.csv --base S.yaml -o out.yaml"):
            done = tiltcal(*command.split(), cwd=tmp_path, code=2)
            assert done.stderr.startswith("tiltcal: S.yaml:"), command
            assert said in done.stderr, command


def test_an_error_that_nothing_foresees_says_that_it_is_ours_and_what_to_send(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tiltcal.cli.check._is_journal", None)
    shutil.copy(FIXTURES / "mavs.yaml", tmp_path / "S.yaml")
    arguments = ["check", str(tmp_path / "S.yaml"), "-o", "out.csv"]
    with pytest.raises(TypeError) as failure:
        run(arguments[:2])
    with pytest.raises(TypeError):
        end_unforeseen(failure.value, arguments)
    monkeypatch.delenv("TILTCAL_TRACEBACK")
    assert end_unforeseen(failure.value, arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith(
        "tiltcal: this is an error of tiltcal: TypeError: 'NoneType' object is not callable at tiltcal.cli.check, line "
    )
    assert f", with {tmp_path}/S.yaml. Report it with this message, what the same command prints with" in said
    shown = tiltcal("--version", "--verbose").stdout.splitlines()
    assert said.rstrip().endswith(", ".join(shown))
    assert {f"tiltcal {__version__}", f"polars {pl.__version__}", f"numpy {np.__version__}"} <= set(shown)
    assert any(line.startswith(f"Python {platform.python_version()}") for line in shown)
    assert tiltcal("--version").stdout == f"tiltcal, version {__version__}\n"


def test_variables_of_the_environment_that_libraries_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.csv").write_text(LOG + '"2000-01-02T00:00:01Z",1024,1030,20\n')
    for name, value in (("POLARS_MAX_THREADS", "0"), ("MPLBACKEND", "nonsense")):
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("TILTCAL_TRACEBACK")
    applied = tiltcal_process("apply", FIXTURES / "mavs.yaml", "log.csv", "-o", "out.csv", cwd=tmp_path)
    assert (applied.returncode, "2 rows" in applied.stderr) == (0, True), applied.stderr
    drawn = tiltcal_process("report", FIXTURES / "mavs.yaml", "log.csv", "-o", "r.html", cwd=tmp_path)
    assert (drawn.returncode, drawn.stderr) == (0, "wrote r.html\n")


# One odd file in a folder of calibrations

MAVS = (FIXTURES / "mavs.yaml").read_bytes()
ODD: dict[str, Callable[[Path], object]] = {
    "not UTF-8": lambda path: path.write_bytes(MAVS.replace(b"\npositions:", b"\n# \xff\npositions:")),
    "a pipe": os.mkfifo,
    "holes": lambda path: (path.write_bytes(MAVS), os.truncate(path, 3_000_000_000)),
    "a device": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="the system has no /dev/zero")
@pytest.mark.parametrize("odd", ODD)
def test_an_odd_file_among_calibrations_is_named_and_left_out(odd: str, tmp_path: Path) -> None:
    folder = tmp_path / "calibrations"
    folder.mkdir()
    (folder / "good.yaml").write_bytes((FIXTURES / "plane.yaml").read_bytes())
    ODD[odd](folder / "odd.yaml")
    (tmp_path / "log.csv").write_text(LOG)
    shown = tiltcal("history", folder, cwd=tmp_path, code=0)
    assert "good.yaml" in shown.stdout
    assert f"{folder}/odd.yaml" in shown.stdout + shown.stderr
    tiltcal("report", folder, "-o", "fleet.html", cwd=tmp_path, code=0)
    assert "odd.yaml" in (tmp_path / "fleet.html").read_text()
    applied = tiltcal("apply", "--calibrations", folder, "log.csv", "--serial", "SIM-42", cwd=tmp_path, code=0)
    assert f"left out: {folder}/odd.yaml" in applied.stderr
