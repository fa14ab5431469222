"""Microchip MCP3208 analog-to-digital converter: eight inputs, 12 bits, SPI.

One frame of three bytes, most significant bit first, starts a conversion and returns it::

    out   0 0 0 0 0 1 S D2   D1 D0 x x x x x x   x x x x x x x x
    in    ? ? ? ? ? ? ? ?    ? ? ? 0 B11 .. B8   B7 .. B0

S is 1 for an input against ground, D2 to D0 its number. The result is a share of the voltage at the reference pin:
4096 steps are all of it.

Source: MCP3204/3208 data sheet, DS21298.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from tiltcal.drivers.bus.link import require_length
from tiltcal.drivers.converter import FrontEnd
from tiltcal.drivers.device import SpiPort, from_twin
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

INPUTS = 8

CODES = 4096
"""Steps of the reference voltage."""

PORT = SpiPort(modes=(0, 3), fastest=2_000_000, speed=1_000_000)
"""20 clocks a sample: 100,000 samples a second at a supply of 5 V are 2 MHz, 50,000 at 2.7 V are 1 MHz."""


class Mcp3208:
    """The driver of an MCP3208.

    Parameters
    ----------
    reference : float
        Voltage at the reference pin, V.
    """

    def __init__(self, link: Link, clock: Clock, reference: float) -> None:
        self._link = link
        self._reference = reference

    def volts(self, number: int) -> float:
        """Convert one input against ground, V.

        BusError: the transaction failed, or every bit of the answer is the same.
        """
        command = command_frame(number)
        answer = require_length(self._link.exchange(command), len(command), "frame")
        _check_data_line(number, answer)
        return decode_code(answer) * self._reference / CODES


def command_frame(number: int) -> bytes:
    """Return the frame that converts an input, 0 to 7, against ground."""
    return bytes([0b110 | number >> 2, (number & 0b11) << 6, 0])


def decode_code(answer: bytes) -> int:
    """Return the result of an answer, 0 to 4095; the bits before the lowest 12 have no meaning."""
    return (answer[1] & 0x0F) << 8 | answer[2]


def _check_data_line(number: int, answer: bytes) -> None:
    """Raise an error for a dead wire: the bit before the result is 0, so a working part never sends only ones."""
    if set(answer) == {0xFF}:
        raise BusError(
            f"the data line is stuck high (input {number} reads ones alone): check MISO, chip select and the "
            "MCP3208's supply"
        )
    if set(answer) == {0x00}:
        raise BusError(
            f"the data line is stuck low, or input {number} is shorted to ground (it reads zeros alone): check MISO "
            "and this input"
        )


def front_end(address: Address) -> FrontEnd:
    """Return the MCP3208 with the ``vref=`` of an address, the voltage at its reference pin.

    UsageError: the reference voltage is missing or out of range.
    """
    # From 0.25 V up to the part's own supply, which may be 5.5 V.
    reference = address.number("vref", 5.0 if address.simulated else None, low=0.25, high=5.5)
    return FrontEnd(
        name="mcp3208",
        description=f"MCP3208, reference {reference:g} V",
        inputs=INPUTS,
        full_scale=reference,
        step=reference / CODES,
        reference=reference,
        options=("vref",),
        spi=PORT,
        driver=partial(Mcp3208, reference=reference),
        twin=from_twin("mcp3208", "Mcp3208Twin"),
    )
