"""Ctrl-C, a full disk and a reader that is gone, whenever they come: an exit code and a message, never a traceback."""

import io
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from support import FIXTURES
from support.command import TILTCAL, called

CAL, LEVEL = (str(FIXTURES / name) for name in ("mavs.yaml", "level.yaml"))
LONG = "x,y,note\n" + "1024,1024,longer than a log that is read without the engine\n" * 5000


def started(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(arguments, cwd=folder, capture_output=True, text=True, timeout=100, check=False)


def test_nothing_is_imported_before_ctrl_c_is_caught() -> None:
    """It ended in a traceback where it came while `typing` was imported, 20 ms on a busy machine."""
    code = "import sys, tiltcal.__main__\nprint(*sorted(name for name in sys.modules if name.startswith('tiltcal')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["tiltcal", "tiltcal.__main__"]


IMPORTED = """
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "{module}":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
"""
LOST = """
import polars

def interrupted(*_words, **_options):
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        pass
    raise TypeError("'<unprintable str object>' is not a data type")

polars.read_csv = polars.scan_csv = interrupted
"""
"""An engine that met it in a callback ended in a TypeError; seen in 1 of 200 interrupted commands."""
FINALISED = """
class Finalised:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

class Drop:
    def find_spec(self, name, path=None, target=None):
        if name == "polars":
            Finalised()
            signal.pause()  # until the dropped one comes again

sys.meta_path.insert(0, Drop())
"""
"""Python drops an exception of a finaliser; seen in 2 of 200 interrupted commands."""
MODULES = ("click", "numpy.linalg", "tiltcal.logs.apply")


@pytest.mark.parametrize("script", [*(IMPORTED.format(module=name) for name in MODULES), LOST, FINALISED])
def test_ctrl_c_where_it_is_easily_lost(script: str, tmp_path: Path) -> None:
    """While a module is imported, in a callback of a library, in a finaliser."""
    (tmp_path / "log.csv").write_text(LONG)
    command = f'main(["apply", {CAL!r}, "log.csv", "-o", "out.csv"])'
    before = "import os, signal, sys\nfrom tiltcal.__main__ import main\n"
    done = started([sys.executable, "-c", before + script + command], tmp_path)
    assert (done.returncode, done.stderr.strip()) == (130, "tiltcal: interrupted")
    assert not (tmp_path / "out.csv").exists()


def test_ctrl_c_in_the_middle_of_a_log(tmp_path: Path) -> None:
    """The first of several logs is a pipe that has gone quiet; by then more than a block of rows has been parsed: the
    engine that did so must not keep Ctrl-C to itself."""
    os.mkfifo(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text("x,y,temperature\n1024,1030,15\n")
    (tmp_path / "tilt").mkdir()
    for command in (["a.csv", "-o", "tilt/a.csv"], ["a.csv", "b.csv", "-o", "tilt"]):
        process = subprocess.Popen([*TILTCAL, "apply", CAL, *command], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
        with open(tmp_path / "a.csv", "wb", buffering=0) as pipe:  # waits for the command to open it
            pipe.write(b"x,y,temperature\n" + b"1024,1030,15\n" * 400_000)  # all but 64 KiB is taken
            process.send_signal(signal.SIGINT)
            said = process.communicate(timeout=60)[1]
            assert (process.returncode, said.strip()) == (130, "tiltcal: interrupted")
            assert list((tmp_path / "tilt").iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_a_full_disk_behind_standard_output(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("x,y\n1024,1024\n")
    command = [*TILTCAL, "apply", CAL, "log.csv"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "tiltcal: the output cannot be written: No space left on device"


# Whoever reads standard output or error is gone, or the disk behind it is full: a session goes on, and the exit code
# says what became of it.

MEASURE = (
    "measure",
    "plane",
    "--sensor",
    "sca100t-d02",
    "--address",
    "sim:?seed=1",
    "--serial",
    "S-1",
    "-o",
    "S-1.yaml",
)
VERIFY = ("verify", FIXTURES / "plane.yaml", "--address", "sim:?seed=2", "--journal", "v.jsonl", "--samples", "3")
SEVERAL = ("apply", FIXTURES / "plane.yaml", "bad.csv", "good.csv", "-o", "tilt", "--json")


@pytest.mark.parametrize(
    ("command", "stream", "disk", "code"),
    [
        ((*MEASURE, "--operator", "sim", "--samples", "3"), "stderr", None, 0),
        ((*MEASURE, "--operator", "terminal"), "stderr", None, 130),
        ((*VERIFY, "--operator", "sim"), "stderr", None, 1),
        ((*VERIFY, "--operator", "sim"), "stdout", None, 1),
        (("measure", "nothing"), "stderr", None, 2),
        (("measure", "--nothing"), "stderr", None, 2),
        (("check", FIXTURES / "plane.yaml", "j.jsonl"), "stdout", None, 1),
        (("check", FIXTURES / "plane.yaml"), "stdout", None, 0),
        (("procedures",), "stdout", None, 0),
        (("apply", CAL, "good.csv"), "stdout", None, 0),
        (SEVERAL, "stderr", None, 2),
        (SEVERAL, "stderr", "/dev/full", 2),
        (SEVERAL, "stdout", None, 2),
    ],
)
def test_what_nobody_reads_changes_no_exit_code(
    command: tuple[str | Path, ...], stream: str, disk: str | None, code: int, tmp_path: Path
) -> None:
    journal = (FIXTURES / "plane.journal.jsonl").read_bytes()
    (tmp_path / "j.jsonl").write_bytes(journal[: journal.index(b"\n", 5000) + 1])
    (tmp_path / "good.csv").write_text("x,y\n1024,1024\n")
    (tmp_path / "bad.csv").write_text("x,y\n1024\n")
    reading, writing = os.pipe()
    os.close(reading)
    if disk is not None:
        os.close(writing)
    gone = open(disk or writing, "w", encoding="utf-8")  # noqa: SIM115
    try:
        with open(os.devnull) as nothing:
            streams = {"stdout": io.StringIO(), "stderr": io.StringIO()} | {stream: gone}
            assert called(command, tmp_path, nothing, **streams) == code
    finally:
        with suppress(OSError):  # what it could not write
            gone.close()
    assert (tmp_path / "S-1.yaml").exists() == (command[0] == "measure" and code == 0)
    assert (tmp_path / "tilt" / "good.csv").exists() == (command is SEVERAL)


BUSY = "def open_dataset(*path, **options):\n    print('busy', flush=True)\n    sum(range(10**15))\n"
"""A library whose loop looks for no signal, as HDF5's does on some damaged files."""


def test_a_log_that_keeps_a_library_busy_is_named_and_ctrl_c_ends_it(tmp_path: Path) -> None:
    (tmp_path / "h5netcdf.py").touch()
    (tmp_path / "xarray.py").write_text(BUSY)
    (tmp_path / "good.csv").write_text("x,y\n1024,1024\n")
    (tmp_path / "torn.nc").write_bytes(b"\x89HDF\r\n\x1a\n")
    (tmp_path / "out").mkdir()
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": environment}
    for logs, output in ((["torn.nc"], "torn-tilt.nc"), (["good.csv", "torn.nc"], "out")):
        with subprocess.Popen([*TILTCAL, "apply", CAL, *logs, "-o", output], cwd=tmp_path, **pipes) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "busy\n"
            process.send_signal(signal.SIGINT)
            said = process.communicate(timeout=30)[1]
        assert (process.returncode, said.splitlines()[-1]) == (-signal.SIGINT, "reading torn.nc")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["good.csv"]
