"""Duty cycles of two pulse trains that share one period, from the edges of both lines.

The maker's application notes show two arrangements; in either, T1 is a pulse's length and T2 the common period::

    rising    x and y rise together in each period; T2 from one rise to the next
    centred   the pulses of x and y have a common centre; T2 from the centre of a pulse of x to the centre of the pulse
              of y in the next period (with edges Ta, Tb of x and Tc, Td of y, and Ta = 0:
              T2 = Td - T1y/2 - T1x/2)

Every pair of pulses shows the arrangement, except if both are equally long; then both give the same result.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from tiltcal.drivers.bus.edges import Edge
from tiltcal.errors import DeviceFault

ALONE = 8
"""Pulses on one line, without one on the other, that indicate a broken wire."""

MOST_APART = 1 / 8
"""Fraction of a period by which the pulses of one sensor may deviate from both arrangements (late timestamps)."""


class Pulse(NamedTuple):
    """One pulse of one line.

    Attributes
    ----------
    rise, fall : int
        Any unit of time.
    """

    rise: int
    fall: int

    @property
    def length(self) -> int:
        """T1."""
        return self.fall - self.rise

    @property
    def centre(self) -> float:
        """Midway between the edges."""
        return (self.rise + self.fall) / 2


class Cycle(NamedTuple):
    """One measurement of both axes.

    Attributes
    ----------
    x, y : float
        T1 of each, in the unit of the edges.
    period : float
        T2, likewise.
    """

    x: float
    y: float
    period: float

    @property
    def duty(self) -> tuple[float, float]:
        """T1/T2 of x and of y."""
        return self.x / self.period, self.y / self.period


def centred_cycle(x: Pulse, y: Pulse) -> Cycle:
    """Return the cycle of a pulse of x and the pulse of y in the next period, with common centres."""
    # Integer arithmetic, so that a timestamp of 2**60 ns keeps all digits.
    period = (y.rise - x.rise + y.fall - x.fall) / 2
    return Cycle(x.length, y.length, period)


def rising_cycle(x: Pulse, y: Pulse, next_x: Pulse) -> Cycle:
    """Return the cycle of the pulses of one period and the next pulse of x, with common rises."""
    return Cycle(x.length, y.length, next_x.rise - x.rise)


class PulseTrains:
    """Converts the edges of both lines to cycles, one per period.

    Attributes
    ----------
    lost : int
        Edges that were captured and never arrived; their periods give no cycle.
    torn : int
        Periods without a cycle because a pulse of one line is missing, although no edge was lost.
    """

    def __init__(self) -> None:
        self.lost = 0
        self.torn = 0
        self.restart()

    def restart(self) -> None:
        """Discard the edges so far; edges until the next one do not count as lost."""
        self._number: int | None = None
        self._clear()

    def take(self, edge: Edge) -> Cycle | None:
        """Add an edge, and return the cycle that it completes, if any.

        DeviceFault: the two trains do not belong together, or one line is dead.
        """
        if self._number is not None:
            gap = (edge.number - self._number - 1) & 0xFFFFFFFF
            if gap:
                self.lost += gap
                self._clear()
        self._number = edge.number
        if edge.rising:
            self._rise[edge.line] = edge.time_ns
            return None
        rise, self._rise[edge.line] = self._rise[edge.line], None
        if rise is None:
            return None
        self._pulses[edge.line].append(Pulse(rise, edge.time_ns))
        return self._cycle()

    def _clear(self) -> None:
        self._rise: list[int | None] = [None, None]
        self._pulses: tuple[deque[Pulse], deque[Pulse]] = (deque(), deque())

    def _cycle(self) -> Cycle | None:
        xs, ys = self._pulses
        self._require_both()
        while len(xs) > 1 and len(ys) > 1:
            x, y = xs[0], ys[0]
            about = xs[1].rise - x.rise
            if about <= 0:
                self._clear()
                raise DeviceFault("two pulses of x rise at one time, or in wrong order: check the times of the edges")
            if y.centre - x.centre > about / 2:
                xs.popleft()
                continue
            if x.centre - y.centre > about / 2:
                ys.popleft()
                continue
            next_x, next_y = xs[1], ys[1]
            xs.popleft()
            ys.popleft()
            if abs(next_y.rise - y.rise - about) > MOST_APART * about:
                # A pulse of one line is missing, so the next pulses are not the next period.
                self.torn += 1
                continue
            return _arranged(x, y, next_x, next_y, about)
        return None

    def _require_both(self) -> None:
        for line, name, other in ((0, "x", "y"), (1, "y", "x")):
            if not self._pulses[line] and len(self._pulses[1 - line]) >= ALONE:
                self._clear()
                raise DeviceFault(
                    f"{other} pulses and {name} does not: check the wire of {name}, and whether the axis is at its rail"
                )


def _arranged(x: Pulse, y: Pulse, next_x: Pulse, next_y: Pulse, about: float) -> Cycle:
    """Return the cycle for the arrangement of the pulses; ``about`` is the approximate period."""
    rises, centres = abs(y.rise - x.rise), abs(y.rise - x.rise + y.fall - x.fall) / 2
    if min(rises, centres) > MOST_APART * about:
        raise DeviceFault(
            "the pulses of x and y share neither their rising edges nor their centres: are both lines of one sensor?"
        )
    return centred_cycle(x, next_y) if centres < rises else rising_cycle(x, y, next_x)
