"""Derivatives of a function that is known by its values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tiltcal.core.model import Array


def central_differences(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """Return the derivatives of a function by its parameters, from its values on both sides; shape (m, k).

    Parameters
    ----------
    function : callable
        From the parameters, shape (k,), to values, shape (m,).
    at : ndarray, shape (k,)
    steps : ndarray, shape (k,)
        How far to either side; a parameter whose step is 0 counts as certain, and its column is 0.
    """
    moves = np.diag(np.where(steps > 0.0, steps, 0.0))
    columns = [(function(at + move) - function(at - move)) / (2.0 * (move.sum() or 1.0)) for move in moves]
    return np.stack(columns, axis=1) if columns else np.zeros((len(function(at)), 0))
