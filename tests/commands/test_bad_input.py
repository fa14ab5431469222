"""Bad input: a clear error with file, line and key, exit code 2, and nothing written."""

import io
import subprocess
from pathlib import Path

import pytest
from support import FIXTURES
from support.command import TILTCAL, called, measure, tiltcal

CALIBRATION = """\
tiltcal: 1
kind: tilt
sensor: {model: sca100t-d02, serial: S-0042, unit: count, channels: [x, y]}
calibration:
  offset: {x: 1024.6, y: 1021.9}
  sensitivity:
    x: {x: 818.2, y: 9.1}
    y: {x: -6.4, y: 820.7}
"""
MEASURE = ("measure", "plane", "--sensor", "sca100t-d02", "--address", "sim:", "--serial", "S-1", "-o", "S-1.yaml")
LOG = "time,x,y\n0,1024,1022\n1,1433,1020\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "cal.yaml").write_text(CALIBRATION)
    (tmp_path / "log.csv").write_text(LOG)
    return tmp_path


def test_a_wrong_calibration_file(folder: Path) -> None:
    tiltcal("check", "cal.yaml", cwd=folder, code=0)
    for old, new, line, key in (
        ("  offset:", "  ofset:", 5, "ofset"),
        ("y: 1021.9", "y: .nan", 5, "calibration.offset.y"),
        ("{x: -6.4, y: 820.7}", "{x: 818.2, y: 9.1}", 6, "calibration.sensitivity"),
        ("kind: tilt", "kind: tilted", 2, "kind"),
    ):
        (folder / "cal.yaml").write_text(CALIBRATION.replace(old, new))
        for name, *rest in (("apply", "log.csv", "-o", "out.csv"), ("check",)):
            result = tiltcal(name, "cal.yaml", *rest, cwd=folder, code=2)
            assert result.stdout == "", (name, new)
            assert f"cal.yaml:{line}: " in result.stderr, (name, new)
            assert key in result.stderr, (name, new)
            assert not (folder / "out.csv").exists()


def test_a_wrong_log_and_a_file_that_is_not_there(folder: Path) -> None:
    for log, said in (
        ("", "log.csv"),
        ("time,x,y\n", "log.csv:2: the log has a header and no rows"),
        ("time,x\n0,1024\n", "'y'"),
        ("time,x,y\n0,1024,fast\n", "log.csv:2: "),
        ("time,x,y\n0,1024\n", "log.csv:2: "),
        ("time,x,y\n0,1024,1022\n1,2,2.\n", "log.csv:3: "),
        (None, "log.csv"),
    ):
        (folder / "log.csv").unlink() if log is None else (folder / "log.csv").write_text(log)
        result = tiltcal("apply", "cal.yaml", "log.csv", "-o", "out.csv", cwd=folder, code=2)
        assert said in result.stderr, log
        assert not (folder / "out.csv").exists()
    (folder / "cal.yaml").unlink()
    result = tiltcal("apply", "cal.yaml", "log.csv", cwd=folder, code=2)
    assert "cal.yaml" in result.stderr


FIT = ("log.csv", "--segments", "seg.csv", "--unit", "count", "--serial", "S-1", "-o", "new.yaml")
ROWS = "1,2,3\n1.5,2,3\n" * 20
TWO = "9.8,0.1,0.2\n9.9,0.2,0.1\n" * 10 + "0.1,9.8,0.3\n0.2,9.7,0.2\n" * 10


def test_wrong_segments(folder: Path) -> None:
    for segments, rows, says in (
        ("x-upp,0,9\n", ROWS, "seg.csv:2: six-face has no position 'x-upp' (did you mean 'x-up'?)"),
        ("x-up,0,99\n", ROWS, "seg.csv:2: segment x-up: ends at row 99; log.csv has 40 rows"),
        ("x-up,0,20\ny-up,20,40\n", TWO, "add the positions level (+z up) and upside down (+z down)"),
    ):
        (folder / "seg.csv").write_text("position,start,end\n" + segments)
        (folder / "log.csv").write_text("x,y,z\n" + rows)
        assert says in tiltcal("fit", "six-face", *FIT, cwd=folder, code=2).stderr
        assert not (folder / "new.yaml").exists()
    assert "'six-face'" in tiltcal("fit", "six-faces", *FIT, cwd=folder).stderr


def test_a_damaged_journal_names_the_line(tmp_path: Path) -> None:
    measure(cwd=tmp_path)
    journal = tmp_path / "S-1.journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    lines[200] = lines[200].replace(b"1", b"2", 1)
    journal.write_bytes(b"".join(lines))
    for command in (("replay",), ("check",), ("measure", "--resume")):
        result = tiltcal(*command, "S-1.journal.jsonl", cwd=tmp_path, code=2)
        assert "S-1.journal.jsonl:201: the line is damaged" in result.stderr


def test_an_unknown_command_offers_the_near_one() -> None:
    assert "measure" in tiltcal("mesure", code=2).stderr


def test_a_serial_number_with_a_control_character(tmp_path: Path) -> None:
    """The file would be refused when it is read back, and the terminal obeys the character."""
    serial = ("--serial", "S\x1b[2J1", "-o", "new.yaml")
    (tmp_path / "log.csv").write_text("x,y,z\n1,2,3\n")
    (tmp_path / "seg.csv").write_text("position,start,end\nx-up,0,1\n")
    for result in (
        measure(*serial, cwd=tmp_path),
        tiltcal("fit", "six-face", "log.csv", "--segments", "seg.csv", "--unit", "V", *serial, cwd=tmp_path),
    ):
        assert result.returncode == 2
        assert "the serial number: the control character '\\x1b' is not allowed" in result.stderr
        assert not (tmp_path / "new.yaml").exists()


@pytest.mark.parametrize(
    ("closed", "arguments"),
    [
        ("stdin", (*MEASURE, "--operator", "terminal")),
        ("stdin", (*MEASURE, "--operator", "json")),
        ("stdout", (*MEASURE, "--operator", "json")),
        ("stdin", ("apply", FIXTURES / "plane.yaml", "-")),
    ],
)
def test_a_closed_standard_stream(closed: str, arguments: tuple[str | Path, ...], tmp_path: Path) -> None:
    """Python has None in its place."""
    streams = {"stdin": io.StringIO(), "stdout": io.StringIO(), "stderr": io.StringIO()} | {closed: None}
    assert called(arguments, tmp_path, **streams) == 2
    assert f"standard {closed.removeprefix('std')}put is closed" in streams["stderr"].getvalue()
    assert "continue with" not in streams["stderr"].getvalue(), "nothing was captured"
    assert not list(tmp_path.iterdir())


def test_a_session_without_standard_error(tmp_path: Path) -> None:
    arguments = [*TILTCAL, *MEASURE, "--operator", "sim", "--samples", "3"]
    done = subprocess.run(["sh", "-c", 'exec "$@" 2>&-', "sh", *arguments], cwd=tmp_path, check=False)
    assert done.returncode == 0
    assert (tmp_path / "S-1.yaml").exists()
