"""A virtual SCL3300-D01 or SCA3300-D01, written from the fact sheet for the tests alone.

Modelled: 32-bit frames answered one frame late; the CRC of both directions; the return status; the flags of STATUS that
reading clears one frame after the other; banks, of which bank 1 has neither mode, reset nor WHOAMI; a power-down that
only the frame of mode 1 ends; the four modes and their settling, before which words are left to chance; the undefined
answers after a reset; words renewed every 0.5 ms behind a first-order filter; the serial number; a line that flips one
bit in some frames, of the request or of the answer.

A frame that the data sheet does not list, or that comes too soon after a reset, is counted as ``forbidden``. What the
part answers to a request with a wrong CRC is not known, so all but its return status is left to chance.
"""

from __future__ import annotations

from support.held_part import HeldPart

ALLOWED = frozenset(
    {
        *("040000F7", "080000FD", "0C0000FB", "100000E9", "140000EF", "180000E5", "1C0000E3", "200000C1"),
        *("240000C7", "280000CD", "2C0000CB", "340000DF", "40000091", "B400001F", "B4000102", "B4000225"),
        *("B4000338", "B400046B", "B4002098", "B0001F6F", "640000A7", "680000AD", "7C0000B3", "FC000073", "FC00016E"),
    }
)
"""Every frame that the data sheet lists."""

SETTLING = {0xC1: (0.025, 0.015, 0.100, 0.100), 0x51: (0.015, 0.015, 0.015, 0.100)}
SCALES = {0xC1: (6000, 3000, 12000, 12000), 0x51: (2700, 1350, 5400, 5400)}


def sealed(head: int) -> bytes:
    """24 bits with their CRC: polynomial 0x1D, start 0xFF, inverted, by division of the whole."""
    register = 0xFF
    for place in range(23, -1, -1):
        out = (register >> 7) ^ (head >> place & 1)
        register = (register * 2) % 256
        if out:
            register ^= 0x1D
    return (head * 256 + (255 - register)).to_bytes(4, "big")


class Scl3300Part(HeldPart):
    """The part; see :class:`support.held_part.HeldPart`.

    Parameters
    ----------
    identity : int
        0xC1 for the SCL3300, 0x51 for the SCA3300.
    serial : int
    damage : float
        Share of the frames in which one bit is flipped.
    """

    def __init__(self, identity: int, serial: int, damage: float, **held: object) -> None:
        super().__init__(**held)
        self.identity = identity
        self.serial = serial
        self.damage = damage
        self.counts.update(requests_damaged=0, answers_damaged=0, resets=0)
        self.now_ns = 0
        self.restart()

    def restart(self) -> None:
        """Lose the supply for a moment, or be reset."""
        self.counts["resets"] += 1
        self.mode, self.bank, self.asleep = 0, 0, False
        self.error, self.status = 0x10, 0x10
        self.ready_ns = self.now_ns + 1_000_000
        self.settled_ns = self.now_ns + 25_000_000
        self.answer = self.undefined()

    def undefined(self) -> bytes:
        return bytes(self.chance.randrange(256) for _ in range(4))

    def transfer(self, out: bytes, start_ns: int, end_ns: int) -> bytes:
        """Answer the frame before this one."""
        self.now_ns = start_ns
        if out.hex().upper() not in ALLOWED:
            self.counts["forbidden"] += 1
        if self.asleep:
            self.asleep = out.hex() != "b400001f"
            return bytes(4)
        request = int.from_bytes(out, "big")
        answer = int.from_bytes(self.answer, "big")
        if self.chance.random() < self.damage:
            place = self.chance.randrange(64)
            if place < 32:
                request ^= 1 << place
                self.counts["requests_damaged"] += 1
            else:
                answer ^= 1 << place - 32
                self.counts["answers_damaged"] += 1
        self.answer = self.carried_out(request)
        return answer.to_bytes(4, "big")

    def carried_out(self, request: int) -> bytes:
        """The answer to a request, which is sent with the next frame."""
        operation, data = request >> 26, request >> 8 & 0xFFFF
        if sealed(request >> 8) != request.to_bytes(4, "big"):
            return sealed(operation << 18 | 0b11 << 16 | self.chance.randrange(65536))
        if request == 0xB4002098 and self.bank == 0:
            self.restart()
            self.ready_ns = self.now_ns + 3_000_000
            return self.answer
        if self.now_ns < self.ready_ns:
            self.counts["forbidden"] += 1
            return self.undefined()
        if self.bank and (operation == 0b101101 or operation == 0b010000):
            return sealed(operation << 18 | 0b11 << 16)
        return_status = 0b11 if self.error or self.broken else 0b01
        if operation == 0b101101:
            self.mode = data
            self.error |= 2
            self.status |= 2
            self.settled_ns = self.now_ns + round(1e9 * SETTLING[self.identity][data])
            return_status = 0b11
        elif operation == 0b111111:
            self.bank = data
        elif not operation & 0b100000:
            data = self.register(operation)
        return sealed(operation << 18 | return_status << 16 | data)

    def register(self, address: int) -> int:
        if address in (1, 2, 3):
            if self.now_ns < self.settled_ns:
                return self.chance.randrange(65536)
            renewed = self.now_ns // 500_000 * 500_000
            value = self.measured(renewed)[address - 1] * SCALES[self.identity][self.mode]
            return max(-32768, min(32767, round(value))) % 65536
        if address == 5:
            return round((273 + self.temperature) * 18.9) % 65536
        if address == 6:
            told = self.status | (8 if self.broken else 0)
            self.status, self.error = self.error, 0
            return told
        if address == 16:
            return self.identity
        if address in (25, 26) and self.bank == 1:
            return self.serial >> 16 if address == 26 else self.serial % 65536
        return 0
