"""The virtual SCL3300 and SCA3300: a link that answers the frames of the part, one frame late."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import atan2, degrees, sqrt
from typing import TYPE_CHECKING

from tiltcal.drivers.scl3300 import MeasuringRange, Scl3300Part
from tiltcal.drivers.scl3300_frames import (
    ACC_X,
    BANK_1,
    ERROR,
    MODES,
    NORMAL,
    RESET,
    SERIAL1,
    SERIAL2,
    STATUS,
    TEMPERATURE,
    WHOAMI,
    crc8,
)
from tiltcal.drivers.twin.conversions import Conversions
from tiltcal.drivers.twin.link import RecallingTwin
from tiltcal.drivers.twin.noise import uniform
from tiltcal.drivers.twin.tolerances import Tolerances

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.fixture import HeldPose
    from tiltcal.drivers.twin.truth import Truth

RATE = 2000.0
"""Words per second."""
BIT_SECONDS = 1.0 / 2_000_000

AFTER_RESET = bytes.fromhex("0300007D")
"""Answer of a real part before its first valid one; the data sheet leaves it undefined."""

POWER, MODE_CHANGE, MEMORY = 0x10, 0x02, 0x08
"""Bits of STATUS."""

ANGLES = {0x09: 0, 0x0A: 1, 0x0B: 2}
ENABLE_ANGLES = bytes.fromhex("B0001F6F")


class Scl3300Twin(RecallingTwin):
    """An SCL3300-D01 or SCA3300-D01 on the SPI bus, in its state after power-up.

    measuring: what the driver is going to set; a session that is resumed finds it set.
    truth: in counts of ``measuring``.
    clock: session time; each frame lets it advance by its bits at 2 MHz.
    """

    letter = "s"

    def __init__(
        self, part: Scl3300Part, measuring: MeasuringRange, truth: Truth, fixture: HeldPose, clock: Clock
    ) -> None:
        super().__init__(clock)
        self._conversions = Conversions(truth, fixture, clock)
        self._part = part
        self._truth_range = measuring
        self._serial = int(uniform(truth.seed, "serial number", 0) * 2**32)
        self._reset()

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer the frame before this one; see :class:`~tiltcal.drivers.bus.link.Link`."""
        fault = self._conversions.fault()
        if fault.kind == "silent":
            answer = b"\xff" * len(out)
        else:
            if fault.kind == "parity":
                self._raise(MEMORY)
            answer = self._answer()
            self._take(out)
        self._clock.sleep(self._seconds(out))
        return answer[: len(out)]

    def _take_set_up_state(self) -> None:
        self._range, self._standing, self._held = self._truth_range, 0, 0

    def _seconds(self, out: bytes) -> float:
        return 8 * len(out) * BIT_SECONDS

    def _reset(self) -> None:
        """Take the state after power-up: mode 1, bank 0, angles off, the flag of the supply set."""
        self._range = self._part.ranges[0]
        self._bank, self._angles = 0, False
        self._standing = self._held = POWER
        self._answer: Callable[[], bytes] = lambda: AFTER_RESET

    def _raise(self, flag: int) -> None:
        self._standing |= flag
        self._held |= flag

    def _take(self, request: bytes) -> None:
        """Execute a request; its answer is made when the next frame fetches it."""
        operation = request[0] >> 2 if request else 0
        if len(request) != 4 or crc8(request[:3]) != request[3]:
            self._answer = partial(_frame, operation, ERROR, 0)
        elif request == RESET and self._bank == 0:
            self._reset()
        elif request[0] & 0x80:
            self._write(request)
            self._answer = partial(_frame, operation, self._status(), int.from_bytes(request[1:3], "big"))
        elif request == STATUS:
            self._answer = partial(_frame, operation, self._status(), self._held)
            self._held, self._standing = self._standing, 0
        else:
            status, bank = self._status(), self._bank
            self._answer = lambda: _frame(operation, status, self._register(operation, bank))

    def _status(self) -> int:
        return ERROR if self._standing else NORMAL

    def _write(self, request: bytes) -> None:
        if request in MODES and self._bank == 0:
            self._range = self._part.ranges[MODES.index(request)]
            self._raise(MODE_CHANGE)
        elif request[0] == BANK_1[0]:
            self._bank = request[2] & 1
        elif request == ENABLE_ANGLES:
            self._angles = True

    def _register(self, address: int, bank: int) -> int:
        """Return the content of a register of a bank, 16 bits."""
        axis = address - (ACC_X[0] >> 2)
        if 0 <= axis <= 2:
            return self._acceleration("xyz"[axis]) & 0xFFFF
        if address in ANGLES:
            return self._angle(ANGLES[address]) & 0xFFFF if self._angles else 0
        if address == TEMPERATURE[0] >> 2:
            return round((self._conversions.temperature() + 273.0) * 18.9) & 0xFFFF
        held = {
            (WHOAMI[0] >> 2, 0): self._part.identity,
            (SERIAL1[0] >> 2, 1): self._serial & 0xFFFF,
            (SERIAL2[0] >> 2, 1): self._serial >> 16,
            (MODES[0][0] >> 2 & 0x1F, 0): self._range.mode - 1,
            (BANK_1[0] >> 2 & 0x1F, bank): bank,
        }
        return held.get((address, bank), 0)

    def _acceleration(self, channel: str) -> int:
        scale = self._range.counts_per_g / self._truth_range.counts_per_g
        return self._conversions.word(channel, RATE, -32768, 32767, scale)

    def _angle(self, axis: int) -> int:
        """Return the angle of one axis above the plane of the other two."""
        words = [self._acceleration(channel) for channel in "xyz"]
        own = words.pop(axis)
        return round(degrees(atan2(own, sqrt(words[0] ** 2 + words[1] ** 2))) / 90.0 * 16384)


def _frame(operation: int, status: int, data: int) -> bytes:
    head = bytes([operation << 2 | status, data >> 8, data & 0xFF])
    return head + bytes([crc8(head)])


def draw_truth(part: Scl3300Part, measuring: MeasuringRange, seed: int) -> Truth:
    """Draw a part within the limits of the SCA3300, which are used for the SCL3300 too."""
    limits = Tolerances(
        offset=part.offset_limit,
        sensitivity=0.007,
        cross=0.01,
        drift=0.1e-3,
        gain=3e-5,
        noise=measuring.noise,
        thermometer=10.0,
    )
    return limits.draw(("x", "y", "z"), measuring.counts_per_g, seed)
