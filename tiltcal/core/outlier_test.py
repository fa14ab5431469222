"""Outliers among the values of many sensors: the generalised extreme Studentised deviate test.

Sources: F. E. Grubbs, *Technometrics* 11 (1969) 1 (one outlier); B. Rosner, *Technometrics* 25 (1983) 165 (several,
none of which hides another).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from tiltcal.core.model import Array

LARGEST_SHARE = 0.25
"""Largest part of the values that may be outliers; one may be in any case."""


def extreme_values(values: Array, false_alarm: float) -> list[int]:
    """Return the places of the values that are too far from the others for a normal distribution, the farthest first.

    Of fewer than three values none is.

    Parameters
    ----------
    values : ndarray, shape (n,)
    false_alarm : float
        The probability that any value of a normal distribution is found.
    """
    from scipy.special import stdtrit

    n = len(values)
    left, removed, found = list(range(n)), [], 0
    for i in range(min(n - 2, max(1, int(LARGEST_SHARE * n)))):
        kept = values[left]
        spread = float(kept.std(ddof=1))
        if not spread > 0.0:
            break
        far = int(np.argmax(np.abs(kept - kept.mean())))
        t = float(stdtrit(n - i - 2, 1.0 - false_alarm / (2.0 * (n - i))))
        limit = (n - i - 1) * t / sqrt((n - i - 2 + t * t) * (n - i))
        extreme = abs(float(kept[far] - kept.mean())) / spread > limit
        removed.append(left.pop(far))
        found = i + 1 if extreme else found
    return removed[:found]
