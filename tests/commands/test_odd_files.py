"""Names that no file can have, pipes, links, and outputs that would replace an input."""

import os
import shutil
import subprocess
from pathlib import Path
from threading import Thread

import pytest
from support import FIXTURES, ROOT
from support.command import TILTCAL, measure, tiltcal, tiltcal_process

LONG = "a" * 300
TABLE = "position,x,y\nx-tilt1,3.5,2.5\nx-tilt2,1.5,2.5\ny-tilt1,2.5,3.5\ny-tilt2,2.5,1.5\n"
SIM = ("--sensor", "sca100t-d02", "--address", "sim:", "--serial", "S")
CSV = "x,y\n1024,1024\n1100,1000\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(FIXTURES / "plane.yaml", tmp_path)
    shutil.copy(FIXTURES / "plane.journal.jsonl", tmp_path)
    (tmp_path / "log.csv").write_text(CSV)
    (tmp_path / "segments.csv").write_text("position,start,end\nlevel,0,2\n")
    (tmp_path / "link.csv").symlink_to("log.csv")
    shutil.copy(ROOT / "procedures" / "plane.yaml", tmp_path / "own.yaml")
    return tmp_path


@pytest.mark.parametrize(
    "command",
    [
        ("apply", "plane.yaml", "log.csv", "-o", "log.csv"),
        ("apply", "plane.yaml", "log.csv", "-o", "link.csv"),
        ("fit", "level", "log.csv", "--segments", "segments.csv", "--base", "plane.yaml", "-o", "segments.csv"),
        ("match", "log.csv", "--pair", "x,y", "--orthogonal", "z", "-o", "log.csv"),
        ("noise", "log.csv", "--figure", "log.csv"),
        ("replay", "plane.journal.jsonl", "-o", "plane.journal.jsonl"),
        ("measure", "plane", *SIM, "-o", "new.yaml", "--journal", "new.yaml"),
        ("combine", "plane.yaml", "plane.yaml", "-o", "plane.yaml"),
        ("fit", "level", "log.csv", "--segments", "segments.csv", "--base", "plane.yaml", "-o", "plane.yaml"),
        ("measure", "level", *SIM[:4], "--base", "plane.yaml", "-o", "plane.yaml"),
        ("measure", "own.yaml", *SIM, "-o", "own.yaml"),
    ],
)
def test_an_output_replaces_no_input(command: tuple[str, ...], folder: Path) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert "it would replace" in tiltcal(*command, cwd=folder, code=2).stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("command", "new"),
    [
        (("measure", "plane", *SIM[:4], "--serial", "SIM-42", "--operator", "sim"), "sca100t-d02 SIM-42"),
        (("fit", "plane", "table.csv", "--table", "--unit", "V", "--jig", "0.1"), "recorded S-1"),
        (("combine", "S-1.yaml", "--mounting", "roll=180"), "sca100t-d02 SIM-42"),
        (("replay", "plane.journal.jsonl"), "sca100t-d02 SIM-42"),
    ],
)
def test_a_calibration_replaces_one_of_its_own_sensor_and_no_other_file(
    command: tuple[str, ...], new: str, folder: Path
) -> None:
    (folder / "table.csv").write_text(TABLE)
    shutil.copy(folder / "plane.yaml", folder / "S-1.yaml")
    if "fit" in command:
        tiltcal(*command, "--serial", "S-1", "-o", "first.yaml", cwd=folder, code=0)
        first, command = (folder / "first.yaml").read_text(), (*command, "--serial", "S-1")
    else:
        first = (folder / "plane.yaml").read_text()
    model, serial = new.split()
    for text, said in (
        ("notes of mine", "out.yaml: the file there is no calibration: move it away, or name another file with -o"),
        ((FIXTURES / "rotation.yaml").read_text(), f"is the calibration of pairs of gradiometer SIM-42, not of {new}"),
        (first.replace(f"serial: {serial}", "serial: B-7"), f"is the calibration of {model} B-7, not of {new}"),
        (first.replace(f"model: {model}", "model: adxl202"), f"is the calibration of adxl202 {serial}, not of {new}"),
    ):
        (folder / "out.yaml").write_text(text)
        done = tiltcal(*command, "-o", "out.yaml", cwd=folder, code=2)
        assert (folder / "out.yaml").read_text() == text, done.stderr
        assert said in done.stderr
        assert not (folder / "out.journal.jsonl").exists()
    ended = "2000-01-01T00:00:00.594Z"
    (folder / "out.yaml").write_text(first)
    done = tiltcal(*command, "-o", "out.yaml", cwd=folder, code=0)
    assert done.stderr.count("out.yaml: the calibration of ") == 1
    assert ("fit" in command) != (f"out.yaml: the calibration of {ended} is replaced" in done.stderr)


@pytest.mark.parametrize(
    "command",
    [
        ("check", LONG),
        ("report", LONG + ".yaml", "-o", "page.html"),
        ("fit", "plane", "log.csv", "--segments", LONG, "--unit", "V", "--serial", "S", "-o", "o.yaml"),
        ("measure", "plane", *SIM, "-o", LONG),
        ("measure", "plane", *SIM, "--address", f"sim:?twin={LONG}", "-o", "o"),
        ("record", *SIM[:4], "--rows", "2", "-o", LONG),
        ("demo", LONG),
    ],
)
def test_a_name_that_is_too_long_is_refused(command: tuple[str, ...], folder: Path) -> None:
    assert LONG in tiltcal(*command, cwd=folder, code=2).stderr


def test_a_calibration_may_come_out_of_a_pipe_where_it_is_read_once(folder: Path) -> None:
    os.mkfifo(folder / "pipe.yaml")
    for command, code in ((("check", "pipe.yaml"), 0), (("apply", "pipe.yaml", "log.csv"), 2)):
        feeder = Thread(target=lambda: (folder / "pipe.yaml").write_bytes((folder / "plane.yaml").read_bytes()))
        feeder.start()
        done = tiltcal(*command, cwd=folder)
        feeder.join()
        assert done.returncode == code, done.stderr
    assert "pipe.yaml: this is no file that can be read twice, and its checksum is needed" in done.stderr


def test_an_output_may_be_the_device_of_standard_output(folder: Path) -> None:
    """/dev/stdout is a link to a name that is no file where it is a pipe."""
    command = [*TILTCAL, "apply", "plane.yaml", "log.csv", "-o", "/dev/stdout"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("x,y,g_x,")


NOT_UTF_8 = os.fsdecode(b"\xff\xe9")


def test_names_that_are_not_utf_8(folder: Path) -> None:
    """What a session would keep of them, in the journal and in the calibration, is text."""
    shutil.copy(folder / "plane.yaml", folder / f"{NOT_UTF_8}.yaml")
    for arguments in (("--serial", NOT_UTF_8), ("-o", f"{NOT_UTF_8}.2.yaml"), ("--journal", NOT_UTF_8)):
        done = measure(*arguments, cwd=folder, code=2)
        assert f"{ascii(NOT_UTF_8)[1:-1]}" in done.stderr
        assert "is not UTF-8" in done.stderr
    for command in (("check", f"{NOT_UTF_8}.yaml"), ("report", ".", "-o", "fleet.html")):
        assert tiltcal_process(*command, cwd=folder).returncode == 0


def test_a_terminal_without_some_characters_shows_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ellipsis in this help is not in Latin-1."""
    monkeypatch.setenv("PYTHONIOENCODING", "latin-1")
    done = subprocess.run([*TILTCAL, "apply", "--help"], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"ROLE=NAME,?" in done.stdout
