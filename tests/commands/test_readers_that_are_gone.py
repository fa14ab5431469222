"""Whoever reads standard output or error may be gone: a session goes on, and its exit code says what became of it."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

import pytest
from support import FIXTURES
from support.command import called

MEASURE = (
    *("measure", "plane", "--sensor", "sca100t-d02", "--address", "sim:?seed=1"),
    *("--serial", "S-1", "-o", "S-1.yaml"),
)
VERIFY = ("verify", FIXTURES / "plane.yaml", "--address", "sim:?seed=2", "--journal", "v.jsonl", "--samples", "3")


@contextmanager
def abandoned(disk: str | None = None) -> Iterator[TextIO]:
    """Yield a pipe that nobody reads, or a disk that is full."""
    reading, writing = os.pipe()
    os.close(reading)
    if disk is not None:
        os.close(writing)
    stream = open(disk or writing, "w", encoding="utf-8")  # noqa: SIM115
    try:
        yield stream
    finally:
        with suppress(OSError):  # what it could not write
            stream.close()


def code_of(*args: str | Path, folder: Path, out: bool = False, err: bool = False) -> int:
    """The exit code of a command whose standard output or error nobody reads."""
    with abandoned() as gone, open(os.devnull) as nothing:
        return called(args, folder, nothing, gone if out else io.StringIO(), gone if err else io.StringIO())


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ((*MEASURE, "--operator", "sim", "--samples", "3"), 0),
        ((*MEASURE, "--operator", "terminal"), 130),
        ((*VERIFY, "--operator", "sim"), 1),
        (("measure", "nothing"), 2),
        (("measure", "--nothing"), 2),
    ],
)
def test_talk_that_nobody_reads_stops_no_session(command: tuple[str | Path, ...], code: int, tmp_path: Path) -> None:
    assert code_of(*command, folder=tmp_path, err=True) == code
    assert (tmp_path / "S-1.yaml").exists() == (code == 0)


def test_a_verdict_that_nobody_reads_is_the_exit_code(tmp_path: Path) -> None:
    assert code_of(*VERIFY, "--operator", "sim", folder=tmp_path, out=True) == 1
    journal = (FIXTURES / "plane.journal.jsonl").read_bytes()
    (tmp_path / "j.jsonl").write_bytes(journal[: journal.index(b"\n", 5000) + 1])
    assert code_of("check", FIXTURES / "plane.yaml", "j.jsonl", folder=tmp_path, out=True) == 1
    assert code_of("check", FIXTURES / "plane.yaml", folder=tmp_path, out=True) == 0
    assert code_of("procedures", folder=tmp_path, out=True) == 0


def logs_of(folder: Path) -> list[str]:
    """Write one sound log, and one that is damaged."""
    (folder / "good.csv").write_text("x,y\n1024,1024\n")
    (folder / "bad.csv").write_text("x,y\n1024\n")
    (folder / "tilt").mkdir()
    return ["bad.csv", "good.csv"]


@pytest.mark.parametrize("disk", [None, "/dev/full"])
def test_talk_that_cannot_be_written_changes_no_exit_code_of_apply(disk: str | None, tmp_path: Path) -> None:
    command = ("apply", FIXTURES / "plane.yaml", *logs_of(tmp_path), "-o", "tilt")
    with abandoned(disk) as gone, open(os.devnull) as nothing:
        assert called(command, tmp_path, nothing, io.StringIO(), gone) == 2
    assert (tmp_path / "tilt" / "good.csv").exists()


def test_results_that_nobody_reads_change_no_exit_code_of_apply(tmp_path: Path) -> None:
    command = ("apply", FIXTURES / "plane.yaml", *logs_of(tmp_path), "-o", "tilt", "--json")
    assert code_of(*command, folder=tmp_path, out=True) == 2
