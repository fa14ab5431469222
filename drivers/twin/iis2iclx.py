"""The virtual IIS2ICLX: a link that answers the bytes of the part on SPI."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.drivers.iis2iclx import (
    CONFIGURED,
    CTRL1,
    CTRL3,
    CTRL9,
    DATA,
    DENSITY,
    IDENTITY,
    MILLI_G,
    OFFSET_LIMIT,
    RATES,
    READING,
    SENSITIVITY_LIMIT,
    SOFTWARE_RESET,
    STATUS,
    TEMPERATURE,
    WHO_AM_I,
    WHOLE_SAMPLES,
    Iis2iclxSettings,
)
from tiltcal.drivers.twin.conversions import Conversions
from tiltcal.drivers.twin.registers import CountingUp, SpiTwin
from tiltcal.drivers.twin.tolerances import Tolerances

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link
    from tiltcal.drivers.twin.fixture import HeldPose
    from tiltcal.drivers.twin.truth import Truth

HELD = {WHO_AM_I: IDENTITY, CTRL3: 0x04, CTRL9: 0xE0}
"""After a reset."""

WRITABLE = range(CTRL1, CTRL9 + 2)


class Iis2iclxRegisters(CountingUp):
    """The registers of one virtual part.

    settings: what the driver is going to set; the truth is in counts of this range.
    """

    FLAG, CLEARED_BY = STATUS, DATA

    def __init__(self, conversions: Conversions, clock: Clock, settings: Iis2iclxSettings) -> None:
        rate_and_range = RATES[settings.rate] << 4 | settings.range << 2
        super().__init__(conversions, clock, HELD, {CTRL9: CONFIGURED, CTRL3: WHOLE_SAMPLES, CTRL1: rate_and_range})
        self._truth_settings = settings

    def write(self, register: int, value: int) -> None:
        """Set a register, or reset the part."""
        if register == CTRL3 and value & SOFTWARE_RESET:
            self._reset()
        elif register in WRITABLE:
            super().write(register, value)

    @property
    def _rate(self) -> float:
        code = self._held.get(CTRL1, 0) >> 4
        return next((rate for rate, known in RATES.items() if known == code), 0.0)

    def _measured(self, rate: float) -> dict[int, int]:
        raw = round(256.0 * (self.conversions.temperature() - 25.0)) & 0xFFFF
        measured = dict(enumerate(raw.to_bytes(2, "little"), TEMPERATURE))
        scale = MILLI_G[self._truth_settings.range] / MILLI_G[self._held[CTRL1] >> 2 & 0b11]
        for place, channel in enumerate("xy"):
            word = self.conversions.word(channel, rate, -32768, 32767, scale)
            measured |= dict(enumerate((word & 0xFFFF).to_bytes(2, "little"), DATA + 2 * place))
        return measured


def iis2iclx_twin(settings: Iis2iclxSettings, truth: Truth, fixture: HeldPose, clock: Clock) -> Link:
    """Return a virtual IIS2ICLX on SPI, in its state after power-up."""
    registers = Iis2iclxRegisters(Conversions(truth, fixture, clock), clock, settings)
    return SpiTwin(registers, clock, lambda command: (command & ~READING, not command & READING))


def draw_truth(settings: Iis2iclxSettings, seed: int) -> Truth:
    """Draw a part within the limits of the data sheet; the limit of the cross-axis sensitivity is ours."""
    limits = Tolerances(
        offset=OFFSET_LIMIT,
        sensitivity=SENSITIVITY_LIMIT,
        cross=0.01,
        drift=0.075e-3,
        gain=1.2e-4,
        noise=DENSITY * (settings.rate / 2) ** 0.5,
        thermometer=15.0,
    )
    return limits.draw(("x", "y"), settings.counts_per_g, seed)
