"""The scale of a sensor's readings: how much of their unit a g is, and a small angle near level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, radians


@dataclass(frozen=True)
class NoiseScale:
    """The scale of a sensor's readings, by which their noise becomes degrees.

    Attributes
    ----------
    per_g : mapping of str to float
        Unit/g, of the channels of which it is known; above 0.
    source : str
        Where that is from.
    """

    unit: str
    per_g: Mapping[str, float]
    source: str

    def degrees(self, channel: str, value: float) -> float | None:
        """Return a small difference of readings as degrees of an axis near level; None where it is not known."""
        return degrees(value / self.per_g[channel]) if channel in self.per_g else None

    def from_degrees(self, channel: str, angle: float | None) -> float | None:
        """Return the inverse of :meth:`degrees`."""
        return None if angle is None or channel not in self.per_g else radians(angle) * self.per_g[channel]
