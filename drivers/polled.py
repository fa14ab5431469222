"""Parts with setup registers and a status register that shows when a new sample is ready."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

from tiltcal.drivers.registers import RegisterPort, check_data_line, in_counts
from tiltcal.errors import BusError, DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.device import Reading

PERIODS = 6
"""Timeout for a sample, in sample periods."""

Settings = Sequence[tuple[int, int]]
"""Registers and their values, in the order of writing."""


class PolledSensor(ABC):
    """Base of the drivers of parts that signal a new sample in a status register.

    The part is set up before the first sample and again after any error. After a reset it measures nothing until it is
    set up, so a reset shows as samples that do not come.

    rate: samples a second.
    """

    NAME: ClassVar[str]
    PART_ID: ClassVar[tuple[int, bytes]]
    """The first register of the part's identity, and the content from there on."""
    NEW_SAMPLE: ClassVar[tuple[int, int]]
    """The status register, and the bit that stands while a new sample is there."""

    def __init__(self, port: RegisterPort, clock: Clock, rate: float) -> None:
        self._port = port
        self._clock = clock
        self._period = 1.0 / rate
        self._ready = False

    def probe(self) -> Mapping[str, str]:
        """Set the part up; return identity, range, rate and a sample as text. Its errors are those of :meth:`read`."""
        self._ready = False
        reading = self.read()
        temperature = f"{reading.temperature:.1f} °C (not trimmed)"
        return {**self._identity(), **in_counts(reading.values), "temperature": temperature}

    def read(self) -> Reading:
        """Wait for the next sample and take it: counts, and the temperature in °C.

        Raises
        ------
        BusError
            The transaction failed, every bit of the sample is the same, or the part does not keep its settings.
        DeviceFault
            Another part answers, it does not measure, or it was reset since it was set up.
        """
        ready, self._ready = self._ready, False
        if not ready:
            self._require_identity()
            self._set_up()
        if not self._sample_comes():
            raise DeviceFault(self._why_no_sample(ready))
        reading = self._sample()
        self._ready = True
        return reading

    def discard(self) -> None:  # noqa: B027 - a part that is polled has nothing to discard
        """Do nothing: every read takes the latest sample."""

    @abstractmethod
    def _set_up(self) -> None:
        """Reset the part and write its settings."""

    @abstractmethod
    def _identity(self) -> Mapping[str, str]:
        """Return what the part is, and its range and rate."""

    @abstractmethod
    def _settings(self) -> Settings:
        """Return the settings of the part during measurement."""

    @abstractmethod
    def _sample(self) -> Reading:
        """Take the present sample."""

    def _require_identity(self) -> None:
        register, expected = self.PART_ID
        found = self._port.read(register, len(expected))
        check_data_line(found)
        if found != expected:
            raise DeviceFault(
                f"the part says that it is {found.hex(' ').upper()}, where an {self.NAME} says "
                f"{expected.hex(' ').upper()}: is another device on this chip select or address?"
            )

    def _sample_comes(self) -> bool:
        register, bit = self.NEW_SAMPLE
        for _ in range(4 * PERIODS):
            (status,) = self._port.read(register, 1)
            # A line that is stuck high has this bit as well; the data show it.
            if status & bit:
                return True
            self._clock.sleep(self._period / 4)
        return False

    def _write(self, settings: Settings) -> None:
        """Write registers, and check their content."""
        for register, value in settings:
            self._port.write(register, value)
        wrong = self._unlike(settings)
        if wrong:
            raise BusError(
                f"the {self.NAME} does not keep what is written to it ({wrong}): check MOSI or SDA, the clock and the "
                "supply"
            )

    def _unlike(self, settings: Settings) -> str:
        """Return the registers with another content, as text."""
        held = [(register, value, self._port.read(register, 1)[0]) for register, value in settings]
        return ", ".join(
            f"register 0x{register:02X} holds 0x{found:02X}, not 0x{value:02X}"
            for register, value, found in held
            if found != value
        )

    def _why_no_sample(self, was_ready: bool) -> str:
        waited = f"no sample came for {PERIODS * self._period:.3g} s"
        wrong = self._unlike(self._settings()) if was_ready else ""
        if wrong:
            return (
                f"the {self.NAME} was reset or its supply failed since it was set up ({wrong}): check the supply and "
                "its wires; it is set up anew"
            )
        return f"{waited}: the {self.NAME} does not measure; switch its supply off and on"
