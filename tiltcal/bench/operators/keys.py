"""The keys that a person presses: single ones on a terminal, whole lines elsewhere."""

from __future__ import annotations

import os
import select
import sys
from types import TracebackType
from typing import Protocol, TextIO

from tiltcal.bench.operators.line_reader import LineReader
from tiltcal.errors import Stopped

ENTER = "\n"

_ESCAPE = "\x1b"
_REST = 0.05  # seconds within which the rest of an escape sequence arrives


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
