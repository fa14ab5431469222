"""Virtual parts with byte registers, and their links on SPI and I2C."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, ClassVar, Protocol

from tiltcal.drivers.twin.conversions import Conversions
from tiltcal.drivers.twin.link import RecallingTwin
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock

SPI_BIT_SECONDS = 1.0 / 500_000
I2C_BIT_SECONDS = 1.0 / 100_000


class Registers(Protocol):
    """The registers of a virtual part."""

    @property
    def conversions(self) -> Conversions:
        """The source of its words."""
        ...

    def read(self, first: int, count: int) -> bytes:
        """Return ``count`` registers of one moment, from ``first`` on in the order of the part."""
        ...

    def write(self, register: int, value: int) -> None:
        """Set a register."""
        ...

    def recalled(self) -> None:
        """Take the state of a part after the setup by its driver."""
        ...


class CountingUp(ABC):
    """Registers whose address counts up in a burst, with a flag for a new sample.

    after_reset: what registers hold after a reset; the others hold 0.
    set_up: what the driver sets.
    """

    FLAG: ClassVar[int]
    """The register whose bit 0 is the flag."""
    CLEARED_BY: ClassVar[int]
    """The register whose reading clears the flag."""

    def __init__(
        self, conversions: Conversions, clock: Clock, after_reset: Mapping[int, int], set_up: Mapping[int, int]
    ) -> None:
        self.conversions = conversions
        self._clock = clock
        self._after_reset = after_reset
        self._set_up = set_up
        self._held = dict(after_reset)
        self._taken = -1

    def read(self, first: int, count: int) -> bytes:
        """Return ``count`` registers from ``first`` up, all of one moment."""
        held = self._held
        if rate := self._rate:
            sample = int(self._clock.now_ns() / 1e9 * rate)
            held = {**held, **self._measured(rate), self.FLAG: int(sample > self._taken)}
            if first <= self.CLEARED_BY < first + count:
                self._taken = sample
        return bytes(held.get(register, 0) for register in range(first, first + count))

    def write(self, register: int, value: int) -> None:
        """Set a register; data and identity registers keep their content."""
        self._held[register] = value

    def recalled(self) -> None:
        """Take the state of a part after the setup by its driver."""
        self._held = {**self._after_reset, **self._set_up}

    def _reset(self) -> None:
        self._held = dict(self._after_reset)

    @property
    @abstractmethod
    def _rate(self) -> float:
        """Samples a second; 0 where nothing is measured."""

    @abstractmethod
    def _measured(self, rate: float) -> dict[int, int]:
        """Return the registers of temperature and data."""


class SpiTwin(RecallingTwin):
    """A part with registers on the SPI bus, at 500 kHz.

    decode: returns the register of a command byte, and whether it writes.
    """

    letter = "s"

    def __init__(self, registers: Registers, clock: Clock, decode: Callable[[int], tuple[int, bool]]) -> None:
        super().__init__(clock)
        self._registers = registers
        self._decode = decode

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one frame; see :class:`~tiltcal.drivers.bus.link.Link`."""
        if not out:
            return b""
        if self._registers.conversions.fault().kind == "silent":
            answer = b"\xff" * len(out)
        else:
            # It is unknown what the part sends during the command byte, so it is random here.
            answer = bytes([self._registers.conversions.filler()]) + self._take(out)
        self._clock.sleep(self._seconds(out))
        return answer

    def _take(self, out: bytes) -> bytes:
        """Return what the part sends behind the command byte."""
        register, writing = self._decode(out[0])
        if not writing:
            return self._registers.read(register, len(out) - 1)
        self._registers.write(register, out[-1])
        return bytes(len(out) - 1)

    def _take_set_up_state(self) -> None:
        self._registers.recalled()

    def _seconds(self, out: bytes) -> float:
        return 8 * len(out) * SPI_BIT_SECONDS


class I2cTwin(RecallingTwin):
    """A part with registers on the I2C bus, at 100 kHz.

    The register pointer is kept from the write to the read of one transaction.

    decode: returns the register of the first byte that is written.
    """

    letter = "i"

    def __init__(self, registers: Registers, clock: Clock, decode: Callable[[int], int]) -> None:
        super().__init__(clock)
        self._registers = registers
        self._decode = decode

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one transaction; see :class:`~tiltcal.drivers.bus.link.Link`."""
        if self._registers.conversions.fault().kind == "silent":
            raise BusError("no device acknowledges, a fault that the virtual sensor's truth sets")
        register = self._decode(out[0]) if out else 0
        if len(out) > 1:
            self._registers.write(register, out[1])
        answer = self._registers.read(register, count)
        # Each byte has an acknowledge; write and read each begin with an address byte.
        sent = 1 + len(out) + (1 + count if count else 0)
        self._clock.sleep(9 * sent * I2C_BIT_SECONDS)
        return answer

    def _take_set_up_state(self) -> None:
        self._registers.recalled()

    def _seconds(self, out: bytes) -> float:
        # How many bytes were read, and so how long it took, is not known.
        return 0.0

    def _take(self, out: bytes) -> None:
        if len(out) > 1:
            self._registers.write(self._decode(out[0]), out[1])
        elif out:
            # The first byte takes the sample.
            self._registers.read(self._decode(out[0]), 1)
