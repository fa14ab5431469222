"""A person at the bench: prompts, a live reading, expected and measured side by side."""

from __future__ import annotations

import io
import os
import select
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from itertools import zip_longest
from types import BuiltinFunctionType
from typing import Any, TextIO

from rich.console import Console

from tiltcal.bench import messages
from tiltcal.bench.guidance import COLUMNS, UNCALIBRATED, SensorGuidance, note_on
from tiltcal.bench.operators import LOOK, LineReader, Operator, in_words
from tiltcal.bench.screen import Screen
from tiltcal.bench.traces import Traces
from tiltcal.bench.typed import number_in
from tiltcal.errors import InputError, Stopped

ENTER, ESCAPE = "\n", "\x1b"
REST = 0.05  # time within which the rest of an escape sequence arrives, s

LIVE_PAUSE = 0.4
"""Seconds between live readings: fast enough to set an angle by, slow enough for the journal of a long night."""


STYLES = {"accepted": "green", "refused": "bold red", "lost": "bold red", "held": "yellow", "done": "green"}
"""The style of an event's lines."""


class LineKeys:
    """The operator's choices as whole lines of a stream: for ``--plain``, pipes and screen readers.

    ``choice`` waits for the next key, :data:`ENTER` for Enter, and ``pressed`` returns one of some keys if it was
    pressed already; ``line`` is a typed line without its end. Where the input has ended they raise Stopped.
    """

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
    """The operator's choices as single keys of a terminal, which is given back as it was at the end of a ``with``.

    A choice is None when ``timeout`` seconds pass without a key.
    """

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
        return key if key and key in choices else None

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


def open_terminal(stack: ExitStack, *, plain: bool) -> Terminal:
    """Return a person's operator, which gives the terminal back at the end of the stack."""

    class Talk(Console):
        def on_broken_pipe(self) -> None:
            self.quiet = True  # in place of SystemExit: the session goes on without its talk

    console = Talk(stderr=True, highlight=False, no_color=plain or None)
    live = sys.stdin.isatty() and sys.stderr.isatty() and not (plain or console.is_dumb_terminal) and os.name == "posix"
    notebook = not isinstance(input, BuiltinFunctionType)  # it has an input() of its own
    lines: Any = NotebookInput() if notebook else sys.stdin
    keys = stack.enter_context(TerminalKeys()) if live else LineKeys(lines)
    terminal = Terminal(console, keys, live=live)
    stack.callback(terminal.clear)
    return terminal


class Terminal(Screen, Operator):
    """Asks a person.

    Parameters
    ----------
    live : bool
        Whether lines may overwrite others, and readings are shown while it waits; needs a terminal.
    """

    def __init__(self, console: Console, keys: LineKeys | TerminalKeys, *, live: bool) -> None:
        super().__init__(console, live=live)
        self._keys = keys
        self.watches = live
        self._traces = Traces()
        self._positions: Sequence[str] = []
        self._sensors: Mapping[str, messages.ShownSensor] = {}
        self._remaining = ""
        self._asked: messages.PositionQuestion | None = None
        self._answer: dict[str, Any] = {}

    def ask(self, question: messages.Question) -> object:
        """Show the person what to do, and wait for a key."""
        match question:
            case messages.PositionQuestion():
                return self._position(question)
            case messages.RotationQuestion():
                return self._rotation(question)
            case messages.Review():
                return self._review(question)
            case messages.WriteQuestion():
                return self._write(question)
            case messages.StopAndKeep():
                return self._stop(question)
        return self._poll()

    def tell(self, event: messages.SessionEvent) -> None:
        """Show an event."""
        if isinstance(event, messages.Refused):
            self._ring()
        match event:
            case messages.Begin():
                self._positions, self._sensors = event.positions, event.sensors
                self._say(f"\n{'  '.join(filter(None, (event.title, event.length)))}", "bold")
                if event.accepted:
                    self._say(f"  kept from before: {', '.join(event.accepted)}")
            case messages.Progress():
                self._remaining = event.left
            case messages.Look() if self._live:
                self._show(event)
            case messages.TurnMade() if self._live:
                self._overwrite([in_words(event)[0].strip()])
            case _:
                for line in in_words(event):
                    self._say(line, STYLES.get(event.kind, ""))

    def _position(self, question: messages.PositionQuestion) -> object:
        """Show what to set, until a key is pressed; where none is for a moment, ask for a reading to show."""
        if question is not self._asked:
            self._asked, self._answer = question, {}
            name = question.position
            number = self._positions.index(name) + 1 if name in self._positions else len(self._positions)
            self._say(f"\n{number}/{len(self._positions)}  {name}   {self._remaining}", "bold cyan")
            self._say(f"  {question.prompt}")
            if question.temperature is not None:
                self._say(f"  at {question.temperature:g} °C")
            if question.stage is not None:
                self._say(f"  stage at {question.stage:g}°")
            self._hint(
                "Enter measure", "a angle set", "t temperature", "b back", "p another position", "q stop and keep"
            )
            key = self._keys.choice(0.0 if self._live else None)
        else:
            key = self._keys.choice(LIVE_PAUSE)
        while key is not None:
            self.clear()
            if key == "q":
                raise Stopped("stopped by the operator")
            if key in (ENTER, "b", "r"):
                self._asked = None
                word = {ENTER: "ready", "b": "back", "r": "redo"}[key]
                return {"answer": word, **(self._answer if key == ENTER else {})}
            if key == "p":
                if named := self._named():
                    self._asked = None
                    return named
            elif key == "t":
                typed = self._typed("temperature in °C", "temperature")
                self._answer |= {"temperature": typed[0]} if typed else {}
            elif key == "a" and question.tilt is not None:
                for axis, angle in question.tilt.items():
                    for tilt in self._typed(f"tilt of {axis} actually set, in degrees (asked {angle:g})", "tilt"):
                        self._answer["tilt"] = {**self._answer.get("tilt", {}), axis: tilt}
            elif key == "a":
                typed = self._typed("direction that points up, as gx gy gz", "gravity", 3)
                self._answer |= {"gravity": typed} if typed else {}
            else:
                self._explain(key)
            key = self._keys.choice(0.0 if self._live else None)
        return {"answer": LOOK}

    def _rotation(self, question: messages.RotationQuestion) -> object:
        for pair in question.pairs:
            self._say(f"  {' and '.join(pair.pair)}, orthogonal {pair.orthogonal}")
        self._say(f"  {question.prompt}")
        self._hint(f"Enter the stage turns, up to {question.turns} turns", "q stop and keep")
        self._choice(ENTER)
        self._hint("s stop and use the turns so far", "q stop and keep")
        return {"answer": "ready"}

    def _poll(self) -> object:
        key = self._keys.pressed("sq")
        if key == "q":
            raise Stopped("stopped by the operator")
        return {"answer": "stop"} if key == "s" else None

    def _review(self, question: messages.Review) -> object:
        """Show what was set and measured, its difference and noise, and ask whether it counts."""
        self.clear()
        self._ring()
        rows = [(list(COLUMNS), None), *messages.rows_of(question.readings, self._sensors)]
        for serial, reading in question.readings.items():
            if "" in reading.guidance.differences:
                self._say(f"{serial}  {reading.guidance.in_words()[0]}")
        if (note := note_on([reading.guidance for reading in question.readings.values()])) != UNCALIBRATED:
            self._say(f"  {note}")
        widths = [max(map(len, column)) for column in zip_longest(*(cells for cells, _ in rows), fillvalue="")]
        for cells, ok in rows:
            line = "  ".join(cell.rjust(width) for cell, width in zip(cells, widths, strict=False))
            self._say(f"{line}{'  ok' if ok else ''}", "dim" if ok is None else "")
        self._hint("Enter accept", "r redo", "b back", "p another position", "q stop and keep")
        return self._answered({ENTER: "accept", "r": "redo", "b": "back"})

    def _write(self, question: messages.WriteQuestion) -> object:
        """Ask once more before the files are written."""
        files = question.files
        named = ", ".join(f"{path} (replaces the one there)" if os.path.exists(path) else path for path in files)
        self._say(f"\nEverything is measured. Write {named}?")
        self._hint("Enter write", "b back", "p another position", "n stop and keep")
        words = {ENTER: "yes", "y": "yes", "b": "back", "n": "quit"}
        return self._answered(words, quits="not written: the operator declined")

    def _stop(self, question: messages.StopAndKeep) -> object:
        """Say why nothing can be written, and wait for the end."""
        self._ring()
        self._say(f"\n  {question.why}", "bold red")
        self._hint("q stop and keep", "b back", "p another position")
        return self._answered({"b": "back"})

    def _answered(self, words: Mapping[str, str], quits: str = "stopped by the operator") -> object:
        """Wait for one of some keys, or for the name of a position to take again, and return the answer."""
        while (key := self._choice("".join((*words, "p")), quits)) == "p":
            if named := self._named():
                return named
        if words[key] == "quit":
            raise Stopped(quits)
        return {"answer": words[key]}

    def _named(self) -> dict[str, str]:
        """Return the answer that names the position to take next; nothing where the line is empty."""
        self._say(f"  which of {', '.join(self._positions)} is to be taken next, or Enter for none: ", end="")
        name = self._keys.line()
        return {"answer": "again", "position": name} if name else {}

    def _choice(self, keys: str, quits: str = "stopped by the operator") -> str:
        """Wait for one of these keys; ``q`` stops the session with these words."""
        while True:
            key = self._keys.choice(None)
            if key == "q":
                raise Stopped(quits)
            if key is not None and key in keys:
                return key
            self._explain(key)

    def _show(self, look: messages.Look) -> None:
        """Show the readings of all sensors, a row each, below their targets: what a row has no room for is left out."""
        readings, rows, targets = look.readings, [], ""
        width = max([6, *map(len, readings)])
        for serial, reading in readings.items():
            unit = self._sensors[serial].unit
            guide: SensorGuidance = reading.guidance
            cells = "".join(words.ljust(22) for words in guide.in_words())
            raw = " ".join(f"{value:.6g}" for value in reading.values.values())
            warmth = "" if reading.temperature is None else f"{reading.temperature:.1f} °C"
            aims = [(channel, tilt.target) for channel, tilt in guide.tilts.items() if tilt.target is not None]
            asked = "".join(f"{channel} {target:+7.2f}°".ljust(22) for channel, target in aims)
            if asked and asked != targets:
                rows.append(self._fitting(f"{'target':<{width}}  {asked}"))
            targets = asked
            rows.append(self._fitting(f"{serial:<{width}}  {cells}".rstrip(), warmth, f"{raw} {unit}"))
        note = look.why or f"live, {note_on([reading.guidance for reading in readings.values()])}"
        self._traces.add(next(iter(readings.values())).guidance.up if len(readings) == 1 else None)
        rows.append(self._fitting(note, self._traces.within(self._console.width - len(note) - 5)))
        self._overwrite(rows)

    def _typed(self, what: str, kind: str, count: int = 1) -> list[float]:
        """Ask until as many numbers of a kind are typed; none where the line is empty."""
        while True:
            self._say(f"  {what}, or Enter to keep it: ", end="")
            typed = self._keys.line().strip()
            parts = [typed] if count == 1 else [part.rstrip(",;") for part in typed.split()]
            try:
                if not typed:
                    return []
                if len(parts) != count:
                    raise InputError(f"{typed!r} is not accepted: type {count} numbers such as 0 0.5 0.866")
                return [number_in(part, kind) for part in parts]
            except InputError as error:
                self._say(f"  {error}")
