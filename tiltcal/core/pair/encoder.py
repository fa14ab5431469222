"""The stage: its angle as an encoder reads it, followed over its turns."""

from __future__ import annotations

from math import floor

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

FEWEST_TURNS = 2.0
BACKLASH = 0.25
"""Turns that the angle may fall behind its highest, by encoder noise and play, before the stage runs backwards."""
_JUMP = 0.125
"""Turns."""
STANDSTILL = 0.05
"""Turns in a whole record below which the stage does not turn."""
_ROUNDING = 1e-6


class AngleTracker:
    """Follows the angle of a stage from block to block, in turns that do not wrap.

    Attributes
    ----------
    rows : int
        Angles that were followed.
    turns : float
        From the first angle to the last.
    moved : bool
        Whether the angle has changed enough to be one.
    backlash : float
        The most that the angle has fallen behind its highest so far, turns.
    """

    def __init__(self) -> None:
        self.rows = 0
        self.backlash = 0.0
        self._first = 0.0
        self._last = 0.0
        self._highest = 0.0

    @property
    def turns(self) -> float:
        return self._last - self._first

    @property
    def moved(self) -> bool:
        return max(self._highest - self._first, self.backlash) >= STANDSTILL

    def follow(self, theta: Array) -> Array:
        """Go on with more angles.

        Parameters
        ----------
        theta : ndarray, shape (n,)
            Degrees, wrapped or not; finite. From one to the next it is less than an eighth of a turn back; more is
            taken for a gap in which the stage went on.

        Returns
        -------
        ndarray, shape (n,)
            Turns. The whole number is a count, the rest is the angle.
        """
        if not len(theta):
            return np.empty(0)
        angle = theta / 360.0
        if not self.rows:
            self._first = self._last = self._highest = float(angle[0] % 1.0)
        steps = np.diff(angle, prepend=self._last)
        whole = np.rint(steps)
        steps -= whole
        # No stage is sampled so seldom that it turns back so far at once: rows are missing, and it went on meanwhile.
        whole -= steps < -_JUMP
        # The angle itself and a count of turns: a sum of millions of steps would lose digits.
        places = np.flatnonzero(whole)
        counts = np.append(0.0, np.cumsum(-whole[places]))
        turns = angle + np.repeat(counts, np.diff(places, prepend=0, append=len(angle)))
        forwards = float(np.min(steps)) >= 0.0 and self._last >= self._highest
        highest = turns if forwards else np.maximum.accumulate(np.maximum(turns, self._highest))
        self.backlash = max(self.backlash, float(np.max(highest - turns)))
        self.rows += len(theta)
        self._last, self._highest = float(turns[-1]), float(highest[-1])
        return np.asarray(turns)

    def require_turns(self) -> None:
        """Refuse a record from which nothing can be demodulated.

        Raises
        ------
        EstimateError
            The stage does not turn, turns backwards, or turns less than twice.
        """
        if not self.moved:
            raise EstimateError(
                f"the stage is not turning: its angle changes by {360.0 * self.turns:.2f}° over {self.rows} rows; is "
                "this the column of the stage angle, in degrees?"
            )
        if self._highest - self._first < STANDSTILL:
            raise EstimateError(
                f"the stage angle runs backwards, {-self.turns:.2f} turns in all: the encoder must count up in the "
                "direction in which the stage turns; swap its two tracks, or log the angle with the other sign"
            )
        if self.backlash > BACKLASH:
            raise EstimateError(
                f"the stage angle runs backwards by {360.0 * self.backlash:.0f}° in the middle of the record: match a "
                "stretch in which the stage turns one way, and check the encoder"
            )
        # Each row stands for one step, the last one too.
        covered = self.turns * self.rows / (self.rows - 1)
        if covered < FEWEST_TURNS - _ROUNDING:
            shown = floor(100.0 * covered) / 100.0
            raise EstimateError(f"the record has {shown:.2f} turns of the stage; at least {FEWEST_TURNS:g} are needed")
