"""ADXL202s that were written apart from the drivers, on pseudo-terminals."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.adxl202_part import Adxl202Part, on_a_pty
from support.command import tiltcal

from tiltcal import TiltcalError, measure
from tiltcal.files.bench import BenchFile, BenchSensor

pytest.importorskip("serial", reason="the pyserial package is not installed")


def test_a_line_that_is_unplugged_is_dropped_by_the_replay_too(tmp_path: Path) -> None:
    """It fails where the bench drops what has arrived; of the other one each seventh sentence is damaged."""
    kept, pulled = Adxl202Part(damage_one_in=7), Adxl202Part()
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
    file = yaml.safe_load((tmp_path / "KEPT.yaml").read_text())
    found = file["calibration"]
    for row, channel in enumerate("xy"):
        assert found["offset"][channel] == pytest.approx(kept.offset[row], abs=4e-4)
        assert found["sensitivity"][channel][channel] == pytest.approx(kept.sensitivity[row][row], abs=1e-3)
        assert all(position["std"][channel] < 2.0 * kept.noise for position in file["positions"])  # no changed digit
    sentences, damaged = (file["provenance"]["link_statistics"][name] for name in ("sentences", "damaged"))
    assert damaged / (sentences + damaged) == pytest.approx(1 / 7, abs=0.03)
    tiltcal("replay", "bench.journal.jsonl", "--golden", "KEPT.yaml", cwd=tmp_path, code=0)
