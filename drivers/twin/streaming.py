"""A virtual device that talks by itself on a serial line, message after message, as time goes by."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.truth import Truth

SILENCE = 5.0
"""Seconds of silence after which a virtual line gives up."""


class StreamingTwin:
    """Says message number n from ``n * period`` on.

    What an exchange returns depends on the time alone: the next message that begins. What was said while nobody
    listened is gone.

    Parameters
    ----------
    truth : Truth
        Its faults: ``unplugged`` and ``silent`` are the line's.
    clock : Clock
        Goes on to the arrival of the last byte that is returned.
    message : callable
        ``message(number)`` returns what is said, shorter in time than the period.
    period : float
        Seconds.
    baudrate : int
        Of ten bits to the byte.
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
        """Nothing to release."""


def answer_in_line(truth: Truth, clock: Clock, *, silent: bool = True) -> None:
    """Let the faults of the line happen that the truth asks for now.

    Raises
    ------
    BusError
        The virtual sensor is unplugged, or, where ``silent`` matters, says nothing.
    """
    fault = truth.fault(clock.now_ns() / 1e9)
    if fault is not None and fault.kind == "unplugged":
        raise BusError("the virtual sensor is unplugged, a fault that its truth asks for: resume the session later")
    if fault is not None and fault.kind == "silent" and silent:
        clock.sleep(SILENCE)
        raise BusError(f"the virtual sensor was silent for {SILENCE:g} s, a fault that its truth asks for")
