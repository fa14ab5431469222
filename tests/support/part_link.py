"""An independent part as a link of a driver under test, on a virtual clock."""

from __future__ import annotations

from tiltcal.drivers.bus.clock import VirtualClock


class PartLink:
    """The part on SPI (``s``) or I2C (``i``), 20 µs to a transaction.

    Attributes
    ----------
    out : list of str
        What the driver has sent, in hexadecimal.
    """

    def __init__(self, part, clock: VirtualClock, letter: str = "s") -> None:
        self.part, self.clock, self.letter = part, clock, letter
        self.out: list[str] = []

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self.clock.sleep(20e-6)
        self.out.append(out.hex(" ").upper())
        now_ns = self.clock.now_ns()
        if self.letter == "s":
            return self.part.transfer(out, now_ns, now_ns)
        return self.part.message(out, count, now_ns)

    def close(self) -> None:
        assert self.part.counts["forbidden"] == 0
