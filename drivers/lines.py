"""Lines of text from a serial line, complete, partial, or with garbage."""

from __future__ import annotations

import re
from collections import deque
from typing import TYPE_CHECKING

from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

CHUNK = 4096
"""The largest number of bytes to take at once."""

LONGEST = 1024
"""Longest line; a longer one means a wrong baud rate, or a device that sends no text."""

PATIENCE = 10.0
"""Seconds from its first byte in which a line must be complete; a slower one is given up."""

SILENCE = 0.1
"""Seconds without a byte after which a line begins; a line that is being sent has shorter pauses."""

UNUSABLE = 50
"""Unusable lines in a row before a driver raises an error."""

_LINE_END = re.compile(rb"[\r\n]+")


class LineBuffer:
    """Splits the bytes of a device into lines.

    The first piece after the start, or after :meth:`discard`, may be the tail of a line; it is a whole one where the
    device was silent before it.

    Parameters
    ----------
    clock : Clock
        Times a line, and the silence before it.
    """

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        self._ready: deque[bytes] = deque()
        self._rest = b""
        self._begun = self._emptied = False

    def next(self) -> tuple[bytes, bool]:
        """Return the next line that is not empty, without its end.

        Returns
        -------
        line : bytes
        whole : bool
            False if its beginning may be missing.

        BusError: silence, bytes without a line end, or line ends alone.
        """
        for _ in range(UNUSABLE):
            began_ns: int | None = None
            while not self._ready:
                self._listen()
                now_ns = self._clock.now_ns()
                began_ns = now_ns if began_ns is None else began_ns
                if not self._ready:
                    self._require_soon(began_ns, now_ns)
            line, whole = self._ready.popleft(), self._begun
            self._begun = True
            if line:
                return line, whole
        raise BusError(f"{UNUSABLE} lines arrived and all were empty: does the device send text?")

    def discard(self) -> None:
        """Discard what has arrived."""
        self._restart()
        self._link.exchange(b"", 0)
        self._emptied = True

    def _restart(self) -> None:
        self._ready.clear()
        self._rest = b""
        self._begun = self._emptied = False

    def _require_soon(self, began_ns: int, now_ns: int) -> None:
        if now_ns - began_ns > PATIENCE * 1e9:
            piece = self._rest
            self._restart()
            raise BusError(
                f"no whole line came in {PATIENCE:g} s, only {shown(piece)}: does the device end its lines, and is "
                "this its baud rate?"
            )

    def _listen(self) -> None:
        asked_ns = self._clock.now_ns()
        try:
            arrived = self._link.exchange(b"", CHUNK)
        except BusError:
            # Data after a reconnection do not continue the partial line from before.
            self._restart()
            raise
        if self._emptied:
            # Nothing was waiting in the port, so a long wait for the first byte was silence on the line.
            self._begun = self._clock.now_ns() - asked_ns > SILENCE * 1e9
            self._emptied = False
        pieces = _LINE_END.split(self._rest + arrived)
        self._rest = pieces.pop()
        self._ready.extend(pieces)
        if not pieces and len(self._rest) > LONGEST:
            endless = self._rest
            self._restart()
            raise BusError(
                f"{len(endless)} bytes came without a line end, beginning with {shown(endless)}: is the baud rate "
                "right, and does the device send text?"
            )


def shown(line: bytes) -> str:
    """Return the first characters of a line for a message, quoted and escaped."""
    return repr(line[:60])[1:]
