"""Rows of a log of accelerometer pairs: blocks in order, and the stuck values that are left out of them.

A channel that keeps its value while the stage turns on is stuck, not still: a converter that stops, or an input that is
held at its rail, repeats a value that counts heavily. No channel that senses the turning keeps one for a quarter of a
turn, unless its steps are a third of its amplitude. Such values are left out as missing ones are, from the first to the
last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.pair.encoder import AngleTracker
from tiltcal.core.rows import repeated, run_bounds

_TURN = 0.25
"""Turns over which a value must stay the same to be stuck."""
_STANDING = 0.01
"""Turns below which the stage stands, so that nothing need change."""
_FEW = 16
_MOST_HELD = 1 << 20
"""Rows."""


@dataclass(frozen=True)
class PairBlock:
    """Some rows of a log, in order.

    Attributes
    ----------
    theta : ndarray, shape (n,)
        Stage angle, degrees; NaN where it is missing.
    readings : ndarray, shape (n, channels)
        NaN where a value is missing.
    time : ndarray, shape (n,), or None
        Seconds; None where the log has no such column.
    first : int
        Number of the first row, counted from 0.
    """

    theta: Array
    readings: Array
    time: Array | None
    first: int

    def complete(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """Angle, readings and number of the rows in which no value is missing."""
        rows = self.first + np.arange(len(self.theta), dtype=np.int64)
        finite = np.isfinite(self.readings)
        good = np.isfinite(self.theta)
        if finite.all() and good.all():
            return self.theta, self.readings, rows
        good &= finite.all(axis=1)
        return self.theta[good], self.readings[good], rows[good]

    def rows(self, where: slice) -> PairBlock:
        """Some of the rows."""
        time = None if self.time is None else self.time[where]
        first = self.first + where.indices(len(self.theta))[0]
        return PairBlock(self.theta[where], self.readings[where], time, first)

    def followed_by(self, other: PairBlock) -> PairBlock:
        """Return one block of this one and the next."""
        time = None if self.time is None or other.time is None else np.concatenate([self.time, other.time])
        return PairBlock(
            np.concatenate([self.theta, other.theta]),
            np.concatenate([self.readings, other.readings]),
            time,
            self.first,
        )


class StuckValues:
    """Leaves stuck values out of a log.

    Rows whose value is the same as the one before are held back until it is clear what they are, a quarter of a turn
    at most; all others go through at once. ``say`` is called with which channel is stuck, and from which row on.
    """

    def __init__(self, channels: Sequence[str], say: Callable[[str], None]) -> None:
        self._channels = tuple(channels)
        self._say = say
        self._held: PairBlock | None = None
        # Of the row before: its values, its angle, and how far the stage has turned since each value came up.
        self._values = np.full(len(self._channels), np.nan)
        self._theta = np.nan
        self._turned = np.zeros(len(self._channels))
        self._stuck = np.zeros(len(self._channels), dtype=bool)

    def cleaned(self, blocks: Iterable[PairBlock]) -> Iterator[PairBlock]:
        """Yield the blocks, with NaN where a value is stuck; rows may move to a later block, in order."""
        for block in blocks:
            if len(block.theta):
                yield from self._judged(block if self._held is None else self._held.followed_by(block))
        if self._held is not None:
            yield self._held

    def _judged(self, block: PairBlock) -> Iterator[PairBlock]:
        readings = block.readings
        same = repeated(readings, self._values)
        channels = np.flatnonzero(same.any(axis=0)).tolist()
        turns = self._turns(block.theta) if channels else np.empty(0)
        cleaned = readings.copy(order="K") if channels else readings
        last = {channel: self._left_out(channel, same[:, channel], turns, cleaned, block.first) for channel in channels}
        ready = min([len(readings), *(run.first for run in last.values() if run.doubtful)])
        # What is held back is judged anew, as it was read.
        self._held = block.rows(slice(ready, None)) if ready < len(readings) else None
        if not ready:
            return
        self._values = readings[ready - 1]
        self._turned[:], self._stuck[:] = 0.0, False
        for channel, run in last.items():
            if run.first < ready and not run.standing:
                self._turned[channel], self._stuck[channel] = abs(turns[ready - 1] - run.begun), run.stuck
        angles = block.theta[:ready][np.isfinite(block.theta[:ready])]
        self._theta = float(angles[-1]) if len(angles) else self._theta
        yield replace(block.rows(slice(ready)), readings=cleaned[:ready])

    def _turns(self, theta: Array) -> Array:
        """Return the angle that the stage turned since the row before; where it is missing, the last one."""
        known = np.append(self._theta, theta)
        present = np.isfinite(known)
        if not present.any():
            return np.zeros(len(theta))
        turns = AngleTracker().follow(known if present.all() else known[present])
        if len(turns) == len(known):
            return np.asarray(turns[1:] - turns[0])
        latest = np.maximum(np.cumsum(present) - 1, 0)
        return np.asarray((turns[latest] - turns[0])[1:])

    def _left_out(self, channel: int, same: NDArray[np.bool_], turns: Array, readings: Array, number: int) -> _Run:
        """Leave out a channel's stuck values; the run of the last one."""
        starts, ends = run_bounds(same)
        firsts, lasts = starts - 1, ends - 1
        begun = np.where(firsts >= 0, turns[firsts], -self._turned[channel])
        turned = np.abs(turns[lasts] - begun)
        for run in np.flatnonzero(turned >= _TURN).tolist():
            first, last = max(int(firsts[run]), 0), int(lasts[run])
            if not (firsts[run] < 0 and self._stuck[channel]):
                self._say(
                    f"row {number + first}: {self._channels[channel]} is stuck at {readings[last, channel]:.6g} while "
                    "the stage turns; left out until it changes"
                )
            readings[first : last + 1, channel] = np.nan
        first = max(int(firsts[-1]), 0)
        if lasts[-1] < len(same) - 1:
            return _Run(len(same), 0.0, 0.0, 0)
        return _Run(first, float(begun[-1]), float(turned[-1]), len(same) - first)


@dataclass(frozen=True)
class _Run:
    """Rows at the end that have one value: the first of them, the angle there, how far it went, how many they are."""

    first: int
    begun: float
    turned: float
    length: int

    @property
    def stuck(self) -> bool:
        return self.turned >= _TURN

    @property
    def standing(self) -> bool:
        return self.length > _MOST_HELD or (self.length > _FEW and self.turned < _STANDING)

    @property
    def doubtful(self) -> bool:
        return self.length > 0 and not self.stuck and not self.standing
