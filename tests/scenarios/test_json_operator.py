"""A program leads the session over JSON Lines (the contract of SPEC section 11)."""

from collections.abc import Callable
from pathlib import Path

import pytest
from support import FIXTURES
from support.command import measure
from support.json_program import Event, ProgramSession, lead

from tiltcal.files.calibration import read_calibration
from tiltcal.files.results import PositionSet


def table(folder: Path, procedure: str, answer: Callable[[Event, int], object]) -> ProgramSession:
    """Be a tilt table's program: answer every ask by a function of it and of its number, counted from 1."""
    asks: list[Event] = []

    def answered(message: Event) -> object:
        if "ask" not in message:
            return None
        asks.append(message)
        return answer(message, len(asks))

    options = ("--sensor", "sca100t-d02", "--address", "sim:?seed=1", "--serial", "S-1", "-o", "S-1.yaml")
    return lead("measure", procedure, *options, "--samples", "20", cwd=folder, answer=answered)


def ready(ask: Event, number: int) -> Event:
    return {"answer": "ready"}


def test_the_dialogue_is_the_contract(tmp_path: Path) -> None:
    led = table(tmp_path, "plane", ready)
    assert led.exit_code == 0, led.errors
    ask = led.asks[2]
    assert ask == {
        "ask": "position",
        "position": "y-tilt1",
        "tilt": {"y": 30.0},
        "gravity": [0.0, 0.5, pytest.approx(0.866, abs=1e-3)],
        "heading": 0,
        "temperature": None,
        "prompt": "Tilt the +Y side up to 30° and keep X level.",
    }
    accepted = led.events("accepted")
    assert [event["position"] for event in accepted] == ["x-tilt1", "x-tilt2", "y-tilt1", "y-tilt2"]
    assert set(accepted[0]) >= {"event", "position", "mean", "std", "n"}
    assert set(accepted[0]["mean"]) == {"x", "y"}
    assert accepted[0]["n"] == 20
    assert led.told[-1] == {"event": "done", "calibrations": ["S-1.yaml"], "journal": "S-1.journal.jsonl"}


def test_a_program_is_told_how_far_three_axes_are_off(tmp_path: Path) -> None:
    """The virtual jig is exact: what the first face shows is the offset of the part, some degrees at most."""
    options = "--sensor adxl345 --address sim:?seed=3 --serial S-1 -o S-1.yaml --samples 10"
    led = lead(
        *("measure", "six-face", *options.split()),
        cwd=tmp_path,
        answer=lambda message: {"answer": "ready"} if "ask" in message else None,
    )
    off = led.events("accepted")[0]["off"]
    assert set(off) == {"angle", "+Y", "+Z"}
    assert off["angle"] == pytest.approx((off["+Y"] ** 2 + off["+Z"] ** 2) ** 0.5, abs=0.01)
    assert 0.0 < off["angle"] < 10.0
    assert led.events("accepted")[-1]["off"]["angle"] < 1.0


def test_the_angle_actually_set_counts(tmp_path: Path) -> None:
    def answer(ask: Event, number: int) -> Event:
        axis, angle = next(iter(ask["tilt"].items()))
        return {"answer": "ready", "tilt": {axis: angle + 0.5}}

    led = table(tmp_path, "plane", answer)
    assert led.exit_code == 0, led.errors
    written = read_calibration(tmp_path / "S-1.yaml")
    assert written.procedure.set["y-tilt1"] == PositionSet(tilt={"y": 30.5})


def test_a_program_is_told_once_a_minute_what_is_waited_for(tmp_path: Path) -> None:
    """The chamber takes its time to 5.5 °C by the bench's clock, which is virtual."""
    twin = (FIXTURES / "twins" / "sca100t-d02.yaml").read_text()
    (tmp_path / "slow.yaml").write_text(twin.replace("time_constant: 0.1", "time_constant: 60.0"))
    options = ("--sensor", "sca100t-d02", "--address", "sim:?twin=slow.yaml", "--serial", "S-1", "-o", "S-1.yaml")
    led = lead(
        *("measure", "two-temperature", *options, "--samples", "20"),
        cwd=tmp_path,
        answer=lambda message: ready(message, 0) if "ask" in message else None,
    )
    assert led.exit_code == 0, led.errors
    cold = [event for event in led.events("waiting") if event["position"] == led.asks[-1]["position"]]
    assert len(cold) > 5
    assert all(event.keys() == {"event", "position", "seconds", "why", "temperature"} for event in cold)
    assert [event["seconds"] // 60 for event in cold] == list(range(1, len(cold) + 1))
    assert all(event["seconds"] % 60 < 10 for event in cold)
    asked = led.asks[-1]["temperature"]
    assert abs(cold[-1]["temperature"] - asked) < abs(cold[0]["temperature"] - asked)
    (tmp_path / "quick").mkdir()
    assert not table(tmp_path / "quick", "plane", ready).events("waiting")


def test_redo_asks_again_and_back_goes_back(tmp_path: Path) -> None:
    words = iter(["redo", "ready", "ready", "back", "ready", "ready", "ready", "ready"])
    led = table(tmp_path, "plane", lambda ask, n: {"answer": next(words)})
    assert led.exit_code == 0, led.errors
    assert [ask["position"] for ask in led.asks] == [
        *("x-tilt1", "x-tilt1", "x-tilt2", "y-tilt1", "x-tilt2", "y-tilt1", "y-tilt2"),
    ]
    assert next(words) == "ready"


def test_a_position_is_asked_for_in_vain_a_hundred_times_in_a_row_and_no_more(tmp_path: Path) -> None:
    """99 times before the first position and before the second do not add up."""
    words = [*["redo"] * 99, "ready", *["redo"] * 99, "ready", *["redo"] * 101]
    led = table(tmp_path, "plane", lambda ask, n: {"answer": words[n - 1]})
    assert led.exit_code == 130
    assert len(led.asks) == 300
    assert "y-tilt1 failed 100 times in a row" in led.errors


def test_quit_keeps_what_was_measured(tmp_path: Path) -> None:
    led = table(tmp_path, "plane", lambda ask, n: {"answer": "ready" if n < 3 else "quit"})
    assert led.exit_code == 130
    assert "--resume S-1.journal.jsonl" in led.errors
    assert not (tmp_path / "S-1.yaml").exists()
    resumed = measure("--resume", "S-1.journal.jsonl", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert (tmp_path / "S-1.yaml").exists()


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
        '{"answer": "ready", "tilt": {"y": ' + "9" * 400 + "}}": "too large a number",
    }
    led = table(tmp_path, "plane", lambda ask, n: [*rubbish, *4 * [{"answer": "ready"}]][n - 1])
    assert led.exit_code == 0, led.errors
    refused = led.events("refused")
    assert {event["position"] for event in refused} == {"x-tilt1"}
    for event, (said, why) in zip(refused, rubbish.items(), strict=True):
        assert why in event["why"], said
