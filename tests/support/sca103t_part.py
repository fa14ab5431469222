"""A virtual SCA103T or SCA61T, written from the fact sheet for the tests alone.

Modelled: the 8-bit commands RDAX, RWTR and, of an SCA103T, RDAY and MEAS; 11-bit words with chance below and before
them; registers that are not fresh sooner than 150 µs after a frame; two elements on one axis that look opposite ways;
the parity fault. Any other command is counted as ``forbidden``.
"""

from __future__ import annotations

from support.held_part import HeldPart


class Sca103tPart(HeldPart):
    """The part; see :class:`support.held_part.HeldPart`.

    Parameters
    ----------
    counts_per_g : float
        Of the difference of the elements, or of the only one.
    elements : int
    common : float
        What both elements read too much, count.
    """

    def __init__(self, counts_per_g: float, elements: int, common: float, **held: object) -> None:
        super().__init__(**held)
        self.counts_per_g = counts_per_g
        self.elements = elements
        self.common = common
        self.last_end_ns = -150_000
        self.words = [0, 0]

    def transfer(self, out: bytes, start_ns: int, end_ns: int) -> bytes:
        """Answer one frame."""
        if start_ns - self.last_end_ns >= 150_000:
            self.words = self.converted(start_ns)
        self.last_end_ns = end_ns
        chance = bytes(self.chance.randrange(256) for _ in range(3))
        if (out[0], len(out)) == (0x08, 2):
            return bytes([chance[0], round(197 - 1.083 * self.temperature)])
        if len(out) == 3 and out[0] in (0x10, 0x11)[: self.elements]:
            bits = self.words[out[0] - 0x10] * 32 + chance[2] % 32
            return chance[:1] + bits.to_bytes(2, "big")
        if out == b"\x00" and self.elements == 2:
            return chance[:1]
        self.counts["forbidden"] += 1
        return b"\xff" * len(out)

    def converted(self, now_ns: int) -> list[int]:
        """Both words."""
        if self.broken:
            return [self.chance.randrange(102), self.chance.randrange(102)]
        (value,) = self.measured(now_ns)
        counts = value * self.counts_per_g
        pair = [counts] if self.elements == 1 else [counts / 2 + self.common, -counts / 2 + self.common]
        return [max(0, min(2047, round(1024 + one))) for one in pair]
