"""Lines of a text stream: waited for, or taken where they have arrived."""

from __future__ import annotations

import io
import os
import select
from collections import deque
from typing import TextIO

CHUNK = 1 << 16
LONGEST = 1 << 16
"""Bytes of a line that are kept; the rest of a longer one is dropped, and what is left is no answer."""
MOST = 1000
"""Lines that are looked at while more arrive."""


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
