"""Coefficients by their dotted names, and the same coefficients at another reference temperature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tiltcal.core.model import Array, Coefficients, polynomial, vector_of, with_vector
from tiltcal.core.uncertain import TURN, Uncertain, central_differences

_STEP = 1e-4
"""Of an uncertainty, by which its coefficient is moved to see how others follow."""


def values(coefficients: Coefficients) -> dict[str, float]:
    """Return every coefficient by its dotted name."""
    named = {f"offset.{c}": float(v) for c, v in zip(coefficients.channels, coefficients.offset, strict=True)}
    for channel, row in zip(coefficients.channels, coefficients.sensitivity, strict=True):
        named |= {f"sensitivity.{channel}.{axis}": float(v) for axis, v in zip(coefficients.axes, row, strict=True)}
    if coefficients.thermal is not None:
        for what, table in (("offset", coefficients.thermal.drift), ("sensitivity", coefficients.thermal.gain)):
            for channel, row in zip(coefficients.channels, table, strict=True):
                named |= {f"temperature.{what}.{channel}.{k}": float(v) for k, v in enumerate(row, start=1)}
    if coefficients.nonlinearity is not None:
        for channel, row in zip(coefficients.channels, coefficients.nonlinearity, strict=True):
            named |= {f"nonlinearity.{channel}.{k}": float(v) for k, v in enumerate(row, start=2)}
    return named


def referred(coefficients: Coefficients, reference: float | None) -> Coefficients:
    """Return the same coefficients at another reference temperature.

    Parameters
    ----------
    coefficients : Coefficients
        Without temperature terms they are the same at every temperature.
    reference : float or None
        °C; None for their own.

    Notes
    -----
    A polynomial p(dT) without a constant term becomes p(dT + s) - p(s) with s the shift of the reference; the offset
    takes p(s) over, and the sensitivity the factor 1 + gain(s), by which the new gain is divided.
    """
    thermal = coefficients.thermal
    if thermal is None or reference is None or thermal.reference == reference:
        return coefficients
    shift = reference - thermal.reference
    drift, gain = (
        np.array([polynomial(row, np.array(shift)) for row in table]) for table in (thermal.drift, thermal.gain)
    )
    return replace(
        coefficients,
        offset=coefficients.offset + drift,
        sensitivity=coefficients.sensitivity * (1.0 + gain)[:, None],
        thermal=replace(
            thermal,
            reference=reference,
            drift=_shifted(thermal.drift, shift),
            gain=_shifted(thermal.gain, shift) / (1.0 + gain)[:, None],
        ),
    )


def uncertain_at(coefficients: Coefficients, uncertain: Uncertain, reference: float | None) -> Uncertain:
    """Return the errors of coefficients at another reference temperature, °C, from those at their own.

    A turn of the mounting stays as it is; a coefficient that has become certain is left out.
    """
    thermal = coefficients.thermal
    if thermal is None or reference is None or thermal.reference == reference:
        return uncertain
    own, turns = uncertain.without(TURN), [name for name in uncertain.names if name.startswith(TURN)]
    names = list(values(coefficients))

    def at(vector: Array) -> Array:
        return vector_of(referred(with_vector(coefficients, own.names, vector), reference), names)

    jacobian = np.zeros((len(names) + len(turns), len(uncertain.names)))
    places = [uncertain.names.index(name) for name in own.names]
    jacobian[: len(names), places] = central_differences(at, vector_of(coefficients, own.names), _STEP * own.u)
    for row, name in enumerate(turns, start=len(names)):
        jacobian[row, uncertain.names.index(name)] = 1.0
    moved = uncertain.through(jacobian, (*names, *turns))
    return moved.chosen(np.flatnonzero(moved.u > 0.0))


def _shifted(table: Array, shift: float) -> Array:
    """Return the coefficients of p(dT + shift) - p(shift), row by row, without the constant term."""
    rows = []
    for row in table:
        moved = np.polynomial.Polynomial([0.0, *row])(np.polynomial.Polynomial([shift, 1.0]))
        rows.append(np.pad(moved.coef[1:], (0, len(row) - len(moved.coef[1:]))))
    return np.array(rows, dtype=float).reshape(table.shape)
