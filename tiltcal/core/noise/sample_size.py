"""The number of samples of a mean: as many as the target asks for, and no more than help.

The standard uncertainty of a mean of n samples is the Allan deviation at the time that they take, which is how far it
is from the mean of the n samples before, and what rounding leaves in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.noise.characterise import ChannelNoise

Limit = Literal["target", "record", "rounding", "flicker", "walk", "drift", "unknown"]
"""What says how many samples: the target is met; the record ends, and more would still help; more do not help because
of rounding, flicker noise, random walk, drift, or what none of them describes."""

LITTLE = 0.1
"""Share by which twice the samples must lower the uncertainty to be worth their time."""

_EACH = 1000
"""Numbers of samples up to which each is tried; beyond, they go up by a hundredth."""

_LIMITS: dict[str, Limit] = {"B": "flicker", "K": "walk", "R": "drift"}


@dataclass(frozen=True)
class SampleSize:
    """A recommended number of samples, and why it is that one.

    Attributes
    ----------
    uncertainty : float
        Of their mean, unit.
    limit : str
        What settles it.
    met : bool or None
        Whether the mean is as good as the target; None where there is no target.
    useful : int or None
        Samples beyond which twice as many gain less than a tenth; None where the record is too short to show it.
    predicted : int or None
        Samples that would meet the target if the noise stayed white for longer than the record could show.
    """

    samples: int
    uncertainty: float
    limit: Limit
    met: bool | None
    useful: int | None
    predicted: int | None = None


def advise(noise: ChannelNoise, interval: float, target: float | None = None) -> SampleSize:
    """Return the smallest number of samples whose mean is good enough, or beyond which more do not help.

    Parameters
    ----------
    interval : float
        Seconds from sample to sample.
    target : float, optional
        Standard uncertainty that a mean should have, unit.
    """
    most = round(float(noise.tau[-1]) / interval)
    samples = _numbers(most)
    u = uncertainty(noise, np.asarray(samples * interval, dtype=np.float64))
    useful, why = _useful(noise, samples, u, interval)
    if target is not None and np.any(u <= target):
        met = int(np.argmax(u <= target))
        return SampleSize(int(samples[met]), float(u[met]), "target", True, useful)
    end = int(np.searchsorted(samples, useful if useful is not None else most))
    predicted = None
    if target is not None and useful is None and target > noise.rounding:
        needed = noise.terms.variance(np.array([interval]))[0] / (target**2 - noise.rounding**2)
        predicted = max(ceil(needed), most)
    return SampleSize(int(samples[end]), float(u[end]), why, None if target is None else False, useful, predicted)


def uncertainty(noise: ChannelNoise, tau: Array) -> Array:
    """Standard uncertainty of a mean that takes so long.

    Parameters
    ----------
    tau : ndarray, shape (n,)
        Seconds, within the record's averaging times.

    Returns
    -------
    ndarray, shape (n,)
        Unit. The Allan deviation of the kinds of noise that show, where they describe it; else, and at times shorter
        than they do, as measured.
    """
    measured = np.exp(np.interp(np.log(tau), np.log(noise.tau), np.log(noise.deviation**2)))
    modelled = noise.terms.variance(tau)
    described = (tau >= noise.tau[noise.terms.first] * (1.0 - 1e-9)) & noise.terms.follows
    return np.asarray(np.sqrt(np.where(described, modelled, measured) + noise.rounding**2))


def _numbers(most: int) -> NDArray[np.int64]:
    """Numbers of samples to try: 1, 2, 3, ... and, where there are many, some of them, with the last."""
    each = np.arange(1, min(most, _EACH) + 1)
    if most <= _EACH:
        return each
    count = ceil(np.log(most / _EACH) * 100)
    return np.unique(np.r_[each, np.round(np.geomspace(_EACH, most, count + 1)).astype(np.int64)])


def _useful(noise: ChannelNoise, samples: NDArray[np.int64], u: Array, interval: float) -> tuple[int | None, Limit]:
    """Return the number of samples from which twice as many stop to help, and the reason."""
    twice = np.interp(2.0 * samples, samples, u, right=np.nan)
    known = ~np.isnan(twice)
    # What falls again behind a hump, as after a vibration, must come below what there was before it.
    helps = np.flatnonzero(known & (twice <= (1.0 - LITTLE) * np.minimum.accumulate(u)))
    if not known.any() or (len(helps) and helps[-1] == np.flatnonzero(known)[-1]):
        return None, "record"
    useful = int(samples[helps[-1]] + 1) if len(helps) else 1
    left = float(u[np.searchsorted(samples, useful)])
    if noise.rounding > left / sqrt(2.0):
        return useful, "rounding"
    left_over = {name: part[0] for name, part in noise.terms.parts(noise.tau[-1:]).items() if name in _LIMITS}
    if not noise.terms.follows or not left_over:
        return useful, "unknown"
    return useful, _LIMITS[max(left_over, key=lambda name: left_over[name])]
