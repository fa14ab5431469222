"""The virtual MCP3208: a link that answers the bits of the part."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.drivers.mcp3208 import CODES, PORT
from tiltcal.drivers.twin.link import TwinLink
from tiltcal.drivers.twin.noise import uniform

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.analog import Wiring

BIT_SECONDS = 1.0 / (PORT.speed or 1_000_000)

COMMAND_BITS = 5
"""Start, single-ended, and three bits of the input's number."""

SAMPLING_BITS = 1
"""Clocks between the command and the null bit."""


class Mcp3208Twin(TwinLink):
    """An MCP3208 on the SPI bus, bit by bit, without state between frames.

    wiring: the voltages at its inputs.
    clock: session time; each frame advances it by its bits at 1 MHz.
    """

    letter = "s"

    def __init__(self, wiring: Wiring, clock: Clock) -> None:
        super().__init__(clock)
        self._wiring = wiring

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one frame; see :class:`~tiltcal.drivers.bus.link.Link`."""
        length = 8 * len(out)
        if self._wiring.silent():
            answer = "1" * length
        else:
            answer = self._answered(f"{int.from_bytes(out, 'big'):0{length}b}" if out else "")
        self._clock.sleep(length * BIT_SECONDS)
        return int(answer or "0", 2).to_bytes(len(out), "big")

    def _answered(self, bits: str) -> str:
        """Return the answer bits; they are random while the part does not drive the line."""
        chance = int(uniform(self._wiring.seed, "filler", self._clock.now_ns()) * 2**48)
        floating = f"{chance:048b}" * (len(bits) // 48 + 1)
        start = bits.find("1")
        command = bits[start : start + COMMAND_BITS]
        if start < 0 or len(command) < COMMAND_BITS or command[1] == "0":
            return floating[: len(bits)]
        result = f"{self._code(int(command[2:], 2)):012b}"
        # With more clocks the part sends its result again, the last bit first, and then zeros.
        driven = f"0{result}{result[-2::-1]}"
        behind = start + COMMAND_BITS + SAMPLING_BITS
        return (floating[:behind] + driven).ljust(len(bits), "0")[: len(bits)]

    def _code(self, number: int) -> int:
        code = round(self._wiring.volts(number) / self._wiring.reference * CODES)
        return min(max(code, 0), CODES - 1)
