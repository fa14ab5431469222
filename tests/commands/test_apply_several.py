"""``tiltcal apply`` to several logs: one after another, or on the workers of a cluster."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import FIXTURES
from support.command import tiltcal, tiltcal_process

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
        (("log1.csv", "log2.csv", "-o", "."), "is the log itself"),
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


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """The address of a scheduler with a worker in another process and another folder."""
    pytest.importorskip("distributed")
    program = (
        "from distributed import LocalCluster\n"
        "if __name__ == '__main__':\n"
        "    with LocalCluster(n_workers=1, threads_per_worker=2, processes=False, protocol='tcp',\n"
        "                      host='127.0.0.1', dashboard_address=None) as cluster:\n"
        "        print(cluster.scheduler_address, flush=True)\n"
        "        input()\n"
    )
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    with subprocess.Popen(
        [sys.executable, "-c", program], cwd=elsewhere, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        process.communicate("\n", timeout=30)


def test_a_cluster_gives_what_this_machine_gives(bench: Path, scheduler: str) -> None:
    (bench / "log2.csv").write_text("x,y\n1,oops\n")
    logs = ("log1.csv", "log2.csv", "log3.csv")
    done = tiltcal_process("apply", CAL, *logs, "-o", "tilt", "--scheduler", scheduler, "--json", cwd=bench)
    assert done.returncode == 2, done.stderr
    assert "log2.csv failed and is left out: " in done.stderr
    assert "oops" in done.stderr
    assert list(json.loads(done.stdout)["logs"]) == ["log1.csv", "log3.csv"]
    for name in ("log1.csv", "log3.csv"):
        assert (bench / "tilt" / name).read_text() == tiltcal("apply", CAL, name, cwd=bench).stdout
