"""The fit of a three-axis sensor at rest in attitudes that nobody set: gravity is 1 g long in each.

The attitudes drop out of the model of :mod:`tiltcal.core.model`, and each leaves one number, by how much the length of
gravity is missed::

    misfit_n = |S^-1 (u_n - offset)| - 1

``S`` is upper triangular, because a turn of all attitudes together changes no length. The scatter of the misfits is the
uncertainty. Sway of the hand turns gravity within a hold: it moves the readings and not their length, and makes their
mean shorter by half of its variance.

Source: D. Tedaldi, A. Pretto, E. Menegatti, *A robust and easy to implement method for IMU calibration without external
equipments* (2014), which minimises the same misfits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import cos, inf, radians, sqrt

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.estimation.equations import NOISE
from tiltcal.core.estimation.solve import undetermined
from tiltcal.core.model import AXES, Array, ChannelModel
from tiltcal.core.uncertain import NORMAL_FACTOR, Uncertain, coverage_factor
from tiltcal.errors import EstimateError

DIFFERENT_ATTITUDE = 5.0  # attitudes closer than this are one attitude taken again, degrees
STEPS = 50  # most Gauss-Newton steps; a fit takes about five
CLOSE = 1e-6  # a misfit up to this counts as this in the fit of least absolute misfits, and in their scatter, g
FAR = 5.0  # an attitude whose studentised misfit exceeds this many scatters is left out; more where few misfits show it
MOST_LEFT_OUT, FEWEST_LEFT = 0.2, 12  # share of the attitudes that may be left out; and how many must remain
MEDIAN_TO_SIGMA = 1.4826  # standard deviation of normal numbers over the median of their absolute values
MEDIAN_EFFICIENCY = 0.37  # degrees of freedom of that median for one of the mean square
CHANCE = 0.01  # misfits below the noise that chance makes less often than this show that the noise is sway

_UPPER = np.triu_indices(3)
UNKNOWNS = 3 + len(_UPPER[0])
_NAMES = [f"offset.{axis}" for axis in AXES]
_NAMES += [f"sensitivity.{AXES[i]}.{AXES[j]}" for i, j in zip(*_UPPER, strict=True)]
_NAMES += [f"temperature.offset.{axis}.1" for axis in AXES]
NO_DRIFT = np.zeros(3)


@dataclass(frozen=True)
class Misfits:
    """By how much the length of gravity is missed in n attitudes, with some coefficients."""

    offset: Array  # (3,), unit
    sensitivity: Array  # upper triangular, (3, 3), unit/g
    gravity: Array  # (n, 3), g
    misfit: Array  # (n,), g
    by_reading: Array  # derivatives of the misfits, (n, 3), g/unit
    drift: Array  # (3,), unit/°C
    warmth: Array | None  # temperatures from their mean, (n,), °C; None where no drift is fitted

    @property
    def jacobian(self) -> Array:
        """Derivatives of the misfits by the offsets, the upper triangle and the drifts, shape (n, 9) or (n, 12)."""
        rows, columns = _UPPER
        blocks = [-self.by_reading, -self.by_reading[:, rows] * self.gravity[:, columns]]
        return np.hstack(blocks if self.warmth is None else [*blocks, -self.by_reading * self.warmth[:, None]])

    def explained(self, u: Array) -> float:
        """Return the root mean square of the misfits, g, that uncertainties of the readings explain, shape (n, 3)."""
        return sqrt(float(np.mean(np.sum((self.by_reading * u) ** 2, axis=1))))


@dataclass(frozen=True)
class FreeFit(Misfits):
    """A sensor from the length of gravity in n attitudes."""

    kept: NDArray[np.bool_]  # False for attitudes that were left out, (n,)
    disagreeing: NDArray[np.intp]  # those that do not agree with the others and are too many to be left out
    noise: float  # root mean square of the misfits that the uncertainties of the readings explain, g

    @property
    def attitudes(self) -> Array:
        """Unit vectors that point up, (n, 3)."""
        return np.asarray(self.gravity / np.linalg.norm(self.gravity, axis=1, keepdims=True))

    @property
    def distinct(self) -> int:
        """Number of kept attitudes that differ from each other by at least :data:`DIFFERENT_ATTITUDE`."""
        count, left = 0, self.attitudes[self.kept]
        while len(left):
            count, left = count + 1, left[1:][left[1:] @ left[0] < cos(radians(DIFFERENT_ATTITUDE))]
        return count

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return int(self.kept.sum()) - self.unknowns

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return UNKNOWNS if self.warmth is None else len(_NAMES)

    @property
    def rms(self) -> float:
        """Root of the mean squared misfit of the kept attitudes, g."""
        return sqrt(float(np.mean(self.misfit[self.kept] ** 2)))

    @property
    def scatter(self) -> float:
        """Standard deviation of a misfit from the residuals, g; infinite where none is left over."""
        return self.rms * sqrt(self.kept.sum() / self.dof) if self.dof > 0 else inf

    @property
    def below_noise(self) -> bool:
        """Whether the misfits are smaller than the noise by chance."""
        return _below_noise(self.scatter, self.dof, self.noise)

    @cached_property
    def expanded(self) -> float:
        """Expanded uncertainty (95 %) of the unknowns on average, g; infinite unless more attitudes differ."""
        if self.distinct <= self.unknowns:
            return inf
        inverse = np.linalg.pinv(self.jacobian[self.kept] * float(np.mean(np.diag(self.sensitivity))))
        student = float(coverage_factor(np.array([float(self.dof)]))[0])
        return student * max(self.noise, self.scatter) * sqrt(float(np.mean(np.sum(inverse**2, axis=1))))

    def uncertain(self, noise_dof: float) -> Uncertain:
        """Return the uncertainty of the coefficients, channel by channel; the noise has so many dof."""
        by_noise = self.dof == 0 or self.below_noise
        scatter, dof = (self.noise, noise_dof) if by_noise else (self.scatter, self.dof)
        return _uncertain(self.jacobian[self.kept], scatter, dof)


def fit_free(mean: Array, u: Array, sway: Array | float = 0.0, warmth: Array | None = None) -> FreeFit:
    """Fit mean readings of x, y, z in free attitudes, and leave out attitudes that do not agree.

    ``u`` is their uncertainty, ``sway`` the standard deviation within each attitude that is motion and not noise, all
    of shape (n, 3). Where ``warmth`` is given, the temperatures from their mean, (n,), °C, the offsets drift. An
    EstimateError where the unknowns stay unknown.
    """
    unknowns = UNKNOWNS if warmth is None else len(_NAMES)
    n, kept, sway = len(mean), np.ones(len(mean), dtype=bool), np.broadcast_to(sway, mean.shape)
    if n < unknowns:
        drifts = "" if warmth is None else ", three of them drifts because the temperature changes"
        raise EstimateError(f"{n} free positions for {unknowns} unknowns{drifts}: {_advice(unknowns)}")
    middle, half = (mean.max(axis=0) + mean.min(axis=0)) / 2.0, np.ptp(mean, axis=0) / 2.0
    start = _misfits(mean, sway, middle, np.diag(half), warmth=warmth)
    near = _minimum(mean, sway, start, absolute=True)
    dof, limit = MEDIAN_EFFICIENCY * (n - unknowns), inf
    if dof:
        # As many misfits as there are unknowns vanish where the sum of absolute misfits is least.
        scatter = MEDIAN_TO_SIGMA * float(np.median(np.sort(np.abs(near.misfit))[unknowns:]))
        scatter = near.explained(u) if _below_noise(scatter, dof, near.explained(u)) else scatter
        limit = FAR * max(scatter, CLOSE) * float(coverage_factor(np.array([dof]))[0]) / NORMAL_FACTOR
    fewest = max(FEWEST_LEFT, n - int(MOST_LEFT_OUT * n))
    while True:
        near = _minimum(mean[kept], sway[kept], replace(near, warmth=None if warmth is None else warmth[kept]))
        _require_determined(near.jacobian)
        leverage = np.sum(np.linalg.qr(near.jacobian)[0] ** 2, axis=1)
        studentised = np.abs(near.misfit) / np.sqrt(np.maximum(1.0 - leverage, 1e-6))
        worst = int(np.argmax(studentised))
        if studentised[worst] <= limit or kept.sum() <= fewest:
            break
        kept[np.flatnonzero(kept)[worst]] = False
    beyond = np.flatnonzero(kept)[studentised > limit]
    disagreeing = np.union1d(np.flatnonzero(~kept), beyond) if len(beyond) else beyond
    every = _misfits(mean, sway, near.offset, near.sensitivity, near.drift, warmth)
    return FreeFit(**vars(every), kept=kept, disagreeing=disagreeing, noise=every.explained(u))


def planned_uncertain(attitudes: Array, noise: float, sensitivity: float) -> Uncertain:
    """Return the uncertainty of the twelve coefficients that planned attitudes, (n, 3), leave; noise of means, unit."""
    if len(attitudes) < UNKNOWNS:
        raise EstimateError(f"{len(attitudes)} free positions for {UNKNOWNS} unknowns: {_advice(UNKNOWNS)}")
    readings = attitudes * sensitivity
    jacobian = _misfits(readings, np.zeros_like(readings), np.zeros(3), np.eye(3) * sensitivity).jacobian
    _require_determined(jacobian)
    return _uncertain(jacobian, noise / sensitivity, inf)


def _minimum(mean: Array, sway: Array, start: Misfits, *, absolute: bool = False) -> Misfits:
    """Return where the sum of squared misfits, or of ``absolute`` ones, is least, by Gauss-Newton steps."""
    near = _misfits(mean, sway, start.offset, start.sensitivity, start.drift, start.warmth)
    for _ in range(STEPS):
        weight = 1.0 / np.sqrt(np.maximum(np.abs(near.misfit), CLOSE)) if absolute else np.ones(len(mean))
        # All unknowns are counted in units of the first sensitivity, so that they are of one size.
        size = near.sensitivity[0, 0]
        change = np.linalg.lstsq(near.jacobian * (size * weight)[:, None], -near.misfit * weight, rcond=None)[0] * size
        sensitivity = near.sensitivity.copy()
        sensitivity[_UPPER] += change[3:UNKNOWNS]
        drift = near.drift if near.warmth is None else near.drift + change[UNKNOWNS:]
        near = _misfits(mean, sway, near.offset + change[:3], sensitivity, drift, near.warmth)
        if np.max(np.abs(change)) <= 1e-12 * size:
            break
    return near


def _misfits(
    mean: Array, sway: Array, offset: Array, sensitivity: Array, drift: Array = NO_DRIFT, warmth: Array | None = None
) -> Misfits:
    if not np.all(np.diag(sensitivity) > 0.0):
        raise EstimateError(f"the readings lie on no ellipsoid: {_advice(UNKNOWNS if warmth is None else len(_NAMES))}")
    inverse = np.linalg.inv(sensitivity)
    gravity = (mean - (offset if warmth is None else offset + warmth[:, None] * drift)) @ inverse.T
    # Gravity is 1 g at each instant; its mean over directions that sway is shorter, by their variance.
    length = np.sqrt(np.sum(gravity**2, axis=1) + np.sum((sway / np.diag(sensitivity)) ** 2, axis=1))
    by_reading = gravity / length[:, None] @ inverse
    return Misfits(offset, sensitivity, gravity, length - 1.0, by_reading, drift, warmth)


def _advice(unknowns: int) -> str:
    least, enough = ("nine", "12 to 18") if unknowns == UNKNOWNS else ("twelve", "16 to 24")
    return (
        "add positions that are spread over the whole sphere, each axis up and down among them; it takes at least "
        f"{least} positions, and {enough} show whether the result is right"
    )


def _below_noise(scatter: float, dof: float, noise: float) -> bool:
    """Return whether a scatter of misfits, g, is smaller than the noise, and is so by chance."""
    from scipy.special import chdtr

    return scatter < noise and float(chdtr(dof, dof * (scatter / noise) ** 2)) > CHANCE


def _require_determined(jacobian: Array) -> None:
    unknowns = jacobian.shape[1]
    mixed = undetermined(jacobian, _NAMES[:unknowns])
    if mixed:
        which = ", ".join(mixed[:4])
        raise EstimateError(f"the {len(jacobian)} free positions do not determine {which}: {_advice(unknowns)}")


def _uncertain(jacobian: Array, scatter: float, dof: float) -> Uncertain:
    """Return the uncertainty of the coefficients, those below the diagonal exact; ``scatter`` in g."""
    unknowns = jacobian.shape[1]
    models = (ChannelModel(axis, AXES, int(unknowns > UNKNOWNS), 0, 0, None) for axis in AXES)
    names = [name for model in models for name in model.coefficients]
    places, covariance = [names.index(name) for name in _NAMES[:unknowns]], np.zeros((len(names), len(names)))
    covariance[np.ix_(places, places)] = scatter**2 * np.linalg.inv(jacobian.T @ jacobian)
    return Uncertain.errors(names, covariance, dof, source=NOISE)
