"""The clock of a session, passed in wherever the program waits or takes the time."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from typing import Protocol

SECOND = 1e9  # of a second, ns
VIRTUAL_START = datetime(2000, 1, 1, tzinfo=UTC)
"""When every session on the virtual bench starts, so that the same seed gives the same file to the byte."""


class Clock(Protocol):
    """The interface of a clock: nanoseconds since the session began."""

    def now_ns(self) -> int:
        """Return the time since the session began, in nanoseconds."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait for at least ``seconds``."""
        ...

    def seek(self, now_ns: int) -> None:
        """Continue from ``now_ns`` (a replayed event's time) if this clock can be set."""
        ...


def session_clock(started: datetime, *, virtual: bool) -> Clock:
    """Return the clock of a session that began at a moment; a virtual one stands at its start."""
    return VirtualClock() if virtual else SystemClock(int(started.timestamp() * SECOND))


class SystemClock:
    """The machine's clock; a resumed session passes the start of the first run, ns since 1970, to show the pause."""

    def __init__(self, started_ns: int) -> None:
        self._since_start = time.time_ns() - started_ns
        self._monotonic = time.monotonic_ns()

    def now_ns(self) -> int:
        return self._since_start + time.monotonic_ns() - self._monotonic

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def seek(self, now_ns: int) -> None:
        """Go on from ``now_ns`` where the machine's clock is behind it, as on a computer whose clock lost its time."""
        self._since_start += max(now_ns - self.now_ns(), 0)


class VirtualClock:
    """A clock that moves only in ``sleep``: a night in the chamber takes no real time."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def sleep(self, seconds: float) -> None:
        self._now_ns += round(seconds * SECOND)

    def seek(self, now_ns: int) -> None:
        self._now_ns = now_ns
