"""The columns of an uncertainty in a log: their names, their digits, and the shares of that of a mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tiltcal.core.model import Array

_SCALES = 10.0 ** np.clip(3 - np.floor(np.log10(2.0) * (np.arange(2048.0) - 1023.0)), 1, 22)  # by biased exponent
_MANTISSA = np.uint64(52)  # bits behind the exponent of a double


def uncertainty_columns(quantities: Sequence[str], *, averaged: bool = False) -> tuple[str, ...]:
    """Return the names of the columns that hold the uncertainties of some quantities; of means, with their shares."""
    leads = ("u_", "U95_", *(("u_random_", "u_common_") if averaged else ()))
    return tuple(f"{lead}{name}" for lead in leads for name in quantities)


def round_up(room: Array, unit: float = 1.0) -> None:
    """Convert numbers that are not negative to a unit, and round them up to four digits, or five, in place."""
    if room.ndim > 1:
        for row in room:
            round_up(row, unit)
        return
    if not len(room):
        return
    ends = np.array([room.min(), room.max()]) * unit
    scale = _scales(ends)
    if scale[0] == scale[1] and np.isfinite(ends).all():
        room *= unit * scale[0]
        scale = scale[:1]
    else:
        room *= unit
        scale = _scales(room)
        room *= scale
    np.ceil(room, out=room)
    room /= scale


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


def _scales(numbers: Array) -> Array:
    """Return the powers of ten by which numbers get as many digits in front of the point as they are to have."""
    exponents = (numbers.view(np.uint64) >> _MANTISSA).view(np.int64)
    return np.asarray(np.take(_SCALES, exponents, mode="clip"))
