"""An ADXL202 that was written apart from the drivers, on a pseudo-terminal, led through ``mavs`` by a program."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from support import ROOT
from support.adxl202_part import Adxl202Part, on_a_pty
from support.command import Completed, tiltcal
from support.json_program import Event, ProgramSession, lead

pytest.importorskip("serial", reason="the pyserial package is not installed")


def led(address: str, folder: Path, take: Callable[[Event], Event]) -> ProgramSession:
    """Lead ``mavs`` with a part at an address, without the six minutes in which a thermometer may be late."""
    shipped = (ROOT / "procedures" / "mavs.yaml").read_text()
    (folder / "mavs.yaml").write_text(shipped.replace(", thermometer: 360}", "}"))
    session = lead(
        *("measure", "mavs.yaml", "--sensor", "adxl202", "--serial", "A-1005", "--address", address),
        *("--settle", "0.2", "--samples", "80", "-o", "A-1005.yaml"),
        cwd=folder,
        answer=lambda message: take(message) if "ask" in message else None,
    )
    assert session.exit_code == 0, session.errors
    return session


def posed(part: Adxl202Part, ask: Event) -> Event:
    """Lay the part as it is asked for."""
    part.gravity, part.temperature = ask["gravity"], ask["temperature"]
    return {"answer": "ready", "temperature": part.temperature}


def lead_through_mavs(part: Adxl202Part, folder: Path) -> tuple[dict, str]:
    """Be the tilt table and the chamber; the calibration file and what was said on standard error."""
    with on_a_pty(part) as path:
        errors = led(f"serial://{path}?baudrate=115200", folder, lambda ask: posed(part, ask)).errors
    return yaml.safe_load((folder / "A-1005.yaml").read_text()), errors


def require_near(part: Adxl202Part, file: dict) -> None:
    found = file["calibration"]
    for row, channel in enumerate("xy"):
        assert found["offset"][channel] == pytest.approx(part.offset[row], abs=4e-4)
        assert found["temperature"]["offset"][channel][0] == pytest.approx(part.drift[row], abs=4e-5)
        for column, axis in enumerate("xy"):
            assert found["sensitivity"][channel][axis] == pytest.approx(part.sensitivity[row][column], abs=6e-4)


def test_one_damaged_sentence_in_seven_is_counted_never_used_and_replays_to_the_byte(tmp_path: Path) -> None:
    part = Adxl202Part(damage_one_in=7)
    file, errors = lead_through_mavs(part, tmp_path)

    require_near(part, file)
    link_statistics = file["provenance"]["link_statistics"]
    assert f"A-1005: {link_statistics['sentences']} sentences, {link_statistics['damaged']} damaged" in errors
    # Every seventh of those that arrived; a sentence whose line end is gone takes none with it.
    assert link_statistics["damaged"] / (link_statistics["sentences"] + link_statistics["damaged"]) == pytest.approx(
        1 / 7, abs=0.03
    )
    # A changed digit would have moved a single reading far beyond the noise.
    for position in file["positions"]:
        for channel in "xy":
            assert position["std"][channel] < 1.5 * part.noise

    replayed = tiltcal("replay", "A-1005.journal.jsonl", "--golden", "A-1005.yaml", cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr


def test_a_device_of_unknown_scale_is_calibrated_where_the_procedure_finds_the_scale(tmp_path: Path) -> None:
    def measure(procedure: str) -> Completed:
        address = "sim:unit=V&columns=x,y"
        sensor = ["--sensor", "serial-columns", "--address", address, "--serial", "C-1", "--operator", "sim"]
        return tiltcal("measure", procedure, *sensor, "-o", f"{procedure}.yaml", cwd=tmp_path)

    assert measure("zero-45").returncode == 0
    refused = measure("two-temperature")
    assert refused.returncode == 2
    assert "state it in the address (sensitivity=" in refused.stderr
    assert not (tmp_path / "two-temperature.yaml").exists()
