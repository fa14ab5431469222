"""What the links to all virtual parts share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock


class TwinLink(ABC):
    """Base of the links to virtual parts: nothing is opened, so there is nothing to release.

    clock: session time; a transaction advances it by the time that its bits take.
    """

    letter: str
    """The bus in a journal line."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    @abstractmethod
    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Carry out one transaction; see :class:`~tiltcal.drivers.bus.link.Link`."""

    def close(self) -> None:  # noqa: B027 - a virtual part holds nothing
        """Do nothing: there is nothing to release."""


class RecallingTwin(TwinLink):
    """A link to a virtual part that keeps what its driver has set; see :class:`~tiltcal.drivers.bus.link.Recalling`."""

    _recalls = False

    def recall(self, out: bytes, now_ns: int) -> None:
        """Repeat what was sent at an earlier time; in mid-session the part is already set up."""
        if not self._recalls:
            self._recalls = True
            self._take_set_up_state()
        with at_time(self._clock, now_ns - round(self._seconds(out) * 1e9)):
            self._take(out)

    @abstractmethod
    def _take_set_up_state(self) -> None:
        """Take the state of a part after the setup by its driver."""

    @abstractmethod
    def _seconds(self, out: bytes) -> float:
        """Return how long before its end a transaction takes effect, s."""

    @abstractmethod
    def _take(self, out: bytes) -> object:
        """Take what is sent; where that was earlier, its answer is dropped."""


@contextmanager
def at_time(clock: Clock, now_ns: int) -> Iterator[None]:
    """Set the clock to another session time, in nanoseconds, for the time of the block."""
    present_ns = clock.now_ns()
    clock.seek(now_ns)
    try:
        yield
    finally:
        clock.seek(present_ns)
