"""A compensation with the uncertainty of every angle, row by row; see :mod:`tiltcal.core.uncertainty_propagation`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tiltcal.core.compensation import Compensated, Compensation
from tiltcal.core.model import Array, Coefficients
from tiltcal.core.uncertainty_inputs import UncertaintyInputs
from tiltcal.core.uncertainty_propagation import Propagation


@dataclass(frozen=True)
class AngleUncertainty:
    """What the kernel makes of n rows, and how uncertain its angles are.

    Attributes
    ----------
    standard : ndarray, shape (n, angles)
        Standard uncertainty of each angle (k = 1), degrees, to four digits; NaN where it is not known.
    expanded : ndarray, shape (n, angles)
        Half width of its 95 % interval, degrees.
    """

    compensated: Compensated
    standard: Array
    expanded: Array


class CompensationWithUncertainty:
    """A compensation, of the same coefficients, with the uncertainty of each angle.

    Raises
    ------
    EstimateError
        The coefficients have none of a name, or a mounting is uncertain of a sensor that has no x and y.

    Notes
    -----
    A row has no uncertainty (NaN) where its flag is 4 or 9, where its temperature is missing and counts, and where the
    argument of an arcsine is so far beyond ±1 that its interval does not reach back.
    """

    def __init__(self, compensation: Compensation, coefficients: Coefficients, inputs: UncertaintyInputs) -> None:
        self._compensation = compensation
        self.propagation = Propagation(compensation, coefficients, inputs)
        self._angles = compensation.angles

    @property
    def expanded(self) -> tuple[str, ...]:
        """Names of the columns of a log that hold half widths of 95 % intervals, in the order of the angles."""
        return tuple(f"U95_{angle}" for angle in self._angles)

    def __call__(self, readings: ArrayLike, temperature: ArrayLike | None = None) -> AngleUncertainty:
        """Compensate rows; the arguments are those of :class:`Compensation`."""
        rows = len(np.asarray(readings))
        compensated = Compensated.empty(rows, len(self._compensation.axes))
        standard, expanded = uncertainty = np.empty((2, len(self._angles), rows))
        with np.errstate(all="ignore"):
            for chunk in self._compensation.chunks(readings, temperature, compensated):
                uncertainty[:, :, chunk.rows] = self.propagation(chunk)
        return AngleUncertainty(compensated, standard.T, expanded.T)
