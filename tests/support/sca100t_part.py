"""A virtual SCA100T, written from the datasheet for the tests alone: see :mod:`support.held_part`.

Modelled: the commands MEAS, RDAX, RDAY and RWTR; 11-bit words with random filler in the command's slot and behind the
last bit; registers that are not fresh sooner than 150 µs after the end of a frame; offset, a sensitivity matrix with
cross-axis terms up to z, a linear temperature coefficient of each offset, Gaussian noise of each conversion, rounding
and clipping; a thermometer by the datasheet's line; a jig that misses each position by a random small rotation.

Not modelled: self-test, nonlinearity, bandwidth, start-up, the parity fault by itself (set ``broken`` for it).
"""

from dataclasses import dataclass

from support.held_part import Held, Row

REFRESH_NS = 150_000


@dataclass(kw_only=True)
class Sca100tPart(Held):
    """The part, and the jig that holds it; ``drift`` is that of each offset, count/°C."""

    offset: Row = (1026.3, 1020.8)
    sensitivity: tuple[Row, ...] = ((817.4, 11.2, -3.5), (-7.9, 821.6, 5.1))
    drift: Row = (0.21, -0.05)
    noise: float = 0.6

    def __post_init__(self) -> None:
        super().__post_init__()
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
        value = self.reading(channel) + self.drift[channel] * (self.temperature - 24.0)
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
