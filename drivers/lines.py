"""Lines of text as they come off a serial line: whole, half, or mixed with garbage."""

from __future__ import annotations

import re
from collections import deque
from typing import TYPE_CHECKING

from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.link import Link

CHUNK = 4096
"""The most bytes to take at once."""

LONGEST = 1024
"""A line longer than this is none: the speed is wrong, or the device speaks no text."""

UNUSABLE = 50
"""Lines in a row that cannot be used before a driver gives up."""

_LINE_END = re.compile(rb"[\r\n]+")


class LineBuffer:
    """Cuts what a device says into lines.

    The first piece after the start, or after :meth:`discard`, may be the tail of a line whose head nobody heard.

    Parameters
    ----------
    link : Link
        Serial.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._ready: deque[bytes] = deque()
        self._rest = b""
        self._begun = False

    def next(self) -> tuple[bytes, bool]:
        """The next line that is not empty, without its end.

        Returns
        -------
        line : bytes
        whole : bool
            False where its head may be missing.

        Raises
        ------
        BusError
            Silence, or bytes without a line end.
        """
        while True:
            while not self._ready:
                self._listen()
            line, whole = self._ready.popleft(), self._begun
            self._begun = True
            if line:
                return line, whole

    def discard(self) -> None:
        """Forget what has arrived."""
        self._restart()
        self._link.exchange(b"", 0)

    def _restart(self) -> None:
        self._ready.clear()
        self._rest = b""
        self._begun = False

    def _listen(self) -> None:
        try:
            arrived = self._link.exchange(b"", CHUNK)
        except BusError:
            # What comes once the line is plugged in again does not continue the half line of before.
            self._restart()
            raise
        pieces = _LINE_END.split(self._rest + arrived)
        self._rest = pieces.pop()
        self._ready.extend(pieces)
        if not pieces and len(self._rest) > LONGEST:
            endless = self._rest
            self._restart()
            raise BusError(
                f"{len(endless)} bytes came without a line end, beginning with {shown(endless)}: is the baudrate "
                "right, and does the device send text?"
            )


def shown(line: bytes) -> str:
    """A line in a message: its first characters, quoted, with what cannot be printed as an escape."""
    return repr(line[:60])[1:]
