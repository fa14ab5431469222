"""The kernel that applies a matching: matched sums of readings and, with both pairs, the gradient signal.

With both pairs matched, the paper's eq. 2 holds without its common acceleration::

    (a1 + a2) - (a3 + a4) = 2 R (Γxx - Γyy) sin 2θ + 4 R Γxy cos 2θ

The orthogonal accelerometer reads a gradient too, with the opposite sign, so a matched sum shows it a little smaller
(by about q / 2); each pair is divided by its own gain, and both are brought to the scale of the first accelerometer.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from tiltcal.core.flags import MISSING, NOT_A_NUMBER, PASS, Bytes, Reasons
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import harmonic_columns
from tiltcal.core.pair.matching import Matching
from tiltcal.core.pair.model import matched_sum
from tiltcal.core.pair.stage import follow

GRADIENT = "gradient"
_HARMONICS = 2


class PairCompensation:
    """One or two matched pairs, ready to be applied to the rows of a log, block after block in order.

    Two of them give the gradient; with ``phase``, the column of the stage angle in degrees, it is demodulated. A row
    holds the ``channels``, in this order.
    """

    def __init__(self, matchings: Sequence[Matching], phase: str | None) -> None:
        self._matchings = tuple(matchings)
        self._readings = tuple(dict.fromkeys(name for matching in matchings for name in matching.pair.channels))
        self._turns = TurnByTurn() if phase is not None and len(matchings) == 2 else None
        self.channels = self._readings if self._turns is None else (*self._readings, str(phase))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that the result adds to a log."""
        names = [f"matched_{matching.pair.name}" for matching in self._matchings]
        if len(self._matchings) == 2:
            names.append(GRADIENT)
        if self._turns is not None:
            names += [f"{GRADIENT}_sin", f"{GRADIENT}_cos"]
        return (*names, "flag", "reason")

    def __call__(self, readings: Array) -> dict[str, Array | Bytes | Reasons]:
        """Return the columns of some rows by name; ``readings``, shape (n, channels), are NaN where one is missing."""
        by_name = dict(zip(self.channels, readings.T, strict=True))
        sums = []
        for matching in self._matchings:
            first, second, orthogonal = (by_name[channel] for channel in matching.pair.channels)
            sums.append(matched_sum(first, second, orthogonal, matching.p, matching.q))
        values = {f"matched_{m.pair.name}": sum_ for m, sum_ in zip(self._matchings, sums, strict=True)}
        if len(sums) == 2:
            values[GRADIENT] = self._gradient(sums)
        if self._turns is not None:
            sines, cosines = self._turns(by_name[self.channels[-1]], values[GRADIENT])
            values |= {f"{GRADIENT}_sin": sines, f"{GRADIENT}_cos": cosines}
        lost = ~np.isfinite(readings[:, : len(self._readings)]).all(axis=1)
        for column in values.values():
            column[lost] = np.nan
        flag, reason = (np.where(lost, *pair) for pair in ((MISSING, PASS), (NOT_A_NUMBER, 0)))
        return {**values, "flag": flag.astype(np.uint8), "reason": reason.astype(np.uint16)}

    def _gradient(self, sums: Sequence[Array]) -> Array:
        first, other = self._matchings
        scale = _amplitude(first) / _amplitude(other)
        return np.asarray(sums[0] / first.gradient_gain - scale * sums[1] / other.gradient_gain)


class TurnByTurn:
    """Demodulates a signal at twice the turning: every row has the components of the last whole turn before its own."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._turn: int | None = None
        self._whole = False
        self._products = np.zeros((0, 0))
        self._latest = (np.nan, np.nan)

    def __call__(self, theta: Array, signal: Array) -> tuple[Array, Array]:
        """sin 2θ and cos 2θ component for each row, NaN before the first whole turn; θ in degrees, all shapes (n,)."""
        components = np.full((2, len(theta)), np.nan)
        good = np.flatnonzero(np.isfinite(theta) & np.isfinite(signal))
        angle = follow(theta[good], self._last)
        turn = np.maximum.accumulate(np.floor(angle).astype(np.int64))
        table = np.concatenate([harmonic_columns(angle, _HARMONICS), signal[good][None, :]])
        begun = 0
        for start, end in pairwise([0, *(np.flatnonzero(np.diff(turn)) + 1).tolist(), len(turn)] if len(turn) else []):
            if int(turn[start]) != self._turn:
                components[:, begun : good[start]] = np.array(self._latest)[:, None]
                begun = int(good[start])
                self._close(int(turn[start]), len(table))
            part = table[:, start:end]
            self._products = self._products + part @ part.T
        components[:, begun:] = np.array(self._latest)[:, None]
        self._last = float(angle[-1]) if len(angle) else self._last
        return components[0], components[1]

    def _close(self, turn: int, size: int) -> None:
        """End a turn and begin the next; the very first one is not whole."""
        if self._whole:
            solved = np.linalg.lstsq(self._products[:-1, :-1], self._products[:-1, -1], rcond=None)[0]
            self._latest = (float(solved[2]), float(solved[3]))
        self._whole = self._turn is not None
        self._turn = turn
        self._products = np.zeros((size, size))


def _amplitude(matching: Matching) -> float:
    return matching.components["before"][matching.pair.first].amplitude
