"""The virtual ADS1115: a link that answers with the registers of the part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tiltcal.drivers.ads1115 import CONFIG, CONVERSION, DONE, RANGES, RATES, RESET, START
from tiltcal.drivers.twin.link import TwinLink, at_time
from tiltcal.drivers.twin.noise import uniform
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.analog import Wiring

BIT_SECONDS = 1.0 / 100_000

SLOWEST, FASTEST = 1.1, 0.9
"""Duration of a conversion over its nominal one: the converter's clock is within 10 %."""

GROUND = 4
"""From this input code on, one input is measured against ground; below it, the difference of two."""

DIFFERENCES = ((0, 1), (0, 3), (1, 3), (2, 3))
"""By the lower input codes."""


@dataclass(frozen=True, slots=True)
class Conversion:
    """A conversion: its result and the time when it is done."""

    code: int
    done_ns: int


class Ads1115Twin(TwinLink):
    """An ADS1115 on the I2C bus, bit by bit.

    Its state is that of the part: the pointer, the config register, and the last conversion. All three follow from what
    was written; :meth:`recall` restores them in the twin of a resumed session.

    wiring: the voltages at its inputs, sampled when a conversion starts.
    clock: session time; each transaction advances it by its bits at 100 kHz.
    """

    letter = "i"

    def __init__(self, wiring: Wiring, clock: Clock) -> None:
        super().__init__(clock)
        self._wiring = wiring
        self._pointer = CONVERSION
        self._config = RESET & ~START
        self._conversion = Conversion(0, 0)
        self._former = 0

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Write, then read the register of the pointer; see :class:`~tiltcal.drivers.bus.link.Link`."""
        if self._wiring.silent():
            raise BusError("no device acknowledges, a fault that the virtual sensor's truth sets")
        # Each byte has a ninth bit for its acknowledge, and each direction begins with the device's address.
        self._clock.sleep(9 * (1 + len(out)) * BIT_SECONDS)
        self._write(out)
        answer = self._register().to_bytes(2, "big")
        if count:
            self._clock.sleep(9 * (1 + count) * BIT_SECONDS)
        return (answer * (count // 2 + 1))[:count]

    def recall(self, out: bytes, now_ns: int) -> None:
        """Repeat a write of an earlier time, whose effect a real part would have kept."""
        with at_time(self._clock, now_ns):
            self._write(out)

    def _write(self, out: bytes) -> None:
        if out:
            self._pointer = out[0] & 0b11
        if len(out) >= 3 and self._pointer == CONFIG:
            written = int.from_bytes(out[1:3], "big")
            self._config = written & ~START
            if written & START and not self._busy():
                self._former = self._conversion.code
                self._conversion = self._converted()

    def _register(self) -> int:
        """Return the register of the pointer; the thresholds are not modelled."""
        if self._pointer == CONFIG:
            return self._config | (0 if self._busy() else DONE)
        if self._pointer == CONVERSION:
            return (self._former if self._busy() else self._conversion.code) & 0xFFFF
        return 0

    def _busy(self) -> bool:
        return self._clock.now_ns() < self._conversion.done_ns

    def _converted(self) -> Conversion:
        """Start the conversion of the config register now, and return it."""
        now_ns = self._clock.now_ns()
        full_scale = (*RANGES, RANGES[-1], RANGES[-1])[self._config >> 9 & 0b111]
        seconds = FASTEST + (SLOWEST - FASTEST) * uniform(self._wiring.seed, "oscillator", 0)
        seconds /= RATES[self._config >> 5 & 0b111]
        code = round(self._volts(self._config >> 12 & 0b111) / full_scale * 32768)
        return Conversion(min(max(code, -32768), 32767), now_ns + round(seconds * 1e9))

    def _volts(self, code: int) -> float:
        if code >= GROUND:
            return self._wiring.volts(code - GROUND)
        plus, minus = DIFFERENCES[code]
        return self._wiring.volts(plus) - self._wiring.volts(minus)
