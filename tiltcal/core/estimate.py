"""The one estimator: weighted least squares under the measurement model.

The model of :mod:`tiltcal.core.model`, written as the vector that is solved for, per channel i::

    u_i(g, dT) = offset + sum_k drift_k dT^k + (1 + sum_k gain_k dT^k) * sum_j S_j g_j

It is linear but for the gain, so Gauss-Newton steps with the analytic Jacobian reach the minimum in one step where no
gain is asked for, and in a few where it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.linalg import lstsq, svd

from tiltcal.core.model import AXES, Array, Coefficients, Thermal
from tiltcal.errors import EstimateError

STEPS = 20
"""Most Gauss-Newton steps; a gain of a few per cent needs three."""

UNDETERMINED = 1e-9
"""A singular value below this share of the largest, with columns scaled to one, counts as zero."""


@dataclass(frozen=True)
class Observation:
    """The mean reading in one position.

    Attributes
    ----------
    position : str
    gravity : ndarray, shape (3,)
        Up in the sensor frame as set, g.
    mean : ndarray, shape (channels,)
        In the sensor's unit.
    u : ndarray, shape (channels,)
        Standard uncertainty of the mean from noise and quantisation, same unit.
    temperature : float or None
        °C.
    """

    position: str
    gravity: Array
    mean: Array
    u: Array
    temperature: float | None = None


@dataclass(frozen=True)
class Design:
    """Which coefficients are to be determined.

    Attributes
    ----------
    channels : tuple of str
    axes : tuple of str
        Columns of the sensitivity matrix.
    drift, gain : int
        Orders of the temperature polynomials; 0 leaves them out.
    reference : float
        Reference temperature, °C; used where an order is above 0.
    jig : float or None
        Standard uncertainty of each set angle, degrees. None: not stated, all positions count the same and their
        scatter says how uncertain they are.
    """

    channels: tuple[str, ...]
    axes: tuple[str, ...]
    drift: int = 0
    gain: int = 0
    reference: float = 0.0
    jig: float | None = None

    @property
    def thermal(self) -> bool:
        """Whether temperature terms are asked for."""
        return bool(self.drift or self.gain)

    def parameters(self, channel: str) -> list[str]:
        """Dotted names of one channel's coefficients, in the order of the parameter vector."""
        return (
            [f"offset.{channel}"]
            + [f"sensitivity.{channel}.{axis}" for axis in self.axes]
            + [f"temperature.offset.{channel}.{k + 1}" for k in range(self.drift)]
            + [f"temperature.sensitivity.{channel}.{k + 1}" for k in range(self.gain)]
        )


@dataclass(frozen=True)
class Estimate:
    """What the positions say.

    Attributes
    ----------
    coefficients : Coefficients
    names : tuple of str
        The parameters, in the order of ``covariance``.
    covariance : ndarray, shape (parameters, parameters)
    residuals : ndarray, shape (positions, channels)
        Measured minus modelled, in the sensor's unit.
    dof : int
        Degrees of freedom left, over all channels.
    chi_square : float or None
        Sum of squared residuals over their stated variance; None where nothing is left over to judge.
    stated : bool
        True where the covariance stands on stated uncertainties, False where the residuals gave it.
    """

    coefficients: Coefficients
    names: tuple[str, ...]
    covariance: Array
    residuals: Array
    dof: int
    chi_square: float | None
    stated: bool

    def uncertainty(self) -> dict[str, float]:
        """Standard uncertainty of each parameter by its dotted name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


def estimate(observations: Sequence[Observation], design: Design) -> Estimate:
    """Determine the coefficients from positions.

    Parameters
    ----------
    observations : sequence of Observation
    design : Design

    Returns
    -------
    Estimate

    Raises
    ------
    EstimateError
        The positions leave coefficients undetermined (they are named), or a temperature is missing.

    Notes
    -----
    Where the jig is stated, a position's variance is that of its mean plus jig² |g x S_i|²: a small turn of the
    sensor moves the reading only by the part of S_i that is perpendicular to gravity. The variances of one channel
    depend on its own sensitivities, so the weights are renewed with each step.
    """
    gravity, dt = _conditions(observations, design)
    mean = np.array([observation.mean for observation in observations])
    noise = np.array([observation.u for observation in observations])
    solved = [
        _solve(design, channel, gravity, dt, mean[:, i], noise[:, i]) for i, channel in enumerate(design.channels)
    ]
    residuals = np.stack([mean[:, i] - fit.modelled for i, fit in enumerate(solved)], axis=1)
    sigma = np.stack([fit.sigma for fit in solved], axis=1)
    dof = residuals.size - sum(len(fit.theta) for fit in solved)
    stated = design.jig is not None or dof == 0
    scatter = np.full(len(mean), np.sqrt(np.sum(residuals**2) / dof)) if dof else np.zeros(len(mean))
    covariance = _block_diagonal([_covariance(fit.jacobian, fit.sigma if stated else scatter) for fit in solved])
    return Estimate(
        coefficients=_coefficients(design, [fit.theta for fit in solved], dt),
        names=tuple(name for channel in design.channels for name in design.parameters(channel)),
        covariance=covariance,
        residuals=residuals,
        dof=dof,
        chi_square=float(np.sum((residuals / sigma) ** 2)) if dof and np.all(sigma > 0) else None,
        stated=stated,
    )


@dataclass(frozen=True)
class _Fit:
    """One channel's solution."""

    theta: Array
    jacobian: Array
    modelled: Array
    sigma: Array


def _covariance(jacobian: Array, sigma: Array) -> Array:
    """Covariance of the parameters of one channel for observations with standard deviations ``sigma``."""
    if not np.any(sigma > 0):
        return np.zeros((jacobian.shape[1],) * 2)
    weighted = jacobian / np.where(sigma > 0, sigma, sigma[sigma > 0].min())[:, None]
    inverse = np.linalg.pinv(weighted)
    return np.asarray(inverse @ inverse.T)


def _conditions(observations: Sequence[Observation], design: Design) -> tuple[Array, Array]:
    """Gravity along the design's axes, and temperature from the reference."""
    columns = [AXES.index(axis) for axis in design.axes]
    gravity = np.array([observation.gravity for observation in observations]).reshape(-1, 3)[:, columns]
    if not design.thermal:
        return gravity, np.zeros(len(observations))
    for observation in observations:
        if observation.temperature is None:
            raise EstimateError(f"position {observation.position}: a temperature is needed for the temperature terms")
    return gravity, np.array([float(o.temperature or 0.0) for o in observations]) - design.reference


def _solve(design: Design, channel: str, gravity: Array, dt: Array, mean: Array, noise: Array) -> _Fit:
    """Gauss-Newton for one channel."""
    theta = np.zeros(len(design.parameters(channel)))
    sigma = np.ones_like(noise)
    for step in range(STEPS):
        modelled, jacobian = _model(design, theta, gravity, dt)
        if step == 0:
            # Before the first step the gain has no lever, all sensitivities being zero: leave it for the second.
            jacobian = jacobian[:, : len(theta) - design.gain]
        else:
            _require_determined(design, channel, jacobian)
            sigma = _sigma(design, theta, gravity, noise)
        weight = sigma if design.jig is not None and step > 0 else np.ones_like(sigma)
        weight = np.where(weight > 0, weight, 1.0)
        change = lstsq(jacobian / weight[:, None], (mean - modelled) / weight, rcond=None)[0]
        theta[: len(change)] += change
        if step > 0 and np.all(np.abs(change) <= 1e-13 * np.max(np.abs(theta), initial=1e-300)):
            break
    modelled, jacobian = _model(design, theta, gravity, dt)
    return _Fit(theta, jacobian, modelled, sigma)


def _model(design: Design, theta: Array, gravity: Array, dt: Array) -> tuple[Array, Array]:
    """Readings of one channel and their derivatives by its parameters."""
    axes, drift, gain = len(design.axes), design.drift, design.gain
    powers = dt[:, None] ** np.arange(1, max(drift, gain) + 1)
    signal = gravity @ theta[1 : 1 + axes]
    scale = 1.0 + powers[:, :gain] @ theta[1 + axes + drift :]
    modelled = theta[0] + powers[:, :drift] @ theta[1 + axes : 1 + axes + drift] + scale * signal
    jacobian = np.hstack(
        [np.ones((len(dt), 1)), scale[:, None] * gravity, powers[:, :drift], powers[:, :gain] * signal[:, None]]
    )
    return modelled, jacobian


def _sigma(design: Design, theta: Array, gravity: Array, noise: Array) -> Array:
    """Standard deviation of each position's mean: noise, and the jig where it is stated."""
    if not design.jig:
        return noise
    full = np.zeros((len(gravity), 3))
    row = np.zeros(3)
    for column, axis in enumerate(design.axes):
        full[:, AXES.index(axis)] = gravity[:, column]
        row[AXES.index(axis)] = theta[1 + column]
    turned = np.linalg.norm(np.cross(full, row), axis=1)
    return np.asarray(np.hypot(noise, radians(design.jig) * turned))


def _require_determined(design: Design, channel: str, jacobian: Array) -> None:
    """Refuse positions that leave a combination of coefficients free, and name it."""
    names = design.parameters(channel)
    size = np.linalg.norm(jacobian, axis=0)
    unseen = [name for name, length in zip(names, size, strict=True) if length == 0.0]
    if unseen:
        raise EstimateError(f"no position says anything of {', '.join(unseen)}: add positions that excite it")
    _, values, vectors = svd(jacobian / size, full_matrices=True)
    rank = int(np.sum(values > UNDETERMINED * values[0]))
    if rank == len(names):
        return
    mixed = [name for name, part in zip(names, vectors[rank], strict=True) if abs(part) > 0.1]
    raise EstimateError(
        f"the {len(jacobian)} positions cannot tell {' and '.join(mixed)} apart: "
        "add a position in which they act differently"
    )


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    size = sum(len(block) for block in blocks)
    whole = np.zeros((size, size))
    start = 0
    for block in blocks:
        whole[start : start + len(block), start : start + len(block)] = block
        start += len(block)
    return whole


def _coefficients(design: Design, thetas: Sequence[Array], dt: Array) -> Coefficients:
    table = np.array(thetas)
    axes, drift = len(design.axes), design.drift
    thermal = None
    if design.thermal:
        covered = (float(dt.min()) + design.reference, float(dt.max()) + design.reference)
        thermal = Thermal(
            design.reference, covered, table[:, 1 + axes : 1 + axes + drift], table[:, 1 + axes + drift :]
        )
    return Coefficients(design.channels, design.axes, table[:, 0], table[:, 1 : 1 + axes], thermal)
