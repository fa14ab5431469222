"""The tolerances of a part as delivered, and virtual parts that are drawn within them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi, sin

from tiltcal.drivers.twin.noise import uniform
from tiltcal.drivers.twin.truth import Truth

REFERENCE = 25.0
"""Temperature of the errors of a part, °C."""


def part_errors(seed: int) -> Callable[[float, str], float]:
    """Return a function that draws an error of a part, uniformly distributed within a limit of either sign, by name."""
    return lambda limit, name: limit * (2.0 * uniform(seed, f"part {name}", 0) - 1.0)


@dataclass(frozen=True, slots=True)
class Tolerances:
    """The tolerances of a model; every error is uniformly distributed within its limit.

    offset: g.
    sensitivity, cross: relative to the nominal sensitivity, and to the part's own.
    drift: of the offset, g/°C.
    gain: of the sensitivity, 1/°C.
    noise: standard deviation of one sample, g.
    thermometer: °C.
    """

    offset: float
    sensitivity: float
    cross: float
    drift: float
    gain: float
    noise: float
    thermometer: float

    def draw(self, channels: tuple[str, ...], counts_per_g: float, seed: int) -> Truth:
        """Draw a plausible part, on a jig of 0.01° in a chamber with a time constant of 20 s."""
        within = part_errors(seed)

        def row(channel: str) -> dict[str, float]:
            own = counts_per_g * (1.0 + within(self.sensitivity, f"sensitivity {channel}"))
            cross, direction = own * within(self.cross, f"cross {channel}"), within(pi, f"direction {channel}")
            first, second = (other for other in "xyz" if other != channel)
            return {channel: own, first: cross * cos(direction), second: cross * sin(direction)}

        return Truth(
            channels=channels,
            offset={channel: counts_per_g * within(self.offset, f"offset {channel}") for channel in channels},
            sensitivity={channel: row(channel) for channel in channels},
            reference=REFERENCE,
            drift={channel: (counts_per_g * within(self.drift, f"drift {channel}"),) for channel in channels},
            gain={channel: (within(self.gain, f"gain {channel}"),) for channel in channels},
            noise=dict.fromkeys(channels, counts_per_g * self.noise),
            thermometer_error=within(self.thermometer, "thermometer"),
            seed=seed,
            jig=0.01,
            ambient=24.0,
            time_constant=20.0,
        )
