"""``tiltcal measure`` prints what it found: coefficients on standard output, talk on standard error, nothing twice."""

import json
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import yaml
from support import ROOT
from support.command import Completed, measure, tiltcal

from tiltcal.files.calibration import read_calibration

QUICK = ("--samples", "30", "--settle", "0.2")
SIM = (*QUICK, "--sensor", "sca100t-d02", "--address", "sim:seed=7", "--serial", "S-7", "-o", "S-7.yaml")
READY = '{"answer": "ready"}\n'


def lines_of(done: Completed) -> list[str]:
    """Every line that was printed, empty ones left out."""
    return [line.strip() for line in (done.stdout + done.stderr).splitlines() if line.strip()]


def test_the_coefficients_of_the_file_are_printed(tmp_path: Path) -> None:
    done = tiltcal("measure", "cross-axis", *SIM, "--operator", "sim", "--jig", "0.1", cwd=tmp_path, code=0)
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
    tiltcal("measure", "six-face", *SIM, "--operator", "sim", cwd=tmp_path, code=0)
    base = () if procedure == "plane" else ("--base", "S-7.yaml")
    given = [*SIM[:-1], "again.yaml"]
    done = tiltcal("measure", procedure, *given, *base, "--operator", "sim", cwd=tmp_path, code=0)
    assert done.stdout
    lines = lines_of(done)
    assert len(lines) == len(set(lines))


def test_a_program_reads_json_alone(tmp_path: Path) -> None:
    """Also where the session is resumed, and the journal names the operator."""
    began = tiltcal("measure", "plane", *SIM, "--operator", "json", cwd=tmp_path, said=READY * 2, code=130)
    ended = tiltcal("measure", "--resume", "S-7.journal.jsonl", cwd=tmp_path, said=READY * 2, code=0)
    events = [json.loads(line) for line in (began.stdout + ended.stdout).splitlines()]
    assert events[-1]["event"] == "done"


def test_the_first_command_of_the_readme_passes_its_verification(tmp_path: Path) -> None:
    """On the virtual bench: one line, whose file is good within 0.3°."""
    commands = re.findall(r"^\$ tiltcal (.*)$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    words = next(command for command in commands if "sim:" in command).split()
    assert words[:2] == ["measure", "cross-axis"]
    assert {"--jig", "sim:", "-o"} <= set(words)
    tiltcal(*words, cwd=tmp_path, code=0)
    file = words[words.index("-o") + 1]
    tiltcal("verify", file, "--address", "sim:", "--operator", "sim", "--limit", "0.3", cwd=tmp_path, code=0)


@pytest.mark.usefixtures("undrawn")
def test_the_log_of_the_demo_lies_within_what_was_calibrated(tmp_path: Path) -> None:
    done = tiltcal("demo", "demo", cwd=tmp_path, code=0)
    log = pl.read_csv(tmp_path / "demo" / "log-tilt.csv")
    assert (len(log), log["flag"].unique().to_list()) == (1500, [1])
    share = np.arange(1500) / 1499
    for axis, reach, turns in (("x", 40.0, 9), ("y", 35.0, 14)):
        true = log[f"true_tilt_{axis}"].to_numpy()
        assert true == pytest.approx(reach * np.sin(2.0 * np.pi * turns * share), abs=0.05)
        before = np.degrees(np.arcsin((log[axis].to_numpy() - 1024.0) / 819.0)) - true
        errors = (before, log[f"tilt_{axis}"].to_numpy() - true)
        figures = (f"{np.sqrt(np.mean(one**2)):.3f}°    {np.abs(one).max():.3f}°" for one in errors)
        assert f"   tilt {axis}   {'           '.join(figures)}\n" in done.stdout
    assert log["time"].to_numpy() == pytest.approx(np.arange(1, 1501), rel=1e-3)
    assert log["temperature"].to_numpy()[[-2, -1]] == pytest.approx([8.0, 8.0], abs=2.5)
    assert "a row outside the calibrated range gets 3" in done.stdout
    lines = lines_of(done)
    assert len(lines) == len(set(lines))


def offcorr(t: float) -> float:
    """The data sheet's mean offset curve in degrees (section 6 of the device facts), typed from there."""
    return -0.0000006 * t**3 + 0.0001 * t**2 - 0.0039 * t + 0.0522


def scorr(t: float) -> float:
    """The data sheet's mean sensitivity curve in per cent."""
    return -0.00011 * t**2 + 0.0022 * t + 0.0408


def test_typical_temperature_is_the_data_sheets_curve_and_said_in_the_file(tmp_path: Path) -> None:
    measure("--typical-temperature", cwd=tmp_path, code=0)
    calibration = read_calibration(tmp_path / "S-1.yaml")
    thermal, reference = calibration.coefficients.thermal, calibration.coefficients.thermal.reference
    assert reference == round(np.mean([one.temperature for one in calibration.positions]), 3)
    for t in (-20.0, 0.0, 40.0, 60.0):
        dt = t - reference
        drift = sum(k * dt**power for power, k in enumerate(thermal.drift[0], start=1))
        assert drift == pytest.approx(819.0 * 0.017453293 * (offcorr(t) - offcorr(reference)), abs=0.02)
        gain = sum(k * dt**power for power, k in enumerate(thermal.gain[1], start=1))
        expected = (1 + scorr(t) / 100) / (1 + scorr(reference) / 100) - 1
        assert gain == pytest.approx(expected, abs=2e-7)
    assert any("not this unit's own" in line for line in calibration.derived.assumed)
    # ±0.008 °/°C and ±0.014 %/°C over the parts.
    assert calibration.uncertainty["temperature.offset.x.1"] == pytest.approx(819 * 0.017453293 * 0.008, rel=1e-3)
    assert calibration.uncertainty["temperature.sensitivity.y.1"] == pytest.approx(1.4e-4)


def test_a_units_own_run_wins_and_other_models_have_no_curves(tmp_path: Path) -> None:
    refused = measure("--typical-temperature", cwd=tmp_path, procedure="mavs", code=2)
    assert "or measures them" in refused.stderr
    refused = measure("--typical-temperature", "--sensor", "sca3000-d01", cwd=tmp_path, code=2)
    assert "measure it" in refused.stderr
