"""The virtual SCA103T and SCA61T: the virtual SCA100T with two elements on one axis, and with one element."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import radians, sin, sqrt
from typing import TYPE_CHECKING, ClassVar

from tiltcal.drivers.sca100t import CROSS_AXIS_LIMIT, FULL_SCALE, RDAX, SENSITIVITY_LIMIT, ZERO
from tiltcal.drivers.twin import counts
from tiltcal.drivers.twin.counts import REFERENCE, Spread
from tiltcal.drivers.twin.sca100t import POINTS_DOWN, Instant, Sca100tTwin, recentred
from tiltcal.drivers.twin.truth import Truth

if TYPE_CHECKING:
    from tiltcal.drivers.sca103t import OneAxisPart


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


def draw_truth(part: OneAxisPart, seed: int) -> Truth:
    """Draw a part within its tolerance, whose drift and sensitivity follow the data sheet's mean curves.

    The noise of 0.6 count (0.8 of a difference), the thermometer within 2 °C and the fixture are ours.
    """
    spread = Spread(
        offset=sin(radians(part.offset_limit)),
        sensitivity=SENSITIVITY_LIMIT,
        cross=CROSS_AXIS_LIMIT,
        drift=part.population.drift_spread / part.counts_per_g,
        gain=part.population.gain_spread,
        noise=(0.8 if part.differential else 0.6) / part.counts_per_g,
        thermometer=2.0,
    )
    truth = counts.draw_truth(("x",), part.counts_per_g, spread, seed)
    _, slope, *higher = recentred(part.population.drift, REFERENCE)
    mean, steepness, *bends = recentred(part.population.gain, REFERENCE)
    return replace(
        truth,
        offset={"x": part.zero + truth.offset["x"]},
        drift={"x": (slope + truth.drift["x"][0], *higher)},
        gain={"x": tuple(k / (1.0 + mean) for k in (steepness + truth.gain["x"][0], *bends))},
    )
