"""Free hands: what the page's operator takes by itself, and what a person has to answer."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, radians, sin
from typing import Any

import pytest

from tiltcal.bench.guidance import AxisTilt, Difference, SensorGuidance
from tiltcal.bench.operators import LOOK
from tiltcal.bench.page_server import PageState
from tiltcal.bench.web import WebOperator

SENSOR = {"model": "any", "unit": "g", "offset": 0.0, "sensitivity": 1.0, "axes": ("x", "y", "z")}
ATTITUDES = {"level": (0.0, 0.0, 1.0), "up": (0.5, 0.0, cos(radians(30))), "over": (0.0, 0.0, -1.0)}


def question(position: str, **more: object) -> dict[str, Any]:
    asked = {"tilt": {"x": 30.0}, "gravity": list(ATTITUDES[position]), "heading": 0, "temperature": None}
    return {"ask": "position", "position": position, "prompt": "", **asked, **more}


def guide(ok: bool | None, channels: str) -> SensorGuidance:
    tilts = dict.fromkeys(channels, AxisTilt(30.0, 30.0))
    return SensorGuidance(tilts, {"": Difference(0.0, 3.0, ok)}, ATTITUDES["up"], {"+X": 0.0, "+Y": 0.0})


class Bench:
    """A sensor whose first position was accepted, and which now stands at a tilt of x, degrees."""

    def __init__(self, *, channels: str = "xyz", headings: bool = False, accepted: str = "level") -> None:
        self.time = 0.0
        self.channels = channels
        self.operator = WebOperator(PageState(), {}, hands_free=True, clock=lambda: self.time)
        sensors = {"S-1": {**SENSOR, "channels": tuple(channels)}}
        shown = {"positions": list(ATTITUDES), "attitudes": ATTITUDES, "headings": headings, "sensors": sensors}
        self.operator.tell({"event": "begin", "title": "", "length": "", "accepted": [], **shown})
        mean = dict(zip("xyz", ATTITUDES[accepted], strict=True))
        values = {"mean": {channel: mean[channel] for channel in channels}}
        self.operator.tell({"event": "accepted", "position": accepted, **values})

    def answers(
        self, asked: Mapping[str, Any], tilt: float = 30.0, *, turns: float = 0.0, ok: bool | None = True
    ) -> str:
        """Return the answer after two seconds in which x turns by so many degrees a second."""
        for _ in range(9):
            answer: Any = self.operator.ask(asked)
            if answer["answer"] != LOOK:
                return str(answer["answer"])
            self.time += 0.25
            angle = tilt + turns * self.time
            values = {"x": sin(radians(angle)), "y": 0.0, "z": cos(radians(angle))}
            reading = {
                "values": {channel: values[channel] for channel in self.channels},
                "temperature": None,
                "guidance": guide(ok, self.channels),
            }
            self.operator.tell({"event": "look", "position": "", "why": "", "readings": {"S-1": reading}})
        return LOOK


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiltcal.bench.web.LIVE_PAUSE", 0.0)


def test_the_next_position_is_taken_where_the_readings_show_it() -> None:
    assert Bench().answers(question("up")) == "ready"


def test_all_else_asks_a_person() -> None:
    refused = Bench()
    refused.operator.tell({"event": "refused", "position": "up", "why": "it moved"})
    answers = {
        "first of all": Bench(accepted="up").answers(question("up")),
        "not moved": Bench().answers(question("up"), tilt=4.0),
        "moving": Bench().answers(question("up"), turns=2.0),
        "not as expected": Bench().answers(question("up"), ok=False),
        "expectation vague": Bench().answers(question("up"), ok=None),
        "temperature": Bench().answers(question("up", temperature=40.0)),
        "stage": Bench().answers(question("up", stage=90.0)),
        "heading": Bench(headings=True).answers(question("up")),
        "after a refusal": refused.answers(question("up")),
    }
    assert answers == dict.fromkeys(answers, LOOK)


def test_a_dead_sensor_is_shown_without_an_attitude() -> None:
    bench = Bench()
    bench.operator.ask(question("up"))
    unknown = SensorGuidance(dict.fromkeys("xyz", AxisTilt(0.0, None)), unknown=True)
    reading = {"values": dict.fromkeys("xyz", 0.0), "temperature": None, "guidance": unknown}
    bench.operator.tell({"event": "look", "position": "up", "why": "", "readings": {"S-1": reading}})
