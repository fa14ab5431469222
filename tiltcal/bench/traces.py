"""The last seconds of the direction that points up, as bars in a line of text, in which a loose wire jumps."""

from __future__ import annotations

from collections import deque
from statistics import median

from tiltcal.core.attitude import Vector

BARS = "▁▂▃▄▅▆▇█"
STEADY = 0.02  # a range in g that the bars span at least (1°), in which the noise of a still sensor is small
KEPT = 60  # readings, of which each bar shows the farthest from the median in its part
FEWEST, MOST = 6, 16  # bars of an axis


class Traces:
    """The last directions of a sensor that point up; None is one that is not known."""

    def __init__(self) -> None:
        self._last: deque[Vector | None] = deque(maxlen=KEPT)
        self.add = self._last.append

    def within(self, room: int) -> str:
        """Return a line such as ``x ▄▄█▄▄▄  y ▄▄▄▄▄▄  z ▄▄▄▄▄▄``; nothing where there is no room, or nothing known."""
        known = [up for up in self._last if up is not None]
        count = min(MOST, (room + 2) // 3 - 4, len(known))
        if count < FEWEST:
            return ""
        return "  ".join(
            f"{name} {_bars(column, count)}" for name, column in zip("xyz", zip(*known, strict=True), strict=True)
        )


def _bars(column: tuple[float, ...], count: int) -> str:
    middle, size = median(column), len(column)
    parts = [column[i * size // count : (i + 1) * size // count] for i in range(count)]
    off = [max((one - middle for one in part), key=abs) for part in parts]
    return "".join(BARS[int(3.5 + 3.5 * one / max(STEADY / 2, *map(abs, off)))] for one in off)
