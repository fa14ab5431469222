"""The interface of every bus to a driver: bytes out, bytes in."""

from __future__ import annotations

from typing import Protocol

from tiltcal.errors import BusError


class CaptureEnded(BusError):
    """A capture has no further edges; its link stays open, because opened anew it would start at the first edge."""


class Link(Protocol):
    """One opened connection to one device.

    Every bus fits one method, so recording and replaying a session takes one class and not one per bus.
    """

    letter: str
    """The bus in a journal line: ``s`` SPI, ``i`` I2C, ``r`` serial, ``e`` edges, ``m`` Modbus, ``n`` a value by
    its name."""

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Carry out one bus transaction; one that failed is a BusError with the cause and what to try.

        out: SPI: the frame shifted out while chip select is low. I2C: the bytes written, may be empty. Serial: the
            bytes sent, may be empty.
        count: I2C: bytes to read after a repeated start. Serial and edges: the largest number of bytes to take, waiting
            for the first; with 0 and nothing to send, what has arrived is discarded. SPI: unused, a frame reads as many
            bytes as it writes.

        Returns the answer; of serial lines and edges at least one byte or record where ``count`` is not 0.
        """
        ...

    def close(self) -> None:
        """Release the bus; closing twice is allowed."""
        ...


def require_length(answer: bytes, length: int, what: str = "transaction") -> bytes:
    """Return an answer that is as long as its transaction; another length is a BusError."""
    if len(answer) != length:
        raise BusError(f"a {what} of {length} bytes was answered with {len(answer)}: the adapter is at fault")
    return answer


def check_data_line(answers: bytes, what: str = "sample") -> None:
    """Raise a BusError for a sample with equal bits: at rest at least one channel measures gravity."""
    for level, place, byte in (("high", "chip select", 0xFF), ("low", "ground", 0x00)):
        if set(answers) == {byte}:
            raise BusError(
                f"the data line is stuck {level} (every bit of the {what} is {byte & 1}): check the data line (MISO or "
                f"SDA), {place} and the sensor's supply"
            )
