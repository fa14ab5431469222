"""The characterisation of a record's noise: averages, Allan deviation, kinds of noise, and disturbances."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from math import sqrt

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.noise.allan import Octaves, limits
from tiltcal.core.noise.allan_fit import AllanFit, terms_of
from tiltcal.core.noise.averages import Average, Averager, decades
from tiltcal.core.noise.disturbances import Disturbances, RowRange
from tiltcal.core.quantisation import StepFinder, rounding_uncertainty
from tiltcal.errors import EstimateError

FEWEST_SAMPLES = 64
"""Samples of a channel below which nothing is said of its noise."""

_FEWEST_AVERAGES = 5
"""Averages of a size that a row of the table must have, where nobody asked for the size."""

_LARGEST = 10_000_000

_FINE = 500  # averaging times at which the lowest deviation is looked for


@dataclass(frozen=True)
class ChannelNoise:
    """The noise of one channel.

    Attributes
    ----------
    mean : float
        Unit.
    count : int
        Samples that are there.
    step : float
        Of the reading, unit; 0 where it is continuous.
    averages : sequence of Average
        By rising size, of single samples first.
    tau : ndarray, shape (k,)
        Averaging times, seconds.
    deviation, low, high : ndarray, shape (k,)
        Allan deviation with its limits (95 %), unit.
    """

    mean: float
    count: int
    step: float
    averages: Sequence[Average]
    tau: Array
    deviation: Array
    low: Array
    high: Array
    terms: AllanFit

    @property
    def rounding(self) -> float:
        """What rounding leaves in a mean, however many samples it has, unit."""
        return rounding_uncertainty(float(self.deviation[0]), self.step)

    @property
    def lowest(self) -> tuple[float, float]:
        """Averaging time, seconds, and lowest deviation: of the kinds of noise that show, or as measured without."""
        if not self.terms.follows:
            place = int(np.argmin(self.deviation))
            return float(self.tau[place]), float(self.deviation[place])
        tau = np.geomspace(self.tau[self.terms.first], self.tau[-1], _FINE)
        variance = self.terms.variance(tau)
        place = int(np.argmin(variance))
        return float(tau[place]), float(np.sqrt(variance[place]))

    def white(self, average: Average) -> float:
        """Return what its standard deviation would be if neighbouring samples had nothing to do with each other."""
        return self.averages[0].std / sqrt(average.samples)

    @property
    def settled(self) -> bool:
        """Whether the deviation has stopped falling within the record."""
        return any(name != "N" for name in self.terms.value)


class Characteriser:
    """Collects all of it along the samples of some channels.

    Parameters
    ----------
    sizes : sequence of int
        Of averages, beside 1, 10, 100, ...
    run : callable
        Does some pieces of work that do not meet, with the signature of ``map``: that of an executor does them side by
        side.
    """

    def __init__(self, channels: int, sizes: Sequence[int] = (), run: Callable[..., Iterable[None]] = map) -> None:
        self._asked, self._run = frozenset(sizes), run
        self._zero = np.full(channels, np.nan)
        """A value near all samples of each channel, so that their sums keep their digits."""
        self._count = np.zeros(channels, dtype=np.int64)
        self.rows = 0
        self._octaves, self._unrest = Octaves(channels), Disturbances(channels)
        self._steps = [StepFinder() for _ in range(channels)]
        self._averagers = [Averager(size, channels) for size in sorted({*decades(_LARGEST, 1), *sizes})]

    def add(self, samples: Array) -> None:
        """Take more samples, evenly spaced behind the last ones, shape (n, channels); NaN where a value is missing."""
        there = np.isfinite(samples)
        present = None if there.all() else there
        self.rows += len(samples)
        self._count += len(samples) if present is None else there.sum(axis=0)
        known = list(samples.T)
        if present is not None:
            known = [channel[here] for channel, here in zip(samples.T, there.T, strict=True)]
        for place, values in enumerate(known):
            if len(values) and np.isnan(self._zero[place]):
                self._zero[place] = values[0]
        # Channel by channel in memory: sums along the samples are then several times faster.
        about_zero = np.asfortranarray(samples - np.nan_to_num(self._zero))
        if present is not None:
            about_zero[~present] = 0.0
        work = [partial(self._octaves.add, about_zero, present), partial(self._unrest.add, about_zero, present)]
        work += [partial(averager.add, about_zero, present) for averager in self._averagers]
        work += [partial(steps.add, values) for steps, values in zip(self._steps, known, strict=True)]
        deque(self._run(_do, work), maxlen=0)

    @property
    def counts(self) -> list[int]:
        """Samples that are there, per channel."""
        found: list[int] = self._count.tolist()
        return found

    def constant(self, channel: int) -> float | None:
        """Return the one value that a channel has had all along, or None."""
        values = self._steps[channel].values
        return float(values[0]) if values is not None and len(values) == 1 else None

    def moved(self, steps: Sequence[float]) -> list[RowRange]:
        """RowRange in which the sensor was moved; ``steps`` are those of the readings."""
        return self._unrest.moved(np.array(steps))

    @property
    def stuck(self) -> RowRange | None:
        """The rows in which the reading stuck, where it did."""
        return self._unrest.stuck()

    def channel(self, place: int, interval: float) -> ChannelNoise:
        """Return what is known of one channel.

        Parameters
        ----------
        place : int
            Number of the channel.
        interval : float
            Seconds from sample to sample.

        Raises
        ------
        EstimateError
            Too much is missing.
        """
        allan = self._octaves.result()
        good = np.nan_to_num(allan.variance[:, place]) > 0.0
        factor, variance = allan.factor[good], allan.variance[good, place]
        if not len(factor):
            raise EstimateError("so much is missing that no two neighbouring averages are left")
        tau = np.asarray(factor * interval, dtype=np.float64)
        count = int(self._count[place])
        terms = terms_of(tau, variance, factor, count)
        low, high = limits(variance, terms.dof)
        averages = [averager.result(place) for averager in self._averagers]
        mean = averages[0].mean + float(self._zero[place])
        shown = [one for one in averages if one.count >= (2 if one.samples in self._asked else _FEWEST_AVERAGES)]
        step = self._steps[place].result()
        return ChannelNoise(mean, count, step, shown, tau, np.sqrt(variance), low, high, terms)


def _do(work: Callable[[], None]) -> None:
    # Noise beyond any number is refused at the end. A thread has its own settings of what numpy warns of.
    with np.errstate(over="ignore", invalid="ignore"):
        work()
