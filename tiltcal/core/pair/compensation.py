"""The kernel that applies a matching: matched sums of readings and, with both pairs, the gradient signal.

With both pairs matched, the paper's eq. 2 holds without its common acceleration::

    (a1 + a2) - (a3 + a4) = 2 R (Γxx - Γyy) sin 2θ + 4 R Γxy cos 2θ

The orthogonal accelerometer reads a gradient too, with the opposite sign, so a matched sum shows it a little smaller
(by about q / 2); each pair is divided by its own gain, and both are brought to the scale of the first accelerometer.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tiltcal.core.flags import MISSING, NOT_A_NUMBER, PASS, Bytes, Reasons
from tiltcal.core.model import Array
from tiltcal.core.pair.matching import Matching
from tiltcal.core.pair.model import matched_sum

GRADIENT = "gradient"


class PairCompensation:
    """One or two matched pairs, ready to be applied to rows of readings of their ``channels``, in this order.

    It adds ``columns`` to a log; two pairs give the gradient.
    """

    def __init__(self, matchings: Sequence[Matching]) -> None:
        self._matchings = tuple(matchings)
        self.channels = tuple(dict.fromkeys(name for matching in matchings for name in matching.pair.channels))
        sums = (f"matched_{matching.pair.name}" for matching in matchings)
        self.columns = (*sums, *((GRADIENT,) if len(matchings) == 2 else ()), "flag", "reason")

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
        lost = ~np.isfinite(readings).all(axis=1)
        for column in values:
            column[lost] = np.nan
        flag, reason = (np.where(lost, *pair) for pair in ((MISSING, PASS), (NOT_A_NUMBER, 0)))
        return dict(zip(self.columns, (*values, flag.astype(np.uint8), reason.astype(np.uint16)), strict=True))


def _amplitude(matching: Matching) -> float:
    return matching.components["before"][matching.pair.first].amplitude
