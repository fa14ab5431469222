"""Frames of the SCL3300-D01 and SCA3300-D01: requests, answers, checksum, and the bits of STATUS.

A frame has 32 bits, most significant first::

    bit  31     30-26    25-24          23-8    7-0
         write  address  return status  data    CRC-8 of the 24 bits above: x⁸+x⁴+x³+x²+1, start 0xFF, inverted

Source: SCA3300-D01 data sheet, Murata doc. 3165 Rev. 3.
"""

from __future__ import annotations

from typing import NamedTuple

ACC_X, ACC_Y, ACC_Z = (bytes.fromhex(frame) for frame in ("040000F7", "080000FD", "0C0000FB"))
TEMPERATURE, STATUS, WHOAMI = (bytes.fromhex(frame) for frame in ("140000EF", "180000E5", "40000091"))
SERIAL1, SERIAL2 = bytes.fromhex("640000A7"), bytes.fromhex("680000AD")
BANK_0, BANK_1 = bytes.fromhex("FC000073"), bytes.fromhex("FC00016E")
RESET = bytes.fromhex("B4002098")
MODES = tuple(bytes.fromhex(frame) for frame in ("B400001F", "B4000102", "B4000225", "B4000338"))
"""Set Murata's mode 1, 2, 3, 4."""
WAKE_UP = MODES[0]
"""The only frame that a part in power-down takes."""

SAMPLE = (ACC_X, ACC_Y, ACC_Z, TEMPERATURE)

NORMAL, ERROR = 0b01, 0b11
"""Return status; 0b00 is a part that starts up, 0b10 is reserved."""

FLAGS = {
    0x200: "digital block (DIGI1)",
    0x100: "digital block (DIGI2)",
    0x080: "clock (CLK)",
    0x040: "signal path saturated (SAT)",
    0x020: "temperature path saturated (TEMP_SAT)",
    0x010: "supply (PWR)",
    0x008: "memory (MEM)",
    0x004: "power-down (PD)",
    0x002: "mode change (MODE_CHANGE)",
    0x001: "internal connection (PIN_CONTINUITY)",
}
"""Bits of STATUS in words."""

SATURATED = 0x040 | 0x020
RESTARTED = 0x010 | 0x004 | 0x002
"""Flags of a part that was reset, switched off or put into another mode since it was set up."""


class Answer(NamedTuple):
    """One decoded answer frame.

    operation: of the request that it answers: write and address, 6 bits.
    status: return status.
    data: 16 bits.
    intact: whether the CRC fits.
    """

    operation: int
    status: int
    data: int
    intact: bool

    @property
    def signed(self) -> int:
        """The data as two's complement."""
        return self.data - 0x10000 if self.data & 0x8000 else self.data

    def answers(self, request: bytes) -> bool:
        """Return whether it is intact and belongs to this request: it echoes the operation and the written data."""
        unlike = bool(request[0] & 0x80) and self.data != int.from_bytes(request[1:3], "big")
        return self.intact and self.operation == request[0] >> 2 and not unlike


def crc8(head: bytes) -> int:
    """Return the CRC-8 of the first three bytes of a frame."""
    crc = 0xFF
    for byte in head:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x1D if crc & 0x80 else crc << 1) & 0xFF
    return crc ^ 0xFF


def decode(frame: bytes) -> Answer:
    """Decode an answer frame of four bytes."""
    return Answer(frame[0] >> 2, frame[0] & 0b11, frame[1] << 8 | frame[2], crc8(frame[:3]) == frame[3])


def decode_temperature(data: int) -> float:
    """Return the temperature of a 16-bit word in two's complement, °C."""
    return -273.0 + data / 18.9


def flags_in_words(status: int) -> str:
    """Return the flags of a STATUS word as text."""
    return ", ".join(words for bit, words in FLAGS.items() if status & bit)
