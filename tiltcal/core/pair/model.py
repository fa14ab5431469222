"""The model of four accelerometers on a turning disk, and what matches a pair of them.

With the in-plane common acceleration a, the stage angle θ and position phases φ of 0, 180, 90 and 270°, accelerometer i
gives::

    I_i = a K_i (sin(θ + φ_i) + δP_i cos(θ + φ_i))  =  S_i sin θ + C_i cos θ

and the matched sum of a pair with an orthogonal third::

    I1 + (I2 + q I4) / (1 - p)

is free of a where (1 - p) (S1, C1) + (S2, C2) + q (S4, C4) = 0. Two equations for two unknowns: solved in K and δP they
are eq. 7 of the source; solved in the components they need no K, no δP and no word on where the angle begins. What all
channels share (an amplitude that wanders, a phase error, the noise of the encoder) multiplies every (S, C) by one and
the same matrix, so it changes neither p nor q.

Source: Misalignment Angle Compensation during Scale Factor Matching (2018), eq. 4, 6 and 7; the minus signs that the
text copy of eq. 6 has lost are put back, and eq. 7 then nulls both components.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiltcal.core.model import Array

FEWEST_TURNS = 2.0  # fewest turns that determine p and q


@dataclass(frozen=True)
class Pair:
    """Which readings make a pair.

    The second one, opposite the first on the disk, is trimmed to it; the orthogonal one takes the misalignment out.
    """

    first: str
    second: str
    orthogonal: str

    @property
    def channels(self) -> tuple[str, str, str]:
        """The three readings, in the order of the equation."""
        return self.first, self.second, self.orthogonal

    @property
    def name(self) -> str:
        """The pair in one word, for a column of a log."""
        return f"{self.first}_{self.second}"


def matched_sum(first: Array, second: Array, orthogonal: Array, p: float, q: float) -> Array:
    """I1 + (I2 + q I4) / (1 - p) of readings, or of components of readings, all of one shape; in their unit."""
    return np.asarray(first + (second + q * orthogonal) / (1.0 - p), dtype=float)


def sum_weights(p: float, q: float) -> Array:
    """Return the weight of each reading in the matched sum: first, second, orthogonal, shape (3,)."""
    return np.array([1.0, 1.0 / (1.0 - p), q / (1.0 - p)])
