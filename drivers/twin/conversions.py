"""The conversions of a virtual part that answers in counts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.drivers.twin.noise import normal, uniform
from tiltcal.drivers.twin.truth import LEVEL, Truth

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.fixture import HeldPose
    from tiltcal.drivers.twin.truth import Fault


class Conversions:
    """The words of a virtual part, conversion by conversion.

    They depend on the truth, the pose, the temperature and the time alone, so a session that is killed and resumed
    goes on with the bytes it would have had.
    """

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        self._truth = truth
        self._fixture = fixture
        self._clock = clock

    def fault(self) -> Fault:
        """Return the fault that is present now.

        BusError: the sensor is unplugged.
        """
        return self._truth.fault_on_link(self._clock.now_ns())

    def word(self, channel: str, rate: float, low: int, high: int, scale: float = 1.0) -> int:
        """Return a channel with the noise of the present conversion, rounded and clipped, count.

        Parameters
        ----------
        rate : float
            Conversions a second.
        low, high : int
            What the word cannot go beyond.
        scale : float
            Counts of the measuring range that is set, to those of the truth.
        """
        gravity, temperature = self._fixture.gravity, self._fixture.temperature(self._truth.lag)
        now = self._clock.now_ns() / 1e9
        fault = self.fault()
        if fault.kind == "stuck":
            # Held at its level value: a function of the fault alone, so a resumed session reads the same words.
            gravity, temperature, now = LEVEL, self._truth.ambient, fault.start
        reading = self._truth.reading(channel, gravity, temperature)
        noise = self._truth.noise.get(channel, 0.0)
        if noise:
            reading += noise * normal(self._truth.seed, f"noise {channel}", int(now * rate))
        return min(max(round(scale * reading), low), high)

    def temperature(self) -> float:
        """Return what the part's own thermometer measures now, °C."""
        return self._fixture.temperature() + self._truth.thermometer_error

    def filler(self) -> int:
        """Return a random byte, where the data sheet leaves the byte undefined."""
        return int(uniform(self._truth.seed, "filler", self._clock.now_ns()) * 256)
