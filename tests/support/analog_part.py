"""A virtual analog SCA100T at an ADS1115 or an MCP3208, written from the fact sheet for the tests alone.

It shares no line with the drivers or their twins, so that a misreading in one does not hide in the other. It runs under
the system's Python and needs the standard library only.

Modelled: two ratiometric outputs, X at input 0 and Y at input 1, and the supply at input 2; a supply that wanders about
its mean; offset and a sensitivity matrix with cross-axis terms; Gaussian noise; a jig that misses each position by a
random small rotation. ADS1115: pointer, config and conversion registers, single-shot conversions of single-ended
inputs that take their time by the monotonic clock, a busy flag, all full scales. MCP3208: the command found by its
start bit anywhere in the frame, a null bit, 12 bits, chance wherever the part does not drive the line; its reference
pin is tied to the supply.

Not modelled: differential inputs, continuous conversion, the comparator, drift with temperature.
"""

from __future__ import annotations

import time
from math import pi, sin

from support.held_part import Held

FULL_SCALES = {0b000: 6.144, 0b001: 4.096, 0b010: 2.048, 0b011: 1.024, 0b100: 0.512, 0b101: 0.256}
RATES = {0b000: 8, 0b001: 16, 0b010: 32, 0b011: 64, 0b100: 128, 0b101: 250, 0b110: 475, 0b111: 860}


class AnalogSca100t(Held):
    """The sensor, its supply, and the jig that holds it.

    Parameters
    ----------
    offset : list of float
        Output of X and Y at 0 g and a supply of 5 V, V.
    sensitivity : list of list of float
        A row for X and one for Y, with columns x, y, z, V/g at a supply of 5 V.
    supply : float
        Mean of the supply, V.
    wander : float
        By which the supply wanders to either side, once in three seconds, V.
    noise : float
        Standard deviation of an output, V.
    jig : float
        Standard deviation of each of the three angles by which a position is missed, degrees.
    seed : int
    """

    def __init__(
        self,
        offset: list[float],
        sensitivity: list[list[float]],
        supply: float,
        wander: float,
        noise: float,
        jig: float,
        seed: int,
    ) -> None:
        super().__init__(jig, seed)
        self.offset = offset
        self.sensitivity = sensitivity
        self.mean_supply = supply
        self.wander = wander
        self.noise = noise

    def vdd(self) -> float:
        """The supply now, V."""
        return self.mean_supply + self.wander * sin(2.0 * pi * time.monotonic() / 3.0)

    def terminal(self, number: int) -> float:
        """What is at an input of the converter now, V."""
        if number == 2:
            return self.vdd()
        if number > 2:
            return 0.0
        if self.broken:
            return self.chance.uniform(0.0, 0.2)
        at_five = self.offset[number]
        for sensitivity, g in zip(self.sensitivity[number], self.gravity):  # noqa: B905
            at_five += sensitivity * g
        return at_five / 5.0 * self.vdd() + self.chance.gauss(0.0, self.noise)


class Ads1115Part(AnalogSca100t):
    """The sensor at an ADS1115."""

    pointer = 0
    config = 0x0583
    result = 0
    done_ns = 0

    def message(self, out: bytes, count: int, start_ns: int) -> bytes:
        """Answer one message of a transaction."""
        if out:
            self.pointer = out[0]
        if len(out) == 3 and self.pointer == 1:
            self.configure(out[1] * 256 + out[2], start_ns)
        if not count:
            return b""
        busy = start_ns < self.done_ns
        register = {0: self.result & 0xFFFF, 1: self.config + (0 if busy else 0x8000)}[self.pointer]
        return register.to_bytes(2, "big")[:count]

    def configure(self, word: int, now_ns: int) -> None:
        """Take a config word, and start the conversion that it may ask for."""
        bits = format(word, "016b")
        self.config = word & 0x7FFF
        if bits[0] == "0" or now_ns < self.done_ns:
            return
        if bits[1] != "1" or bits[7] != "1":
            raise ValueError(f"only single shots of single inputs are modelled, not {bits}")
        volts = self.terminal(int(bits[2:4], 2))
        steps = volts * 32768 / FULL_SCALES[int(bits[4:7], 2)]
        self.result = max(-32768, min(32767, round(steps)))
        # A part whose clock is 8 % slow.
        self.done_ns = now_ns + round(1.08e9 / RATES[int(bits[8:11], 2)])


class Mcp3208Part(AnalogSca100t):
    """The sensor at an MCP3208 whose reference pin is the sensor's supply."""

    def transfer(self, out: bytes, start_ns: int, end_ns: int) -> bytes:
        """Answer one frame, chip select low throughout."""
        sent = "".join(format(byte, "08b") for byte in out)
        back = [self.chance.choice("01") for _ in sent]
        start = sent.find("1")
        if start >= 0 and sent[start + 1 : start + 2] == "1":
            number = int(sent[start + 2 : start + 5], 2)
            code = max(0, min(4095, round(4096 * self.terminal(number) / self.vdd())))
            for place, bit in enumerate("0" + format(code, "012b"), start=start + 6):
                back[place] = bit
        return int("".join(back), 2).to_bytes(len(out), "big")
