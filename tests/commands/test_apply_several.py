"""``tiltcal apply`` to several logs: one after another, or on the workers of a cluster."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest
from support import FIXTURES
from support.command import TILTCAL, tiltcal, tiltcal_process

CAL = FIXTURES / "mavs.yaml"


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A folder with three logs, each of its own length, and one for what comes out."""
    for rows in (1, 2, 3):
        (tmp_path / f"log{rows}.csv").write_text("x,y,temperature\n" + "1024,1100,10\n" * rows)
    (tmp_path / "tilt").mkdir()
    return tmp_path


def test_each_goes_into_the_folder_under_its_name_and_a_bad_one_is_named(bench: Path) -> None:
    logs = ("log1.csv", "log2.csv", "log3.csv")
    told = json.loads(tiltcal("apply", CAL, *logs, "-o", "tilt", "--json", cwd=bench, code=0).stdout)["logs"]
    assert [(log, one["output"], one["rows"]) for log, one in told.items()] == [
        (log, f"tilt/{log}", rows) for rows, log in enumerate(logs, start=1)
    ]
    alone = {log: tiltcal("apply", CAL, log, cwd=bench).stdout for log in logs}
    assert {path.name: path.read_text() for path in (bench / "tilt").iterdir()} == alone
    (bench / "log2.csv").write_text("x,y\n1,oops\n")
    done = tiltcal("apply", CAL, "log1.csv", "log2.csv", "-o", "new/tilt", cwd=bench, code=2)
    assert done.stderr.splitlines() == [
        "new/tilt/log1.csv: 1 row",
        "  flag 1 pass: 1",
        "log2.csv failed and is left out: log2.csv:2: column 'y': 'oops' is no number",
        "tiltcal: 1 of 2 logs failed; the others are written",
    ]
    assert [path.name for path in (bench / "new" / "tilt").iterdir()] == ["log1.csv"]
    failed = tiltcal("apply", CAL, "log2.csv", "-o", "tilt", "--json", cwd=bench, code=2)
    assert (failed.stdout, failed.stderr.splitlines()[-1]) == ('{"logs": {}}\n', "tiltcal: 1 of 1 logs failed")


def test_an_error_that_nothing_foresees_costs_its_log_alone(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A block of rows without what the writer needs; Ctrl-C ends all."""
    monkeypatch.delenv("TILTCAL_TRACEBACK")
    for error, code in ((TypeError("odd"), 2), (KeyboardInterrupt(), 130)):
        with monkeypatch.context() as broken:
            broken.setattr("tiltcal.library.recorded.apply_to_log", lambda *_words, error=error: _raise(error))
            done = tiltcal("apply", CAL, "log1.csv", "log2.csv", "-o", "tilt", cwd=bench, code=code)
        assert (
            done.stderr.count("failed and is left out: this is an error of tiltcal: TypeError: odd") == (code == 2) * 2
        )
        assert done.stderr.count(", with log2.csv. Report it") == (code == 2)


def _raise(error: BaseException) -> NoReturn:
    raise error


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense"])
def test_a_scheduler_that_does_not_answer_is_named(address: str, bench: Path) -> None:
    """In a process: distributed keeps a thread for its connections until it ends."""
    pytest.importorskip("distributed")
    done = tiltcal_process("apply", CAL, "log1.csv", "-o", "tilt", "--scheduler", address, cwd=bench)
    assert (done.returncode, f"--scheduler: no scheduler answers at {address}: " in done.stderr) == (2, True)
    assert not list((bench / "tilt").iterdir())


def test_what_a_scheduler_loses_is_named_with_its_log(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It cancels what has not begun; a stand-in for ``distributed``, whose client is a context."""
    client, given = nullcontext(), []
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = ("apply", CAL, "log1.csv", "log2.csv", "log3.csv", "-o", "tilt", "--scheduler", "tcp://127.0.0.1:1")
    assert "pip install 'tiltcal[cluster]'" in tiltcal(*words, cwd=bench, code=2).stderr

    def submit(function: Any, calibration: Path, log: str, output: str, *how: Any, pure: bool) -> Future[Any]:
        given.append((calibration, Path(log).relative_to(bench), Path(output).relative_to(bench), pure))
        future: Future[Any] = Future()
        if log.endswith("1.csv"):
            future.cancel()
        elif log.endswith("2.csv"):
            future.set_exception(ImportError("no tiltcal"))
        else:
            future.set_result(function(calibration, log, output, *how))
        return future

    vars(client)["submit"] = submit
    stand_in = SimpleNamespace(Client=lambda *args, **how: client, as_completed=iter)
    monkeypatch.setitem(sys.modules, "distributed", stand_in)
    said = tiltcal(*words, cwd=bench, code=2).stderr
    assert "log1.csv failed and is left out: the scheduler was lost before its turn: start one, and repeat" in said
    assert "log2.csv failed and is left out: its worker failed: ImportError('no tiltcal')\n" in said
    assert said.endswith("tiltcal: 2 of 3 logs failed; the others are written\n")
    assert given == [(CAL, Path(f"log{n}.csv"), Path(f"tilt/log{n}.csv"), False) for n in (1, 2, 3)]
    assert [path.name for path in (bench / "tilt").iterdir()] == ["log3.csv"]


def test_remarks_on_a_log_name_it_and_those_on_the_calibration_come_once(bench: Path) -> None:
    arguments = ["--magnetometer", "mx,my,mz", "--uncertainty"]
    for name in ("log1.csv", "log2.csv"):
        (bench / name).write_text("x,y,mx,my,mz\n1024,1100,20,1,40\n")
    done = tiltcal("apply", CAL, "log1.csv", "log2.csv", "-o", "tilt", *arguments, cwd=bench, code=0)
    assert done.stderr.count("note: heading counts from magnetic north") == 1
    lagged = tiltcal("apply", FIXTURES / "ramp.yaml", "log1.csv", "log2.csv", "-o", "tilt", cwd=bench, code=0)
    for name in ("log1.csv", "log2.csv"):
        assert f"{name}: note: the log has no column of times" in lagged.stderr


# A cluster


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """The address of a scheduler with two workers in other processes and another folder."""
    pytest.importorskip("distributed")
    program = (
        "from distributed import LocalCluster\n"
        "if __name__ == '__main__':\n"
        "    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:\n"
        "        print(cluster.scheduler_address, flush=True)\n"
        "        input()\n"
    )
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "cluster.py").write_text(program)
    with subprocess.Popen(
        [sys.executable, "cluster.py"], cwd=elsewhere, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        process.communicate("\n", timeout=30)


def reader_of(pipe: Path) -> int:
    """Return the process, other than this one, that has a named pipe open."""
    for handle in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):
            if os.path.realpath(handle) == str(pipe) and handle.parts[2] != str(os.getpid()):
                return int(handle.parts[2])
    raise LookupError(f"nothing reads {pipe}")


@pytest.mark.skipif(sys.platform != "linux", reason="the reader of a pipe is found in /proc")
def test_a_cluster_gives_what_this_machine_gives_and_loses_nothing_with_a_worker(bench: Path, scheduler: str) -> None:
    content = (bench / "log1.csv").read_bytes()
    (bench / "log2.csv").write_text("x,y\n1,oops\n")
    alone = {name: tiltcal("apply", CAL, name, cwd=bench).stdout for name in ("log1.csv", "log3.csv")}
    (bench / "log1.csv").unlink()
    os.mkfifo(bench / "log1.csv")
    arguments = ["log1.csv", "log2.csv", "log3.csv", "-o", "tilt", "--scheduler", scheduler, "--json"]
    command = [*TILTCAL, "apply", str(CAL), *arguments]
    with subprocess.Popen(command, cwd=bench, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        with open(bench / "log1.csv", "wb", buffering=0) as first:  # waits for a worker to open it
            first.write(content[:30])
            os.kill(reader_of(bench / "log1.csv"), signal.SIGKILL)
            with suppress(BrokenPipeError):  # the worker is gone
                while True:
                    first.write(b"1024,")
        with open(bench / "log1.csv", "wb") as second:  # waits for the other one
            second.write(content)
        stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 2, stderr
    assert "log2.csv failed and is left out: " in stderr
    assert "oops" in stderr
    assert list(json.loads(stdout)["logs"]) == ["log1.csv", "log3.csv"]
    assert {path.name: path.read_text() for path in (bench / "tilt").iterdir()} == alone
