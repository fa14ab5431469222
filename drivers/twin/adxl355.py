"""The virtual ADXL355: a link that answers the bytes of the part on SPI."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.drivers.adxl355 import (
    AFTER_RESET,
    CENTRE,
    CENTRE_CELSIUS,
    COUNTS_PER_G,
    DATA,
    DENSITY,
    FASTEST,
    FILTER,
    IDENTITY,
    MEASURE,
    OFFSET_LIMIT,
    POWER,
    RANGE,
    RESET,
    RESET_CODE,
    SENSITIVITY_LIMIT,
    SHADOW,
    SLOPE,
    STATUS,
    TEMPERATURE,
    WHO,
    Adxl355Settings,
)
from tiltcal.drivers.twin.conversions import Conversions
from tiltcal.drivers.twin.registers import CountingUp, SpiTwin
from tiltcal.drivers.twin.tolerances import Tolerances

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link
    from tiltcal.drivers.twin.fixture import HeldPose
    from tiltcal.drivers.twin.truth import Truth

RAIL = 2**19
STANDBY = 0x01
REVISION = 1
TRIM = bytes.fromhex("2A 7C 05 91 3E")
"""Content of the shadow registers of this part."""

HELD = {
    **dict(enumerate((*IDENTITY, REVISION), WHO)),
    RANGE: AFTER_RESET | 1,
    POWER: STANDBY,
    **dict(enumerate(TRIM, SHADOW)),
}
"""After a reset."""


class Adxl355Registers(CountingUp):
    """The registers of one virtual part.

    settings: what the driver is going to set; the truth is in counts of this range.
    """

    FLAG = CLEARED_BY = STATUS

    def __init__(self, conversions: Conversions, clock: Clock, settings: Adxl355Settings) -> None:
        set_up = {FILTER: settings.step, RANGE: AFTER_RESET | settings.range, POWER: MEASURE}
        super().__init__(conversions, clock, HELD, set_up)
        self._truth_settings = settings

    def write(self, register: int, value: int) -> None:
        """Set a register, or reset the part."""
        if (register, value) == (RESET, RESET_CODE):
            self._reset()
        elif register >= FILTER:
            super().write(register, value)

    @property
    def _rate(self) -> float:
        return 0.0 if self._held[POWER] & STANDBY else FASTEST * 0.5 ** self._held.get(FILTER, 0)

    def _measured(self, rate: float) -> dict[int, int]:
        raw = round(CENTRE + SLOPE * (self.conversions.temperature() - CENTRE_CELSIUS)) & 0xFFF
        measured = {TEMPERATURE: raw >> 8, TEMPERATURE + 1: raw & 0xFF}
        scale = COUNTS_PER_G[self._held[RANGE] & 0b11 or 1] / self._truth_settings.counts_per_g
        for place, channel in enumerate("xyz"):
            word = self.conversions.word(channel, rate, -RAIL, RAIL - 1, scale)
            measured |= dict(enumerate((word << 4 & 0xFFFFFF).to_bytes(3, "big"), DATA + 3 * place))
        return measured


def adxl355_twin(settings: Adxl355Settings, truth: Truth, fixture: HeldPose, clock: Clock) -> Link:
    """Return a virtual ADXL355 on SPI, in its state after power-up."""
    registers = Adxl355Registers(Conversions(truth, fixture, clock), clock, settings)
    return SpiTwin(registers, clock, lambda command: (command >> 1, not command & 1))


def draw_truth(settings: Adxl355Settings, seed: int) -> Truth:
    """Draw a part within the data sheet's limits."""
    limits = Tolerances(
        offset=OFFSET_LIMIT,
        sensitivity=SENSITIVITY_LIMIT,
        cross=0.01,
        drift=0.15e-3,
        gain=1e-4,
        noise=DENSITY * (settings.rate / 4) ** 0.5,
        thermometer=5.0,
    )
    return limits.draw(("x", "y", "z"), settings.counts_per_g, seed)
