"""A person at the bench: prompts, a live reading, expected and measured side by side."""

from __future__ import annotations

import io
import os
import select
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from math import asin, copysign, degrees, isfinite
from types import BuiltinFunctionType
from typing import Any, Protocol, TextIO, TypeVar

from rich.console import Console
from rich.table import Table
from rich.text import Text

from tiltcal.bench.operators import LOOK, LineReader, Message, Operator, in_words
from tiltcal.core.attitude import gravity_from_tilt, normalised
from tiltcal.core.detection import TEMPERATURES
from tiltcal.errors import InputError, Stopped
from tiltcal.printable import printable

T = TypeVar("T")

LIVE_PAUSE = 0.4
"""Seconds between live readings: fast enough to set an angle by, slow enough for the journal of a long night."""

WIDEST = 10_000  # columns of a terminal on which any table fits
CLEAR = "\r\x1b[2K"  # empties the line of the live reading

ENTER, ESCAPE = "\n", "\x1b"
REST = 0.05  # time within which the rest of an escape sequence arrives, s
STYLES = {"accepted": "green", "refused": "bold red", "lost": "bold red", "held": "yellow"}
"""The style of an event's lines."""


def open_terminal(stack: ExitStack, *, plain: bool) -> Terminal:
    """Return a person's operator, which gives the terminal back at the end of the stack."""

    class Talk(Console):
        def on_broken_pipe(self) -> None:
            self.quiet = True  # in place of SystemExit: the session goes on without its talk

    console = Talk(stderr=True, highlight=False, no_color=plain or None)
    live = sys.stdin.isatty() and sys.stderr.isatty() and not (plain or console.is_dumb_terminal) and os.name == "posix"
    notebook = not isinstance(input, BuiltinFunctionType)  # it has an input() of its own
    lines: Any = NotebookInput() if notebook else sys.stdin
    keys: Keys = stack.enter_context(TerminalKeys()) if live else LineKeys(lines)
    terminal = Terminal(console, keys, live=live)
    stack.callback(terminal.clear)
    return terminal


class Terminal(Operator):
    """Asks a person.

    Parameters
    ----------
    live : bool
        Whether one line may overwrite another, and readings are shown while it waits; needs a terminal.
    """

    def __init__(self, console: Console, keys: Keys, *, live: bool) -> None:
        self._console = console
        self._keys = keys
        self._live = self.watches = live
        self._line_is_live = False
        self._offered: list[str] = []
        self._positions: list[str] = []
        self._sensors: Mapping[str, Mapping[str, Any]] = {}
        self._asked: Message = {}
        self._answer: dict[str, Any] = {}

    def ask(self, question: Message) -> object:
        """Show the person what to do, and wait for a key."""
        asks: dict[str, Callable[[Message], object]] = {
            "position": self._position, "rotation": self._rotation, "poll": self._poll, "review": self._review,
            "write": self._write,
        }  # fmt: skip
        return asks[question["ask"]](question)

    def tell(self, event: Message) -> None:
        """Show an event."""
        match event["event"]:
            case "begin":
                self._positions, self._sensors = event["positions"], event["sensors"]
                self._say(f"\n{'  '.join(filter(None, (event['title'], event['length'])))}", "bold")
            case "look":
                self._show(event)
            case "turn" if self._live:
                self._line(in_words(event)[0].strip())
            case kind:
                for line in in_words(event):
                    self._say(line, "green" if line.startswith("wrote ") else STYLES.get(kind, ""))

    def _position(self, question: Message) -> object:
        """Show what to set, until a key is pressed; where none is for a moment, ask for a reading to show."""
        if question is not self._asked:
            self._asked, self._answer = question, {}
            name = question["position"]
            number = self._positions.index(name) + 1 if name in self._positions else len(self._positions)
            self._say(f"\n{number}/{len(self._positions)}  {name}", "bold cyan")
            self._say(f"  {question['prompt']}")
            if question["temperature"] is not None:
                self._say(f"  at {question['temperature']:g} °C")
            if "stage" in question:
                self._say(f"  stage at {question['stage']:g}°")
            self._hint("Enter measure", "a angle set", "t temperature", "b back", "q stop and keep")
            key = self._keys.choice(0.0 if self._live else None)
        else:
            key = self._keys.choice(LIVE_PAUSE)
        while key is not None:
            self.clear()
            if key == ENTER:
                self._asked = {}
                return {"answer": "ready", **self._answer}
            if key == "q":
                raise Stopped("stopped by the operator")
            if key in ("b", "r"):
                self._asked = {}
                return {"answer": "back" if key == "b" else "redo"}
            if key == "t":
                self._set(
                    "temperature", self._number("temperature in °C", *TEMPERATURES, self._answer.get("temperature"))
                )
            elif key == "a" and question["tilt"] is not None:
                self._set("tilt", self._angles(question["tilt"], self._answer.get("tilt", {})) or None)
            elif key == "a":
                asked = "direction that points up, as gx gy gz"
                self._set("gravity", self._typed(asked, direction, self._answer.get("gravity")))
            else:
                self._refuse_key()
            key = self._keys.choice(0.0 if self._live else None)
        return {"answer": LOOK}

    def _set(self, key: str, value: object) -> None:
        if value is not None:
            self._answer[key] = value

    def _rotation(self, question: Message) -> object:
        for pair in question["pairs"]:
            self._say(f"  {' and '.join(pair['pair'])}, orthogonal {pair['orthogonal']}")
        self._say(f"  {question['prompt']}")
        self._hint(f"Enter the stage turns, up to {question['turns']} turns", "q stop and keep")
        if self._choice(f"{ENTER}q") == "q":
            raise Stopped("stopped by the operator")
        self._hint("s stop and use the turns so far", "q stop and keep the journal")
        return {"answer": "ready"}

    def _poll(self, question: Message) -> object:
        key = self._keys.pressed("sq")
        if key == "q":
            raise Stopped("stopped by the operator")
        return {"answer": "stop"} if key == "s" else None

    def _review(self, question: Message) -> object:
        """Show expected, measured and noise, and ask whether it counts."""
        self.clear()
        table = self._table(question)
        wide = self._console.options.update(width=WIDEST)
        if self._console.measure(table, options=wide).maximum <= self._console.width:
            self._console.print(table)
        else:
            self._list(question)
        self._hint("Enter accept", "r redo", "b back", "q stop and keep")
        key = self._choice(f"{ENTER}rbq")
        if key == "q":
            raise Stopped("stopped by the operator")
        return {"answer": {ENTER: "accept", "r": "redo", "b": "back"}[key]}

    def _write(self, question: Message) -> object:
        """Ask once more before the files are written."""
        files = question["files"]
        named = ", ".join(f"{path} (replaces the one there)" if os.path.exists(path) else path for path in files)
        self._say(f"\nEverything is measured. Write {named}?")
        self._hint("Enter write", "n stop and keep")
        if self._choice(f"{ENTER}ynq") in "nq":
            raise Stopped("not written: the operator declined")
        return {"answer": "yes"}

    def _choice(self, keys: str) -> str:
        """Wait for one of these keys."""
        while True:
            key = self._keys.choice(None)
            if key is not None and key in keys:
                return key
            self._refuse_key()

    def _say(self, text: str, style: str = "", end: str = "\n") -> None:
        """Print a line as it stands: what comes from a file is no markup, and holds no escape sequence."""
        self.clear()
        self._console.print(Text(printable(text), style=style), end=end)

    def _hint(self, *choices: str) -> None:
        line, self._offered = Text("  "), []
        for choice in choices:
            key, _, meaning = choice.partition(" ")
            line.append(key, style="bold").append(f" {meaning}   ", style="dim")
            self._offered.append(key)
        self._console.print(line)

    def _refuse_key(self) -> None:
        """Name the keys that are offered, once; the one that was pressed may have no name, such as an arrow."""
        if self._offered:
            self._say(f"  not one of the keys: {', '.join(self._offered)}")
            self._offered = []

    def _line(self, *parts: str) -> None:
        """Print one line that the next one overwrites; parts that do not fit are left out whole."""
        room = self._console.width - 3
        line, *others = (printable(part) for part in parts)
        for left, part in enumerate(others, start=1 - len(others)):
            if len(line) + len(part) + (5 if left else 3) > room:
                line = f"{line[: room - 2]} …"
                break
            line = f"{line}   {part}"
        self._line_is_live = True
        self._console.file.write(f"{CLEAR}  {line[:room]}")
        self._console.file.flush()

    def clear(self) -> None:
        """Empty the line of the live reading, which whatever is printed next would be appended to."""
        if self._line_is_live:
            self._line_is_live = False
            self._console.file.write(CLEAR)
            self._console.file.flush()

    def _rows(self, review: Message) -> Iterator[tuple[str, str, str, str, str, str]]:
        """Iterate over name, expected, measured, tilt, noise and n of each reading; a temperature has two of them."""
        for serial, values in review["sensors"].items():
            expected = review["expected"].get(serial, {})
            for channel, mean in values["mean"].items():
                yield (
                    f"{serial} {channel}",
                    f"{expected[channel]:.6g}" if expected else "unknown",
                    f"{mean:.6g} {self._sensors[serial]['unit']}",
                    self._angle(serial, mean),
                    f"{values['std'][channel]:.2g}",
                    str(values["n"]),
                )
            if values["temperature"] is not None:
                yield f"{serial} T", "", f"{values['temperature']:.2f} °C", "", "", ""

    def _list(self, review: Message) -> None:
        """Print what the table says, one channel below the other."""
        for name, expected, measured, tilt, noise, n in self._rows(review):
            self._say(f"  {name}  {measured}", "bold")
            if expected:
                self._say(f"    expected {expected}")
                self._say(f"    tilt {tilt}, noise {noise}, n {n}")

    def _table(self, review: Message) -> Table:
        table = Table(box=None, pad_edge=False, padding=(0, 2), header_style="dim")
        for heading in ("", "expected", "measured", "tilt", "noise", "n"):
            table.add_column(heading, justify="right")
        for name, *cells in self._rows(review):
            table.add_row(Text(printable(name)), *cells)
        return table

    def _show(self, look: Message) -> None:
        """Show readings on one line, and first why: what has no room is left out."""
        if not self._live:
            return
        parts = [look["why"]] if look["why"] else []
        for serial, reading in look["readings"].items():
            lead = f"{serial} " if len(look["readings"]) > 1 else ""
            for channel, value in reading["values"].items():
                parts.append(f"{lead}{channel} {value:.6g} ({self._angle(serial, value)})")
                lead = ""
            if reading["temperature"] is not None:
                parts.append(f"{reading['temperature']:.1f} °C")
        self._line(*parts, *(() if look["why"] else ("live",)))

    def _angle(self, serial: str, value: float) -> str:
        """Return a reading as a tilt, by the model's nominal coefficients."""
        sensor = self._sensors[serial]
        sine = (value - sensor["offset"]) / sensor["sensitivity"]
        return f"{degrees(asin(sine)):+.2f}°" if abs(sine) <= 1 else f"beyond {copysign(90.0, sine):+.0f}°"

    def _angles(self, asked: Mapping[str, float], before: dict[str, float]) -> dict[str, float]:
        """Ask for the angles actually set, one an axis; an empty line keeps what was typed before."""
        while True:
            tilt = dict(before)
            for axis, angle in asked.items():
                what = f"tilt of {axis} actually set, in degrees (asked {angle:g})"
                typed = self._number(what, -90.0, 90.0, before.get(axis))
                if typed is not None:
                    tilt[axis] = typed
            try:
                gravity_from_tilt({**asked, **tilt})
            except InputError as error:
                self._say(f"  {error}")
                continue
            return tilt

    def _number(self, what: str, low: float, high: float, before: float | None) -> float | None:
        def parse(typed: str) -> float:
            try:
                value = float(typed.replace(",", "."))
            except ValueError:
                raise InputError(f"type a number such as {low / 3:.1f}") from None
            if not (isfinite(value) and low <= value <= high):
                raise InputError(f"it must be between {low:g} and {high:g}")
            return value

        return self._typed(what, parse, before)

    def _typed(self, what: str, parse: Callable[[str], T], before: T | None) -> T | None:
        """Ask until the typed line can be understood; an empty line leaves what was there before."""
        while True:
            self._say(f"  {what}, or Enter to keep it: ", end="")
            typed = self._keys.line()
            if not typed.strip():
                return before
            try:
                return parse(typed)
            except InputError as error:
                self._say(f"  {typed!r} is not accepted: {error}")


def direction(typed: str) -> list[float]:
    """Return a typed direction as a unit vector.

    InputError: not three numbers, or all zero.
    """
    try:
        parts = [float(part) for part in typed.replace(",", " ").split()]
    except ValueError:
        raise InputError("type three numbers such as 0 0.5 0.866") from None
    return list(normalised(parts))


class Keys(Protocol):
    """A source of the operator's choices."""

    def choice(self, timeout: float | None) -> str | None:
        """Return the next key (:data:`ENTER` for Enter), or None when ``timeout`` seconds pass without one.

        Stopped: the input has ended.
        """
        ...

    def pressed(self, choices: str) -> str | None:
        """Return one of these keys if it has been pressed already, without waiting."""
        ...

    def line(self) -> str:
        """Read a typed line, without its newline."""
        ...


class LineKeys:
    """Reads whole lines of a stream and never returns by itself: for ``--plain``, pipes and screen readers."""

    def __init__(self, stream: TextIO) -> None:
        self._lines = LineReader(stream)

    def choice(self, timeout: float | None) -> str | None:
        return self.line()[:1].lower() or ENTER

    def pressed(self, choices: str) -> str | None:
        # What else waits may be the answer to a question that is still to come.
        for number, line in enumerate(self._lines.waiting(), start=1):
            key = line.strip()[:1].lower()
            if key and key in choices:
                for _ in range(number):
                    self._lines.next()
                return key
        return None

    def line(self) -> str:
        typed = self._lines.next()
        if not typed:
            raise Stopped("the input has ended")
        return typed.strip()


class NotebookInput(io.TextIOBase):
    """The lines that a person types below the cell of a notebook."""

    def readline(self, size: int = -1) -> str:  # type: ignore[override]
        try:
            return f"{input()}\n"
        except EOFError:
            return ""


class TerminalKeys:
    """Reads single keys from a terminal, which is given back as it was at the end of a ``with``."""

    def __init__(self) -> None:
        self._descriptor = sys.stdin.fileno()
        self._before: list[object] = []

    def __enter__(self) -> TerminalKeys:
        import termios
        import tty

        self._before = termios.tcgetattr(self._descriptor)
        tty.setcbreak(self._descriptor)
        return self

    def __exit__(self, *error: object) -> None:
        import termios

        termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)  # type: ignore[arg-type]

    def choice(self, timeout: float | None) -> str | None:
        ready, _, _ = select.select([self._descriptor], [], [], timeout)
        if not ready:
            return None
        key = os.read(self._descriptor, 1).decode(errors="replace")
        if key in ("", "\x04"):
            raise Stopped("the input has ended")
        if key == ESCAPE and select.select([self._descriptor], [], [], REST)[0]:
            os.read(self._descriptor, 16)  # of an arrow or a function key, whose letters are no choices
        return ENTER if key in "\r\n" else key.lower()

    def pressed(self, choices: str) -> str | None:
        key = self.choice(0.0)
        return key if key is not None and key in choices else None

    def line(self) -> str:
        import tty

        self.__exit__()
        try:
            typed = sys.stdin.readline()
        finally:
            tty.setcbreak(self._descriptor)
        if not typed:
            raise Stopped("the input has ended")
        return typed.strip()
