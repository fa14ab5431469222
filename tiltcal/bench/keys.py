"""What a person types: lines of a text stream, waited for or taken where they have arrived, and single keys."""

from __future__ import annotations

import io
import os
import select
import sys
from collections import deque
from types import TracebackType
from typing import Protocol, TextIO

from tiltcal.errors import Stopped

ENTER = "\n"

CHUNK = 1 << 16
LONGEST = 1 << 16
"""Bytes of a line that are kept; the rest of a longer one is dropped, and what is left is no answer."""
MOST = 1000
"""Lines that are looked at while more arrive."""

_ESCAPE = "\x1b"
_REST = 0.05  # seconds within which the rest of an escape sequence arrives


class LineReader:
    """The lines of a text stream.

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
        except (OSError, ValueError, io.UnsupportedOperation):
            self._descriptor = None

    def next(self) -> str:
        """Wait for the next line and return it with its end; empty at the end of the stream."""
        if self._descriptor is None:
            return self._stream.readline()
        while not self._ready and not self._ended:
            self._listen(self._descriptor)
        return self._ready.popleft() if self._ready else ""

    def waiting(self) -> list[str]:
        """Return the lines that have arrived; they stay."""
        while self._descriptor is not None and not self._ended and len(self._ready) < MOST:
            if not select.select([self._descriptor], [], [], 0.0)[0]:
                break
            self._listen(self._descriptor)
        return list(self._ready)

    def drop(self, count: int) -> None:
        """Let the first of the waiting lines go."""
        for _ in range(count):
            self._ready.popleft()

    def _listen(self, descriptor: int) -> None:
        arrived = os.read(descriptor, CHUNK)
        self._ended = not arrived
        *lines, rest = arrived.split(b"\n")
        if lines:
            lines[0] = self._rest + lines[0]
            self._rest = rest
        else:
            self._rest += rest
        self._rest = self._rest[:LONGEST]
        self._ready.extend(line[:LONGEST].decode(errors="replace") + "\n" for line in lines)
        if self._ended and self._rest:
            self._ready.append(self._rest.decode(errors="replace"))
            self._rest = b""


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
    """Reads whole lines and never returns by itself: for ``--plain``, pipes and screen readers.

    Parameters
    ----------
    stream : text stream
        Nothing else may read it.
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
                self._lines.drop(number)
                return key
        return None

    def line(self) -> str:
        typed = self._lines.next()
        if not typed:
            raise Stopped("the input has ended")
        return typed.strip()


class TerminalKeys:
    """Reads single keys from a terminal, which is given back as it was.

    Use as a context manager.
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cooked()

    def choice(self, timeout: float | None) -> str | None:
        ready, _, _ = select.select([self._descriptor], [], [], timeout)
        if not ready:
            return None
        key = self._byte()
        if key in ("", "\x04"):
            raise Stopped("the input has ended")
        if key == _ESCAPE:
            self._skip_sequence()
        return ENTER if key in "\r\n" else key.lower()

    def _byte(self) -> str:
        return os.read(self._descriptor, 1).decode(errors="replace")

    def _skip_sequence(self) -> None:
        """Read the rest of what an arrow or a function key sends, whose letters are no choices (ECMA-48, 5.4)."""
        kind = _ESCAPE
        while kind == _ESCAPE and select.select([self._descriptor], [], [], _REST)[0]:
            kind = self._byte()  # with Alt there is an escape before that of the key
        if kind == "O":
            self._byte()
        if kind == "[" and (byte := self._byte()) == "[":  # F1 to F5 of the Linux console
            self._byte()
        elif kind == "[":
            while byte and not "@" <= byte <= "~":
                byte = self._byte()

    def pressed(self, choices: str) -> str | None:
        key = self.choice(0.0)
        return key if key is not None and key in choices else None

    def line(self) -> str:
        import tty

        self._cooked()
        try:
            typed = sys.stdin.readline()
        finally:
            tty.setcbreak(self._descriptor)
        if not typed:
            raise Stopped("the input has ended")
        return typed.strip()

    def _cooked(self) -> None:
        import termios

        termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)  # type: ignore[arg-type]
