"""A virtual SCA100T, written from the datasheet for the tests alone.

It shares no line with the drivers or their twins, so that a misreading in one does not hide in the other. It runs under
the system's Python and needs the standard library only.

Modelled: the commands MEAS, RDAX, RDAY and RWTR; 11-bit words with random filler in the command's slot and behind the
last bit; registers that are not fresh sooner than 150 µs after the end of a frame; offset, a sensitivity matrix with
cross-axis terms up to z, a linear temperature coefficient of each offset, Gaussian noise of each conversion, rounding
and clipping; a thermometer by the datasheet's line; a jig that misses each position by a random small rotation.

Not modelled: self-test, nonlinearity, bandwidth, start-up, the parity fault by itself (set ``broken`` for it).
"""

from __future__ import annotations

from support.held_part import Held

REFRESH_NS = 150_000


class Sca100tPart(Held):
    """The part, and the jig that holds it.

    Parameters
    ----------
    offset : list of float
        X and Y word at 0 g and 24 °C, count.
    sensitivity : list of list of float
        A row for X and one for Y, with columns x, y, z, count/g.
    drift : list of float
        Of each offset, count/°C.
    noise : float
        Standard deviation of a conversion, count.
    jig : float
        Standard deviation of each of the three angles by which a position is missed, degrees.
    seed : int
    """

    def __init__(
        self,
        offset: list[float],
        sensitivity: list[list[float]],
        drift: list[float],
        noise: float,
        jig: float,
        seed: int,
    ) -> None:
        super().__init__(jig, seed)
        self.offset = offset
        self.sensitivity = sensitivity
        self.drift = drift
        self.noise = noise
        self.last_end_ns: int | None = None
        self.words = [0, 0]

    def transfer(self, out: bytes, start_ns: int, end_ns: int) -> bytes:
        """Answer one frame, chip select low from ``start_ns`` to ``end_ns``."""
        if self.last_end_ns is None or start_ns - self.last_end_ns >= REFRESH_NS:
            self.words = [self.convert(0), self.convert(1)]
        self.last_end_ns = end_ns
        bits = 8 * len(out)
        answer = self.slot(out[0]) if out else ""
        answer += "".join(self.chance.choice("01") for _ in range(bits))
        return int(answer[:bits] or "0", 2).to_bytes(len(out), "big")

    def convert(self, channel: int) -> int:
        """The word of a channel now."""
        if self.broken:
            return self.chance.randrange(0, 102)
        value = self.offset[channel] + self.drift[channel] * (self.temperature - 24.0)
        for sensitivity, g in zip(self.sensitivity[channel], self.gravity):  # noqa: B905
            value += sensitivity * g
        return max(0, min(2047, round(self.chance.gauss(value, self.noise))))

    def slot(self, command: int) -> str:
        """The bits that the part drives after the first falling edge; what follows them is left to chance."""
        unknown = "".join(self.chance.choice("01") for _ in range(8))
        if command == 0b0001_0000:
            return unknown + format(self.words[0], "011b")
        if command == 0b0001_0001:
            return unknown + format(self.words[1], "011b")
        if command == 0b0000_1000:
            return unknown + format(max(0, min(255, round(197 - 1.083 * self.temperature))), "08b")
        if command == 0b0000_0000:
            return unknown
        return "1" * 64
