"""What a person at a terminal is shown and may type."""

import io
import os
import pty
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from msgspec.structs import replace
from rich.console import Console

from tiltcal.bench.guidance import AxisTilt, Difference, SensorGuidance
from tiltcal.bench.messages import (
    Begin,
    Look,
    PositionQuestion,
    Progress,
    Refused,
    Review,
    ShownReading,
    ShownSensor,
)  # fmt: skip
from tiltcal.bench.operators import understood
from tiltcal.bench.terminal import ENTER, LineKeys, Terminal, TerminalKeys
from tiltcal.errors import InputError, Stopped

LEVEL = PositionQuestion(
    position="level", tilt={"x": 0.0, "y": 0.0}, gravity=[0, 0, 1], heading=0, temperature=None, prompt="Lay it level.",
)  # fmt: skip
SENSOR = ShownSensor("count", 1024.0, 819.0)


def test_a_line_with_a_key_is_taken_where_it_waits_and_the_end_is_told_when_a_question_is_asked() -> None:
    source, sink = os.pipe()
    with open(source, encoding="utf-8") as stream:
        keys = LineKeys(stream)
        os.write(sink, b"\n\n")
        assert keys.pressed("sq") is None
        os.write(sink, b"stop\ny\n\n")
        # What was typed before the key was typed in vain.
        assert [keys.pressed("sq"), keys.pressed("sq")] == ["s", None]
        assert [keys.choice(None), keys.choice(None)] == ["y", ENTER]
        os.close(sink)
        assert keys.pressed("sq") is None
        with pytest.raises(Stopped, match="the input has ended"):
            keys.choice(None)


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[TerminalKeys, int]]:
    """Keys of a terminal, and where they are typed."""
    person, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with TerminalKeys() as keys:
            yield keys, person
    os.close(person)


def test_a_key_is_a_choice_at_once_and_an_arrow_or_a_function_key_is_none(typed: tuple[TerminalKeys, int]) -> None:
    """xterm's down, F2 of the Linux console, Alt-down of rxvt, and the escape key alone."""
    keys, person = typed
    os.write(person, b"B\r")
    assert [keys.choice(1.0), keys.choice(1.0), keys.choice(0.0)] == ["b", ENTER, None]
    for sequence in (b"\x1b[B", b"\x1b[[B", b"\x1b\x1b[B", b"\x1b"):
        os.write(person, sequence)
        assert keys.choice(1.0) == "\x1b"
    os.write(person, b"r\x04")
    assert keys.choice(1.0) == "r"
    with pytest.raises(Stopped, match="has ended"):
        keys.choice(1.0)


class Typed:
    """Keys, None where none comes, and lines that were typed beforehand."""

    def __init__(self, keys: str | list[str | None], *lines: str) -> None:
        self._keys, self._lines = list(keys), list(lines)

    def choice(self, timeout: float | None) -> str | None:
        return self._keys.pop(0)

    def line(self) -> str:
        return self._lines.pop(0)


def terminal(
    shown: io.StringIO, keys: str | list[str | None], *lines: str, width: int = 100, live: bool = False, **begin: Any
) -> Terminal:
    """A terminal after the begin of a session."""
    console = Console(file=shown, force_terminal=True, width=width, height=24, color_system=None)
    operator = Terminal(console, Typed(keys, *lines), live=live)  # type: ignore[arg-type]
    said: Any = {"title": "A title", "accepted": [], "positions": ["level"], "attitudes": {}, "headings": False}
    operator.tell(Begin(**{**said, "sensors": {"S-1": SENSOR}, **begin}))
    return operator


def guide(**axes: tuple[float | None, float | None, bool | None]) -> SensorGuidance:
    """Guidance of two axes by target, present and ok."""
    tilts = {channel: AxisTilt(target, present) for channel, (target, present, _) in axes.items()}
    return SensorGuidance(
        tilts,
        {
            channel: Difference(None if present is None or target is None else present - target, 3.0, ok)
            for channel, (target, present, ok) in axes.items()
        },
    )


def test_angles_temperatures_and_directions_are_typed_or_left() -> None:
    """Whether a sensor can have the angles is the session's to say, which asks again."""
    shown, free = io.StringIO(), replace(LEVEL, tilt=None)
    for question, keys, lines, answer in (
        (LEVEL, "a\n", ("", ""), {}),
        (LEVEL, "at\n", ("1,5", "", ""), {"tilt": {"x": 1.5}}),
        (LEVEL, "at\n", ("lots", "0.5", "-0.25", "24.5"), {"tilt": {"x": 0.5, "y": -0.25}, "temperature": 24.5}),
        (free, "a\n", ("",), {}),
        (free, "a\n", ("up", "0 1", "0, 3 4"), {"gravity": [0.0, 3.0, 4.0]}),
        (free, "a\n", ("0° 0 1", "0 0,5 0.866"), {"gravity": [0.0, 0.5, 0.866]}),
    ):
        assert terminal(shown, keys, *lines).ask(question) == {"answer": "ready", **answer}
    assert "'lots' is not accepted, it is no number: type an angle such as 29.5" in shown.getvalue()
    assert "type 3 numbers such as 0 0.5 0.866" in shown.getvalue()


@pytest.mark.parametrize(
    ("key", "texts", "number"),
    [
        ("tilt", ("27.5", "27,5", "+27.5", " 27.50 ", "27,5°", "27.5 °", "27.5 deg", "27,5deg"), 27.5),
        ("tilt", ("-0.25", "−0,25", "-.25°", "−,25 deg"), -0.25),
        ("tilt", ("1.000,5", "1,000.5", "27..5", "2,7,5", "27.5,"), "two decimal marks"),
        ("tilt", ("27.5 rad", "27°30'", "27.5 degrees", "1e1", "0x1B", "27 5", "27.5 %"), "behind the number"),
        ("tilt", ("", "lots", "°", "nan", "inf", "--3", "x 27.5", "٢٧", "½"), "is not accepted"),
        ("temperature", ("21.5", "21,5 °C", "21.5C", "21.5 C", "21,5 ° C", "+21.5°C"), 21.5),
        ("temperature", ("21.5 °", "70 °F", "294.6 K", "21.5 deg", "21.5 c", "21.5 ºC"), "behind the number"),
        ("gravity", ("0,5", "0.5 ", ".5"), 0.5),
        ("gravity", ("0.5 g", "0.5°"), "behind the number"),
    ],
)
def test_what_is_typed_is_read_or_refused_at_terminal_page_and_by_a_program(
    key: str, texts: tuple[str, ...], number: float | str
) -> None:
    """SPEC: one decimal mark, ° and deg behind an angle, °C and C behind a temperature, nothing else."""
    for text in texts:
        said = {"answer": "ready", key: {"tilt": {"x": text}, "gravity": [text, "0", "1"]}.get(key, text)}
        if isinstance(number, str):
            with pytest.raises(InputError, match=number):
                understood(said)
            continue
        answer = understood(said)
        assert {"tilt": answer.tilt.get("x"), "temperature": answer.temperature}.get(key, 0.5) == number


def test_a_live_reading_is_shown_until_a_key_is_pressed() -> None:
    """The session takes one each time that the answer is a look; what was typed before is kept."""
    operator = terminal(shown := io.StringIO(), [None, None, "a", None, ENTER], "1.5", "", live=True)
    answers = [operator.ask(LEVEL) for _ in range(4)]
    assert answers == [{"answer": "look"}] * 3 + [{"answer": "ready", "tilt": {"x": 1.5}}]
    assert shown.getvalue().count("Lay it level.") == 1


def test_six_sensors_are_shown_in_80_columns_below_their_targets() -> None:
    """The targets are repeated where the next sensor sits another way; the next reading takes the place of the rows."""
    serials = [f"SCL-100{n}" for n in range(6)]
    sensors = dict.fromkeys(serials, SENSOR)
    operator = terminal(shown := io.StringIO(), ENTER, width=80, live=True, sensors=sensors)
    straight = guide(x=(30.0, 29.71, True), y=(0.0, None, False))
    tilts = {"x": AxisTilt(90.0, 88.07), "y": AxisTilt(0.0, -1.5), "z": AxisTilt(0.0, 1.21)}
    three = SensorGuidance(tilts, {"": Difference(1.93, 6.0, True)}, sides={"+Y": -1.5, "+Z": 1.21})
    values = {"x": 2973.0, "y": 7000.0}
    readings = {one: ShownReading(values, 24.0, three if one.endswith("5") else straight) for one in serials}
    shown.truncate(0)
    for why in ("", "sample 3 of 20"):
        operator.tell(Look("level", why, readings))
    first, _, second = shown.getvalue().partition("\r\x1b[2K")
    rows = first.splitlines()[-9:]
    assert rows[0].split()[-4:] == ["x", "+30.00°", "y", "+0.00°"]
    assert " ".join(rows[1].split()) == "SCL-1000 x +29.71° (-0.29) ok y beyond 90° 24.0 °C 2973 7000 count"
    assert [row.split()[0] for row in rows[5:8]] == ["SCL-1004", "target", "SCL-1005"]
    assert rows[7].split(maxsplit=1)[1].startswith("1.93° off: +Y -1.50° raise, +Z +1.21° ok")
    assert rows[8].strip() == "live, angles are not calibrated yet"
    assert all(len(row) <= 80 for row in rows[1:])
    assert second.count("\x1b[1A\r\x1b[2K") == 8
    assert second.endswith("sample 3 of 20")


def test_a_loose_wire_jumps_in_the_traces_of_one_sensor() -> None:
    operator = terminal(shown := io.StringIO(), ENTER, width=80, live=True)
    for x in (0.0, 0.0, 0.5, 0.0, 0.0, 0.0):
        one = SensorGuidance({}, {}, up=(x, 0.0, 1.0))
        operator.tell(Look("level", "", {"S-1": ShownReading({"x": 0.0, "y": 0.0}, None, one)}))
    assert shown.getvalue().endswith("live, angles are not calibrated yet  x ▄▄█▄▄▄  y ▄▄▄▄▄▄  z ▄▄▄▄▄▄")


def test_the_keys_are_explained_and_the_time_that_remains_is_said() -> None:
    operator = terminal(shown := io.StringIO(), "?\n", positions=["first", "level"], accepted=["first"])
    operator.tell(Progress("level", ["first"], "about 1 h 11 min left"))
    assert operator.ask(LEVEL) == {"answer": "ready"}
    for said in (
        "kept from before: first",
        "2/2  level   about 1 h 11 min left",
        "a      type the angle that was",
    ):
        assert said in shown.getvalue()


def test_no_escape_sequence_and_no_markup_of_a_file_reaches_the_terminal() -> None:
    """ESC ] 0 ; sets a window title, ESC [ 2 J clears the screen; a title [/] closes what rich never opened."""
    operator = terminal(shown := io.StringIO(), "\n", title="a[/]\x1b]0;owned\x07 title")
    operator.ask(replace(LEVEL, position="p\x1b[2J", prompt="Tilt \x9b2J it"))
    operator.tell(Refused("level", "\x1b[2J[bold]S[/]"))
    said = shown.getvalue()
    assert "a[/]?]0;owned? title" in said
    assert not set("\x1b\x07\x9b") & set(said)
    assert "refused: ?[2J[bold]S[/]" in said


@pytest.mark.parametrize("width", [30, 80])
def test_no_number_of_a_review_is_cut_off(width: int) -> None:
    operator = terminal(shown := io.StringIO(), ENTER, width=width)
    axes = guide(x=(0.0, 1.49, True), y=(0.0, -0.35, True))
    measured = ShownReading({"x": 1045.25, "y": 1018.95}, 24.93, axes, {"x": 0.65, "y": 0.69}, 20)
    assert operator.ask(Review("level", {"S-1": measured})) == {"answer": "accept"}
    for number in ("1045.25", "1018.95", "+0.00°", "+1.49°", "-0.35°", "ok", "0.65", "0.69", "24.93"):
        assert number in shown.getvalue().split()
    assert all(len(line) <= width for line in shown.getvalue().splitlines())
