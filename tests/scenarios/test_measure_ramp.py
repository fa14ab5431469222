"""``tiltcal measure ramp``: a continuous record at the virtual bench, whose sensing element is late."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.json_program import Event, ProgramSession, lead

from tiltcal.bench.operators.operator import Live, OperatorAnswer
from tiltcal.bench.operators.sim import SimOperator
from tiltcal.bench.session import Session
from tiltcal.bench.session_plan import plan_session, single
from tiltcal.files.calibration import read_calibration
from tiltcal.files.procedure import Position
from tiltcal.files.procedure_file import find_procedure

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


def chamber(message: Event) -> Event | None:
    """A program of a chamber, which also reports the temperature that it had when it was asked."""
    return {"answer": "ready", "temperature": 21.0} if "ask" in message else None


@pytest.fixture(scope="module")
def led(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ProgramSession]:
    folder = tmp_path_factory.mktemp("ramp")
    (folder / "twin.yaml").write_text(TWIN)
    (folder / "quick.yaml").write_text(PROCEDURE)
    options = ("--sensor", "sca100t-d02", "--address", "sim:twin=twin.yaml", "--serial", "S-1", "-o", "S-1.yaml")
    return folder, lead("measure", "quick.yaml", *options, "--jig", "0", cwd=folder, answer=chamber)


def test_a_program_leads_through_the_turns(led: tuple[Path, ProgramSession]) -> None:
    _, session = led
    assert session.exit_code == 0, session.errors
    assert [(ask["position"], ask["temperature"]) for ask in session.asks] == [("down", 5), ("up", 40), ("back", 5)]
    assert [event["position"] for event in session.events("accepted")] == ["down", "up", "back"]
    assert "a thermal lag of" in session.errors


def test_the_lag_and_the_drift_are_those_of_the_twin(led: tuple[Path, ProgramSession]) -> None:
    folder, _ = led
    found = read_calibration(folder / "S-1.yaml")
    thermal = found.coefficients.thermal
    assert thermal is not None
    assert thermal.lag == pytest.approx(60.0, abs=3.0 * found.uncertainty["temperature.lag"])
    assert found.uncertainty["temperature.lag"] < 3.0
    assert thermal.drift[:, 0] == pytest.approx([2.1, -3.0], abs=0.03)
    assert found.coefficients.offset == pytest.approx([1030.0, 1018.0], abs=0.5)


def test_a_replay_gives_the_same_file(led: tuple[Path, ProgramSession]) -> None:
    folder, _ = led
    session = Session.of_journal(folder / "S-1.journal.jsonl")
    (text,) = session.replay().texts.values()
    assert text == (folder / "S-1.yaml").read_text()


class Watching(SimOperator):
    """A person at a terminal, who looks at a few live readings before each answer."""

    def position(self, position: Position, number: int, live: Live) -> OperatorAnswer:
        for _ in range(3):
            live()
        return super().position(position, number, live)


def test_live_readings_are_taken_again_in_a_replay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("twin.yaml").write_text(TWIN)
    Path("quick.yaml").write_text(PROCEDURE)
    journal = Path("S-1.journal.jsonl")
    plan = plan_session(
        find_procedure("quick.yaml"),
        single("sca100t-d02", "S-1", "sim:?twin=twin.yaml"),
        [Path("S-1.yaml")],
        journal,
        operator="sim",
    )
    session = Session(plan, journal)
    session.preflight()
    measured = session.run(Watching())
    measured.write()
    assert journal.read_text().count('"live"') == 9
    assert Session.of_journal(journal).replay().texts == measured.texts
