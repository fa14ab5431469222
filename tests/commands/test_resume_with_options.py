"""What is stated beside ``--resume`` is compared with what the session began with, in all that decides its result."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.command import Completed, tiltcal

BENCH = """tiltcal: 1
kind: bench
operator: A. Technician
jig: 0.1
table: 0.05
heading: 1
thermometer: {model: sca100t-d02, address: "sim:?seed=3", uncertainty: 0.2}
sensors:
  - {serial: B-1, model: sca100t-d02, address: "sim:?seed=1"}
  - {serial: B-2, model: sca100t-d02, address: "sim:?seed=2", axes: [-y, x]}
"""
OWN = """tiltcal: 1
kind: procedure
name: own
title: Own
determines: {axes: [x, y]}
samples: 3
settle: 1
positions:
  - {name: level, prompt: "Level", tilt: {x: 0, y: 0}}
  - {name: up, prompt: "Up", tilt: {x: 20, y: 20}}
  - {name: down, prompt: "Down", tilt: {x: -20, y: -20}}
  - {name: side, prompt: "Side", tilt: {x: 20, y: -20}}
"""


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of a bench by a procedure of one's own, which visits its first position again."""
    folder = tmp_path_factory.mktemp("begun")
    (folder / "bench.yaml").write_text(BENCH)
    (folder / "own.yaml").write_text(OWN)
    options = ("--bench", "bench.yaml", "-o", ".", "--operator", "sim", "--journal", "b.jsonl", "--closing")
    done = tiltcal("measure", "own.yaml", *options, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


def resumed(begun: Path, *options: str) -> Completed:
    return tiltcal("measure", *options, "--resume", "b.jsonl", "--operator", "sim", cwd=begun)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('model: sca100t-d02, address: "sim:?seed=2', 'model: sca100t-d01, address: "sim:?seed=2', "sensors"),
        ("axes: [-y, x]", "axes: [y, x]", "sensors"),
        ("seed=2", "seed=4", "sensors"),
        ("seed=3", "seed=4", "thermometer"),
        ("uncertainty: 0.2", "uncertainty: 0.3", "thermometer"),
        ("jig: 0.1", "jig: 0.2", "jig"),
        ("table: 0.05\n", "", "table"),
        ("heading: 1", "heading: 2", "heading"),
        ("A. Technician", "B. Technician", ""),
    ],
)
def test_a_bench_file_that_has_changed_is_refused_with_resume(begun: Path, old: str, new: str, key: str) -> None:
    assert resumed(begun, "--bench", "bench.yaml").returncode == 0
    assert BENCH.count(old) == 1
    (begun / "other.yaml").write_text(BENCH.replace(old, new))
    done = resumed(begun, "--bench", "other.yaml")
    assert done.returncode == (2 if key else 0), done.stderr
    assert f"--bench differs in its {key} from what the session of b.jsonl began with" in done.stderr or not key


def test_an_option_replaces_a_key_of_the_bench_file_with_resume(begun: Path) -> None:
    (begun / "other.yaml").write_text(BENCH.replace("jig: 0.1", "jig: 0.2"))
    assert resumed(begun, "--bench", "other.yaml", "--jig", "0.1").returncode == 0


def test_a_procedure_that_has_changed_is_refused_with_resume(begun: Path) -> None:
    assert resumed(begun, "own.yaml").returncode == resumed(begun, "own.yaml", "--closing").returncode == 0
    for old, new in (("x: -20, y: -20", "x: -20, y: -19"), ("name: own", "name: other"), ("settle: 1", "settle: 2")):
        (begun / "changed.yaml").write_text(OWN.replace(old, new))
        done = resumed(begun, "changed.yaml")
        assert (done.returncode, done.stderr.split()[1:3]) == (2, ["PROCEDURE", "differs"]), done.stderr
