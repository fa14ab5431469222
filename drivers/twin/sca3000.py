"""The virtual SCA3000: links that answer the bytes of the part, over SPI and over I2C."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from tiltcal.drivers.sca3000 import (
    CHECKSUM_ERROR,
    COMMAND_SHIFT,
    OVERFLOW,
    REVID,
    STATUS,
    TEMP_LSB,
    TEMP_MSB,
    X_LSB,
    Z_MSB,
    Sca3000Part,
)
from tiltcal.drivers.twin.conversions import Conversions
from tiltcal.drivers.twin.registers import I2cTwin, SpiTwin
from tiltcal.drivers.twin.tolerances import Tolerances

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link
    from tiltcal.drivers.twin.fixture import HeldPose
    from tiltcal.drivers.twin.truth import Truth

REVISION = 0x21
"""Content of REVID; the values of real parts are unknown."""

HIGHEST_REGISTER = 0x3F


class Sca3000Registers:
    """The registers of one virtual part."""

    def __init__(self, conversions: Conversions, part: Sca3000Part) -> None:
        self.conversions = conversions
        self._part = part

    def read(self, first: int, count: int) -> bytes:
        """Return ``count`` registers from ``first`` down, all of one moment."""
        damaged = self.conversions.fault().kind == "parity"
        held = {REVID: REVISION, STATUS: CHECKSUM_ERROR if damaged else 0}
        held.update(self._data())
        if self._part.thermometer:
            held.update(self._thermometer())
        answer = bytearray()
        register = first
        for _ in range(count):
            answer.append(held.get(register, 0))
            register = Z_MSB if register == X_LSB else (register - 1) & HIGHEST_REGISTER
        return bytes(answer)

    def write(self, register: int, value: int) -> None:
        """Change nothing: the driver never writes."""

    def recalled(self) -> None:
        """Do nothing: the part has no settings."""

    def _data(self) -> dict[int, int]:
        """Return the six data registers."""
        low, high = map(int, OVERFLOW)
        held = {}
        for place, channel in enumerate("xyz"):
            word = self.conversions.word(channel, self._part.rate, low, high) << 3 & 0xFFFF
            held[X_LSB + 2 * place], held[X_LSB + 2 * place + 1] = word & 0xFF, word >> 8
        return held

    def _thermometer(self) -> dict[int, int]:
        raw = min(max(round(256.0 + 1.8 * (self.conversions.temperature() - 23.0)), 0), 511)
        return {TEMP_MSB: raw >> 3, TEMP_LSB: (raw & 0b111) << 5}


def sca3000_twin(part: Sca3000Part, truth: Truth, fixture: HeldPose, clock: Clock) -> Link:
    """Return a virtual SCA3000 on the first of its buses."""
    registers = Sca3000Registers(Conversions(truth, fixture, clock), part)
    if part.schemes[0] == "i2c":
        return I2cTwin(registers, clock, lambda pointer: pointer >> part.pointer_shift)
    return SpiTwin(registers, clock, lambda command: (command >> COMMAND_SHIFT, False))


TOLERANCES = Tolerances(offset=0.05, sensitivity=0.03, cross=0.02, drift=0.5e-3, gain=1e-4, noise=0.0, thermometer=2.0)
"""These limits are ours, because no source states the tolerances."""


def draw_truth(part: Sca3000Part, seed: int) -> Truth:
    """Draw a plausible part within :data:`TOLERANCES`, with a noise of 1.5 count."""
    truth = TOLERANCES.draw(("x", "y", "z"), part.counts_per_g, seed)
    return replace(truth, noise=dict.fromkeys(truth.channels, 1.5))
