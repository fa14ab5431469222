"""Detectors of a sensor that is still, moves, is knocked, or is stuck at one value.

They work on the samples of a position; the bench, recorded logs and the characterisation of noise use them with limits
of their own. Those of a record of any length are in :mod:`tiltcal.core.rows`, those that need positions in
:mod:`tiltcal.bench.checks` and :mod:`tiltcal.logs.static_intervals`, that of a turning stage in
:mod:`tiltcal.core.pair.stage`.

Samples that are all alike are not still: a sensor at rest has noise, and one whose reading does not change although its
noise is larger than half a step of the reading is stuck.

Source: QARTOD's flat line test for stuck readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import erf, inf, log, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.samples import SampleSummary, noise_under_rounding

CHANCE = 1e-6
"""Probability of identical samples below which they are no chance."""

JUMP = 8.0
"""A difference of block means beyond so many standard deviations is motion."""

BURST = 5.0
"""So is a scatter within a block beyond so many times the usual one."""

FEWEST_SAMPLES = 8
"""Readings among which one can be called far off."""

OUTLYING = 6.0
"""Standard deviations beyond which a sample is far off."""

LEFT_OUT = 0.05
"""The largest share of samples that is left out as far off; more is a fault that must not be hidden."""

TEMPERATURES = (-60.0, 150.0)
"""The range of temperatures at a bench, °C: a DS18B20 that fails reads -127."""

TEMPERATURE_JUMP = 5.0
"""A temperature this far from those around it is a failed conversion, °C."""

FLICKER = 0.5
"""Standard deviation of a reading that takes two neighbouring values, at most, in steps."""

TILTED = 0.1
"""How far a channel's axis has to move before its reading must change, g."""

_SIGMA_OF_MEDIAN = 1.4826  # standard deviation of normal numbers over the median of their distance from the median
_SIGMA_OF_NEAREST = 1.267  # and over the root mean square of the nearest 90 % of them
_EXACT = 1.0 + 1e-9  # arithmetic may leave the last digits of a scatter that is the largest of a flicker
_MANY, _SAMPLE = 1 << 13, 1 << 11  # values of which a sample is taken first, and those of the sample


# ---------------------------------------------------------------------------------------------------------------- stuck


def noise_of_positions(summaries: Sequence[SampleSummary], step: float) -> float:
    """Return the noise that a channel has in several positions, before rounding.

    Parameters
    ----------
    summaries : sequence of SampleSummary
        Of its samples in each position.
    step : float
        Of the reading, unit; 0 where it is continuous.

    Returns
    -------
    float
        Unit; 0 where none is shown. A reading that flickers between two values scatters by up to half a step however
        small its noise is: that shows nothing of a position in which the reading stands still.
    """
    scatters = [summary.std**2 * (summary.n - 1) / summary.n for summary in summaries]
    if step and np.median(scatters) <= (FLICKER * step) ** 2 * _EXACT:
        return 0.0
    scatter = float(np.mean(scatters))
    return noise_under_rounding(scatter, step) if step else sqrt(scatter)


def identical_by_chance(count: int, noise: float, step: float) -> bool:
    """Return whether noise can leave so many samples in one step of the reading.

    Parameters
    ----------
    count : int
        Of the samples that are identical.
    noise : float
        Standard deviation of the samples, in their unit.
    step : float
        Of the reading, same unit.
    """
    if noise == 0.0:
        return True
    # Of normal noise no step holds more than the one in the middle.
    most = erf(step / noise / sqrt(8.0))
    return most > 0.0 and count * log(most) >= log(CHANCE)


# ---------------------------------------------------------------------------------------------------------------- still


def is_still(
    change: float, uncertainty: float, limit: float, *, sigmas: float = 4.0, shown: bool = False, coverage: float = 2.0
) -> bool:
    """Return whether a change along a line through some samples is none.

    Parameters
    ----------
    change, uncertainty : float
        Of :func:`tiltcal.core.samples.drift`.
    limit : float
        The largest change that counts as none, same unit.
    sigmas : float
        A change below this many of its standard uncertainties is noise.
    shown : bool
        The change must be shown to be within the limit: noise that might hide a larger one is no excuse.
    coverage : float
        Standard uncertainties within which it is shown.
    """
    return abs(change) <= (limit - coverage * uncertainty if shown else max(limit, sigmas * uncertainty))


# ---------------------------------------------------------------------------------------------------------------- moved


def jumps(means: Array, rounding: ArrayLike = 0.0) -> Mask:
    """Return the blocks before and behind a difference of block means that stands out: a step, a turn.

    Parameters
    ----------
    means : ndarray, shape (blocks, channels)
        NaN where a block has none.
    rounding : array_like, shape (channels,)
        Standard deviation that rounding gives, below which no difference stands out.
    """
    changes = np.diff(means, axis=0)
    difference = np.abs(changes - np.nanmedian(changes, axis=0))
    usual = np.maximum(_SIGMA_OF_MEDIAN * np.nanmedian(difference, axis=0), rounding)
    far = difference > JUMP * usual
    none = np.zeros((1, far.shape[1]), dtype=np.bool_)
    return np.asarray(np.concatenate([far, none]) | np.concatenate([none, far]))


def bursts(scatter: Array, rounding: ArrayLike = 0.0) -> Mask:
    """Return the blocks whose standard deviation stands out: a knock, a vibration; see :func:`jumps`."""
    usual = np.maximum(np.nanmedian(scatter, axis=0), rounding)
    return np.asarray(scatter > BURST * usual)


def outliers(samples: Sequence[float] | Array, step: float = 0.0) -> NDArray[np.intp]:
    """Return the samples of one channel that stand far out of the others; none of fewer than eight.

    Parameters
    ----------
    samples : sequence of float
        Of a sensor at rest.
    step : float
        Of the reading, in the unit of the samples: a distance of two steps is no outlier.
    """
    distance, limit, _ = distances(np.asarray(samples, dtype=float))
    return np.flatnonzero(distance > max(limit, 2.0 * step)) if distance is not None else np.empty(0, np.intp)


def distances(values: Array) -> tuple[Array | None, float, float]:
    """Return how far each sample is from the median, beyond what distance it is far off, and the median.

    Where none is far off, the distances are None, and the limit is a lower bound of it, which many samples show sooner.

    Parameters
    ----------
    values : ndarray, shape (n,)
        At least one; of fewer than eight none is an outlier.
    """
    centre = _median(values)
    if len(values) < FEWEST_SAMPLES:
        return None, inf, centre
    farthest = max(float(values.max()) - centre, centre - float(values.min()))
    bound = OUTLYING * _SIGMA_OF_MEDIAN * _least_median_distance(values, centre)
    if farthest <= bound:
        return None, bound, centre
    distance = np.abs(values - centre)
    limit = OUTLYING * _SIGMA_OF_MEDIAN * _median(distance)
    if farthest > limit:
        # Where more than half of the samples are in one step, that median is 0; the nearest 90 % are not.
        count = max(1, round(0.9 * len(values)))
        nearest = np.partition(distance, count - 1)[:count]
        limit = max(limit, OUTLYING * _SIGMA_OF_NEAREST * float(np.sqrt(np.mean(nearest**2))))
    return (distance if farthest > limit else None), limit, centre


def _least_median_distance(values: Array, centre: float) -> float:
    """Return a number that the median distance from the centre reaches; 0 where a few of the samples show none."""
    if len(values) < _MANY:
        return 0.0
    count = int(0.47 * _SAMPLE)
    near = float(np.partition(np.abs(values[:: len(values) // _SAMPLE] - centre), count)[count])
    # It does where not more than half of the samples are nearer.
    nearer = np.count_nonzero(values < centre + near) - np.count_nonzero(values <= centre - near)
    return near / _EXACT if nearer <= (len(values) - 1) // 2 else 0.0


def _median(values: Array) -> float:
    """Return the median of numbers without a missing one; of many, it is sought among those near that of a sample."""
    middle = len(values) // 2
    if len(values) >= _MANY:
        few = np.sort(values[:: len(values) // _SAMPLE])
        lower, upper = few[[int(share * len(few)) for share in (0.46, 0.54)]]
        below = int(np.count_nonzero(values < lower))
        near = np.compress((values >= lower) & (values <= upper), values)
        if below < middle < below + len(near):
            return _middle(near, middle - below, even=len(values) % 2 == 0)
    return _middle(values, middle, even=len(values) % 2 == 0)


def _middle(values: Array, place: int, *, even: bool) -> float:
    """Return the value of a place by size; of an even number, the mean of it and the one before."""
    parted = np.partition(values, place)
    upper = float(parted[place])
    return (float(parted[:place].max()) + upper) / 2.0 if even else upper
