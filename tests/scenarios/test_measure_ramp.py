"""``tiltcal measure ramp``: a continuous record at the virtual bench, whose sensing element is late."""

from itertools import count
from pathlib import Path
from typing import Any

import pytest
from support.command import tiltcal
from support.json_program import lead

from tiltcal.bench import devices
from tiltcal.files.calibration import read_calibration
from tiltcal.library.measure import measure

TWIN = """\
tiltcal: 1
kind: twin
model: sca100t-d02
seed: 3
truth:
  offset: {x: 1030.0, y: 1018.0}
  sensitivity: {x: {x: 822.0, y: 5.0}, y: {x: -4.0, y: 816.0}}
  temperature: {reference: 24.0, offset: {x: [2.1, 0.02], y: [-3.0]}}
  noise: {x: 0.6, y: 0.6}
  lag: 60.0
  ambient: 24.0
"""

PROCEDURE = """\
tiltcal: 1
kind: procedure
name: quick-ramp
title: A ramp of two and a half hours
determines: {axes: [], drift: 2, cross_validated: true}
reference: 24.0
ramp: {pace: 1.0, interval: 10}
positions:
  - {name: down, tilt: {x: 0, y: 0}, temperature: 5.0, prompt: "Cool to {temperature} °C."}
  - {name: up, tilt: {x: 0, y: 0}, temperature: 40.0, prompt: "Warm to {temperature} °C."}
  - {name: back, tilt: {x: 0, y: 0}, temperature: 5.0, prompt: "Cool to {temperature} °C."}
"""


OPTIONS = ("--sensor", "sca100t-d02", "--address", "sim:twin=twin.yaml", "--serial", "S-1", "-o", "S-1.yaml")


def test_a_program_leads_through_the_turns_and_the_lag_is_that_of_the_twin(tmp_path: Path) -> None:
    """It reports a temperature as well, that of when it was asked; to go back or tilt is refused, and loses no leg."""
    (tmp_path / "twin.yaml").write_text(TWIN)
    (tmp_path / "quick.yaml").write_text(PROCEDURE)
    said = ["ready", "back", "redo", {"answer": "ready", "tilt": {"x": 5}}, "ready", "back", "ready"]
    answers = iter([one if isinstance(one, dict) else {"answer": one} for one in said])
    session = lead(
        *("measure", "quick.yaml", *OPTIONS, "--jig", "0"),
        cwd=tmp_path,
        answer=lambda message: {**next(answers), "temperature": 21.0} if "ask" in message else None,
    )
    assert session.exit_code == 0, session.errors
    asked = [("down", 5), *[("up", 40)] * 4, *[("back", 5)] * 2]
    assert [(ask["position"], ask["temperature"]) for ask in session.asks] == asked
    record, attitude = "a ramp is one continuous record", "a ramp has one attitude"
    assert [one["why"].partition(":")[0] for one in session.events("refused")] == [record, record, attitude, record]
    assert [event["position"] for event in session.events("accepted")] == ["down", "up", "back"]
    assert "a thermal lag of" in session.errors
    found = read_calibration(tmp_path / "S-1.yaml")
    thermal = found.coefficients.thermal
    assert thermal is not None
    assert thermal.lag == pytest.approx(60.0, abs=3.0 * found.uncertainty["temperature.lag"])
    assert found.uncertainty["temperature.lag"] < 3.0
    assert thermal.drift[:, 0] == pytest.approx([2.1, -3.0], abs=0.03)
    assert found.coefficients.offset == pytest.approx([1030.0, 1018.0], abs=0.5)
    tiltcal("replay", "S-1.journal.jsonl", "--golden", "S-1.yaml", cwd=tmp_path, code=0)


def test_faults_that_pass_cost_their_samples_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Six breaks of the bus in an hour, and a reading at the rail of 2047: nobody has to press a key."""
    monkeypatch.chdir(tmp_path)
    connect, taken = devices.open_device, count()

    def opened(*arguments: Any) -> Any:
        link = connect(*arguments)
        exchange = link.exchange

        def railed(out: bytes, size: int = 0) -> bytes:
            answer = exchange(out, size)
            return bytes([0, 0xFF, 0xE0]) if out[0] == 0x10 and next(taken) == 200 else answer

        link.exchange = railed  # type: ignore[method-assign]
        return link

    monkeypatch.setattr(devices, "open_device", opened)
    breaks = [f"{{kind: unplugged, start: {600.0 * k}, end: {600.0 * k + 3.0}}}" for k in range(1, 7)]
    Path("twin.yaml").write_text(TWIN + f"  faults: [{', '.join(breaks)}]\n")
    Path("quick.yaml").write_text(PROCEDURE)
    said: list[str] = []
    sensor = {"sensor": "sca100t-d02", "serial": "S-1", "address": "sim:?twin=twin.yaml"}
    measure("quick.yaml", operator="sim", output="S-1.yaml", remark=said.append, **sensor)
    assert not [line for line in said if "refused" in line]
    thermal = read_calibration("S-1.yaml").coefficients.thermal
    assert thermal is not None
    assert thermal.lag == pytest.approx(60.0, abs=2.0)
    assert thermal.drift[0].tolist() == pytest.approx([2.1, 0.02], abs=0.01)
