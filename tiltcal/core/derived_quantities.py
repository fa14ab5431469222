"""Derived quantities of the sensitivity matrix: cross-axis sensitivities and misalignment angles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import atan2, degrees, hypot

import numpy as np

from tiltcal.core.closed_forms import cross_axis_sensitivity
from tiltcal.core.model import AXES, Array, Coefficients, vector_of, with_vector
from tiltcal.core.uncertainty_budget import propagated
from tiltcal.core.uncertainty_inputs import UncertaintyInputs


@dataclass(frozen=True)
class DerivedQuantity:
    """A number with its standard uncertainty, in the same unit, and the factor of that for an interval of 95 %."""

    value: float
    u: float
    factor: float


def cross_axis(coefficients: Coefficients) -> dict[str, float]:
    """Return the cross-axis sensitivity of each channel, % (Cross-axis Compensation, eq. 1).

    A column that was not determined counts as zero; a channel whose own axis was not determined is left out.
    """
    shares = {}
    for channel in coefficients.channels:
        if channel in coefficients.axes:
            own, others = _row(coefficients, channel)
            shares[channel] = float(cross_axis_sensitivity(own, *others))
    return shares


def misalignment(coefficients: Coefficients) -> dict[str, float]:
    """Return the angle between each channel's sensitive direction and its nominal axis, degrees."""
    angles = {}
    for channel in coefficients.channels:
        if channel in coefficients.axes:
            own, others = _row(coefficients, channel)
            angles[channel] = degrees(atan2(hypot(*others), own))
    return angles


def derived(
    quantity: Callable[[Coefficients], dict[str, float]], coefficients: Coefficients, uncertain: UncertaintyInputs
) -> dict[str, DerivedQuantity]:
    """Compute a quantity that follows from the coefficients, by channel, with its uncertainty.

    Parameters
    ----------
    quantity : callable
        :func:`cross_axis` or :func:`misalignment`.
    uncertain : UncertaintyInputs
        Without turns of the mounting.
    """
    found = quantity(coefficients)
    return with_uncertainty(
        list(found), lambda moved: np.array(list(quantity(moved).values())), coefficients, uncertain
    )


def with_uncertainty(
    names: Sequence[str],
    function: Callable[[Coefficients], Array],
    coefficients: Coefficients,
    uncertain: UncertaintyInputs,
) -> dict[str, DerivedQuantity]:
    """Compute named values of a function of the coefficients, with their uncertainties."""
    u, factors = propagated(
        lambda vector: function(with_vector(coefficients, uncertain.names, vector)),
        vector_of(coefficients, uncertain.names),
        uncertain.covariance,
        uncertain.factors,
    )
    each = zip(function(coefficients).tolist(), u.tolist(), factors.tolist(), strict=True)
    return {name: DerivedQuantity(*values) for name, values in zip(names, each, strict=True)}


def _row(coefficients: Coefficients, channel: str) -> tuple[float, list[float]]:
    """Return the sensitivity of a channel to its own axis, and to the two others."""
    row = dict(
        zip(coefficients.axes, coefficients.sensitivity[coefficients.channels.index(channel)].tolist(), strict=True)
    )
    return row[channel], [row.get(axis, 0.0) for axis in AXES if axis != channel]
