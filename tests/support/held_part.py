"""What the independent virtual parts share: the jig that holds them, and what they measure there.

They share no line with the drivers or their twins, so that a misreading in one does not hide in the other. They run
under the system's Python and need the standard library only. A test makes one for its truth; what it was made with
makes another behind the emulated node.
"""

import random
from dataclasses import dataclass
from math import radians

Row = tuple[float, ...]


@dataclass(kw_only=True)
class Held:
    """A part with offsets (count at 0 g and 24 °C) and a sensitivity matrix (count/g, a row for each channel).

    ``noise`` is the standard deviation of a word, count; ``jig`` that of each of the three angles by which a position
    is missed, degrees.
    """

    offset: Row
    sensitivity: tuple[Row, ...]
    noise: float
    jig: float = 0.01
    seed: int = 1

    def __post_init__(self) -> None:
        self.chance = random.Random(self.seed)
        # The jig has its own: how often the part is read must not change how it lies.
        self.misses = random.Random(self.seed)
        self.gravity = [0.0, 0.0, 1.0]
        self.temperature = 24.0
        self.broken = False

    def pose(self, gravity: list[float], temperature: float | None) -> None:
        """Lie as asked, but for the jig's error: g' = g + e x g for a small rotation e."""
        ex, ey, ez = (self.misses.gauss(0.0, radians(self.jig)) for _ in range(3))
        gx, gy, gz = gravity
        missed = [gx + ey * gz - ez * gy, gy + ez * gx - ex * gz, gz + ex * gy - ey * gx]
        length = sum(component**2 for component in missed) ** 0.5
        self.gravity = [component / length for component in missed]
        if temperature is not None:
            self.temperature = temperature

    def reading(self, channel: int) -> float:
        """What a channel reads now without noise."""
        return self.offset[channel] + sum(k * g for k, g in zip(self.sensitivity[channel], self.gravity, strict=True))
