"""What the independent virtual parts share: the jig that holds them, and what they measure there.

They share no line with the drivers or their twins, so that a misreading in one does not hide in the other. They run
under the system's Python and need the standard library only.
"""

from __future__ import annotations

import random
from math import radians


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
