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
from tiltcal.core.pair.demodulate import bounds_of
from tiltcal.core.pair.matching import Matching
from tiltcal.core.pair.model import matched_sum
from tiltcal.core.pair.stage import follow

GRADIENT = "gradient"


class PairCompensation:
    """One or two matched pairs, ready for the rows of a log, block after block, of their ``channels`` in this order.

    It adds ``columns`` to a log; two pairs give the gradient, and with ``phase``, the column of the stage angle in
    degrees, its components at twice the turning.
    """

    def __init__(self, matchings: Sequence[Matching], phase: str | None) -> None:
        self._matchings = tuple(matchings)
        self._readings = tuple(dict.fromkeys(name for matching in matchings for name in matching.pair.channels))
        self._turns = TurnByTurn() if phase is not None and len(matchings) == 2 else None
        self.channels = self._readings if self._turns is None else (*self._readings, str(phase))
        sums = (f"matched_{matching.pair.name}" for matching in matchings)
        gradient = (GRADIENT,) if len(matchings) == 2 else ()
        turning = () if self._turns is None else (f"{GRADIENT}_sin", f"{GRADIENT}_cos")
        self.columns = (*sums, *gradient, *turning, "flag", "reason")

    def __call__(self, readings: Array) -> dict[str, Array | Bytes | Reasons]:
        """Return the columns of some rows by name; ``readings``, shape (n, channels), are NaN where one is missing."""
        by_name = dict(zip(self.channels, readings.T, strict=True))
        values = []
        for matching in self._matchings:
            first, second, orthogonal = (by_name[channel] for channel in matching.pair.channels)
            values.append(matched_sum(first, second, orthogonal, matching.p, matching.q))
        if len(values) == 2:
            one, other = self._matchings
            scale = _amplitude(one) / _amplitude(other)
            values.append(values[0] / one.gradient_gain - scale * values[1] / other.gradient_gain)
        if self._turns is not None:
            values += self._turns(by_name[self.channels[-1]], values[-1])
        lost = ~np.isfinite(readings[:, : len(self._readings)]).all(axis=1)
        for column in values:
            column[lost] = np.nan
        flag, reason = (np.where(lost, *pair) for pair in ((MISSING, PASS), (NOT_A_NUMBER, 0)))
        return dict(zip(self.columns, (*values, flag.astype(np.uint8), reason.astype(np.uint16)), strict=True))


class TurnByTurn:
    """Demodulates a signal at twice the turning: each row has the components of the last whole turn before its own."""

    def __init__(self) -> None:
        self._latest, self._begun = np.full(2, np.nan), 0  # the first turn that has begun is not whole
        self._rows = np.empty((2, 0))  # angle in turns, and signal, in the turn in progress

    def __call__(self, theta: Array, signal: Array) -> list[Array]:
        """Return the sin 2θ and cos 2θ component for each row, NaN before the first whole turn; θ in degrees, (n,)."""
        components, start = np.full((2, len(theta)), np.nan), 0
        good, before = np.flatnonzero(np.isfinite(theta) & np.isfinite(signal)), self._rows.shape[1]
        angle = follow(theta[good], float(self._rows[0, -1]) if before else None)
        rows = np.concatenate([self._rows, np.stack([angle, signal[good]])], axis=1)
        *bounds, _ = bounds_of(np.maximum.accumulate(np.floor(rows[0])))
        for begin, end in pairwise(bounds):
            components[:, start : good[end - before]] = self._latest[:, None]
            start = int(good[end - before])
            if self._begun:
                turns = 2.0 * np.pi * np.outer([1.0, 2.0], rows[0, begin:end])
                columns = np.vstack([np.sin(turns), np.cos(turns), np.ones(end - begin)]).T
                self._latest = np.linalg.lstsq(columns, rows[1, begin:end], rcond=None)[0][[1, 3]]
            self._begun += 1
        components[:, start:] = self._latest[:, None]
        self._rows = rows[:, bounds[-1] :]
        return list(components)


def _amplitude(matching: Matching) -> float:
    return matching.components["before"][matching.pair.first].amplitude
