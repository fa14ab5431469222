"""What a person is shown and may type, and when the virtual jig gives up."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace

import pytest
from rich.console import Console

from tiltcal.bench.operators.keys import ENTER
from tiltcal.bench.operators.operator import OperatorAnswer
from tiltcal.bench.operators.sim import SimOperator
from tiltcal.bench.operators.terminal import TerminalOperator
from tiltcal.bench.position_result import PositionResult
from tiltcal.calibration.measurement import Measurement
from tiltcal.core.samples import SampleSummary
from tiltcal.drivers import find_model
from tiltcal.drivers.model import Reading
from tiltcal.errors import Stopped
from tiltcal.files.procedure import Determines, Position, Procedure

LEVEL = Position("level", "Lay it level.", (0.0, 0.0, 1.0), {"x": 0.0, "y": 0.0})
PROCEDURE = Procedure(name="one", title="A title", determines=Determines(axes=()), positions=(LEVEL,))


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
def person(shown: io.StringIO) -> Callable[..., TerminalOperator]:
    console = Console(file=shown, force_terminal=True, width=100, color_system=None)
    return lambda keys, *lines: TerminalOperator(console, Typed(keys, *lines), live=False)


def asked(operator: TerminalOperator, position: Position = LEVEL) -> OperatorAnswer:
    operator.begin(PROCEDURE, {})
    return operator.position(position, 1, dict)


def test_a_typed_angle_can_be_left_without_a_number(person, shown) -> None:
    assert asked(person("a\n", "", "")) == OperatorAnswer("ready")
    assert asked(person("at\n", "1,5", "", "")) == OperatorAnswer("ready", tilt={"x": 1.5})


def test_what_is_wrong_with_a_typed_number_is_said_in_plain_words(person, shown) -> None:
    answer = asked(person("at\n", "lots", "95", "0.5", "-0.25", "warm", "24.5"))
    assert answer == OperatorAnswer("ready", tilt={"x": 0.5, "y": -0.25}, temperature=24.5)
    said = shown.getvalue()
    assert "'lots' is not accepted: type a number such as" in said
    assert "'95' is not accepted: it must be between -90 and 90" in said
    assert "could not convert" not in said


def test_an_unknown_key_is_answered_with_those_that_are_offered(person, shown) -> None:
    """Once each time. With --plain a line that is not answered would look like a program that hangs."""
    assert asked(person("\x1b\x1b\x1b\n")) == OperatorAnswer("ready")
    assert shown.getvalue().count("  not one of the keys: Enter, a, t, b, q\n") == 1
    operator = person("z\n")
    operator.begin(PROCEDURE, {"S-1": find_model("sca100t-d02")})
    assert operator.review(REVIEWED) == OperatorAnswer("accept")
    assert "  not one of the keys: Enter, r, b, q\n" in shown.getvalue()


def test_a_reading_of_more_than_1_g_has_no_tilt(shown: io.StringIO) -> None:
    """An SCL3300 with an offset of -97 counts reads -6097 upside down, where the data sheet has 6000 count/g."""
    console = Console(file=shown, force_terminal=True, width=100, color_system=None)
    operator = TerminalOperator(console, Typed(ENTER), live=True)
    operator.begin(PROCEDURE, {"S-1": find_model("scl3300")})
    operator.look(LEVEL, {"S-1": Reading((-6097.0, 6100.0, 0.0), None)}, "live", 0.0)
    assert "x -6097 (beyond -90°)   y 6100 (beyond +90°)   z 0 (+0.00°)" in shown.getvalue()


def test_a_direction_is_typed_or_left(person, shown) -> None:
    free = Position("free-1", "Any attitude.", (0.0, 0.0, 1.0))
    assert asked(person("a\n", ""), free) == OperatorAnswer("ready")
    assert asked(person("a\n", "up", "0 0 0", "0 3 4"), free).gravity == pytest.approx((0.0, 0.6, 0.8))
    assert "type three numbers such as 0 0.5 0.866" in shown.getvalue()


def test_no_escape_sequence_and_no_markup_of_a_file_reaches_the_terminal(person, shown) -> None:
    """ESC ] 0 ; sets a window title, ESC [ 2 J clears the screen; a title [/] closes what rich never opened."""
    operator = person("\n")
    operator.begin(replace(PROCEDURE, title="a[/]\x1b]0;owned\x07 title"), {})
    operator.position(Position("p\x1b[2J", "Tilt \x9b2J it", (0.0, 0.0, 1.0)), 1, dict)
    operator.refused(LEVEL, "\x1b[2J[bold]S[/]")
    said = shown.getvalue()
    assert "a[/]?]0;owned? title" in said
    assert not set("\x1b\x07\x9b") & set(said)
    assert "refused: ?[2J[bold]S[/]" in said


REVIEWED = PositionResult(
    LEVEL,
    {
        "S-1": Measurement(
            "level",
            LEVEL.gravity,
            LEVEL.tilt,
            24.93,
            {"x": SampleSummary(1045.25, 0.65, 20, 0.1), "y": SampleSummary(1018.95, 0.69, 20, 0.1)},
        )
    },
    expected={"S-1": {"x": 1024.0, "y": 1023.0}},
)


@pytest.mark.parametrize("width", [30, 40, 80])
def test_no_number_of_a_review_is_cut_off(width: int, shown: io.StringIO) -> None:
    console = Console(file=shown, force_terminal=True, width=width, color_system=None)
    operator = TerminalOperator(console, Typed(ENTER), live=False)
    operator.begin(PROCEDURE, {"S-1": find_model("sca100t-d02")})
    assert operator.review(REVIEWED) == OperatorAnswer("accept")
    text = shown.getvalue()
    for number in ("1045.25 count", "1018.95 count", "1024", "1023", "+1.49°", "-0.35°", "0.65", "0.69", "24.93 °C"):
        assert number in text
    assert "…" not in text
    assert all(len(line) <= width for line in text.splitlines())


def test_a_reading_is_shown_whole_or_not_at_all(shown: io.StringIO) -> None:
    """45 columns have no room for y: a part of its number would be one that nobody measured."""
    console = Console(file=shown, force_terminal=True, width=45, color_system=None)
    operator = TerminalOperator(console, Typed(ENTER), live=True)
    operator.begin(PROCEDURE, {"S-1": find_model("sca100t-d02")})
    shown.truncate(0)
    operator.look(LEVEL, {"S-1": Reading((1045.0, 1019.0), 24.9)}, "waiting until still", 0.0)
    line = shown.getvalue().rpartition("K")[2]
    assert line == "  waiting until still   x 1045 (+1.47°) …"
    operator.clear()
    assert shown.getvalue().endswith("\r\x1b[2K")


@pytest.mark.parametrize("width", range(30, 100))
def test_the_live_line_of_two_sensors_names_each_and_is_cut_between_its_parts(width: int, shown: io.StringIO) -> None:
    console = Console(file=shown, force_terminal=True, width=width, color_system=None)
    operator = TerminalOperator(console, Typed(ENTER), live=True)
    operator.begin(PROCEDURE, dict.fromkeys(("S-1", "S-2"), find_model("sca100t-d02")))
    operator.look(
        LEVEL, {"S-1": Reading((1045.0, 1019.0), 24.9), "S-2": Reading((1024.0, 205.0), None)}, "not still", 0.0
    )
    line = shown.getvalue().rpartition("K")[2]
    parts = ["not still", "S-1 x 1045 (+1.47°)", "y 1019 (-0.35°)", "24.9 °C", "S-2 x 1024 (+0.00°)", "y 205 (-90.00°)"]
    whole = ["  " + "   ".join(parts[:count]) + (" …" if count < len(parts) else "") for count in range(1, 7)]
    assert line == max((text for text in whole if len(text) < width), key=len)


def test_what_is_said_after_a_live_line_has_a_line_of_its_own(shown: io.StringIO) -> None:
    """A leg of a ramp is accepted without a review, right after a live reading."""
    console = Console(file=shown, force_terminal=True, width=80, color_system=None)
    operator = TerminalOperator(console, Typed(ENTER), live=True)
    operator.begin(PROCEDURE, {"S-1": find_model("sca100t-d02")})
    operator.look(LEVEL, {"S-1": Reading((1045.0, 1019.0), 24.9)}, "on the way to 5 °C", 0.0)
    operator.accepted(REVIEWED)
    assert shown.getvalue().endswith("24.9 °C\r\x1b[2K  accepted level\n")
    operator.refused(LEVEL, "it moves")
    assert shown.getvalue().endswith("  accepted level\n  refused: it moves\n")


def test_the_virtual_jig_numbers_a_position_that_a_resumed_session_only_reports() -> None:
    """It was accepted before the interruption, so it is not asked for again."""
    said: list[str] = []
    operator = SimOperator(said.append)
    two = replace(PROCEDURE, positions=(replace(LEVEL, name="first"), LEVEL))
    operator.begin(two, {"S-1": find_model("sca100t-d02")})
    operator.accepted(REVIEWED)
    assert said[0] == "A title: 2 positions"
    assert said[1].startswith("  2/2 level ")


def test_the_virtual_jig_gives_up_a_position_that_is_refused_again_and_again() -> None:
    operator = SimOperator()
    for _ in range(9):
        operator.refused(LEVEL, "x is stuck")
    with pytest.raises(Stopped, match="level was refused 10 times in a row: x is stuck"):
        operator.refused(LEVEL, "x is stuck")
