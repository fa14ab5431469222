"""A person at the bench: prompts, a live reading, expected and measured side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import asin, degrees, isfinite
from pathlib import Path
from typing import TypeVar

from rich.console import Console
from rich.table import Table
from rich.text import Text

from tiltcal.bench.operators.answer import OperatorAnswer
from tiltcal.bench.operators.keys import ENTER, Keys
from tiltcal.bench.operators.operator import Live, MeasuredPosition
from tiltcal.bench.operators.sim_stage import StageTurn, said
from tiltcal.core.frames import gravity_from_tilt, normalised
from tiltcal.core.pair.matching import Matching
from tiltcal.core.pair.model import Pair
from tiltcal.drivers.device import Model, Reading
from tiltcal.errors import HardwareError, InputError, Stopped
from tiltcal.files.procedure import Position

T = TypeVar("T")

LIVE_PAUSE = 0.4
"""Seconds between live readings: fast enough to set an angle by, slow enough for the journal of a long night."""


class TerminalOperator:
    """Asks a person.

    Parameters
    ----------
    console : Console
        Where to talk.
    keys : Keys
        Where the choices come from.
    models : mapping of str to Model
        Per serial number, so that readings can be shown as angles too.
    live : bool
        Whether to show readings while waiting; needs a terminal.
    """

    def __init__(self, console: Console, keys: Keys, models: Mapping[str, Model], *, live: bool) -> None:
        self._console = console
        self._keys = keys
        self._models = models
        self._live = live
        self._positions = 0

    def begin(self, title: str, positions: int) -> None:
        self._positions = positions
        self._console.print(f"\n[bold]{title}[/bold]" + (f"  {positions} positions" if positions else ""))

    def position(self, position: Position, number: int, live: Live) -> OperatorAnswer:
        """Show the operator what to set, and a live reading, until a key is pressed."""
        self._console.print(f"\n[bold cyan]{number}/{self._positions or '?'}  {position.name}[/bold cyan]")
        self._console.print(f"  {position.prompt}", markup=False)
        if position.temperature is not None:
            self._console.print(f"  at {position.temperature:g} °C")
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
                temperature = self._number("temperature in °C", -100.0, 200.0)
            elif key == "a" and position.tilt is not None:
                tilt = self._angles(position.tilt)
            elif key == "a":
                gravity = self._direction()
            elif key is not None:
                self._console.print(f"  {key!r} is no choice here")

    def look(self, position: Position, readings: Mapping[str, Reading], why: str) -> None:
        self._show(readings, why)

    def review(self, position: Position, measured: list[MeasuredPosition]) -> OperatorAnswer:
        """Show expected, measured and noise, and ask whether it counts."""
        self._clear()
        table = Table(box=None, pad_edge=False, padding=(0, 2), header_style="dim")
        for heading in ("", "expected", "measured", "tilt", "noise", "n"):
            table.add_column(heading, justify="right")
        for one in measured:
            for channel, mean in one.mean.items():
                table.add_row(
                    f"{one.serial} {channel}",
                    f"{one.expected[channel]:.6g}" if one.expected else "unknown",
                    f"{mean:.6g} {one.unit}",
                    self._angle(one.serial, mean),
                    f"{one.std[channel]:.2g}",
                    str(one.n),
                )
            if one.temperature is not None:
                table.add_row(f"{one.serial} T", "", f"{one.temperature:.2f} °C", "", "", "")
        self._console.print(table)
        self._hint("Enter accept", "r redo", "b back", "q stop and keep")
        while True:
            key = self._keys.choice(None)
            if key == ENTER:
                return OperatorAnswer("accept")
            if key == "q":
                raise Stopped("stopped by the operator")
            if key in ("r", "b"):
                return OperatorAnswer("redo" if key == "r" else "back")

    def accepted(self, position: Position, measured: list[MeasuredPosition]) -> None:
        self._console.print(f"  [green]accepted[/green] {position.name}")

    def refused(self, position: Position, why: str) -> None:
        self._clear()
        self._console.print(Text(f"  refused: {why}", style="bold red"))

    def lost(self, serial: str, why: str) -> None:
        self._console.print(Text(f"  {serial} is given up, the others go on: {why}", style="bold red"))

    def turning(self, prompt: str, pairs: Sequence[Pair], turns: int) -> OperatorAnswer:
        """Ask to let the stage turn."""
        for pair in pairs:
            self._console.print(f"  {pair.first} and {pair.second}, orthogonal {pair.orthogonal}", markup=False)
        self._console.print(f"  {prompt}", markup=False)
        self._hint(f"Enter it turns: up to {turns} turns", "q stop and keep")
        while True:
            key = self._keys.choice(None)
            if key == ENTER:
                self._hint("s stop and use what is there", "q stop and keep the journal")
                return OperatorAnswer("ready")
            if key == "q":
                raise Stopped("stopped by the operator")

    def poll(self) -> OperatorAnswer | None:
        key = self._keys.pressed("sq")
        if key == "q":
            raise Stopped("stopped by the operator")
        return OperatorAnswer("stop") if key == "s" else None

    def turned(self, turn: StageTurn) -> None:
        if self._live:
            self._line(str(turn))
        else:
            self._console.print(f"  {turn}", markup=False)

    def held(self, why: str) -> None:
        self._clear()
        self._console.print(Text(f"  held: {why}", style="yellow"))

    def resumed(self) -> None:
        self._console.print("  goes on")

    def turning_refused(self, why: str) -> None:
        self._clear()
        self._console.print(Text(f"  refused: {why}", style="bold red"))

    def matched(self, turns: float, matchings: Sequence[Matching]) -> None:
        self._clear()
        for one in matchings:
            self._console.print(f"  [green]matched[/green] {said(one.pair.name, one)} after {turns:.1f} turns")

    def write(self, files: list[Path]) -> OperatorAnswer:
        """Ask once more before the files are written."""
        named = ", ".join(f"{path} (replaces the one there)" if path.exists() else str(path) for path in files)
        self._console.print(f"\nAll is measured. Write {named}?")
        self._hint("Enter write", "n stop and keep")
        while True:
            key = self._keys.choice(None)
            if key in (ENTER, "y"):
                return OperatorAnswer("yes")
            if key in ("n", "q"):
                raise Stopped("not written, as the operator wished")

    def done(self, files: list[Path], journal: Path) -> None:
        for path in files:
            self._console.print(f"[green]wrote[/green] {path}")
        self._console.print(f"journal {journal}")

    def _wait(self, live: Live) -> str | None:
        """The next key; meanwhile the readings are shown."""
        if not self._live:
            return self._keys.choice(None)
        key = self._keys.choice(0.0)
        while key is None:
            try:
                self._show(live(), "live")
            except HardwareError as error:
                self._line(f"no reading: {error}")
            key = self._keys.choice(LIVE_PAUSE)
        self._clear()
        return key

    def _show(self, readings: Mapping[str, Reading], why: str) -> None:
        if not self._live:
            return
        parts = []
        for serial, reading in readings.items():
            channels = self._models[serial].channels
            parts += [
                f"{channel} {value:.6g} ({self._angle(serial, value)})"
                for channel, value in zip(channels, reading.values, strict=True)
            ]
            if reading.temperature is not None:
                parts.append(f"{reading.temperature:.1f} °C")
        self._line("   ".join(parts) + f"   {why}")

    def _angle(self, serial: str, value: float) -> str:
        """A reading as a tilt, by the model's nominal coefficients."""
        model = self._models[serial]
        sine = (value - model.offset) / model.sensitivity
        return f"{degrees(asin(sine)):+.2f}°" if abs(sine) <= 1 else "over range"

    def _line(self, text: str) -> None:
        """One line that the next one overwrites."""
        width = self._console.width - 3
        self._console.file.write(f"\r\x1b[2K  {text[:width]}")
        self._console.file.flush()

    def _clear(self) -> None:
        if self._live:
            self._console.file.write("\r\x1b[2K")
            self._console.file.flush()

    def _hint(self, *choices: str) -> None:
        told = Text("  ")
        for choice in choices:
            key, _, meaning = choice.partition(" ")
            told.append(key, style="bold").append(f" {meaning}   ", style="dim")
        self._console.print(told)

    def _angles(self, asked: Mapping[str, float]) -> dict[str, float]:
        """The angles actually set, one question an axis."""
        while True:
            tilt = {
                axis: self._number(f"tilt of {axis} actually set, in degrees (asked {angle:g})", -90.0, 90.0)
                for axis, angle in asked.items()
            }
            try:
                gravity_from_tilt(tilt)
            except InputError as error:
                self._console.print(f"  {error}")
                continue
            return tilt

    def _direction(self) -> tuple[float, ...]:
        """The direction actually set."""
        return self._typed("direction that points up, as gx gy gz", _direction)

    def _number(self, what: str, low: float, high: float) -> float:
        def parse(typed: str) -> float:
            value = float(typed.replace(",", "."))
            if not (isfinite(value) and low <= value <= high):
                raise InputError(f"{value:g} is not between {low:g} and {high:g}")
            return value

        return self._typed(what, parse)

    def _typed(self, what: str, parse: Callable[[str], T]) -> T:
        """Ask until the typed line can be understood."""
        while True:
            self._console.print(f"  {what}: ", end="")
            typed = self._keys.line()
            try:
                return parse(typed)
            except (ValueError, InputError) as error:
                self._console.print(f"  {typed!r} will not do: {error}")


def _direction(typed: str) -> tuple[float, ...]:
    return normalised([float(part) for part in typed.replace(",", " ").split()])
