"""A sensor model of a third party: DFRobot's TOY0048, a Murata SCA100T-D02 behind a microcontroller on a serial line.

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

from tiltcal.drivers import sca100t
from tiltcal.drivers.bus import Link
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.model import Model, Reading, Sensor
from tiltcal.drivers.virtual import SILENCE, HeldPose, Truth, VirtualPart
from tiltcal.errors import BusError, DeviceFault

REQUEST, HEADER = bytes.fromhex("55AA02FD"), bytes.fromhex("55AA")
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


class Dfrobot(Sensor):
    """The driver of the module; it counts the answers that it used, and the damaged ones that it requested again."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._counts = {"answers": 0, "damaged": 0}

    def read(self) -> Reading:
        received = b""
        for _ in range(ATTEMPTS):
            self._link.exchange(b"", 0)
            received = self._link.exchange(REQUEST, 4096)
            try:
                while len(received) < LENGTH:
                    received += self._link.exchange(b"", 4096)
            except BusError:  # a byte was lost: part of an answer is a damaged one
                pass
            reading = parse_answer(received)
            if reading is None:
                self._counts["damaged"] += 1
                continue
            self._counts["answers"] += 1
            if min(reading.values) < sca100t.LOWEST_SANE_WORD:
                raise DeviceFault(f"it reads {reading.values}, the fault signal of its sensor: switch it off and on")
            return reading
        raise BusError(
            f"{ATTEMPTS} requests got no answer 55 AA ... with its checksum; the last one got "
            f"{received[:LENGTH].hex(' ')}: is the baud rate right, and is it this module?"
        )

    def link_statistics(self) -> Mapping[str, int]:
        return dict(self._counts)


class VirtualDfrobot(VirtualPart):
    """The virtual module at 9600 baud: the virtual SCA100T behind a serial line."""

    letter, silence = "r", SILENCE

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, fixture, clock)
        self._sensor = sca100t.VirtualSca100t(truth, fixture, clock)

    def _answered(self, out: bytes, count: int) -> bytes:
        if out != REQUEST:
            return b""
        payload = b""
        for command in (sca100t.RDAX, sca100t.RDAY):
            payload += sca100t.decode_word(self._sensor.exchange(bytes([command, 0, 0]))).to_bytes(2, "big")
            self._clock.sleep(sca100t.REFRESH)
        payload += self._sensor.exchange(bytes([sca100t.RWTR, 0]))[1:]
        self._clock.sleep((len(REQUEST) + LENGTH) * 10 / 9600)
        return (HEADER + payload + bytes([checksum(payload)]))[:count]


def _at(address: Address) -> Model:
    """Require a baud rate in the address of a real module."""
    if not address.simulated:
        address.text("baudrate")
    return DFROBOT_SCA100T


DFROBOT_SCA100T = replace(
    sca100t.D02,
    name="dfrobot-sca100t",
    title="DFRobot TOY0048 module with a Murata SCA100T-D02, ±90°, serial",
    addresses=("serial:///dev/ttyUSB0?baudrate=9600",),
    driver=Dfrobot,
    twin=VirtualDfrobot,
    not_modelled=(*sca100t.D02.not_modelled, "the microcontroller: it answers at once and without damage"),
    spi=None,
    configure=_at,
)
