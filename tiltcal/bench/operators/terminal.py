"""A person at the bench: prompts, a live reading, expected and measured side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import asin, copysign, degrees, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rich.console import Console
from rich.table import Table
from rich.text import Text

from tiltcal.bench.operators.keys import ENTER, Keys
from tiltcal.bench.operators.operator import Live, OperatorAnswer, StageTurn, pair_in_words
from tiltcal.core.attitude import gravity_from_tilt, normalised
from tiltcal.core.detection import TEMPERATURES
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import HardwareError, InputError, Stopped
from tiltcal.files.procedure import Position, Procedure
from tiltcal.printable import printable

if TYPE_CHECKING:
    from tiltcal.bench.position_result import PositionResult
    from tiltcal.core.pair.matching import Matching
    from tiltcal.core.pair.model import Pair

T = TypeVar("T")

LIVE_PAUSE = 0.4
"""Seconds between live readings: fast enough to set an angle by, slow enough for the journal of a long night."""

_WIDEST = 10_000
"""Columns of a terminal on which any table fits."""

CLEAR = "\r\x1b[2K"
"""Empties the line of the live reading."""


class _Terminal:
    """The two operators' common part.

    Parameters
    ----------
    live : bool
        Whether one line may overwrite another; needs a terminal.
    """

    def __init__(self, console: Console, keys: Keys, *, live: bool) -> None:
        self._console = console
        self._keys = keys
        self._live = live
        self._line_is_live = False
        self._offered: list[str] = []

    def confirm_write(self, files: list[Path]) -> OperatorAnswer:
        """Ask once more before the files are written."""
        named = ", ".join(f"{path} (replaces the one there)" if os.path.exists(path) else str(path) for path in files)
        self._say(f"\nEverything is measured. Write {named}?")
        self._hint("Enter write", "n stop and keep")
        if self._choice(f"{ENTER}ynq") in "nq":
            raise Stopped("not written: the operator declined")
        return OperatorAnswer("yes")

    def done(self, files: list[Path], journal: Path) -> None:
        for path in files:
            self._say(f"wrote {path}", "green")
        self._say(f"journal {journal}")

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


class TerminalOperator(_Terminal):
    """Asks a person for positions; ``live`` shows readings while it waits."""

    def __init__(self, console: Console, keys: Keys, *, live: bool) -> None:
        super().__init__(console, keys, live=live)
        self._positions = 0
        self._models: Mapping[str, Model] = {}

    def begin(self, procedure: Procedure, models: Mapping[str, Model]) -> None:
        self._positions, self._models = len(procedure.positions), models
        self._say(f"\n{procedure.title}  {procedure.length}", "bold")

    def position(self, position: Position, number: int, live: Live) -> OperatorAnswer:
        """Show the operator what to set, and a live reading, until a key is pressed."""
        self._say(f"\n{number}/{self._positions}  {position.name}", "bold cyan")
        self._say(f"  {position.prompt}")
        if position.temperature is not None:
            self._say(f"  at {position.temperature:g} °C")
        if position.stage is not None:
            self._say(f"  stage at {position.stage:g}°")
        self._hint("Enter measure", "a angle set", "t temperature", "b back", "q stop and keep")
        tilt: dict[str, float] = {}
        gravity: tuple[float, ...] | None = None
        temperature: float | None = None
        while True:
            key = self._wait(live)
            if key == ENTER:
                return OperatorAnswer("ready", tilt, gravity, temperature)
            if key == "q":
                raise Stopped("stopped by the operator")
            if key in ("b", "r"):
                return OperatorAnswer("back" if key == "b" else "redo")
            if key == "t":
                temperature = self._number("temperature in °C", *TEMPERATURES, temperature)
            elif key == "a" and position.tilt is not None:
                tilt = self._angles(position.tilt, tilt)
            elif key == "a":
                gravity = self._typed("direction that points up, as gx gy gz", direction, gravity)
            elif key is not None:
                self._refuse_key()

    def look(self, position: Position, readings: Mapping[str, Reading], why: str, seconds: float) -> None:
        self._show(readings, why)  # first, because what has no room is left out

    def review(self, result: PositionResult) -> OperatorAnswer:
        """Show expected, measured and noise, and ask whether it counts."""
        self.clear()
        table = self._table(result)
        wide = self._console.options.update(width=_WIDEST)
        if self._console.measure(table, options=wide).maximum <= self._console.width:
            self._console.print(table)
        else:
            self._list(result)
        self._hint("Enter accept", "r redo", "b back", "q stop and keep")
        key = self._choice(f"{ENTER}rbq")
        if key == "q":
            raise Stopped("stopped by the operator")
        return OperatorAnswer({ENTER: "accept", "r": "redo", "b": "back"}[key])

    def accepted(self, result: PositionResult) -> None:
        self._say(f"  accepted {result.position.name}", "green")

    def refused(self, position: Position, why: str) -> None:
        self._say(f"  refused: {why}", "bold red")

    def lost(self, serial: str, why: str) -> None:
        self._say(f"  {serial} is dropped, the others continue: {why}", "bold red")

    def _rows(self, result: PositionResult) -> Iterator[tuple[str, str, str, str, str, str]]:
        """Iterate over name, expected, measured, tilt, noise and n of each reading; a temperature has two of them."""
        for serial, measurement in result.measurements.items():
            expected = result.expected.get(serial, {})
            for channel, summary in measurement.summaries.items():
                yield (
                    f"{serial} {channel}",
                    f"{expected[channel]:.6g}" if expected else "unknown",
                    f"{summary.mean:.6g} {self._models[serial].unit}",
                    self._angle(serial, summary.mean),
                    f"{summary.std:.2g}",
                    str(summary.n),
                )
            if measurement.temperature is not None:
                yield f"{serial} T", "", f"{measurement.temperature:.2f} °C", "", "", ""

    def _list(self, result: PositionResult) -> None:
        """Print what the table says, one channel below the other."""
        for name, expected, measured, tilt, noise, n in self._rows(result):
            self._say(f"  {name}  {measured}", "bold")
            if expected:
                self._say(f"    expected {expected}")
                self._say(f"    tilt {tilt}, noise {noise}, n {n}")

    def _table(self, result: PositionResult) -> Table:
        table = Table(box=None, pad_edge=False, padding=(0, 2), header_style="dim")
        for heading in ("", "expected", "measured", "tilt", "noise", "n"):
            table.add_column(heading, justify="right")
        for name, *cells in self._rows(result):
            table.add_row(Text(printable(name)), *cells)
        return table

    def _wait(self, live: Live) -> str | None:
        """Return the next key; meanwhile the readings are shown."""
        if not self._live:
            return self._keys.choice(None)
        key = self._keys.choice(0.0)
        while key is None:
            try:
                self._show(live())
            except HardwareError as error:
                self._line(f"no reading: {error}")
            key = self._keys.choice(LIVE_PAUSE)
        self.clear()
        return key

    def _show(self, readings: Mapping[str, Reading], *why: str) -> None:
        if not self._live:
            return
        parts = [*why]
        for serial, reading in readings.items():
            lead = f"{serial} " if len(readings) > 1 else ""
            for channel, value in zip(self._models[serial].channels, reading.values, strict=True):
                parts.append(f"{lead}{channel} {value:.6g} ({self._angle(serial, value)})")
                lead = ""
            if reading.temperature is not None:
                parts.append(f"{reading.temperature:.1f} °C")
        self._line(*parts, *(() if why else ("live",)))

    def _angle(self, serial: str, value: float) -> str:
        """Return a reading as a tilt, by the model's nominal coefficients."""
        model = self._models[serial]
        sine = (value - model.offset) / model.sensitivity
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


class TerminalRotationOperator(_Terminal):
    """Asks a person to let a stage turn."""

    def begin(self, title: str) -> None:
        self._say(f"\n{title}", "bold")

    def turning(self, prompt: str, pairs: Sequence[Pair], turns: int) -> OperatorAnswer:
        """Ask to let the stage turn."""
        for pair in pairs:
            self._say(f"  {pair.first} and {pair.second}, orthogonal {pair.orthogonal}")
        self._say(f"  {prompt}")
        self._hint(f"Enter the stage turns, up to {turns} turns", "q stop and keep")
        if self._choice(f"{ENTER}q") == "q":
            raise Stopped("stopped by the operator")
        self._hint("s stop and use the turns so far", "q stop and keep the journal")
        return OperatorAnswer("ready")

    def poll(self) -> OperatorAnswer | None:
        key = self._keys.pressed("sq")
        if key == "q":
            raise Stopped("stopped by the operator")
        return OperatorAnswer("stop") if key == "s" else None

    def turn_completed(self, turn: StageTurn) -> None:
        if self._live:
            self._line(str(turn))
        else:
            self._say(f"  {turn}")

    def paused(self, why: str) -> None:
        self._say(f"  held: {why}", "yellow")

    def resumed(self) -> None:
        self._say("  goes on")

    def refused(self, why: str) -> None:
        self._say(f"  refused: {why}", "bold red")

    def matched(self, turns: float, matchings: Sequence[Matching]) -> None:
        for matching in matchings:
            self._say(f"  matched {pair_in_words(matching.pair.name, matching)} after {turns:.1f} turns", "green")


def direction(typed: str) -> tuple[float, ...]:
    """Return a typed direction as a unit vector.

    InputError: not three numbers, or all zero.
    """
    try:
        parts = [float(part) for part in typed.replace(",", " ").split()]
    except ValueError:
        raise InputError("type three numbers such as 0 0.5 0.866") from None
    return normalised(parts)
