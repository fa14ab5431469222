"""A stream of samples cut into sectors of the turn, and what in it cannot be used.

The online estimators are run sample by sample; what they need of the samples is the products of the demodulating
columns and the readings, summed over an eighth of a turn. However the samples come, one at a time or a million, the
sectors are the same. A sector in which the stage stood, the stream had a gap or values were missing is not handed on:
the estimators hold what they have, the stream says why, and goes on with the next whole sector.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from math import floor
from statistics import median

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import harmonic_columns
from tiltcal.core.pair.encoder import AngleTracker

Rows = NDArray[np.int64]

STANDS = "the stage stands still"
GAP = "the stream has a gap"
COARSE = (
    "from one angle to the next are more than 45°, which is too coarse to be followed: more rows a turn, or a finer "
    "encoder; without --online they will do"
)

SECTORS = 8
"""Of a turn."""
HARMONICS = 2
ONE, DRIFT, READINGS = 2 * HARMONICS, 2 * HARMONICS + 1, 2 * HARMONICS + 2
"""Where they stand among the products of a sector."""

_TYPICAL = 16
_STANDING = 4.0
"""Times the rows of a typical sector after which the stage stands."""
_COMPLETE = 0.5
_MOST_GAPS = 0.2
"""Of all sectors; where there are more it is no gap that the stream has."""
_BACKWARDS = 1.5 / SECTORS
"""Turns that the angle may fall back."""


@dataclass(frozen=True)
class Sector:
    """An eighth of a turn, all of it there.

    Attributes
    ----------
    products : ndarray, shape (size, size)
        Of sin θ, cos θ, sin 2θ, cos 2θ, 1, the row counted from the end of the sector, and the readings less the pilot.
    end : int
        Row behind its last one.
    follows : bool
        Whether it begins where the last one handed on ended.
    """

    products: Array
    end: int
    follows: bool


@dataclass(frozen=True)
class Notice:
    """The stream is held, or goes on.

    Attributes
    ----------
    row : int
        Counted from 0.
    why : str
        Why it is held; empty where it goes on.
    """

    row: int
    why: str

    def __str__(self) -> str:
        return f"row {self.row}: held, {self.why}" if self.why else f"row {self.row}: goes on"


class _OpenSector:
    """A sector that has not ended yet."""

    def __init__(self, start: int, size: int, why_not: str | None) -> None:
        self.start = start
        self.used = 0
        self.why_not = why_not
        self.partial = why_not is not None
        self.products = np.zeros((size, size))


class SectorStream:
    """Cuts a stream into sectors.

    Attributes
    ----------
    rows : int
        That came in.
    missing : int
        Of them, those with a missing value.
    turns : float
        Of the sectors that were handed on.
    why : str
        Why the stream is held now; empty where it is not.
    """

    def __init__(self, channels: int) -> None:
        self.rows = 0
        self.missing = 0
        self.turns = 0.0
        self.why = "the stage has not turned yet"
        self._size = READINGS + channels
        self._stage = AngleTracker()
        self._pilot: Array | None = None
        self._open: _OpenSector | None = None
        self._number: int | None = None
        self._handed: int | None = None
        self._highest = -np.inf
        self._lowest: float | None = None
        self._typical: deque[int] = deque(maxlen=_TYPICAL)
        self._entered = self._gaps = 0

    @property
    def coarse(self) -> bool:
        """Whether the angle jumps over sectors so often that it cannot be followed."""
        return self._gaps > _MOST_GAPS * self._entered

    def push(self, theta: Array, readings: Array) -> list[Sector | Notice]:
        """Take samples, and return the sectors that they end, and where the stream is held and goes on, in order.

        Parameters
        ----------
        theta : ndarray, shape (n,)
            Degrees; NaN where it is missing.
        readings : ndarray, shape (n, channels)
            NaN where a value is missing.
        """
        first, self.rows = self.rows, self.rows + len(theta)
        known = np.flatnonzero(np.isfinite(theta)).astype(np.int64)
        turns = self._stage.follow(theta[known])
        whole: Mask = np.asarray(np.isfinite(readings).all(axis=1))
        self.missing += len(theta) - int(np.count_nonzero(whole[known]))
        found: list[Sector | Notice] = []
        start = 0
        while start < len(known):
            if self._lowest is None:
                start = self._forwards(start, turns, known + first, readings[known], whole[known], found)
            else:
                start = self._backwards(start, turns, self._lowest)
        self._watch_standing(found)
        return found

    def _forwards(
        self, start: int, turns: Array, rows: Rows, readings: Array, whole: Mask, found: list[Sector | Notice]
    ) -> int:
        """Go on to the end, or to where the stage runs backwards."""
        highest = np.maximum.accumulate(np.maximum(turns[start:], self._highest))
        behind = np.flatnonzero(highest - turns[start:] > _BACKWARDS)
        end = start + int(behind[0]) if len(behind) else len(turns)
        if end > start:
            self._highest = float(highest[end - start - 1])
            number = np.floor(highest[: end - start] * SECTORS).astype(np.int64)
            cuts = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), end - start]
            for a, b in pairwise(cuts):
                part = slice(start + a, start + b)
                self._enter(int(number[a]), int(rows[start + a]), found)
                self._add(turns[part], rows[part], readings[part], whole[part])
        if len(behind):
            self._hold(int(rows[end]), "the stage runs backwards", found)
            self._open = self._number = self._handed = None
            self._lowest = float(turns[end])
        return end

    def _backwards(self, start: int, turns: Array, lowest: float) -> int:
        """Wait until the stage turns forwards again."""
        lows = np.minimum.accumulate(np.minimum(turns[start:], lowest))
        risen = np.flatnonzero(turns[start:] - lows > _BACKWARDS)
        self._lowest = float(lows[-1])
        if not len(risen):
            return len(turns)
        self._lowest, self._highest = None, float(turns[start + int(risen[0])])
        return start + int(risen[0])

    def _enter(self, number: int, row: int, found: list[Sector | Notice]) -> None:
        """Come to a row of a sector: end the one before, where it is another."""
        if number == self._number:
            return
        self._entered += 1
        gap = self._number is not None and number != self._number + 1
        if gap:
            self._gaps += 1
            self._hold(row, COARSE if self.coarse else GAP, found)
        elif self._open is not None:
            self._close(self._open, row, found)
        # The stream came into the first sector, and into the one behind a gap, in its middle.
        whole = self._number is not None and not gap
        self._open = _OpenSector(row, self._size, None if whole else "begun in its middle")
        self._number = number

    def _add(self, turns: Array, rows: Rows, readings: Array, whole: Mask) -> None:
        sector = self._open
        if sector is None or sector.why_not is not None or not whole.any():
            return
        if self._pilot is None:
            self._pilot = readings[int(np.argmax(whole))].copy()
        # Rows are counted from the sector's start, and from its end once that is known.
        table = np.concatenate(
            [
                harmonic_columns(turns[whole], HARMONICS),
                (rows[whole] - sector.start)[None, :],
                (readings[whole] - self._pilot).T,
            ]
        )
        sector.products += table @ table.T
        sector.used += table.shape[1]

    def _close(self, sector: _OpenSector, end: int, found: list[Sector | Notice]) -> None:
        """Hand a sector on, or say why not."""
        length = end - sector.start
        if sector.why_not is None and self._standing(length):
            sector.why_not = STANDS
            self._hold(self._standing_from(sector), STANDS, found)
        if sector.why_not is None and sector.used < _COMPLETE * length:
            sector.why_not = "values are missing"
            self._hold(sector.start, sector.why_not, found)
        if not sector.partial:
            # A stage that has become slow for good is typical after a while.
            self._typical.append(length)
        if sector.why_not is not None:
            return
        if self.why:
            if self.turns:
                found.append(Notice(sector.start, ""))
            self.why = ""
        self.turns += 1.0 / SECTORS
        found.append(Sector(moved(sector.products, length), end, follows=self._handed == sector.start))
        self._handed = end

    def _standing(self, length: int) -> bool:
        return len(self._typical) >= SECTORS and length > _STANDING * median(self._typical)

    def _watch_standing(self, found: list[Sector | Notice]) -> None:
        """Say that the stage stands as soon as that is clear, not when it turns again."""
        sector = self._open
        if sector is None or sector.why_not is not None or not self._standing(self.rows - sector.start):
            return
        sector.why_not = STANDS
        self._hold(self._standing_from(sector), STANDS, found)

    def _standing_from(self, sector: _OpenSector) -> int:
        """Return the row with which that was clear."""
        return sector.start + floor(_STANDING * median(self._typical)) + 1

    def _hold(self, row: int, why: str, found: list[Sector | Notice]) -> None:
        if why != self.why:
            found.append(Notice(row, why))
        self.why = why


def moved(products: Array, rows: int | Rows) -> Array:
    """Return products of the demodulating columns in which rows are counted from a row that is so many rows later.

    Parameters
    ----------
    products : ndarray, shape (..., n, m)
        With the columns first, and what else is multiplied by them behind.
    rows : int or ndarray, shape (...)
    """
    found = products.copy()
    back = np.asarray(rows, float)[..., None]
    found[..., DRIFT, :] -= back * found[..., ONE, :]
    found[..., :, DRIFT] -= back * found[..., :, ONE]
    return found
