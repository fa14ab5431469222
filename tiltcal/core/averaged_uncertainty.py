"""The uncertainty of means: the share of independent readings, and the share that all have in common."""

from __future__ import annotations

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.uncertainty_columns import round_up


def with_shares(total: Array, common: Array) -> Array:
    """Return what means add to the standard uncertainty: the share of independent readings, then the common one.

    Parameters
    ----------
    total, common : ndarray, shape (2, k, n)
        Standard and expanded uncertainty of k quantities: of the means, and without the noise of readings.

    Returns
    -------
    ndarray, shape (4 k, n)
        Rounded up: standard and expanded uncertainty, then both shares of the standard one.
    """
    random = np.sqrt(np.maximum(total[0] ** 2 - common[0] ** 2, 0.0))
    found = np.concatenate([total[0], total[1], random, common[0]])
    round_up(found)
    return found
