"""A program leads the session over JSON Lines (the contract of SPEC section 11)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support import FIXTURES
from support.json_program import Event, ProgramSession, lead

from tiltcal import measure as measure_here
from tiltcal.bench import settle
from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.drivers import find_model
from tiltcal.files.calibration import read_calibration
from tiltcal.files.procedure import find_procedure
from tiltcal.files.results import PositionSet


def table(folder: Path, procedure: str, answer: Callable[[Event, int], object]) -> ProgramSession:
    """Be a tilt table's program: answer every ask by a function of it and of its number, counted from 1."""
    asks: list[Event] = []

    def answered(message: Event) -> object:
        if "ask" not in message:
            return None
        asks.append(message)
        return answer(message, len(asks))

    options = [f"--{name}={value}" for name, value in SENSOR.items()]
    return lead("measure", procedure, *options, "--samples", "20", cwd=folder, answer=answered)


READY = {"answer": "ready"}
SENSOR: Any = {"sensor": "sca100t-d02", "address": "sim:?seed=1", "serial": "S-1", "output": "S-1.yaml"}


def dialogue(said: list[tuple[str, Event]]) -> list[Event]:
    """What is told where a position is answered so; nothing of ready is said before the last of all is accepted."""
    truth, steps = find_model("sca100t-d02").default_truth(1), find_procedure("plane").positions
    told: list[Event] = []
    for name, answer in said:
        one = next(position for position in steps if position.name == name)
        ask = {"ask": "position", "position": name, "tilt": one.tilt, "heading": 0, "temperature": None}
        told.append({**ask, "gravity": pytest.approx(one.gravity, abs=1e-9), "prompt": one.prompt})
        if answer["answer"] == "ready":
            up = gravity_from_tilt(answer.get("tilt", one.tilt))
            mean = {c: pytest.approx(truth.reading(c, up, 24.0), abs=0.6) for c in "xy"}
            std = {c: pytest.approx(truth.noise[c], rel=0.5) for c in "xy"}
            measured = {"mean": mean, "std": std, "n": 20, "temperature": pytest.approx(24.0, abs=0.94)}
            told.append({"event": "accepted", "position": name, **measured})
    return [*told, {"event": "done", "calibrations": ["S-1.yaml"], "journal": "S-1.journal.jsonl"}]


@pytest.mark.parametrize("way", ["a program", "an object"])
def test_the_dialogue_is_the_contract(way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All that is asked and told: a position is asked for once more, one is taken back, and one is set otherwise."""
    once_more, taken_back, half_more = {"answer": "redo"}, {"answer": "back"}, {"answer": "ready", "tilt": {"y": 30.5}}
    said = [("x-tilt1", once_more), ("x-tilt1", READY), ("x-tilt2", READY), ("y-tilt1", taken_back), ("x-tilt2", READY),
            ("y-tilt1", half_more), ("y-tilt2", READY)]  # fmt: skip
    told: list[Event] = []
    if way == "a program":
        led = table(tmp_path, "plane", lambda ask, n: said[n - 1][1])
        told = led.told
        assert led.exit_code == 0, led.errors
    else:
        monkeypatch.chdir(tmp_path)
        answers = iter([answer for _, answer in said])

        class Rig:
            accepted = done = told.append

            def position(self, ask: Event) -> object:
                told.append(ask)
                return next(answers)

        measure_here("plane", operator=Rig(), samples=20, **SENSOR)
    assert told == dialogue(said)
    written = read_calibration(tmp_path / "S-1.yaml")
    assert written.procedure.set["y-tilt1"] == PositionSet(tilt={"y": 30.5})


def test_a_program_is_told_once_a_minute_what_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The chamber takes its time to 5.5 °C by the bench's clock, which is virtual."""
    monkeypatch.setattr(settle, "SOAK_LOOKS", 50)
    twin = (FIXTURES / "twins" / "sca100t-d02.yaml").read_text()
    (tmp_path / "slow.yaml").write_text(twin.replace("time_constant: 0.1", "time_constant: 60.0"))
    options = ("--sensor", "sca100t-d02", "--address", "sim:?twin=slow.yaml", "--serial", "S-1", "-o", "S-1.yaml")
    led = lead(*("measure", "two-temperature", *options, "--samples", "20"), cwd=tmp_path)
    assert led.exit_code == 0, led.errors
    cold = [event for event in led.events("waiting") if event["position"] == led.asks[-1]["position"]]
    assert len(cold) > 5
    assert all(event.keys() == {"event", "position", "seconds", "why", "temperature"} for event in cold)
    assert [event["seconds"] // 60 for event in cold] == list(range(1, len(cold) + 1))
    assert all(event["seconds"] % 60 < 10 for event in cold)
    asked = led.asks[-1]["temperature"]
    assert abs(cold[-1]["temperature"] - asked) < abs(cold[0]["temperature"] - asked)


def test_a_position_is_asked_for_in_vain_a_hundred_times_in_a_row_and_no_more(tmp_path: Path) -> None:
    """99 times before the first position and before the second do not add up."""
    words = [*["redo"] * 99, "ready", *["redo"] * 99, "ready", *["redo"] * 101]
    led = table(tmp_path, "plane", lambda ask, n: {"answer": words[n - 1]})
    assert led.exit_code == 130
    assert len(led.asks) == 300
    assert "y-tilt1 failed 100 times in a row" in led.errors


def test_an_answer_that_will_not_do_is_refused_with_the_reason(tmp_path: Path) -> None:
    rubbish = {
        "what?": "not understood: 'what?'",
        "[]": "a mapping is needed here, found a list",
        '{"answer": "yes"}': "answer 'yes' is not one of ready, redo, back, again, quit",
        '{"answer": "ready", "tilt": {"y": NaN}}': "not understood",
        '{"answer": "ready", "tilt": {"y": 95}}': "a tilt of 95.0° is not between -90° and 90°",
        '{"answer": "ready", "tilt": {"q": 3}}': "unknown key 'q'; known here: x, y",
        '{"answer": "ready", "gravity": [0, 0, 0]}': "gravity [0, 0, 0] has no direction",
        '{"answer": "ready", "angle": 30}': "unknown key 'angle'",
        '{"answer": "ready", "temperature": 151}': "temperature in the answer is 151 °C, not between -60 and 150",
        '{"answer": "ready", "temperature": -61}': "temperature in the answer is -61 °C, not between -60 and 150",
        '{"answer": "again"}': "the answer 'again' names the position",
        '{"answer": "redo", "position": "x-tilt1"}': "the answer 'redo' names no position",
        '{"answer": "back"}': "this is the first position: there is none before it to go back to",
        '{"answer": "ready", "tilt": {"y": ' + "9" * 400 + "}}": "too large a number",
    }
    led = table(tmp_path, "plane", lambda ask, n: [*rubbish, *4 * [{"answer": "ready"}]][n - 1])
    assert led.exit_code == 0, led.errors
    refused = led.events("refused")
    assert {event["position"] for event in refused} == {"x-tilt1"}
    for event, (said, why) in zip(refused, rubbish.items(), strict=True):
        assert why in event["why"], said
