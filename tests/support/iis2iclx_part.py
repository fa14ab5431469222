"""A virtual IIS2ICLX, written from the fact sheet for the tests alone, on SPI and on I2C.

Modelled: WHO_AM_I, power-down after a reset, ranges and rates, the new-sample bit that reading clears, bytes of
two samples unless BDU holds them, three unsettled samples after power-down, samples that are no measurement without
DEVICE_CONF, the thermometer. On I2C a register pointer that the first written byte sets.

Counted as ``forbidden``: a write to any register but CTRL1_XL, CTRL3_C and CTRL9_XL, bits that the data sheet wants to
be 0, reserved rates, reading z, and a transaction within 15 ms of a reset.
"""

from __future__ import annotations

from support.held_part import HeldPart

RATES = (0, 12.5, 26, 52, 104, 208, 416, 833)
MG_PER_LSB = (0.015, 0.122, 0.031, 0.061)


class Iis2iclxPart(HeldPart):
    """The part; see :class:`support.held_part.HeldPart`."""

    def __init__(self, **held: object) -> None:
        super().__init__(**held)
        self.counts.update(resets=0)
        self.pointer = 0
        self.now_ns = 0
        self.reset_ns = -20_000_000
        self.restart()

    def restart(self) -> None:
        """Lose the supply for a moment, or be reset."""
        self.counts["resets"] += 1
        self.control = {0x10: 0x00, 0x12: 0x04, 0x18: 0xE0}
        self.seen = self.began = -1

    def transfer(self, out: bytes, start_ns: int, end_ns: int) -> bytes:
        """Answer one SPI frame; the byte under the command is left to chance."""
        unknown = bytes([self.chance.randrange(256)])
        if out[0] < 128:
            self.write(out[0], out[1:], start_ns)
            return unknown + bytes(len(out) - 1)
        return unknown + self.read(out[0] - 128, len(out) - 1, start_ns)

    def message(self, out: bytes, count: int, now_ns: int) -> bytes:
        """Answer one I2C message: a write sets the pointer and registers, a read begins at the pointer."""
        if out:
            self.pointer = out[0]
            if len(out) > 1:
                self.write(out[0], out[1:], now_ns)
        return self.read(self.pointer, count, now_ns) if count else b""

    def listen(self, now_ns: int) -> None:
        self.now_ns = now_ns
        if now_ns - self.reset_ns < 15_000_000:
            self.counts["forbidden"] += 1

    def write(self, register: int, values: bytes, now_ns: int) -> None:
        self.listen(now_ns)
        value = values[0]
        allowed = {0x10: value < 0x80 and value % 2 == 0, 0x12: value & 0b10 == 0, 0x18: value & 1 == 0}
        if len(values) != 1 or not allowed.get(register, False):
            self.counts["forbidden"] += 1
        elif register == 0x12 and value & 1:
            self.restart()
            self.reset_ns = now_ns
        else:
            self.control[register] = value
            if register == 0x10:
                self.seen = self.began = self.sample_number()

    def rate(self) -> float:
        return RATES[self.control[0x10] >> 4]

    def sample_number(self) -> int:
        return int(self.now_ns / 1e9 * self.rate())

    def read(self, register: int, count: int, now_ns: int) -> bytes:
        """Registers from ``register`` up, as long as IF_INC has it so."""
        self.listen(now_ns)
        held = {0x0F: 0x6B, **self.control}
        if self.rate():
            number = self.sample_number()
            held[0x1E] = 1 if number > self.seen else 0
            if register <= 0x2B and register + count > 0x28:
                self.seen = number
            raw = round((self.temperature - 25) * 256) % 65536
            held[0x20], held[0x21] = raw % 256, raw // 256
            lsb = MG_PER_LSB[self.control[0x10] >> 2 & 3] / 1000
            for axis, value in enumerate(self.measured(int(number / self.rate() * 1e9))):
                bits = max(-32768, min(32767, round(value / lsb))) % 65536
                if number - self.began <= 3 or not self.control[0x18] & 2:
                    bits = self.chance.randrange(65536)
                held[0x28 + 2 * axis], held[0x29 + 2 * axis] = bits % 256, bits // 256
                if not self.control[0x12] & 0x40:
                    held[0x28 + 2 * axis] = self.chance.randrange(256)
        if any(0x2C <= one <= 0x34 for one in range(register, register + count)):
            self.counts["forbidden"] += 1
        return bytes(held.get(one, 0) for one in range(register, register + count))
