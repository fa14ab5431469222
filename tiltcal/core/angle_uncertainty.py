"""A compensation with the uncertainty of every angle, row by row; see :mod:`tiltcal.core.uncertainty_propagation`."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan, pi

import numpy as np
from numpy.typing import ArrayLike

from tiltcal.core.compensation import Compensated, Compensation
from tiltcal.core.model import AXES, Array, Coefficients, Limits, overlap
from tiltcal.core.uncertain import TURN, Uncertain
from tiltcal.core.uncertainty_propagation import Propagation

_ATTITUDES, _ROUNDING = 9, 1e-9  # values of g_x and of g_y at which the length of gravity is tried; g


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

    def __init__(self, compensation: Compensation, coefficients: Coefficients, uncertain: Uncertain) -> None:
        self._compensation = compensation
        self.propagation = Propagation(compensation, coefficients, uncertain)
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


def length_half_width(coefficients: Coefficients, limits: Limits, uncertain: Uncertain) -> float:
    """Return half of the widest 95 % interval of the length of gravity of three axes over the calibrated range, g.

    It is that of the coefficients and of a single reading; 0 where no attitude was covered.
    """
    uncertain = uncertain.without(TURN)  # a turn changes no length
    ends = (limits.tilt.get(axis, (-pi / 2, pi / 2)) for axis in AXES)
    x, y, z = (np.sin(np.linspace(low, high, _ATTITUDES)) for low, high in ends)
    g_x, g_y, side = np.meshgrid(x, y, np.array([1.0, -1.0]))
    square = 1.0 - g_x**2 - g_y**2
    g_z = side * np.sqrt(np.maximum(square, 0.0))
    reached = (square > -_ROUNDING) & (g_z >= z[0] - _ROUNDING) & (g_z <= z[-1] + _ROUNDING)
    gravity = np.stack([g_x, g_y, g_z], axis=-1)[reached]
    thermal = coefficients.thermal
    covered = None if thermal is None else overlap(limits.temperature, thermal.range)
    temperatures = (nan,) if thermal is None else (thermal.reference, *(covered or ()))
    gravity, temperature = np.tile(gravity, (len(temperatures), 1)), np.repeat(temperatures, len(gravity))
    compensation, out = Compensation(coefficients), Compensated.empty(len(gravity), 3)
    propagation = Propagation(compensation, coefficients, uncertain)
    chunks = compensation.chunks(coefficients.predict(gravity, temperature), temperature, out)
    return max((float(propagation.length_half_width(chunk).max()) for chunk in chunks), default=0.0)
