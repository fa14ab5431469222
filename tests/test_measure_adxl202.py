"""An ADXL202 that was written apart from the drivers, on a pseudo-terminal, led through ``mavs`` by a program."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from adxl202_part import Adxl202Part, on_a_pty

pytest.importorskip("serial", reason="the pyserial package is not installed")


def lead_through_mavs(part: Adxl202Part, folder: Path) -> tuple[dict, str]:
    """Be the tilt table and the chamber; the calibration file and what was said on standard error."""
    with on_a_pty(part) as path:
        program = subprocess.Popen(
            [
                *(sys.executable, "-m", "tiltcal", "measure", "mavs", "--sensor", "adxl202", "--serial", "A-1005"),
                *("--address", f"serial://{path}?baudrate=115200", "--operator", "json", "--settle", "0.2"),
                *("--samples", "200", "-o", "A-1005.yaml"),
            ],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for line in program.stdout:
            said = json.loads(line)
            if "ask" in said:
                part.gravity, part.temperature = said["gravity"], said["temperature"]
                program.stdin.write(json.dumps({"answer": "ready", "temperature": part.temperature}) + "\n")
                program.stdin.flush()
        _, errors = program.communicate()
    assert program.returncode == 0, errors
    return yaml.safe_load((folder / "A-1005.yaml").read_text()), errors


def require_near(part: Adxl202Part, file: dict) -> None:
    found = file["calibration"]
    for row, channel in enumerate("xy"):
        assert found["offset"][channel] == pytest.approx(part.offset[row], abs=4e-4)
        assert found["temperature"]["offset"][channel][0] == pytest.approx(part.drift[row], abs=4e-5)
        for column, axis in enumerate("xy"):
            assert found["sensitivity"][channel][axis] == pytest.approx(part.sensitivity[row][column], abs=6e-4)


def test_mavs_finds_the_four_coefficients(tmp_path: Path) -> None:
    part = Adxl202Part()
    file, errors = lead_through_mavs(part, tmp_path)

    require_near(part, file)
    assert file["sensor"] == {"model": "adxl202", "serial": "A-1005", "unit": "duty", "channels": ["x", "y"]}
    assert file["provenance"]["reception"]["damaged"] == 0
    assert "0 damaged" in errors


def test_one_damaged_sentence_in_seven_is_counted_and_never_used(tmp_path: Path) -> None:
    part = Adxl202Part(damage_one_in=7)
    file, errors = lead_through_mavs(part, tmp_path)

    require_near(part, file)
    reception = file["provenance"]["reception"]
    assert f"A-1005: {reception['sentences']} sentences, {reception['damaged']} damaged" in errors
    # Every seventh of those that arrived; a sentence whose line end is gone takes none with it.
    assert reception["damaged"] / (reception["sentences"] + reception["damaged"]) == pytest.approx(1 / 7, abs=0.03)
    # A changed digit would have moved a single reading far beyond the noise.
    for position in file["positions"]:
        for channel in "xy":
            assert position["std"][channel] < 1.5 * part.noise


def test_the_captured_session_replays_to_the_same_file(tmp_path: Path) -> None:
    lead_through_mavs(Adxl202Part(damage_one_in=7), tmp_path)

    replayed = subprocess.run(
        [sys.executable, "-m", "tiltcal", "replay", "A-1005.journal.jsonl", "--check", "A-1005.yaml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert replayed.returncode == 0, replayed.stderr
