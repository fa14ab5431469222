"""Derived quantities of the sensitivity matrix: cross-axis sensitivities and misalignment angles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import atan2, degrees, hypot

import numpy as np

from tiltcal.core.closed_forms import cross_axis_sensitivity
from tiltcal.core.model import AXES, Array, Coefficients, vector_of, with_vector
from tiltcal.core.uncertainty_budget import propagated


def cross_axis(coefficients: Coefficients) -> dict[str, float]:
    """Cross-axis sensitivity of each channel, % (Cross-axis Compensation, eq. 1).

    A column that was not determined counts as zero; a channel whose own axis was not determined is left out.
    """
    shares = {}
    for channel in coefficients.channels:
        if channel in coefficients.axes:
            own, others = _row(coefficients, channel)
            shares[channel] = float(cross_axis_sensitivity(own, *others))
    return shares


def misalignment(coefficients: Coefficients) -> dict[str, float]:
    """Angle between each channel's sensitive direction and its nominal axis, degrees."""
    angles = {}
    for channel in coefficients.channels:
        if channel in coefficients.axes:
            own, others = _row(coefficients, channel)
            angles[channel] = degrees(atan2(hypot(*others), own))
    return angles


def derived_uncertainty(
    quantity: Callable[[Coefficients], dict[str, float]],
    coefficients: Coefficients,
    names: Sequence[str],
    covariance: Array,
) -> dict[str, float]:
    """Standard uncertainty of what follows from the coefficients.

    Parameters
    ----------
    quantity : callable
        :func:`cross_axis` or :func:`misalignment`.
    names : sequence of str
        Dotted names of the uncertain coefficients.
    covariance : ndarray, shape (k, k)

    Returns
    -------
    dict of str to float
        Per channel, in the unit of the quantity.
    """

    def values(vector: Array) -> Array:
        return np.array(list(quantity(with_vector(coefficients, names, vector)).values()))

    u = propagated(values, vector_of(coefficients, names), covariance)
    return dict(zip(quantity(coefficients), u.tolist(), strict=True))


def _row(coefficients: Coefficients, channel: str) -> tuple[float, list[float]]:
    """Sensitivity of a channel to its own axis, and to the two others."""
    row = dict(
        zip(coefficients.axes, coefficients.sensitivity[coefficients.channels.index(channel)].tolist(), strict=True)
    )
    return row[channel], [row.get(axis, 0.0) for axis in AXES if axis != channel]
