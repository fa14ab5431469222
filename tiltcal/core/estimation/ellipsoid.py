"""The ellipsoid on which the readings of a three-axis sensor at rest lie, whatever way it is held.

With |g| = 1 the attitudes drop out of the model of :mod:`tiltcal.core.model`, and each position leaves one number, by
how much the length of gravity is missed::

    misfit_n = |S^-1 (u_n - offset)| - 1

``S`` is upper triangular: a turn of all attitudes together changes no length. This is the estimator's unit-gravity fit
with the attitudes eliminated: nine unknowns instead of nine and two a position. It is quick enough to judge many
choices of positions, and gives the estimator its start; its own comes from an algebraic fit, linear in nine numbers, of
``(u - offset)ᵀ (S Sᵀ)⁻¹ (u - offset) = 1``.

Source: D. Tedaldi, A. Pretto, E. Menegatti, *A robust and easy to implement method for IMU calibration without external
equipments* (2014), which minimises the same misfits.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, inf, radians, sqrt

import numpy as np

from tiltcal.core.coverage_factor import coverage_factor
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

DIFFERENT_ATTITUDE = 5.0
"""Attitudes closer than this are one attitude taken again, degrees."""

STEPS = 50
"""Most Gauss-Newton steps; from the algebraic fit it takes three to five."""

_UPPER = tuple((row, column) for row in range(3) for column in range(row, 3))
UNKNOWNS = 3 + len(_UPPER)


@dataclass(frozen=True)
class Ellipsoid:
    """Ellipsoid through the readings of free positions.

    Attributes
    ----------
    offset : ndarray, shape (3,)
        Its centre, unit.
    sensitivity : ndarray, shape (3, 3)
        Upper triangular, unit/g.
    attitudes : ndarray, shape (n, 3)
        Unit vectors that point up, one for each reading.
    misfit : ndarray, shape (n,)
        By how much each length of gravity differs from 1, g.
    noise : float
        Root mean square of the misfits that the uncertainties of the readings explain, g.
    spread : float
        Standard uncertainty of the nine unknowns on average, for misfits of 1 g, in units of the sensitivity.
    """

    offset: Array
    sensitivity: Array
    attitudes: Array
    misfit: Array
    noise: float
    spread: float

    @property
    def distinct(self) -> int:
        """Number of attitudes that differ from each other by at least :data:`DIFFERENT_ATTITUDE`."""
        return count_distinct(self.attitudes)

    @property
    def rms(self) -> float:
        """Root of the mean squared misfit, g."""
        return float(np.sqrt(np.mean(self.misfit**2)))

    @property
    def scatter(self) -> float:
        """Standard deviation of a misfit, g: from the residuals, and never less than the noise.

        Misfits below the noise are due to chance, or to too few positions.
        """
        dof = len(self.misfit) - UNKNOWNS
        return max(self.noise, sqrt(float(np.sum(self.misfit**2)) / dof)) if dof > 0 else inf

    @property
    def expanded(self) -> float:
        """Expanded uncertainty (95 %) of the nine unknowns on average, in units of the sensitivity.

        Infinite unless there are more distinct attitudes than unknowns: nine fit anything.
        """
        if self.distinct <= UNKNOWNS:
            return inf
        student = float(coverage_factor(np.array([float(len(self.misfit) - UNKNOWNS)]))[0])
        return student * self.scatter * self.spread


def count_distinct(attitudes: Array) -> int:
    """Count the unit vectors, shape (n, 3), that differ by :data:`DIFFERENT_ATTITUDE` from each one counted before."""
    count, left = 0, attitudes
    while len(left):
        count, left = count + 1, left[1:][left[1:] @ left[0] < cos(radians(DIFFERENT_ATTITUDE))]
    return count


def misfits(mean: Array, offset: Array, sensitivity: Array) -> Array:
    """Compute the differences of the measured lengths of gravity from 1 g, shape (n,), g.

    Parameters
    ----------
    mean : ndarray, shape (n, 3)
        Readings, unit.
    offset : ndarray, shape (3,)
        Unit.
    sensitivity : ndarray, shape (3, 3)
        Unit/g.
    """
    return _seen(mean, offset, sensitivity)[1] - 1.0


def fit_ellipsoid(mean: Array, u: Array) -> Ellipsoid:
    """Fit an ellipsoid to mean readings, all with the same weight.

    Parameters
    ----------
    mean : ndarray, shape (n, 3)
        Mean readings of three channels in n positions, unit.
    u : ndarray, shape (n, 3)
        Their standard uncertainties, same unit.

    Raises
    ------
    EstimateError
        The readings are fewer than nine, or lie on no ellipsoid.
    """
    offset, sensitivity = _start(mean)
    for _ in range(STEPS):
        gravity, length, by_reading = _seen(mean, offset, sensitivity)
        jacobian = _jacobian(gravity, by_reading)
        # All unknowns are counted in units of the first sensitivity, so that they are of one size.
        size = sensitivity[0, 0]
        change = np.linalg.lstsq(jacobian * size, 1.0 - length, rcond=None)[0] * size
        offset = offset + change[:3]
        sensitivity = sensitivity.copy()
        for place, step in zip(_UPPER, change[3:], strict=True):
            sensitivity[place] += step
        if not np.all(np.isfinite(change)) or np.any(np.diag(sensitivity) <= 0.0):
            raise EstimateError("the readings lie on no ellipsoid: hold the sensor in attitudes that point every way")
        if np.max(np.abs(change)) <= 1e-12 * size:
            break
    gravity, length, by_reading = _seen(mean, offset, sensitivity)
    inverse = np.linalg.pinv(_jacobian(gravity, by_reading) * float(np.mean(np.diag(sensitivity))))
    return Ellipsoid(
        offset=offset,
        sensitivity=sensitivity,
        attitudes=gravity / length[:, None],
        misfit=length - 1.0,
        noise=float(np.sqrt(np.mean(np.sum((by_reading * u) ** 2, axis=1)))),
        spread=float(np.sqrt(np.mean(np.sum(inverse**2, axis=1)))),
    )


def directions_from_readings(mean: Array) -> Array:
    """Return a first guess at the directions of gravity, by an algebraic fit of the ellipsoid.

    Parameters
    ----------
    mean : ndarray, shape (n, 3)
        Mean readings of three channels in n free positions, any unit; at least nine, spread over the sphere.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit vectors, in the frame in which the sensitivity matrix is upper triangular with positive diagonal: a
        channel that is mounted against its axis shows up in the other two.

    Raises
    ------
    EstimateError
        The readings do not lie on an ellipsoid.
    """
    centre, scale = mean.mean(axis=0), float(np.max(np.ptp(mean, axis=0)))
    if len(mean) < 9 or scale == 0.0:
        raise EstimateError(f"{len(mean)} free positions; an ellipsoid takes at least nine, well spread")
    x, y, z = ((mean - centre) / scale).T
    terms = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
    a, b, c, d, e, f, *half = np.linalg.lstsq(terms, np.ones(len(mean)), rcond=None)[0]
    shape = np.array([[a, d, e], [d, b, f], [e, f, c]])
    try:
        offset = -np.linalg.solve(shape, half)
        # sᵀ shape s = 1 + offsetᵀ shape offset; S Sᵀ is the inverse of the normalised shape.
        factor = np.linalg.cholesky(shape / (1.0 + offset @ shape @ offset))
    except np.linalg.LinAlgError:
        raise EstimateError(
            "the readings do not lie on an ellipsoid: lay the sensor on more sides, each axis up and down among them"
        ) from None
    # shape = L Lᵀ and S⁻¹ upper triangular with S⁻ᵀ S⁻¹ = shape: S⁻¹ = Lᵀ.
    gravity = (np.stack([x, y, z], axis=1) - offset) @ factor
    unit: Array = gravity / np.linalg.norm(gravity, axis=1, keepdims=True)
    return unit


def _start(mean: Array) -> tuple[Array, Array]:
    """Return offset and sensitivity by linear least squares against the first guess at the directions."""
    directions = directions_from_readings(mean)
    table = np.linalg.lstsq(np.hstack([np.ones((len(mean), 1)), directions]), mean, rcond=None)[0]
    return table[0], np.triu(table[1:].T)


def _seen(mean: Array, offset: Array, sensitivity: Array) -> tuple[Array, Array, Array]:
    """Return gravity after the ellipsoid's compensation, its length, and the derivative of that by each reading."""
    inverse = np.linalg.inv(sensitivity)
    gravity: Array = (mean - offset) @ inverse.T
    length: Array = np.linalg.norm(gravity, axis=1)
    by_reading: Array = (gravity / length[:, None]) @ inverse
    return gravity, length, by_reading


def _jacobian(gravity: Array, by_reading: Array) -> Array:
    """Return the derivatives of the lengths by offset and S."""
    return np.hstack(
        [-by_reading, np.stack([-by_reading[:, row] * gravity[:, column] for row, column in _UPPER], axis=1)]
    )
