"""``tiltcal measure`` prints what it found: coefficients on standard output, talk on standard error, nothing twice."""

from __future__ import annotations

import json
import re
from pathlib import Path

import polars as pl
import pytest
import yaml
from support import ROOT
from support.command import Completed, tiltcal

SIM = ("--sensor", "sca100t-d02", "--address", "sim:seed=7", "--serial", "S-7", "-o", "S-7.yaml")
READY = '{"answer": "ready"}\n'


def lines_of(done: Completed) -> list[str]:
    """Every line that was printed, empty ones left out."""
    return [line.strip() for line in (done.stdout + done.stderr).splitlines() if line.strip()]


def test_the_coefficients_of_the_file_are_printed(tmp_path: Path) -> None:
    done = tiltcal("measure", "cross-axis", *SIM, "--operator", "sim", "--jig", "0.1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    written = yaml.safe_load((tmp_path / "S-7.yaml").read_text())
    printed = re.findall(r"^  (\w+ \w+) +(-?[\d.]+) ± ([\d.]+) count", done.stdout, re.MULTILINE)
    numbers = {name: (float(value), float(u)) for name, value, u in printed}
    for channel in "xy":
        value, u = numbers[f"offset {channel}"]
        assert value == pytest.approx(written["calibration"]["offset"][channel], abs=0.01)
        assert u == pytest.approx(written["uncertainty"]["offset"][channel], rel=0.05)
        for axis in "xyz":
            value, u = numbers[f"sensitivity {channel}{axis}"]
            assert value == pytest.approx(written["calibration"]["sensitivity"][channel][axis], abs=0.1)
            assert u == pytest.approx(written["uncertainty"]["sensitivity"][channel][axis], rel=0.05)


@pytest.mark.parametrize("procedure", ["plane", "mounting", "level"])
def test_nothing_is_printed_twice(procedure: str, tmp_path: Path) -> None:
    assert tiltcal("measure", "six-face", *SIM, "--operator", "sim", cwd=tmp_path).returncode == 0
    base = () if procedure == "plane" else ("--base", "S-7.yaml")
    given = [*SIM[:-1], "again.yaml"]
    done = tiltcal("measure", procedure, *given, *base, "--operator", "sim", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout
    lines = lines_of(done)
    assert len(lines) == len(set(lines))


def test_a_program_reads_json_alone(tmp_path: Path) -> None:
    """Also where the session is resumed, and the journal names the operator."""
    began = tiltcal("measure", "plane", *SIM, "--operator", "json", cwd=tmp_path, said=READY * 2)
    assert began.returncode == 130
    ended = tiltcal("measure", "--resume", "S-7.journal.jsonl", cwd=tmp_path, said=READY * 2)
    assert ended.returncode == 0, ended.stderr
    events = [json.loads(line) for line in (began.stdout + ended.stdout).splitlines()]
    assert events[-1]["event"] == "done"


def test_the_first_command_of_the_readme_passes_its_verification(tmp_path: Path) -> None:
    """On the virtual bench: one line, whose file is good within 0.3°."""
    commands = re.findall(r"^\$ tiltcal (.*)$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    words = next(command for command in commands if "sim:" in command).split()
    assert words[:2] == ["measure", "cross-axis"]
    assert {"--jig", "sim:", "-o"} <= set(words)
    assert tiltcal(*words, cwd=tmp_path).returncode == 0
    file = words[words.index("-o") + 1]
    done = tiltcal("verify", file, "--address", "sim:", "--operator", "sim", "--limit", "0.3", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.usefixtures("undrawn")
def test_the_log_of_the_demo_lies_within_what_was_calibrated(tmp_path: Path) -> None:
    done = tiltcal("demo", "demo", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    log = pl.read_csv(tmp_path / "demo" / "log-tilt.csv")
    assert (log["flag"] == 1).all()
    assert "a row outside the calibrated range gets 3" in done.stdout
    lines = lines_of(done)
    assert len(lines) == len(set(lines))
