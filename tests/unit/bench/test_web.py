"""Free hands: what the page's operator takes by itself, and what a person has to answer."""

import json
from math import cos, radians, sin
from typing import Any

import pytest

from tiltcal.bench.guidance import AxisTilt, Difference, SensorGuidance
from tiltcal.bench.messages import (
    Accepted,
    AfterwardsQuestion,
    Begin,
    Look,
    PositionQuestion,
    Progress,
    Refused,
    Review,
    RotationQuestion,
    ShownReading,
    ShownSensor,
    StagePair,
    StopAndKeep,
    WriteQuestion,
)
from tiltcal.bench.operators import LOOK
from tiltcal.bench.page_server import PageState
from tiltcal.bench.web import WebOperator
from tiltcal.errors import Stopped

ATTITUDES = {"level": (0.0, 0.0, 1.0), "up": (0.5, 0.0, cos(radians(30))), "over": (0.0, 0.0, -1.0)}


def question(position: str, **more: Any) -> PositionQuestion:
    asked = {"tilt": {"x": 30.0}, "gravity": list(ATTITUDES[position]), "heading": 0, "temperature": None}
    return PositionQuestion(position=position, prompt="", **{**asked, **more})


def guide(ok: bool | None, channels: str) -> SensorGuidance:
    if ok is None:  # a dead sensor
        return SensorGuidance(dict.fromkeys(channels, AxisTilt(30.0, None)), unknown=True)
    tilts = dict.fromkeys(channels, AxisTilt(30.0, 30.0))
    return SensorGuidance(tilts, {"": Difference(0.0, 3.0, ok)}, ATTITUDES["up"], {"+X": 0.0, "+Y": 0.0})


class Bench:
    """A sensor whose first position was accepted, and which now stands at a tilt of x, degrees."""

    def __init__(
        self, *, channels: str = "xyz", headings: bool = False, accepted: str = "level", free: bool = False
    ) -> None:
        self.time = 0.0
        self.channels = channels
        self.state = PageState()
        self.operator = WebOperator(self.state, {}, hands_free=True, clock=lambda: self.time)
        sensors = {"S-1": ShownSensor("g", 0.0, 1.0)}
        shown: Any = {"positions": list(ATTITUDES), "attitudes": ATTITUDES, "headings": headings, "sensors": sensors}
        self.operator.tell(Begin(title="", accepted=[], free=free, **shown))
        self.accept(accepted)

    def accept(self, accepted: str) -> None:
        """Have a position accepted."""
        mean = dict(zip("xyz", ATTITUDES[accepted], strict=True))
        self.operator.tell(Accepted(accepted, {channel: mean[channel] for channel in self.channels}, {}, 1))

    def doing(self) -> str:
        """Return what the page says that the session does."""
        return str(json.loads(self.state.after(0)[1])["doing"])

    def answers(
        self, asked: PositionQuestion, tilt: float = 30.0, *, turns: float = 0.0, ok: bool | None = True
    ) -> str:
        """Return the answer after two seconds in which x turns by so many degrees a second."""
        for _ in range(9):
            answer: Any = self.operator.ask(asked)
            if answer["answer"] != LOOK:
                return str(answer["answer"])
            self.time += 0.25
            angle = tilt + turns * self.time
            values = {"x": sin(radians(angle)), "y": 0.0, "z": cos(radians(angle))}
            shown = {channel: values[channel] for channel in self.channels}
            self.operator.tell(Look("", "", {"S-1": ShownReading(shown, None, guide(ok, self.channels))}))
        return LOOK


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiltcal.bench.web.LIVE_PAUSE", 0.0)


def test_the_next_position_is_taken_where_the_readings_show_it() -> None:
    bench = Bench()
    assert bench.answers(question("up")) == "ready"
    assert bench.operator.ask(Review("up", {})) == {"answer": "accept"}


def test_all_else_asks_a_person_and_says_what_it_waits_for() -> None:
    refused = Bench()
    refused.operator.tell(Refused("up", "it moved"))
    for bench, answers, said in (
        (Bench(accepted="up"), {}, "reads as the position before"),
        (Bench(), {"tilt": 4.0}, "reads as the position before"),
        (Bench(), {"turns": 2.0}, "waits until it stands still"),
        (Bench(), {"ok": False}, "waits until the reading is within the tolerance"),
        (Bench(), {"ok": None}, "nothing predicts this reading: press Measure"),
        (Bench(), {"temperature": 40.0}, "a temperature asks a person"),
        (Bench(), {"stage": 90.0}, "an angle of the stage asks a person"),
        (Bench(headings=True), {}, "a heading asks a person"),
        (refused, {}, "the first position, and one after a refusal"),
    ):
        asked = {key: answers.pop(key) for key in ("temperature", "stage") if key in answers}
        assert bench.answers(question("up", **asked), **answers) == LOOK, said
        assert bench.doing().startswith(f"hands-free: {said}")


@pytest.mark.parametrize(
    ("asked", "shown"),
    [
        (question("up", temperature=40.0, stage=90.0, heading=30.0),
         {"prompt": "", "conditions": ["at 40 °C", "stage at 90°", "heading 30°"]}),
        (question("up"), {"prompt": "", "conditions": []}),
        (RotationQuestion([StagePair(("a1", "a2"), "a4")], 12, "Let it turn."),
         {"prompt": "Let it turn.", "step": "up to 12 turns", "conditions": ["a1 and a2, orthogonal a4"]}),
        (StopAndKeep("up", "no agreement"),
         {"prompt": "no agreement", "step": "stop and keep", "accepted": list(ATTITUDES), "conditions": []}),
        (WriteQuestion(["a", "b"]),
         {"prompt": "Write a, b?", "step": "everything is measured", "table": None, "guide": None, "remaining": None}),
        (AfterwardsQuestion(True, "What now?"), {"prompt": "What now?", "step": "everything is measured"}),
    ],
)  # fmt: skip
def test_what_the_page_shows_of_a_question(asked: Any, shown: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    bench.operator.tell(Progress("over", ["level"], "12 min"))
    monkeypatch.setattr(bench.state, "wait", lambda seconds: {"answer": "go", "id": 1})
    assert bench.operator.ask(asked) == {"answer": "go", "id": 1}
    state = json.loads(bench.state.after(0)[1])
    before = {"step": "3 of 3   over", "accepted": ["level"], "remaining": "12 min", "samples": None, "soak": None}
    expected = {**before, "refused": "", "doing": "", **shown}
    if isinstance(asked, WriteQuestion | AfterwardsQuestion):
        expected |= {"accepted": list(ATTITUDES), "remaining": None}
    assert {key: state[key] for key in expected} == expected
    assert {**state["question"], "id": ""} == {**json.loads(json.dumps(asked.as_data())), "id": ""}
    monkeypatch.setattr(bench.state, "wait", lambda seconds: {"answer": "quit"})
    why = "not written: the operator declined" if isinstance(asked, WriteQuestion) else "stopped by the operator"
    with pytest.raises(Stopped, match=f"^{why}$"):
        bench.operator.ask(asked)


def test_the_readings_of_two_sensors_are_drawn_with_the_worst_and_how_still_they_stand() -> None:
    """S-1 has two axes, S-2 a direction; then x turns by 1° a second for 1 s, and then S-2 has no reading."""
    bench = Bench()
    sensors = {"S-1": ShownSensor("count", 1000.0, 800.0), "S-2": ShownSensor("g", 0.0, 1.0)}
    bench.operator.tell(Begin(title="", positions=[], attitudes={}, headings=False, accepted=[], sensors=sensors))
    assert bench.operator.ask(question("up")) == {"answer": LOOK}
    axes = {"x": AxisTilt(30.0, 29.0), "y": AxisTilt(0.0, 0.5)}
    two = {"x": Difference(-1.0, 4.0, True), "y": Difference(0.5, 1.0, True)}
    high = SensorGuidance({}, {"": Difference(9.0, 6.0, False)}, (0.6, 0.0, 0.8), {"+X": 9.0, "+Y": 0.0})

    def look(x: float) -> dict[str, Any]:
        shown = {
            "S-1": ShownReading({"x": 1000.0 + 800.0 * sin(radians(x)), "y": 1000.0}, 24.93,
                                SensorGuidance(axes, two, ATTITUDES["up"], {"+X": 1.0, "+Y": -0.5})),
            "S-2": ShownReading({"x": 0.6, "y": 0.0, "z": 0.8}, None, high),
        }  # fmt: skip
        bench.operator.tell(Look("up", "waits", shown, 12.5))
        return dict(json.loads(bench.state.after(0)[1]))

    state = look(29.0)
    guided = state.pop("guide")
    drawn = [
        {
            "name": "S-1",
            "said": "y +0.5°",
            "present": [*ATTITUDES["up"]],
            "sides": [1.0, -0.5],
            "share": 0.5,
            "ok": True,
        },
        {"name": "S-2", "said": "+9.0°", "present": [0.6, 0.0, 0.8], "sides": [9.0, 0.0], "share": 1.5, "ok": False},
    ]
    worst = {"axis": "", "angle": 9.0, "tolerance": 6.0, "fits": False}
    assert guided == {"target": [*ATTITUDES["up"]], "sides": ["+X", "+Y"], "sensors": drawn, "worst": worst,
                      "fits": False, "ok": False, "note": "", "still": 0.0}  # fmt: skip
    assert state["table"] == {
        "head": ["not calibrated yet", "set", "now", "difference", "reading"],
        "rows": [
            {"cells": ["S-1 x", "+30.00°", "+29.00°", "-1.00°", "1387.85 count"], "ok": True},
            {"cells": ["S-1 y", "+0.00°", "+0.50°", "+0.50°", "1000 count"], "ok": True},
            {"cells": ["S-1 T", "", "", "", "24.93 °C"], "ok": None},
            {"cells": ["S-2 direction", "", "", "9.00°", ""], "ok": False},
            *(
                {"cells": [f"S-2 {axis}", "", "", "", f"{g} g"], "ok": None}
                for axis, g in zip("xyz", (0.6, 0, 0.8), strict=True)
            ),
        ],
    }
    assert (state["doing"], state["soak"], state["samples"]) == ("waits", 12.5, None)
    for number, still in ((1, 0.0), (2, 0.0), (3, 0.0), (4, 0.3 / 0.625), (5, 0.3 / 0.75)):
        # Of five readings 0.25° apart the means of the first two and of the last three are 0.625° apart; of six 0.75°.
        bench.time += 0.25
        assert look(29.0 + 0.25 * number)["guide"]["still"] == pytest.approx(still, rel=1e-3), number
    bench.time += 0.25
    bench.operator.tell(Look("up", "no reading", {}))
    assert json.loads(bench.state.after(0)[1])["guide"]["still"] == 0.0


def test_the_sphere_shows_what_is_missing_and_of_free_positions_the_share_that_is_met() -> None:
    """A cap of 40° is (1 - cos 40°) / 2 of the sphere, 11.7 %; those of two opposite directions do not meet."""
    bench = Bench()
    bench.operator.tell(Progress("up", ["level"], ""))
    sphere = json.loads(bench.state.after(0)[1])["sphere"]
    assert ([met for _, met in sphere["dots"]], sphere["share"]) == ([True, False, False], None)
    free = Bench(free=True)
    for accepted, share in ((["level"], 0.117), (["level", "over"], 0.234), (["before", "level", "over"], None)):
        free.accept(accepted[-1])
        free.operator.tell(Progress("next", accepted, ""))
        shown = json.loads(free.state.after(0)[1])["sphere"]["share"]
        assert shown == (None if share is None else pytest.approx(share, abs=0.01))
    alone = Bench(free=True, channels="z")  # a direction by z alone
    alone.operator.tell(Progress("next", ["level"], ""))
    assert json.loads(alone.state.after(0)[1])["sphere"]["dots"] == [[[0.0, 0.0, 1.0], True]]
