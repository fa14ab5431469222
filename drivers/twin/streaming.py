"""A virtual device that streams messages on a serial line."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.truth import Truth

SILENCE = 5.0
"""Timeout of a virtual line, s."""


class StreamingTwin:
    """Sends message number n at ``n * period``.

    The answer depends on the time alone: the next message that begins. A message that was not read at once is lost.

    Parameters
    ----------
    truth : Truth
        Its faults ``unplugged`` and ``silent`` affect the line.
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
        self._truth = truth
        self._clock = clock
        self._message = message
        self._period_ns = round(period * 1e9)
        self._byte_ns = round(10e9 / baudrate)

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Wait for the next message; see :class:`~tiltcal.drivers.bus.link.Link`."""
        answer_in_line(self._truth, self._clock, silent=count > 0)
        if not count:
            return b""
        now_ns = self._clock.now_ns()
        number = -(-now_ns // self._period_ns)
        arrived = self._message(number)[:count]
        self._clock.sleep((number * self._period_ns + len(arrived) * self._byte_ns - now_ns) / 1e9)
        return arrived

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


def answer_in_line(truth: Truth, clock: Clock, *, silent: bool = True) -> None:
    """Raise the faults of the line that the truth sets now.

    Raises
    ------
    BusError
        The virtual sensor is unplugged, or sends nothing while ``silent`` is set.
    """
    fault = truth.fault(clock.now_ns() / 1e9)
    if fault is not None and fault.kind == "unplugged":
        raise BusError("the virtual sensor is unplugged, a fault that its truth sets: resume the session later")
    if fault is not None and fault.kind == "silent" and silent:
        clock.sleep(SILENCE)
        raise BusError(f"the virtual sensor was silent for {SILENCE:g} s, a fault that its truth sets")
