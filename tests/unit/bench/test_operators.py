"""What a person is shown and may type."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import pytest
from rich.console import Console
from tiltcal.bench.keys import ENTER

from tiltcal.bench.operators import VirtualJig
from tiltcal.bench.terminal import Terminal

LEVEL = {
    "ask": "position", "position": "level", "tilt": {"x": 0.0, "y": 0.0}, "gravity": [0, 0, 1], "heading": 0,
    "temperature": None, "prompt": "Lay it level.",
}  # fmt: skip
SCA100T = {"unit": "count", "offset": 1024.0, "sensitivity": 819.0}
SCL3300 = {"unit": "count", "offset": 0.0, "sensitivity": 6000.0}


def begin(positions: tuple[str, ...] = ("level",), **sensors: object) -> dict[str, Any]:
    named = {name.replace("_", "-"): facts for name, facts in sensors.items()}
    begins = {"event": "begin", "title": "A title", "length": "", "accepted": []}
    return begins | {"positions": list(positions), "sensors": named}


def axis(target: float | None, present: float | None, ok: bool | None = None) -> dict[str, Any]:
    difference = None if target is None or present is None else present - target
    return {"target": target, "present": present, "difference": difference, "tolerance": 3.0, "ok": ok}


class Typed:
    """Keys and lines that were typed beforehand."""

    def __init__(self, keys: str, *lines: str) -> None:
        self._keys, self._lines = list(keys), list(lines)

    def choice(self, timeout: float | None) -> str | None:
        return self._keys.pop(0)

    def pressed(self, choices: str) -> str | None:
        return None

    def line(self) -> str:
        return self._lines.pop(0)


@pytest.fixture
def shown() -> io.StringIO:
    return io.StringIO()


@pytest.fixture
def person(shown: io.StringIO) -> Callable[..., Terminal]:
    console = Console(file=shown, force_terminal=True, width=100, color_system=None)
    return lambda keys, *lines: Terminal(console, Typed(keys, *lines), live=False)


def asked(operator: Terminal, question: dict[str, Any] = LEVEL) -> object:
    operator.tell(begin())
    return operator.ask(question)


def test_a_typed_angle_can_be_left_without_a_number(person, shown) -> None:
    assert asked(person("a\n", "", "")) == {"answer": "ready"}
    assert asked(person("at\n", "1,5", "", "")) == {"answer": "ready", "tilt": {"x": 1.5}}


def test_what_is_wrong_with_a_typed_number_is_said_in_plain_words(person, shown) -> None:
    """Whether a sensor can have the angles is the session's to say, which asks again."""
    answer = asked(person("at\n", "lots", "0.5", "-0.25", "warm", "24.5"))
    assert answer == {"answer": "ready", "tilt": {"x": 0.5, "y": -0.25}, "temperature": 24.5}
    assert "'lots' is not accepted: type a number such as 29.5" in shown.getvalue()
    assert "could not convert" not in shown.getvalue()


def test_a_live_reading_is_shown_until_a_key_is_pressed(shown: io.StringIO) -> None:
    """The session takes one each time that the answer is a look; what was typed before is kept."""
    console = Console(file=shown, force_terminal=True, width=100, color_system=None)
    keys = Typed("", "1.5", "")
    keys._keys = [None, None, "a", None, ENTER]  # type: ignore[list-item]
    operator = Terminal(console, keys, live=True)
    operator.tell(begin(S_1=SCA100T))
    answers = [operator.ask(LEVEL) for _ in range(4)]
    assert answers == [{"answer": "look"}] * 3 + [{"answer": "ready", "tilt": {"x": 1.5}}]
    assert shown.getvalue().count("Lay it level.") == 1


def test_six_sensors_are_shown_in_80_columns_below_their_targets(shown: io.StringIO) -> None:
    """The targets are repeated where the next sensor sits another way; the next reading takes the place of the rows."""
    console = Console(file=shown, force_terminal=True, width=80, height=24, color_system=None)
    operator = Terminal(console, Typed(ENTER), live=True)
    serials = [f"SCL-100{n}" for n in range(6)]
    operator.tell(begin(**{serial.replace("-", "_"): SCL3300 for serial in serials}))
    straight = {"x": axis(30.0, 29.71, True), "y": axis(0.0, None, False), "z": axis(60.0, 59.5, True)}
    turned = {"x": axis(0.0, 0.2, True), "y": axis(30.0, 29.9, True), "z": axis(60.0, 60.0, True)}
    readings = {
        serial: {
            "values": {"x": 2973.0, "y": 7000.0, "z": 5170.0},
            "temperature": 24.0,
            "guidance": turned if serial.endswith("5") else straight,
        }
        for serial in serials
    }
    for why in ("", "sample 3 of 20"):
        operator.tell({"event": "look", "position": "level", "why": why, "readings": readings})
    first, _, second = shown.getvalue().partition("\r\x1b[2K")
    rows = first.splitlines()[-9:]
    assert rows[0].split() == ["target", "x", "+30.00°", "y", "+0.00°", "z", "+60.00°"]
    assert " ".join(rows[1].split()) == "SCL-1000 x +29.71° (-0.29) ok y beyond 90° z +59.50° (-0.50) ok"
    assert [row.split()[0] for row in rows[5:8]] == ["SCL-1004", "target", "SCL-1005"]
    assert rows[8].strip() == "live, angles are not calibrated yet"
    assert all(len(row) <= 80 for row in rows)
    assert second.count("\x1b[1A\r\x1b[2K") == 8
    assert second.endswith("sample 3 of 20")


def test_the_keys_are_explained_and_the_time_that_remains_is_said(person, shown) -> None:
    operator = person("?\n")
    operator.tell(begin(("first", "level")) | {"accepted": ["first"]})
    operator.tell({"event": "progress", "position": "level", "accepted": ["first"], "seconds": 4210.0})
    assert operator.ask(LEVEL) == {"answer": "ready"}
    said = shown.getvalue()
    assert "kept from before: first" in said
    assert "2/2  level   about 1 h 11 min left" in said
    assert "a      type the angle that was really set" in said


def test_a_direction_is_typed_or_left(person, shown) -> None:
    free = {**LEVEL, "position": "free-1", "tilt": None}
    assert asked(person("a\n", ""), free) == {"answer": "ready"}
    assert asked(person("a\n", "up", "0 1", "0, 3 4"), free) == {"answer": "ready", "gravity": [0.0, 3.0, 4.0]}
    assert "type 3 numbers such as 0 0.5 0.866" in shown.getvalue()


def test_no_escape_sequence_and_no_markup_of_a_file_reaches_the_terminal(person, shown) -> None:
    """ESC ] 0 ; sets a window title, ESC [ 2 J clears the screen; a title [/] closes what rich never opened."""
    operator = person("\n")
    operator.tell({**begin(), "title": "a[/]\x1b]0;owned\x07 title"})
    operator.ask({**LEVEL, "position": "p\x1b[2J", "prompt": "Tilt \x9b2J it"})
    operator.tell({"event": "refused", "position": "level", "why": "\x1b[2J[bold]S[/]"})
    said = shown.getvalue()
    assert "a[/]?]0;owned? title" in said
    assert not set("\x1b\x07\x9b") & set(said)
    assert "refused: ?[2J[bold]S[/]" in said


MEASURED = {"mean": {"x": 1045.25, "y": 1018.95}, "std": {"x": 0.65, "y": 0.69}, "n": 20, "temperature": 24.93}
EXPECTED = {"S-1": {"x": 1024.0, "y": 1023.0}}
GUIDED = {"S-1": {"x": axis(0.0, 1.49, True), "y": axis(0.0, -0.35, True)}}
REVIEWED = {
    "ask": "review",
    "position": "level",
    "sensors": {"S-1": MEASURED},
    "expected": EXPECTED,
    "guidance": GUIDED,
}
ACCEPTED = {"event": "accepted", "position": "level", **MEASURED}


@pytest.mark.parametrize("width", [30, 40, 80])
def test_no_number_of_a_review_is_cut_off(width: int, shown: io.StringIO) -> None:
    console = Console(file=shown, force_terminal=True, width=width, color_system=None)
    operator = Terminal(console, Typed(ENTER), live=False)
    operator.tell(begin(S_1=SCA100T))
    assert operator.ask(REVIEWED) == {"answer": "accept"}
    text = shown.getvalue()
    for number in ("1045.25 count", "1018.95 count", "1024", "1023", "+1.49°", "-0.35 ok", "0.65", "0.69", "24.93 °C"):
        assert number in text
    assert "…" not in text
    assert all(len(line) <= width for line in text.splitlines())


def test_the_virtual_jig_numbers_a_position_that_a_resumed_session_only_reports() -> None:
    """It was accepted before the interruption, so it is not asked for again."""
    said: list[str] = []
    operator = VirtualJig(said.append)
    operator.tell({**begin(("first", "level"), S_1=SCA100T), "length": "2 positions"})
    operator.tell(ACCEPTED)
    assert said[0] == "A title: 2 positions"
    assert said[1].startswith("  2/2 level ")
