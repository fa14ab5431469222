"""A bus that expects these transactions in this order, and notes when each of them came."""

from __future__ import annotations

from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.errors import BusError


class Script:
    """A link for a driver under test.

    Parameters
    ----------
    letter : str
    clock : VirtualClock
    *lines : str
        ``out / in`` in hexadecimal; ``xx`` stands for a byte that means nothing, ``unplugged`` for a failure.
    """

    def __init__(self, letter: str, clock: VirtualClock, *lines: str) -> None:
        self.letter = letter
        self._clock = clock
        self._lines = [line.replace("xx", "3d").split("/") for line in lines]
        self.times: list[float] = []

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self.times.append(self._clock.now_ns() / 1e9)
        assert self._lines, f"the driver sends {out.hex(' ')} where nothing is expected"
        expected, answer = self._lines.pop(0)
        assert out.hex(" ") == bytes.fromhex(expected).hex(" ")
        if answer.strip() == "unplugged":
            raise BusError("unplugged")
        returned = bytes.fromhex(answer)
        if self.letter == "i" and len(returned) != 1:
            assert count == len(returned)
        return returned

    def close(self) -> None:
        assert not self._lines, f"the driver never sent {self._lines}"
