"""The virtual SCA103T and SCA61T: the virtual SCA100T with two elements on one axis, and with one element."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import TYPE_CHECKING, ClassVar

from tiltcal.drivers.sca100t import FULL_SCALE, RDAX, ZERO
from tiltcal.drivers.twin.sca100t import POINTS_DOWN, Instant, Sca100tTwin, draw_inclinometer

if TYPE_CHECKING:
    from tiltcal.drivers.sca100t import InclinometerPart
    from tiltcal.drivers.twin.truth import Truth


class Sca61tTwin(Sca100tTwin):
    """An SCA61T; it does not answer RDAY, because its answer is unknown."""

    ELEMENTS: ClassVar[Mapping[int | None, str]] = {RDAX: "x"}


class Sca103tTwin(Sca100tTwin):
    """An SCA103T: each element holds half of the difference about its middle, one with either sign."""

    def _reading(self, channel: str, instant: Instant) -> tuple[float, float]:
        half = self._truth.reading("x", instant.gravity, instant.temperature) / 2.0
        return ZERO + (half if channel == "x" else -half), self._truth.noise.get("x", 0.0) / sqrt(2.0)

    def _reach(self, channel: str, instant: Instant) -> float:
        up = instant.gravity[0] if channel == "x" else -instant.gravity[0]
        return self._truth.sensitivity["x"]["x"] / 2.0 if up < POINTS_DOWN else 0.75 * FULL_SCALE


def draw_truth(part: InclinometerPart, seed: int) -> Truth:
    """Draw a part with our noise of 0.6 count, or 0.8 of a difference, whose nominal zero is 0."""
    return draw_inclinometer(part, 0.6 if part.zero else 0.8, seed)
