"""A sensor that was plugged in again: its level measured live, resumed, replayed, and fitted from a log."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import FIXTURES
from support.command import tiltcal
from support.json_program import lead

from tiltcal.core.model import Thermal
from tiltcal.files.calibration import read_calibration
from tiltcal.library.calibration import Calibration

BASE = FIXTURES / "complete.yaml"
TWIN = (FIXTURES / "twins" / "sca100t-d02.yaml").read_text(encoding="utf-8")
JOURNAL = "again.journal.jsonl"


@pytest.fixture(scope="module")
def plugged_in(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the session of a sensor that sits askew, led by a program that knows its table."""
    folder = tmp_path_factory.mktemp("plugged-in")
    (folder / "askew.yaml").write_text(TWIN + "  mounting: {roll: 1.5, pitch: -1.0, yaw: 1.2}\n", encoding="utf-8")
    led = lead(
        *("measure", "level", "--base", BASE, "--sensor", "sca100t-d02", "--address", "sim:twin=askew.yaml"),
        *("--serial", "SIM-42", "--jig", "0.05", "--samples", "40", "-o", "again.yaml"),
        cwd=folder,
        answer=lambda message: {"answer": "ready", "tilt": {"x": 0.02, "y": -0.01}} if "ask" in message else None,
    )
    assert led.exit_code == 0, led.errors
    assert led.asks[0]["position"] == "level"
    assert "changed: offset.x, offset.y by more" in led.errors
    return folder


def test_the_offset_alone_is_new(plugged_in: Path) -> None:
    """Turns of 1.0° and 1.5° of a part of 819 counts per g: 14.3 and 21.4 counts."""
    old, new = read_calibration(BASE), read_calibration(plugged_in / "again.yaml")
    step = new.coefficients.offset - old.coefficients.offset
    assert abs(step) == pytest.approx([14.3, 21.4], abs=2.0)
    assert (new.coefficients.sensitivity == old.coefficients.sensitivity).all()
    assert {n: u for n, u in new.uncertainty.items() if "offset" not in n.split(".")[0]} == {
        n: u for n, u in old.uncertainty.items() if "offset" not in n.split(".")[0]
    }
    assert new.provenance.base is not None
    assert new.provenance.base.name == BASE.name


def test_the_same_from_a_log_that_is_all_level(plugged_in: Path, tmp_path: Path) -> None:
    tiltcal("replay", JOURNAL, "--samples", tmp_path / "log.csv", "-o", tmp_path / "x.yaml", cwd=plugged_in, code=0)
    tiltcal("fit", "level", "log.csv", "--base", BASE, "--jig", "0.05", "-o", "fit.yaml", cwd=tmp_path, code=0)
    found, live = (read_calibration(path) for path in (tmp_path / "fit.yaml", plugged_in / "again.yaml"))
    # The log does not tell that the table was off by 0.02° and -0.01°, 0.3 and 0.15 counts.
    assert found.coefficients.offset == pytest.approx(live.coefficients.offset, abs=0.6)
    assert found.provenance.log is not None


def test_a_level_without_the_temperature_that_counts_is_asked_for_again(tmp_path: Path) -> None:
    """An SCA3000-E04 has no thermometer: the operator types the temperature."""
    own = read_calibration(FIXTURES / "free.yaml")
    thermal = Thermal(24.0, (5.0, 30.0), np.full((3, 1), 0.1), np.zeros((3, 0)))
    base = replace(
        own, sensor=own.sensor.replaced(model="sca3000-e04"), coefficients=replace(own.coefficients, thermal=thermal)
    )
    Calibration(base).save(tmp_path / "base.yaml")
    typed = iter([{"answer": "ready"}, {"answer": "ready", "temperature": 12.0}])
    led = lead(
        *("measure", "level", "--base", "base.yaml", "--sensor", "sca3000-e04", "--address", "sim:"),
        *("--serial", "SIM-42", "--jig", "0.05", "--samples", "20", "-o", "again.yaml"),
        cwd=tmp_path,
        answer=lambda message: next(typed) if "ask" in message else None,
    )
    assert led.exit_code == 0, led.errors
    assert "changes with temperature, and level has none" in led.events("refused")[0]["why"]
    assert read_calibration(tmp_path / "again.yaml").fit.level.temperature == 12.0
