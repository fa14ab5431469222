"""``tiltcal apply`` to several logs: in the processes of this machine, or on the workers of a cluster."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path

import pytest
from support import FIXTURES
from support.command import TILTCAL, tiltcal, tiltcal_process

from tiltcal.cli import apply_tasks
from tiltcal.cli.apply_tasks import ApplyTask, Outcome
from tiltcal.logs.apply_summary import ApplySummary
from tiltcal.logs.prepared_calibration import ApplyOptions

CAL = FIXTURES / "mavs.yaml"


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A folder with three logs, each of its own length, and one for what comes out."""
    for rows in (1, 2, 3):
        (tmp_path / f"log{rows}.csv").write_text("x,y,temperature\n" + "1024,1100,10\n" * rows)
    (tmp_path / "tilt").mkdir()
    return tmp_path


def lines(path: Path) -> int:
    return len(path.read_text().splitlines())


def test_each_goes_into_the_folder_under_its_name(bench: Path) -> None:
    done = tiltcal("apply", CAL, "log1.csv", "log2.csv", "log3.csv", "-o", "tilt", "--json", cwd=bench)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)["logs"]
    assert [one["rows"] for one in told.values()] == [1, 2, 3]
    assert [lines(bench / "tilt" / f"log{rows}.csv") for rows in (1, 2, 3)] == [2, 3, 4]
    alone = tiltcal("apply", CAL, "log2.csv", cwd=bench)
    assert (bench / "tilt" / "log2.csv").read_text() == alone.stdout


def test_one_log_may_go_into_a_folder_too(bench: Path) -> None:
    assert tiltcal("apply", CAL, "log1.csv", "-o", "tilt", cwd=bench).returncode == 0
    assert lines(bench / "tilt" / "log1.csv") == 2


def test_a_bad_log_is_named_and_the_others_are_done(bench: Path) -> None:
    (bench / "log2.csv").write_text("x,y\n1,oops\n")
    done = tiltcal("apply", CAL, "log1.csv", "log2.csv", "log3.csv", "-o", "tilt", cwd=bench)
    assert done.returncode == 2
    assert "log2.csv failed and is left out: log2.csv:2: column 'y': 'oops' is no number" in done.stderr
    assert "1 of 3 logs failed" in done.stderr
    assert sorted(path.name for path in (bench / "tilt").iterdir()) == ["log1.csv", "log3.csv"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("log1.csv", "log2.csv"), "several logs need a folder"),
        (("log1.csv", "log2.csv", "-o", "absent"), "several logs need a folder"),
        (("log1.csv", "tilt/log1.csv", "-o", "tilt"), "would both be"),
        (("log1.csv", "log2.csv", "-o", "."), "it would replace log1.csv, which is read"),
        (("-", "log2.csv", "-o", "tilt"), "standard input is one log"),
        (("log1.csv", "-o", "tilt", "--scheduler", "tcp://127.0.0.1:1"), "no scheduler answers at tcp://127.0.0.1:1"),
        (("log1.csv", "-o", "tilt", "--scheduler", "nonsense"), "no scheduler answers at nonsense"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_is(arguments: tuple[str, ...], said: str, bench: Path) -> None:
    call = tiltcal
    if "--scheduler" in arguments:
        pytest.importorskip("distributed")
        call = tiltcal_process  # distributed keeps a thread for its connections until the process ends
    done = call("apply", CAL, *arguments, cwd=bench)
    assert done.returncode == 2
    assert said in done.stderr
    assert not list((bench / "tilt").iterdir())


def test_a_lost_scheduler_is_named() -> None:
    future: Future[Outcome] = Future()
    future.cancel()
    assert "the scheduler was lost" in str(apply_tasks._result(future))


class Ending(ApplyTask):
    """A task whose library ends the process."""

    def run(self, *_: object, **__: object) -> ApplySummary:
        os._exit(1)


@pytest.mark.usefixtures("resource_tracker")
def test_processes_give_what_one_gives_and_a_lost_one_costs_its_log_alone(
    bench: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apply_tasks, "WORTH_PROCESSES", -1)
    tasks = [
        kind(CAL, ApplyOptions(), str(bench / f"log{rows}.csv"), str(bench / "tilt" / f"log{rows}.csv"))
        for rows, kind in ((1, ApplyTask), (2, Ending), (3, ApplyTask))
    ]
    outcomes = {Path(task.log).name: outcome for task, outcome in apply_tasks.done_here(tasks, 2)}
    assert [getattr(outcomes[name], "rows", 0) for name in ("log1.csv", "log2.csv", "log3.csv")] == [1, 0, 3]
    assert str(outcomes["log2.csv"]).endswith(
        "log2.csv cannot be read: its library ended the process; the file is damaged"
    )
    for name in ("log1.csv", "log3.csv"):
        assert (bench / "tilt" / name).read_text() == tiltcal("apply", CAL, bench / name).stdout


# A rerun


def rerun(bench: Path, *options: str) -> list[str]:
    """Return the logs that are processed again."""
    cal = bench / "S.yaml" if (bench / "S.yaml").exists() else CAL
    done = tiltcal("apply", cal, "log1.csv", "log2.csv", "-o", "tilt", "--json", *options, cwd=bench)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)["logs"]
    assert [one["rows"] for one in told.values()] == [1, lines(bench / "log2.csv") - 1]
    return [name for name, one in told.items() if not one.get("up_to_date")]


def test_a_rerun_skips_what_would_come_out_the_same(bench: Path) -> None:
    assert rerun(bench) == ["log1.csv", "log2.csv"]
    assert rerun(bench) == []
    assert rerun(bench, "--force") == ["log1.csv", "log2.csv"]
    said = tiltcal("apply", CAL, "log1.csv", "-o", "tilt", cwd=bench).stderr
    assert said == "tilt/log1.csv: up to date, skipped (--force processes it again)\n"
    assert sorted(path.name for path in (bench / "tilt").iterdir()) == ["log1.csv", "log2.csv"]


def changed_log(bench: Path) -> None:
    log, before = bench / "log2.csv", (bench / "log2.csv").stat()
    log.write_text(log.read_text().replace("1024", "1025"))
    os.utime(log, ns=(before.st_atime_ns, before.st_mtime_ns))  # as a copy that keeps the time has it


def edited_result(bench: Path) -> None:
    with open(bench / "tilt" / "log2.csv", "a") as result:
        result.write("# checked\n")


def replaced_result(bench: Path) -> None:
    result = bench / "tilt" / "log2.csv"
    result.unlink()
    result.write_text("x,y\n")


@pytest.mark.parametrize("change", [changed_log, edited_result, replaced_result])
def test_a_changed_log_or_result_is_processed_again(change: Callable[[Path], None], bench: Path) -> None:
    rerun(bench)
    change(bench)
    assert rerun(bench) == ["log2.csv"]
    assert rerun(bench) == []


@pytest.mark.parametrize(
    "options",
    ["--uncertainty", "--first-order", "--skip-bad-rows", "--columns x=y,y=x", "--mounting roll=180"],
)
def test_a_changed_option_is_seen(options: str, bench: Path) -> None:
    rerun(bench)
    assert rerun(bench, *options.split()) == ["log1.csv", "log2.csv"]
    assert rerun(bench, *options.split()) == []


def test_a_changed_calibration_or_version_is_seen(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(CAL, bench / "S.yaml")
    rerun(bench)
    (bench / "S.yaml").write_text(CAL.read_text().replace("procedure:", "# read again\nprocedure:", 1))
    assert rerun(bench) == ["log1.csv", "log2.csv"]
    monkeypatch.setattr("tiltcal.__version__", "9.9")
    assert rerun(bench) == ["log1.csv", "log2.csv"]


def test_a_file_system_without_attributes_keeps_it_hidden_beside(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("setxattr", "getxattr"):
        monkeypatch.delattr(os, name, raising=False)
    rerun(bench)
    assert rerun(bench) == []
    assert {path.name for path in (bench / "tilt").iterdir() if not path.name.startswith(".")} == {
        "log1.csv",
        "log2.csv",
    }
    changed_log(bench)
    assert rerun(bench) == ["log2.csv"]


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
