"""A calibration as an affine map: g = A (u - b), at its reference temperature.

It is what most programs hold. Two things make a calibration more than that: a bent characteristic, and the third
component of gravity, which a sensor of two channels does not measure. The affine map takes the slope at 0 g for the
first, and for the second the tangent at level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Array, Coefficients


@dataclass(frozen=True)
class Affine:
    """The map g = A (u - b): A in g/unit, shape (axes, channels), and b in the unit, shape (channels,)."""

    matrix: Array
    offset: Array

    def __call__(self, readings: Array) -> Array:
        """Return gravity, shape (n, axes), of readings, shape (n, channels)."""
        return np.asarray((readings - self.offset) @ self.matrix.T)


def affine_of(coefficients: Coefficients) -> Affine:
    """Return the affine map of a calibration.

    EstimateError: the coefficients cannot be turned round.
    """
    compensation = Compensation(coefficients)
    matrix, constant = compensation.inverse, np.zeros(len(compensation.axes))
    rotation = np.eye(3) if compensation.rotation is None else compensation.rotation
    if compensation.solves_z:
        # Near level g lies in the plane up · g = 1, which gives the component that is not measured.
        plane = np.vstack([np.column_stack([np.eye(2), compensation.coupling]), rotation[2]])
        own = rotation[:2] @ np.linalg.inv(plane)
        matrix, constant = own[:, :2] @ matrix, own[:, 2]
    elif compensation.rotation is not None:
        matrix = rotation @ matrix
    return Affine(matrix, coefficients.offset - np.linalg.solve(matrix, constant))
