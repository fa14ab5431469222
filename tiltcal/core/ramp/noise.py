"""The noise of a long record: white, and a process whose correlation decays with time.

Their sizes and the correlation time are not known. The restricted likelihood (Patterson and Thompson, 1971) weighs
them, and the covariance is the mean over what it allows: an estimate of them alone would make the intervals too narrow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tiltcal.core.coverage_factor import NORMAL_FACTOR, half_width
from tiltcal.core.model import Array
from tiltcal.core.ramp.means import FittedMeans, slopes_of

_RATIOS = np.concatenate([[0.0], np.geomspace(1e-2, 1e5, 22)])
"""Variance of the process over that of the white noise."""

_PRIOR = np.concatenate([[0.5], np.full(len(_RATIOS) - 1, 0.5 / (len(_RATIOS) - 1))])
"""Half of the weight is on white noise alone."""

_DISTANCES = (1, 2, 4, 8)
"""Means between which second differences are taken; a step of the thermometer may last several."""


def whitener(means: FittedMeans, design: Array, values: Array) -> Array:
    """Return the matrix that makes the noise of a channel white, of variance 1: see :func:`noise_covariance`."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(noise_covariance(means, design, values))))


def joint_least_squares(
    whiteners: Sequence[Array], designs: Sequence[Array], values: Array
) -> tuple[Array, Array, float]:
    """Solve for the unknowns of all channels, of which they share the last one.

    Parameters
    ----------
    whiteners : sequence of ndarray, shape (means, means)
        Of each channel; of shape (means,) where they are diagonal.
    designs : sequence of ndarray, shape (means, p + 1)
        Of each channel; the last column is that of the unknown that they share.
    values : ndarray, shape (means, channels)

    Returns
    -------
    solution : ndarray, shape (channels p + 1,)
        Channel by channel.
    covariance : ndarray, shape (channels p + 1,) twice
    square : float
        The sum of squares of the whitened residuals.
    """
    p, size = designs[0].shape[1] - 1, len(designs) * (designs[0].shape[1] - 1) + 1
    normal, right, square = np.zeros((size, size)), np.zeros(size), 0.0
    for c, (whiten, design) in enumerate(zip(whiteners, designs, strict=True)):
        places = [*range(c * p, (c + 1) * p), size - 1]
        table = np.column_stack([design, values[:, c]])
        table = whiten @ table if whiten.ndim == 2 else whiten[:, None] * table
        x, y = table[:, :-1], table[:, -1]
        normal[np.ix_(places, places)] += x.T @ x
        right[places] += x.T @ y
        square += float(y @ y)
    scale = 1.0 / np.sqrt(np.diag(normal))
    covariance = np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
    solution = covariance @ right
    return solution, covariance, square - float(solution @ right)


def noise_covariance(means: FittedMeans, design: Array, values: Array) -> Array:
    """Return the covariance of the noise of one channel, shape (means, means).

    Parameters
    ----------
    design : ndarray, shape (means, p)
        Columns that the noise is left by; the first is constant.
    values : ndarray, shape (means,)

    Notes
    -----
    Of the mean over sizes and correlation times, what is correlated is scaled so that 1.96 standard uncertainties of
    the constant hold 95 % of its distribution, which is a mixture.
    """
    n, p = design.shape
    x = np.linalg.qr(design)[0]
    off = values - x @ (x.T @ values)
    least = min(_short_variance(off), float(off @ off) / (n - p))
    likelihood, variances, spreads = [], [], []
    for _, eigenvalues, vectors in means.correlations:
        xr, yr = vectors.T @ x, vectors.T @ values
        weight = 1.0 / (1.0 + _RATIOS[:, None] * np.maximum(eigenvalues, 0.0))
        normal = np.einsum("ni,rn,nj->rij", xr, weight, xr, optimize=True)
        solution = np.linalg.solve(normal, ((weight * yr) @ xr)[:, :, None])[:, :, 0]
        left = yr - solution @ xr.T
        square = np.sum(weight * left**2, axis=1)
        variance = np.maximum(square / (n - p), least)
        determinant = np.linalg.slogdet(normal)[1] - np.sum(np.log(weight), axis=1)
        likelihood.append(np.log(_PRIOR) - 0.5 * ((n - p) * np.log(variance) + square / variance + determinant))
        variances.append(variance)
        spreads.append(np.sqrt(variance / normal[:, 0, 0]))
    weights = np.exp(np.array(likelihood) - np.max(likelihood))
    weights /= weights.sum()
    parts = weights * np.array(variances)
    spread, white = np.array(spreads), float(parts.sum())
    half = float(half_width(spread.reshape(1, -1), weights.ravel())[0])
    lasting = float(np.sum(weights * spread**2)) - white
    share = max(((half / NORMAL_FACTOR) ** 2 - white) / lasting, 0.0) if lasting > 0.0 else 0.0
    covariance = white * np.eye(n)
    for (correlation, _, _), part in zip(means.correlations, parts, strict=True):
        covariance += share * float(part @ _RATIOS) * correlation
    return covariance


def noise_of_temperature(element: Array, coefficients: Array, means: FittedMeans) -> Array:
    """Return the covariance of polynomials because the temperature has noise of its own, channel by channel.

    Noise in the temperature flattens a fitted curve (W. A. Fuller, Measurement Error Models, 1987). By how much is
    known only where none of it is rounding, so the whole of it is taken as a standard uncertainty. Rounding averages
    out over a step, but for the turns: they shift the curve.

    Parameters
    ----------
    element : ndarray, shape (parts,)
        °C from the reference.
    coefficients : ndarray, shape (channels, p)
    """
    channels, p = coefficients.shape
    powers, slopes = np.vander(element, p, increasing=True), slopes_of(element, coefficients)
    by_temperature = np.column_stack([np.zeros(len(element)), powers[:, :-1] * np.arange(1, p)])
    flattened = np.linalg.pinv(powers.T @ powers) @ by_temperature.T @ slopes
    shifts = np.pad(coefficients[:, 1:] * np.arange(1, p), ((0, 0), (0, 1))) * means.shift
    found = np.zeros((channels, p, channels, p))
    # Noise of a thermometer that is later cancels between the parts of a mean.
    variance = _variance_between(element, 1) / means.group**2
    for c, (flat, shifted) in enumerate(zip(variance * flattened.T, shifts, strict=True)):
        found[c, :, c] = np.outer(flat, flat) + np.outer(shifted, shifted)
    return found.reshape(coefficients.size, coefficients.size)


def _short_variance(left: Array) -> float:
    """Return the variance of what lasts no longer than a few means, which no drift of the zero explains.

    The thermometer's noise and steps are among it. A process that took them up would take up the drift with them.
    """
    return max(float(np.finfo(float).tiny), *(_variance_between(left, k) for k in _DISTANCES if 2 * k < len(left)))


def _variance_between(values: Array, distance: int) -> float:
    """Return the variance of white noise that second differences over a distance of some values show."""
    second = values[2 * distance :] - 2.0 * values[distance:-distance] + values[: -2 * distance]
    return float(np.mean(second**2)) / 6.0
