"""What the independent virtual parts share: the jig that holds them, and what they measure there.

They share no line with the drivers or their twins, so that a misreading in one does not hide in the other. They run
under the system's Python and need the standard library only.
"""

from __future__ import annotations

import random
from math import exp, pi, radians


class Held:
    """A part on a jig that misses each position by a random small rotation.

    Parameters
    ----------
    jig : float
        Standard deviation of each of the three angles by which a position is missed, degrees.
    seed : int
    """

    def __init__(self, jig: float, seed: int) -> None:
        self.jig = radians(jig)
        self.chance = random.Random(seed)
        # The jig has its own: how often the part is read must not change how it lies.
        self.misses = random.Random(seed)
        self.gravity = [0.0, 0.0, 1.0]
        self.temperature = 24.0
        self.broken = False

    def pose(self, gravity: list[float], temperature: float | None) -> None:
        """Lie as asked, but for the jig's error: g' = g + e x g for a small rotation e."""
        ex, ey, ez = (self.misses.gauss(0.0, self.jig) for _ in range(3))
        gx, gy, gz = gravity
        missed = [gx + ey * gz - ez * gy, gy + ez * gx - ex * gz, gz + ex * gy - ey * gx]
        length = sum(component**2 for component in missed) ** 0.5
        self.gravity = [component / length for component in missed]
        if temperature is not None:
            self.temperature = temperature


class HeldPart(Held):
    """A part on a jig, whose words pass a filter.

    Parameters
    ----------
    offset : list of float
        Of each channel at 0 g, g.
    sensitivity : list of list of float
        A row for each channel, with columns x, y, z, 1 where it is nominal.
    noise : float
        Standard deviation of a word behind the part's filter, g.
    corner : float
        Of that filter, first order, Hz.
    jig : float
        Standard deviation of each of the three angles by which a position is missed, degrees.
    seed : int

    Attributes
    ----------
    counts : dict of str to int
        What happened that a test may ask for; ``forbidden`` must stay 0.
    """

    def __init__(
        self,
        offset: list[float],
        sensitivity: list[list[float]],
        noise: float,
        corner: float,
        jig: float,
        seed: int,
    ) -> None:
        super().__init__(jig, seed)
        self.offset = offset
        self.sensitivity = sensitivity
        self.noise = noise
        self.corner = corner
        self.filtered = [self.chance.gauss(0.0, noise) for _ in offset]
        self.filtered_ns = 0
        self.counts = {"forbidden": 0}

    def measured(self, now_ns: int) -> list[float]:
        """Every channel now, g; noise that is asked for too soon is the noise of before."""
        elapsed = (now_ns - self.filtered_ns) / 1e9
        if elapsed > 0:
            kept = exp(-2 * pi * self.corner * elapsed)
            fresh = self.noise * (1 - kept**2) ** 0.5
            self.filtered = [kept * one + self.chance.gauss(0.0, fresh) for one in self.filtered]
            self.filtered_ns = now_ns
        values = []
        for offset, row, noise in zip(self.offset, self.sensitivity, self.filtered):  # noqa: B905
            values.append(offset + noise + sum(share * g for share, g in zip(row, self.gravity)))  # noqa: B905
        return values
