"""Coefficients by their dotted names, and the same coefficients at another reference temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.model import Array, Coefficients, polynomial
from tiltcal.core.uncertain import TURN, Uncertain, central_differences
from tiltcal.errors import EstimateError

_STEP = 1e-4  # of an uncertainty, by which its coefficient is moved to see how others follow


_KINDS = ("offset.", "sensitivity.", "temperature.offset.", "temperature.sensitivity.", "nonlinearity.")
"""The order in which coefficients are named."""


def values(coefficients: Coefficients) -> dict[str, float]:
    """Return every coefficient by its dotted name."""
    named = dict(zip(_names(coefficients), coefficients.vectors.ravel().tolist(), strict=True))
    return {name: value for kind in _KINDS for name, value in named.items() if name.startswith(kind)}


def vector_of(coefficients: Coefficients, names: Sequence[str]) -> Array:
    """Return the coefficients with some names, shape (k,); an EstimateError where there is none of a name."""
    return coefficients.vectors.ravel()[_places(coefficients, names)]


def with_vector(coefficients: Coefficients, names: Sequence[str], vector: Array) -> Coefficients:
    """Return coefficients with other values for some names, shape (k,)."""
    vectors = coefficients.vectors
    vectors.ravel()[_places(coefficients, names)] = vector
    return coefficients.with_vectors(vectors)


def referred(coefficients: Coefficients, reference: float | None) -> Coefficients:
    """Return the same coefficients at another reference temperature, °C; None for their own.

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


def _names(coefficients: Coefficients) -> list[str]:
    """Return the dotted names, channel by channel, as :attr:`Coefficients.vectors` has them."""
    return [name for model in coefficients.models for name in model.coefficients]


def _places(coefficients: Coefficients, names: Sequence[str]) -> list[int]:
    known = {name: place for place, name in enumerate(_names(coefficients))}
    for name in names:
        if name not in known:
            raise EstimateError(f"the calibration has no coefficient {name!r}")
    return [known[name] for name in names]


def _shifted(table: Array, shift: float) -> Array:
    """Return the coefficients of p(dT + shift) - p(shift), row by row, without the constant term."""
    rows = []
    for row in table:
        moved = np.polynomial.Polynomial([0.0, *row])(np.polynomial.Polynomial([shift, 1.0]))
        rows.append(np.pad(moved.coef[1:], (0, len(row) - len(moved.coef[1:]))))
    return np.array(rows, dtype=float).reshape(table.shape)
