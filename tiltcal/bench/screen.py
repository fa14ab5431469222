"""The screen of a terminal: lines that stay, and below them the rows that the next ones overwrite."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from tiltcal.bench.guidance import UNCALIBRATED
from tiltcal.printable import printable

CLEAR, UP, BELL = "\r\x1b[2K", "\x1b[1A", "\a"

HELP = {
    "Enter measure": "wait until the reading is still, then take the samples",
    "Enter accept": "the position counts",
    "Enter write": "write the calibration files",
    "a angle set": "type the angle that was really set, where it is not the one asked for",
    "t temperature": "type the temperature, where no thermometer is read",
    "b back": "give up the position before this one, and take that again",
    "r redo": "take this position again",
    "p another position": "type the name of the one to take next; one that was accepted is withdrawn",
    "s stop and use the turns so far": "match the pairs on the turns that were made",
    "q stop and keep": "stop; what was accepted is kept, and --resume goes on",
    "n stop and keep": "stop without the files; --resume asks again",
}
"""What the keys do, by their hints."""

READING_HELP = (
    "each axis: present angle, in brackets its difference from the target, and ok where it is near enough; "
    "of three axes the angle from the direction asked for, and how far two sides are too high; "
    f"{UNCALIBRATED}: they are by the data sheet and the positions before"
)


class Screen:
    """Prints lines, hints and live rows; what comes from a file is no markup, and holds no escape sequence."""

    def __init__(self, console: Console, *, live: bool) -> None:
        self._console, self._live = console, live
        self._live_rows = 0
        self._offered: list[str] = []

    def _say(self, text: str, style: str = "", end: str = "\n") -> None:
        """Print a line as it stands: what comes from a file is no markup, and holds no escape sequence."""
        self.clear()
        self._console.print(Text(printable(text).rstrip(" "), style=style), end=end)

    def _ring(self) -> None:
        if self._live:
            self._console.file.write(BELL)

    def _hint(self, *choices: str) -> None:
        line, self._offered = Text("  "), list(choices)
        for choice in (*choices, "? help"):
            key, _, meaning = choice.partition(" ")
            line.append(key, style="bold").append(f" {meaning}  ", style="dim")
        self._console.print(line)

    def _explain(self, key: str | None) -> None:
        """Say what the keys do, or name them, once; the one that was pressed may have no name, such as an arrow."""
        keys = [choice.partition(" ")[0] for choice in self._offered]
        if key == "?":
            for name, choice in zip(keys, self._offered, strict=True):
                self._say(f"  {name:<6} {HELP.get(choice, choice.removeprefix(name).strip())}")
            self._say(f"  {READING_HELP}")
        elif keys:
            self._say(f"  not one of the keys: {', '.join(keys)}")
            self._offered = []

    def _overwrite(self, lines: list[str]) -> None:
        """Print lines that the next ones overwrite, as many and as much of each as there is room for."""
        self.clear()
        room = self._console.width - 3
        rows = [f"  {line}" if len(line) <= room else f"  {line[: room - 2]} …" for line in map(printable, lines)]
        rows = rows[-self._console.height + 1 :]
        self._live_rows = len(rows)
        self._console.file.write("\n".join(rows))
        self._console.file.flush()

    def clear(self) -> None:
        """Empty the lines of the live reading, which whatever is printed next would be appended to."""
        if self._live_rows:
            self._console.file.write(CLEAR + (UP + CLEAR) * (self._live_rows - 1))
            self._console.file.flush()
            self._live_rows = 0

    def _fitting(self, row: str, *more: str) -> str:
        """Return a row with as many further parts as there is room for."""
        for part in filter(None, more):
            row = f"{row}  {part}" if len(row) + len(part) + 5 <= self._console.width else row
        return row.rstrip()
