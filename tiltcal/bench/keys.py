"""What is typed: single keys of a terminal, lines of a stream, and lines of a notebook."""

from __future__ import annotations

import io
import os
import select
import sys
from collections import deque
from typing import Protocol, TextIO

from tiltcal.errors import Stopped

ENTER, ESCAPE = "\n", "\x1b"
REST = 0.05  # time within which the rest of an escape sequence arrives, s
CHUNK = LONGEST = 1 << 16  # bytes that are read at once, and of a line without an end that are kept


class LineReader:
    """The lines of a text stream, waited for or taken where they have arrived.

    It reads the stream's descriptor itself, because Python's buffer cannot be asked without waiting; nothing else may
    read the stream. A stream without a descriptor is read as it is, and has nothing ready.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._ready: deque[str] = deque()
        self._rest = b""
        self._ended = False
        try:
            self._descriptor: int | None = stream.fileno()
        except (OSError, ValueError):
            self._descriptor = None

    def next(self) -> str:
        """Wait for the next line and return it with its end; empty at the end of the stream."""
        if self._descriptor is None:
            return self._stream.readline()
        while not self._ready and not self._ended:
            self._read(self._descriptor)
        return self._ready.popleft() if self._ready else ""

    def waiting(self) -> list[str]:
        """Return the lines that have arrived; they stay."""
        if self._descriptor is not None and not self._ended and select.select([self._descriptor], [], [], 0.0)[0]:
            self._read(self._descriptor)
        return list(self._ready)

    def _read(self, descriptor: int) -> None:
        arrived = os.read(descriptor, CHUNK)
        self._ended = not arrived
        *lines, rest = (self._rest + arrived).split(b"\n")
        self._rest = b"" if self._ended else rest[:LONGEST]
        self._ready.extend(line.decode(errors="replace") + "\n" for line in lines)
        if self._ended and rest:
            self._ready.append(rest.decode(errors="replace"))


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
