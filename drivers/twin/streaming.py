"""Virtual devices on a line, and those that stream messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from tiltcal.drivers.twin.link import TwinLink
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.truth import Truth

SILENCE = 5.0
"""Timeout of a virtual line, s."""


class LineTwin(TwinLink):
    """A virtual device on a line of its own: serial, or captured edge by edge.

    Parameters
    ----------
    truth : Truth
        Its faults ``unplugged`` and ``silent`` affect the line.
    """

    def __init__(self, truth: Truth, clock: Clock) -> None:
        super().__init__(clock)
        self._truth = truth

    def _require_line(self, *, silent: bool = True) -> None:
        """Raise the faults of the line that the truth sets now.

        BusError: the virtual sensor is unplugged, or sends nothing while ``silent`` is set.
        """
        if self._truth.fault_on_link(self._clock.now_ns()).kind == "silent" and silent:
            self._clock.sleep(SILENCE)
            raise BusError(f"the virtual sensor was silent for {SILENCE:g} s, a fault that its truth sets")


class StreamingTwin(LineTwin):
    """Sends message number n at ``n * period``.

    The answer depends on the time alone: the next message that begins. A message that was not read at once is lost.

    Parameters
    ----------
    clock : Clock
        Advances to the arrival of the last returned byte.
    message : callable
        ``message(number)`` returns the bytes; they take less time than the period.
    period : float
        Seconds.
    baudrate : int
        With ten bits per byte.
    """

    letter = "r"

    def __init__(
        self, truth: Truth, clock: Clock, message: Callable[[int], bytes], *, period: float, baudrate: int
    ) -> None:
        super().__init__(truth, clock)
        self._message = message
        self._period_ns = round(period * 1e9)
        self._byte_ns = round(10e9 / baudrate)

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Wait for the next message; see :class:`~tiltcal.drivers.bus.link.Link`."""
        self._require_line(silent=count > 0)
        if not count:
            return b""
        now_ns = self._clock.now_ns()
        number = -(-now_ns // self._period_ns)
        arrived = self._message(number)[:count]
        self._clock.sleep((number * self._period_ns + len(arrived) * self._byte_ns - now_ns) / 1e9)
        return arrived
