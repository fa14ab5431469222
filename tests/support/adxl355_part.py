"""A virtual ADXL355, written from the fact sheet for the tests alone, on SPI and on I2C.

Modelled: identity, STATUS that reading clears, thermometer, 20-bit words, ranges and rates, standby after a reset in
which nothing is measured, the trim's shadow registers, a reset that fails to load them once, the clock's tolerance. On
I2C a register pointer that the first written byte sets.

Counted as ``forbidden``: a write to any register but FILTER, RANGE, POWER and RESET, or of a setting outside standby, a
high-pass filter, and a transaction within 5 ms of a reset.
"""

from __future__ import annotations

from support.held_part import HeldPart

LSB_PER_G = {1: 256000, 2: 128000, 3: 64000}


class Adxl355Part(HeldPart):
    """The part; see :class:`support.held_part.HeldPart`.

    Parameters
    ----------
    clock : float
        Its rate, relative to nominal.
    races : int
        Resets that leave the trim unloaded.
    """

    def __init__(self, clock: float, races: int, **held: object) -> None:
        super().__init__(**held)
        self.clock = clock
        self.races = races
        self.counts.update(resets=0)
        self.pointer = 0
        self.now_ns = self.reset_ns = 0
        self.reset_ns = -10_000_000
        self.restart()

    def restart(self) -> None:
        """Lose the supply for a moment, or be reset."""
        self.counts["resets"] += 1
        self.filter, self.range, self.power = 0, 0x81, 0x01
        self.seen = -1
        self.trim = [0x11, 0xA0, 0x3C, 0x5B, 0xE7]

    def transfer(self, out: bytes, start_ns: int, end_ns: int) -> bytes:
        """Answer one SPI frame; the byte under the command is left to chance."""
        unknown = bytes([self.chance.randrange(256)])
        if out[0] % 2 == 0:
            self.write(out[0] // 2, out[1:], start_ns)
            return unknown + bytes(len(out) - 1)
        return unknown + self.read(out[0] // 2, len(out) - 1, start_ns)

    def message(self, out: bytes, count: int, now_ns: int) -> bytes:
        """Answer one I2C message: a write sets the pointer and registers, a read begins at the pointer."""
        if out:
            self.pointer = out[0]
            if len(out) > 1:
                self.write(out[0], out[1:], now_ns)
        return self.read(self.pointer, count, now_ns) if count else b""

    def write(self, register: int, values: bytes, now_ns: int) -> None:
        self.listen(now_ns)
        standby = self.power % 2 == 1
        if len(values) != 1:
            self.counts["forbidden"] += 1
        elif register == 0x2F and values[0] == 0x52:
            self.restart()
            self.reset_ns = now_ns
            if self.races > 0:
                self.races -= 1
                self.trim = [0, 0, 0, 0, 0]
        elif register == 0x28 and standby and values[0] <= 10:
            self.filter = values[0]
        elif register == 0x2C and standby and values[0] & 0x83 in (0x81, 0x82, 0x83):
            self.range = values[0]
        elif register == 0x2D:
            self.power = values[0]
            self.seen = self.sample_number()
        else:
            self.counts["forbidden"] += 1

    def listen(self, now_ns: int) -> None:
        self.now_ns = now_ns
        if now_ns - self.reset_ns < 5_000_000:
            self.counts["forbidden"] += 1

    def sample_number(self) -> int:
        return int(self.now_ns * 4e-6 * self.clock / 2**self.filter)

    def read(self, register: int, count: int, now_ns: int) -> bytes:
        """Registers from ``register`` up, of one sample."""
        self.listen(now_ns)
        held = {0: 0xAD, 1: 0x1D, 2: 0xED, 3: 0x01, 0x28: self.filter, 0x2C: self.range, 0x2D: self.power}
        for place, one in enumerate(self.trim):
            held[0x50 + place] = one
        if self.power % 2 == 0:
            number = self.sample_number()
            held[4] = 1 if number > self.seen else 0
            if register <= 4 < register + count:
                self.seen = number
            raw = round(1885 - 9.05 * (self.temperature - 25))
            # What lies above the 12 bits, and below the 20, means nothing.
            held[6], held[7] = raw // 256 + 16 * self.chance.randrange(16), raw % 256
            taken_ns = int(number / (4e-6 * self.clock / 2**self.filter))
            for axis, value in enumerate(self.measured(taken_ns)):
                count_of = max(-524288, min(524287, round(value * LSB_PER_G[self.range % 4])))
                bits = count_of % 2**20 * 16 + self.chance.randrange(16)
                for byte in range(3):
                    held[8 + 3 * axis + byte] = bits >> 16 - 8 * byte & 255
        return bytes(held.get(one, 0) for one in range(register, register + count))
