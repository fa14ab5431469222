"""A bus that expects these transactions in this order, and notes when each of them came."""

from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.errors import BusError


class Script:
    """A link for a driver under test, by its letter, with lines of ``out / in`` in hexadecimal.

    ``xx`` stands for a byte that means nothing, ``unplugged`` for a failure, and ``09 +6 / in`` on I2C writes 09 and
    reads six bytes.
    """

    def __init__(self, letter: str, clock: VirtualClock, *lines: str) -> None:
        self.letter = letter
        self._clock = clock
        self._lines = [line.replace("xx", "3d").split("/") for line in lines]
        self.times: list[float] = []

    @property
    def rests(self) -> list[float]:
        """Seconds before each transaction since the one before, or since the clock's start."""
        return [time - before for before, time in zip([0.0, *self.times], self.times, strict=False)]

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self.times.append(self._clock.now_ns() / 1e9)
        assert self._lines, f"the driver sends {out.hex(' ')} where nothing is expected"
        expected, answer = self._lines.pop(0)
        written, _, length = expected.partition("+")
        assert out.hex(" ") == bytes.fromhex(written).hex(" ")
        assert count == int(length or count)
        if answer.strip() == "unplugged":
            raise BusError("unplugged")
        returned = bytes.fromhex(answer)
        if not length and self.letter == "i" and len(returned) != 1:
            assert count == len(returned)
        return returned

    def close(self) -> None:
        assert not self._lines, f"the driver never sent {self._lines}"
