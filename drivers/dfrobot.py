"""DFRobot's TOY0048: a Murata SCA100T-D02 behind a microcontroller on a serial line.

::

    host     55 AA 02 FD
    module   55 AA Xhi Xlo Yhi Ylo T checksum     the words and the temperature code of the SCA100T

The last byte is the complement of the XOR of the bytes between the header and itself. The baud rate is not documented,
so the address must state it.

Source: https://wiki.dfrobot.com/toy0048/docs/18369 and its four published frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from operator import xor
from typing import TYPE_CHECKING

from tiltcal.drivers import sca100t
from tiltcal.drivers.bus.link import Interruption
from tiltcal.drivers.device import Model, Reading, from_twin, in_words
from tiltcal.drivers.lines import CHUNK
from tiltcal.drivers.registers import in_counts
from tiltcal.errors import BusError, DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

REQUEST = bytes.fromhex("55AA02FD")
HEADER = bytes.fromhex("55AA")

LENGTH = 8
"""Bytes of an answer, with header and checksum."""

ATTEMPTS = 10
"""Requests for one sample before the driver raises an error."""


def checksum(payload: bytes) -> int:
    """Return the complement of the XOR of the payload's bytes."""
    return reduce(xor, payload, 0) ^ 0xFF


def parse_answer(received: bytes) -> Reading | None:
    """Return x and y (0 to 2047 count) and temperature (°C) of an answer, possibly after garbage; None without one."""
    start = received.find(HEADER)
    while 0 <= start <= len(received) - LENGTH:
        *payload, stated = received[start + len(HEADER) : start + LENGTH]
        x, y = payload[0] << 8 | payload[1], payload[2] << 8 | payload[3]
        if stated == checksum(bytes(payload)) and max(x, y) <= sca100t.FULL_SCALE:
            return Reading((float(x), float(y)), sca100t.decode_temperature(bytes([0, payload[4]])))
        start = received.find(HEADER, start + 1)
    return None


class DfrobotSca100t:
    """The driver of the module, on a serial line."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._used = self._damaged = 0

    def probe(self) -> Mapping[str, str]:
        """Return a sample, and the link statistics, as text; the errors are those of :meth:`read`."""
        reading = self.read()
        return in_counts(reading.values) | {
            "temperature": f"{reading.temperature:.1f} °C (not trimmed)",
            "link": in_words(self.link_statistics()),
        }

    def read(self) -> Reading:
        """Request one sample: x and y in counts and the temperature in °C.

        Raises
        ------
        BusError
            No data, or no valid answer.
        DeviceFault
            A word below 102.
        """
        received = b""
        for _ in range(ATTEMPTS):
            self._link.exchange(b"", 0)
            received = self._link.exchange(REQUEST, CHUNK)
            try:
                while len(received) < LENGTH:
                    received += self._link.exchange(b"", CHUNK)
            except Interruption:
                raise
            except BusError:  # a byte was lost: part of an answer is a damaged one
                pass
            reading = parse_answer(received)
            if reading is not None:
                self._used += 1
                return _sane(reading)
            self._damaged += 1
        raise BusError(
            f"{ATTEMPTS} requests got no answer 55 AA ... with its checksum; the last one got "
            f"{received[:LENGTH].hex(' ')}: is the baud rate right, and is it this module?"
        )

    def discard(self) -> None:
        """Do nothing: the module sends no data without a request."""

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of used and of damaged answers; the latter were requested again."""
        return {"answers": self._used, "damaged": self._damaged}


def _sane(reading: Reading) -> Reading:
    for channel, word in zip("xy", reading.values, strict=True):
        if word < sca100t.LOWEST_SANE_WORD:
            raise DeviceFault(
                f"{channel} reads {word:.0f} count, and words below {sca100t.LOWEST_SANE_WORD} are the SCA100T's fault "
                "signal: switch the module off and on; if it stays, replace it"
            )
    return reading


def _configured(address: Address) -> Model:
    """Return the model, and require a baud rate in the address."""
    if not address.simulated:
        address.text("baudrate")
    return DFROBOT_SCA100T


DFROBOT_SCA100T = replace(
    sca100t.D02,
    name="dfrobot-sca100t",
    title="DFRobot TOY0048 module with a Murata SCA100T-D02, ±90°, serial",
    schemes=("serial",),
    addresses=("serial:///dev/ttyUSB0?baudrate=9600",),
    driver=DfrobotSca100t,
    twin=from_twin("dfrobot", "DfrobotTwin"),
    not_modelled=(
        *(line for line in sca100t.D02.not_modelled if "self-test" not in line and "chip select" not in line),
        "the microcontroller of the module: it answers at once and without damage",
    ),
    spi=None,
    configure=_configured,
)
