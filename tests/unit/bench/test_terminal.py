"""What a person at a terminal is shown and may type."""

import io
import os
import pty
import sys
import termios
from collections.abc import Iterator
from typing import Any

import pytest
from msgspec.structs import replace
from rich.console import Console

from tiltcal.bench import messages as m
from tiltcal.bench.guidance import AxisTilt, Difference, SensorGuidance
from tiltcal.bench.operators import understood
from tiltcal.bench.terminal import ENTER, LIVE_PAUSE, LineKeys, Terminal, TerminalKeys
from tiltcal.bench.traces import Traces
from tiltcal.errors import InputError, Stopped

LEVEL = m.PositionQuestion(
    position="level", tilt={"x": 0.0, "y": 0.0}, gravity=[0, 0, 1], heading=0, temperature=None, prompt="Lay it level.",
)  # fmt: skip
SENSOR = m.ShownSensor("count", 1024.0, 819.0)


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


def test_a_key_is_a_choice_at_once_and_an_arrow_or_a_function_key_is_none(
    typed: tuple[TerminalKeys, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """xterm's down, F2 of the Linux console, Alt-down of rxvt, and the escape key alone."""
    keys, person = typed
    os.write(person, b"B\r")
    assert [keys.choice(1.0), keys.choice(1.0), keys.choice(0.0)] == ["b", ENTER, None]
    for sequence in (b"\x1b[B", b"\x1b[[B", b"\x1b\x1b[B", b"\x1b"):
        os.write(person, sequence)
        assert keys.choice(1.0) == "\x1b"
    os.write(person, b"sx")
    assert [keys.pressed("sq"), keys.pressed("sq"), keys.pressed("sq")] == ["s", None, None]
    before = termios.tcgetattr(sys.stdin)
    for line in (" 44,9 ", ""):
        os.write(person, f"{line}\n".encode())
        assert keys.line() == line.strip()
        assert termios.tcgetattr(sys.stdin) == before
    os.write(person, b"r\x04")
    assert keys.choice(1.0) == "r"
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    for last in (lambda: keys.choice(1.0), keys.line):
        with pytest.raises(Stopped, match="has ended"):
            last()


class Typed:
    """Keys, None where none comes, and lines that were typed beforehand."""

    def __init__(self, keys: str | list[str | None], *lines: str) -> None:
        self._keys, self._lines = list(keys), list(lines)
        self.timeouts: list[float | None] = []

    def choice(self, timeout: float | None) -> str | None:
        self.timeouts.append(timeout)
        return self._keys.pop(0)

    def pressed(self, choices: str) -> str | None:
        return self._keys.pop(0)

    def line(self) -> str:
        return self._lines.pop(0)


def terminal(
    shown: io.StringIO,
    keys: str | list[str | None],
    *lines: str,
    width: int = 100,
    height: int = 24,
    live: bool = False,
    **begin: Any,
) -> Terminal:
    """A terminal after the begin of a session."""
    console = Console(file=shown, force_terminal=True, width=width, height=height, color_system=None)
    operator = Terminal(console, Typed(keys, *lines), live=live)  # type: ignore[arg-type]
    said: Any = {"title": "A title", "accepted": [], "positions": ["level"], "attitudes": {}, "headings": False}
    operator.tell(m.Begin(**{**said, "sensors": {"S-1": SENSOR}, **begin}))
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


MEASURED = m.ShownReading(
    {"x": 1045.25, "y": 1018.95}, 24.93, guide(x=(0.0, 1.49, True), y=(0.0, -4.5, False)), {"x": 0.65, "y": 0.69}, 20
)
EXACT = m.ShownReading(
    {"x": 1.0}, None, SensorGuidance({}, {"": Difference(1.93, 6.0, True)}, None, {"+Y": -1.9}, True)
)
ROTATION = m.RotationQuestion([m.StagePair(("a1", "a2"), "a4")], 12, "Let it turn.")
P_AND_Q = ({"a": 0.01}, {"a": -0.02}, {"a": 1e-3}, {"a": 2e-3})
WHICH = "  which of first, level is to be taken next, or Enter for none:"
MEASURE = "  Enter measure  a angle set  t temperature  b back  p another position  q stop and keep  ? help  \n"
ACCEPT = "  Enter accept  r redo  b back  p another position  q stop and keep  ? help  \n"
STOP = "  q stop and keep  b back  p another position  ? help  \n"
WRITE = "  Enter write  b back  p another position  n stop and keep  ? help  \n"
LAY = "\n2/2  level   about 1 h 11 min left\n  Lay it level.\n"
HELP = """\
  Enter  wait until the reading is still, then take the samples
  a      type the angle that was really set, where it is not the one asked for
  t      type the temperature, where no thermometer is read
  b      give up the position before this one, and take that again
  p      type the name of the one to take next; one that was accepted is withdrawn
  q      stop; what was accepted is kept, and --resume goes on
  each axis: present angle, in brackets its difference from the target, and ok where it is near enough; of three axes \
the angle from the direction asked for, and how far two sides are too high; angles are not calibrated yet: they are by \
the data sheet and the positions before
"""
TABLE = """\
          set     now  difference        reading  noise   n
S-1 x  +0.00°  +1.49°      +1.49°  1045.25 count   0.65  20  ok
S-1 y  +0.00°  -4.50°      -4.50°  1018.95 count   0.69  20
S-1 T                                   24.93 °C
"""
FROM_FIRST = {"answer": "again", "position": "first"}
STOPPED, DECLINED = "stopped by the operator", "not written: the operator declined"


@pytest.mark.parametrize(
    ("said", "keys", "lines", "answer", "shown"),
    [
        (replace(LEVEL, temperature=40.0, stage=90.0), "?xxp\n", [""], {"answer": "ready"},
         f"{LAY}  at 40 °C\n  stage at 90°\n{MEASURE}{HELP}  not one of the keys: Enter, a, t, b, p, q\n{WHICH}"),
        (LEVEL, "b", [], {"answer": "back"}, LAY + MEASURE),
        (LEVEL, "r", [], {"answer": "redo"}, LAY + MEASURE),
        (LEVEL, "q", [], STOPPED, LAY + MEASURE),
        (replace(LEVEL, position="other"), "p", ["first"], FROM_FIRST,
         LAY.replace("level ", "other ") + MEASURE + WHICH),
        (m.Review("level", {"S-1": MEASURED}), "zpr", [""], {"answer": "redo"},
         f"{TABLE}{ACCEPT}  not one of the keys: Enter, r, b, p, q\n{WHICH}"),
        (m.Review("level", {"S-1": MEASURED}), "p", ["first"], FROM_FIRST, TABLE + ACCEPT + WHICH),
        (m.Review("level", {"S-1": EXACT}), "b", [], {"answer": "back"}, f"""\
S-1  1.93° off: +Y -1.90°
  calibrated angles: set the table by its own scale, not by this number
               set  now  difference  reading  noise  n
S-1 direction                 1.93°
        S-1 x                        1 count
{ACCEPT}"""),
        (m.Review("level", {"S-1": MEASURED}), "q", [], STOPPED, TABLE + ACCEPT),
        (m.Refused("level", "it moved"), "", [], None, "  refused: it moved\n"),
        (m.Accepted("level", {}, {}, 20), "", [], None, "  accepted level\n"),
        (m.Lost("S-2", "silent"), "", [], None, "  S-2 is dropped, the others continue: silent\n"),
        (m.Moved("level", "level: x 0.01°"), "", [], None, "  level: x 0.01°\n"),
        (m.Waiting("level", 60, "it cools", 30.0), "", [], None, ""),
        (m.Look("level", "", {"S-1": MEASURED}), "", [], None, ""),
        (ROTATION, "s\n", [], {"answer": "ready"}, """\
  a1 and a2, orthogonal a4
  Let it turn.
  Enter the stage turns, up to 12 turns  q stop and keep  ? help  \n  not one of the keys: Enter, q
  s stop and use the turns so far  q stop and keep  ? help  \n"""),
        (m.Poll(), "s", [], {"answer": "stop"}, ""),
        (m.Poll(), "q", [], STOPPED, ""),
        (m.Poll(), [None], [], None, ""),
        (m.TurnMade(3, 12, *P_AND_Q, {"b": "no signal"}, 4), "", [], None,
         "  turn 3 of 12   a: p 0.0100 ± 0.0010, q -0.0200 ± 0.0020   b: no signal   4 samples left out\n"),
        (m.Held("a gap"), "", [], None, "  held: a gap\n"),
        (m.Resumed(), "", [], None, "  goes on\n"),
        (m.Matched("rotation", 11.96, *P_AND_Q, {}), "", [], None,
         "  matched a: p 0.0100 ± 0.0010, q -0.0200 ± 0.0020 after 12.0 turns\n"),
        (m.StopAndKeep("level", "no agreement"), "\nb", [], {"answer": "back"},
         f"\n  no agreement\n{STOP}  not one of the keys: q, b, p\n"),
        (m.StopAndKeep("level", "no agreement"), "q", [], STOPPED, f"\n  no agreement\n{STOP}"),
        (m.WriteQuestion(["new", "/dev"]), "y", [], {"answer": "yes"},
         f"\nEverything is measured. Write new, /dev (replaces the one there)?\n{WRITE}"),
        *((m.WriteQuestion(["new"]), key, [], answer, f"\nEverything is measured. Write new?\n{WRITE}")
          for key, answer in (("\n", {"answer": "yes"}), ("b", {"answer": "back"}), ("n", DECLINED), ("q", DECLINED))),
        (m.Done(["new"], "journal.jsonl"), "", [], None, "wrote new\njournal journal.jsonl\n"),
    ],
)  # fmt: skip
def test_what_a_person_is_shown_and_answers(said: Any, keys: str, lines: list[str], answer: object, shown: str) -> None:
    """Each question and event of a session, the keys and lines that are typed then, and all that is on the screen."""
    screen = io.StringIO()
    operator = terminal(
        screen, keys, *lines, width=400, length="2 positions", positions=["first", "level"], accepted=["first"]
    )
    operator.tell(m.Progress("level", ["first"], "about 1 h 11 min left"))
    assert screen.getvalue() == "\nA title  2 positions\n  kept from before: first\n"
    screen.truncate(screen.seek(0))
    if isinstance(said, m.SessionEvent):
        operator.tell(said)
    elif isinstance(answer, str):
        with pytest.raises(Stopped, match=f"^{answer}$"):
            operator.ask(said)
    else:
        assert operator.ask(said) == answer
    assert screen.getvalue() == shown


@pytest.mark.parametrize("width", [30, 80])
def test_no_number_of_a_review_is_cut_off(width: int) -> None:
    operator = terminal(shown := io.StringIO(), ENTER, width=width)
    assert operator.ask(m.Review("level", {"S-1": MEASURED})) == {"answer": "accept"}
    assert shown.getvalue().split() == ["A", "title", *(TABLE + ACCEPT).split()]
    assert all(len(line) <= width for line in shown.getvalue().splitlines())


def test_a_live_reading_is_shown_until_a_key_is_pressed() -> None:
    """The session takes one each time that the answer is a look; what was typed before is kept, and a refusal rings."""
    operator = terminal(shown := io.StringIO(), [None, None, "a", None, ENTER], "1.5", "", live=True)
    waited = operator._keys.timeouts
    operator.tell(m.Refused("level", "it moved"))
    answers = [operator.ask(LEVEL) for _ in range(4)]
    assert answers == [{"answer": "look"}] * 3 + [{"answer": "ready", "tilt": {"x": 1.5}}]
    assert waited == [0.0, LIVE_PAUSE, LIVE_PAUSE, 0.0, LIVE_PAUSE]
    assert (shown.getvalue().count("Lay it level."), shown.getvalue().count("\a")) == (1, 1)
    operator.tell(m.TurnMade(3, 12, *P_AND_Q))
    assert shown.getvalue().endswith("  turn 3 of 12   a: p 0.0100 ± 0.0010, q -0.0200 ± 0.0020")


TARGET = "  target    x  +30.00°            y   +0.00°"
ONE = "  SCL-100{}  x  +29.71° (-0.29) ok y beyond 90°"
LAST = ["  target    x  +90.00°            y   +0.00°            z   +0.00°",
        "  SCL-1005  1.93° off: +Y -1.50° raise, +Z +1.21° ok"]  # fmt: skip


@pytest.mark.parametrize(
    ("width", "height", "rows"),
    [
        (79, 24, [TARGET, *(f"{ONE.format(n)}  24.0 °C  2973 7000 count" for n in range(5)), LAST[0],
                  f"{LAST[1]}  24.0 °C  2973 7000 count", "  live, angles are not calibrated yet"]),
        (78, 4, [*LAST[:1], f"{LAST[1]}  24.0 °C", "  live, angles are not calibrated yet"]),
        (50, 24, [TARGET, *(ONE.format(n) for n in range(5)), f"{LAST[0][:47]} …", f"{LAST[1][:47]} …",
                  "  live, angles are not calibrated yet"]),
    ],
)  # fmt: skip
def test_six_sensors_are_shown_below_their_targets_as_far_as_there_is_room(
    width: int, height: int, rows: list[str]
) -> None:
    """The targets are repeated where the next sensor sits another way; the next reading takes the place of the rows."""
    serials = [f"SCL-100{n}" for n in range(6)]
    operator = terminal(
        shown := io.StringIO(), ENTER, width=width, height=height, live=True, sensors=dict.fromkeys(serials, SENSOR)
    )
    straight = guide(x=(30.0, 29.71, True), y=(0.0, None, False))
    tilts = {"x": AxisTilt(90.0, 88.07), "y": AxisTilt(0.0, -1.5), "z": AxisTilt(0.0, 1.21)}
    three = SensorGuidance(tilts, {"": Difference(1.93, 6.0, True)}, sides={"+Y": -1.5, "+Z": 1.21})
    values = {"x": 2973.0, "y": 7000.0}
    readings = {one: m.ShownReading(values, 24.0, three if one.endswith("5") else straight) for one in serials}
    shown.truncate(shown.seek(0))
    operator.tell(m.Look("level", "", readings))
    assert shown.getvalue().splitlines() == rows
    shown.truncate(shown.seek(0))
    operator.tell(m.Look("level", "sample 3 of 20", readings))
    assert shown.getvalue().startswith("\r\x1b[2K" + "\x1b[1A\r\x1b[2K" * (len(rows) - 1) + rows[0])
    assert shown.getvalue().endswith("\n  sample 3 of 20")
    shown.truncate(shown.seek(0))
    operator.tell(m.Lost("S-2", "silent"))
    operator.tell(m.Held("a gap"))
    cleared = "\r\x1b[2K" + "\x1b[1A\r\x1b[2K" * (len(rows) - 1)
    assert shown.getvalue() == f"{cleared}  S-2 is dropped, the others continue: silent\n  held: a gap\n"


@pytest.mark.parametrize(
    ("width", "traces"), [(80, "  x ▄▄█▄▄▄  y ▄▄▄▄▄▄  z ▄▄▄▄▄▄"), (68, "  x ▄▄█▄▄▄  y ▄▄▄▄▄▄  z ▄▄▄▄▄▄"), (67, "")]
)
def test_a_loose_wire_jumps_in_the_traces_of_one_sensor(width: int, traces: str) -> None:
    operator = terminal(shown := io.StringIO(), ENTER, width=width, live=True)
    for x in (0.0, None, 0.0, 0.5, 0.0, 0.0, 0.0):
        one = SensorGuidance({}, {}, up=None if x is None else (x, 0.0, 1.0))
        operator.tell(m.Look("level", "", {"S-1": m.ShownReading({"x": 0.0, "y": 0.0}, None, one)}))
    assert shown.getvalue().endswith(f"\n  live, angles are not calibrated yet{traces}")


def test_a_bar_shows_the_farthest_of_its_part_from_the_median() -> None:
    """Of 64 directions the last 60; 16 bars at most, of which one spans a degree at least."""
    traces = Traces()
    for n in range(64):
        traces.add((1.0 if n == 3 else 0.004 * (n == 30) - 0.006 * (n == 31), 0.01 * (n == 63), -0.5 * (n < 12)))
    x, y, z = "▄▄▄▄▄▄▄▂▄▄▄▄▄▄▄▄", "▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄█", "▁▁▁▄▄▄▄▄▄▄▄▄▄▄▄▄"
    assert traces.within(200) == traces.within(58) == f"x {x}  y {y}  z {z}"
    assert len(traces.within(57)) == 55
    assert (len(traces.within(28)), traces.within(27)) == (28, "")


def test_no_escape_sequence_and_no_markup_of_a_file_reaches_the_terminal() -> None:
    """ESC ] 0 ; sets a window title, ESC [ 2 J clears the screen; a title [/] closes what rich never opened."""
    operator = terminal(shown := io.StringIO(), "\n", title="a[/]\x1b]0;owned\x07 title")
    operator.ask(replace(LEVEL, position="p\x1b[2J", prompt="Tilt \x9b2J it"))
    operator.tell(m.Refused("level", "\x1b[2J[bold]S[/]"))
    said = shown.getvalue()
    assert "a[/]?]0;owned? title" in said
    assert not set("\x1b\x07\x9b") & set(said)
    assert "refused: ?[2J[bold]S[/]" in said
