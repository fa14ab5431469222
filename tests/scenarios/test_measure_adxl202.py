"""An ADXL202 that was written apart from the drivers, on a pseudo-terminal, led through ``mavs`` by a program."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import yaml
from support import ROOT
from support.adxl202_part import Adxl202Part, on_a_pty
from support.command import tiltcal
from support.json_program import Event, lead

from tiltcal import TiltcalError, measure
from tiltcal.files.bench import BenchFile, BenchSensor

pytest.importorskip("serial", reason="the pyserial package is not installed")


def test_one_damaged_sentence_in_seven_is_counted_never_used_and_replays_to_the_byte(tmp_path: Path) -> None:
    """Without the six minutes in which a thermometer may be late."""
    shipped = (ROOT / "procedures" / "mavs.yaml").read_text()
    (tmp_path / "mavs.yaml").write_text(shipped.replace(", thermometer: 360}", "}"))
    part = Adxl202Part(damage_one_in=7)

    def posed(ask: Event) -> Event | None:
        if "ask" not in ask:
            return None
        part.gravity, part.temperature = ask["gravity"], ask["temperature"]
        return {"answer": "ready", "temperature": part.temperature}

    with on_a_pty(part) as path:
        led = lead(
            *("measure", "mavs.yaml", "--sensor", "adxl202", "--serial", "A-1005", "--samples", "80"),
            *("--settle", "0.1", "--address", f"serial://{path}?baudrate=115200", "-o", "A-1005.yaml"),
            cwd=tmp_path,
            answer=posed,
        )
    assert led.exit_code == 0, led.errors
    file = yaml.safe_load((tmp_path / "A-1005.yaml").read_text())
    assert file["sensor"] == {"model": "adxl202", "serial": "A-1005", "unit": "duty", "channels": ["x", "y"]}
    found = file["calibration"]
    for row, channel in enumerate("xy"):
        assert found["offset"][channel] == pytest.approx(part.offset[row], abs=4e-4)
        assert found["temperature"]["offset"][channel][0] == pytest.approx(part.drift[row], abs=4e-5)
        for column, axis in enumerate("xy"):
            assert found["sensitivity"][channel][axis] == pytest.approx(part.sensitivity[row][column], abs=6e-4)
        # A changed digit would have moved a single reading far beyond the noise.
        assert all(position["std"][channel] < 1.5 * part.noise for position in file["positions"])
    sentences, damaged = (file["provenance"]["link_statistics"][name] for name in ("sentences", "damaged"))
    assert f"A-1005: {sentences} sentences, {damaged} damaged" in led.errors
    # Every seventh of those that arrived; a sentence whose line end is gone takes none with it.
    assert damaged / (sentences + damaged) == pytest.approx(1 / 7, abs=0.03)
    tiltcal("replay", "A-1005.journal.jsonl", "--golden", "A-1005.yaml", cwd=tmp_path, code=0)


def test_a_line_that_is_unplugged_is_dropped_by_the_replay_too(tmp_path: Path) -> None:
    """It fails where the bench drops what has arrived, before any reading."""
    kept, pulled = Adxl202Part(), Adxl202Part()
    port = tmp_path / "ttyUSB0"  # by a name of its own: the number of a pty that is closed is soon another test's
    with on_a_pty(kept) as path, ExitStack() as line:
        port.symlink_to(line.enter_context(on_a_pty(pulled)))
        sensors = (
            BenchSensor("PULLED", "adxl202", f"serial://{port}"),
            BenchSensor("KEPT", "adxl202", f"serial://{path}"),
        )

        class Rig:
            def position(self, ask: Mapping[str, Any]) -> dict[str, str]:
                kept.gravity = pulled.gravity = ask["gravity"]
                if ask["position"] == "x-45":
                    port.unlink(missing_ok=True)
                    line.close()
                return {"answer": "ready"}

        bench = BenchFile(sensors)
        with pytest.raises(TiltcalError, match="no calibration file for PULLED"):
            measure("zero-45", bench=bench, operator=Rig(), output=tmp_path, samples=20, settle=0.3)
    assert [file.name for file in tmp_path.glob("*.yaml")] == ["KEPT.yaml"]
