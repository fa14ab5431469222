"""A virtual SCA3000, written from the fact sheet for the tests alone, on SPI and on I2C: see :mod:`support.held_part`.

Modelled: the command byte (address in bits 7 to 2, bit 1 to write); the register address counting down within one frame
and wrapping from X_LSB to Z_MSB; REVID, STATUS, MODE, the six data registers and, where the part has one, the
thermometer; 13-bit two's complement left-aligned in 16 bits; new words at the output data rate only; offset, a 3 x 3
sensitivity matrix, Gaussian noise of each word, the overflow codes; a jig that misses each position by a random small
rotation. On I2C a register pointer that the first written byte sets.

Not modelled: the ring buffer, motion detection, interrupts, drift with temperature. A write does nothing.
"""

from dataclasses import dataclass

from support.held_part import Held, Row

REVID, STATUS = 0x00, 0x02
X_LSB, Z_MSB = 0x04, 0x09
TEMP_LSB, TEMP_MSB = 0x12, 0x13


@dataclass(kw_only=True)
class Sca3000Part(Held):
    """The part, and the jig that holds it; ``rate`` is that of its words, Hz."""

    offset: Row = (31.4, -18.7, 44.2)
    sensitivity: tuple[Row, ...] = ((1341.2, 9.6, -14.3), (-7.1, 1322.5, 11.8), (5.9, -12.4, 1338.7))
    noise: float = 1.5
    rate: float = 250.0
    thermometer: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self.pointer = 0
        self.slot = -1
        self.words = [0, 0, 0]

    def pose(self, gravity: list[float], temperature: float | None) -> None:
        """Lie as asked, and take new words."""
        super().pose(gravity, temperature)
        self.slot = -1

    def transfer(self, out: bytes, start_ns: int, end_ns: int) -> bytes:
        """Answer one SPI frame; the byte under the command is left to chance."""
        if not out:
            return b""
        unknown = bytes([self.chance.randrange(256)])
        if out[0] & 0b11:
            return unknown + bytes(len(out) - 1)
        return unknown + self.burst(out[0] >> 2, len(out) - 1, start_ns)

    def message(self, out: bytes, count: int, now_ns: int) -> bytes:
        """Answer one I2C message: a write sets the pointer, a read begins at it."""
        if out:
            self.pointer = out[0]
        return self.burst(self.pointer, count, now_ns) if count else b""

    def burst(self, address: int, count: int, now_ns: int) -> bytes:
        """Registers from ``address`` down."""
        self.renew(now_ns)
        answer = bytearray()
        for _ in range(count):
            answer.append(self.register(address))
            address = Z_MSB if address == X_LSB else (address - 1) % 64
        return bytes(answer)

    def renew(self, now_ns: int) -> None:
        """Take new words where the output data rate has them."""
        slot = now_ns // round(1e9 / self.rate)
        if slot != self.slot:
            self.slot = slot
            self.words = [self.convert(channel) for channel in range(3)]

    def convert(self, channel: int) -> int:
        """The word of a channel now, as 16 bits."""
        count = round(self.chance.gauss(self.reading(channel), self.noise))
        if count >= 3455:
            return 0x6BFF
        if count <= -3456:
            return 0x9400
        return (count * 8) % 65536

    def register(self, address: int) -> int:
        """One byte."""
        if X_LSB <= address <= Z_MSB:
            word = self.words[(address - X_LSB) // 2]
            return word // 256 if address % 2 else word % 256
        if address in (TEMP_LSB, TEMP_MSB) and self.thermometer:
            raw = max(0, min(511, round(256 + 1.8 * (self.temperature - 23))))
            # The two bits above the nine of the thermometer mean nothing.
            return (raw // 8) + 64 * self.chance.randrange(4) if address == TEMP_MSB else raw % 8 * 32
        if address == REVID:
            return 0x21
        if address == STATUS:
            return 0b0000_0010 if self.broken else 0
        return 0
