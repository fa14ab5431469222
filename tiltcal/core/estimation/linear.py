"""The system near its minimum, where every unknown is a linear function of the equations' errors.

``delta = G error``, with ``G`` the pseudo-inverse of the weighted Jacobian and errors in units of their standard
uncertainties: the covariance of the unknowns is ``G Gᵀ``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiltcal.core.estimation.equations import System
from tiltcal.core.estimation.gauss_newton import column_sizes, pseudo_inverse
from tiltcal.core.model import Array


@dataclass(frozen=True)
class LinearSolution:
    """The system near its minimum.

    Attributes
    ----------
    jacobian : ndarray, shape (equations, unknowns)
        Weighted.
    gain : ndarray, shape (unknowns, equations)
        What each equation's error, in its standard uncertainties, does to each unknown.
    """

    jacobian: Array
    gain: Array


def linear(system: System, z: Array) -> LinearSolution:
    """The system near a point; unknowns that are held do not move."""
    jacobian = system.at(z).jacobian
    moving = ~system.fixed
    size = column_sizes(jacobian)
    gain = np.zeros(jacobian.T.shape)
    gain[moving] = pseudo_inverse((jacobian / size)[:, moving]) / size[moving, None]
    return LinearSolution(jacobian, gain)
