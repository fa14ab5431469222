"""The samples of a log in one still interval: those that are far off, the rise of the temperature, the times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from math import sqrt
from sys import maxsize

import numpy as np

from tiltcal.core.detection import TEMPERATURE_JUMP, distances, outliers
from tiltcal.core.model import Array
from tiltcal.core.quantisation import resolution
from tiltcal.files.tables import Segment
from tiltcal.logs.recorded_readings import RecordedReadings

TO_THE_END = maxsize
"""The end of a segment that has the rest of the log."""

SOAKS = 3
"""Soaks up to the end of a segment over which the temperature is judged."""

FEWEST_FOR_A_RISE, CERTAIN = 4, 3.0
"""The least number of samples that can show a rise, and the standard deviations by which it exceeds their scatter."""

Rails = Mapping[str, tuple[float, float]]
"""The lowest and the highest reading of channels, unit."""


@dataclass(frozen=True)
class Samples:
    """The samples of an interval without those that are far off or have no number.

    Attributes
    ----------
    left_out : int
        Samples that are far off or have no number.
    why : str
        Which is the first, and by how much it is off; empty without.
    channels : mapping of str to ndarray, shape (n,)
        The others.
    """

    left_out: int
    why: str
    channels: Mapping[str, Array]


@dataclass(frozen=True)
class LogInterval:
    """One attitude of a log: segments of one name that follow each other.

    Attributes
    ----------
    parts : sequence of Segment
        As they were named.
    previous_end : int
        The row behind the interval before, from which on rows without a time may belong to this one.
    """

    parts: Sequence[Segment]
    record: RecordedReadings
    previous_end: int = 0

    def rows_of(self, column: Array) -> Array:
        """Return the values of a column in the interval, shape (n,)."""
        parts = sorted(self.parts, key=lambda part: part.start)
        return np.concatenate([column[part.start : part.end] for part in parts])

    def samples(self, step: float) -> Samples:
        """Return the samples of the interval for a step of the reading, unit: within two steps none is far off."""
        channels = self.record.channels
        samples = np.stack([self.rows_of(column) for column in self.record.columns])
        lost, why = 0, ""
        if not (there := np.isfinite(samples)).all():
            why = f"{channels[int(np.argmin(there.all(axis=1)))]} has no number"
            complete = there.all(axis=0)
            samples, lost = samples[:, complete], int(np.count_nonzero(~complete))
        if not samples.shape[1]:
            return Samples(lost, why, {})
        judged = [distances(channel) for channel in samples]
        # How far a sample is off in the channel in which it is farthest of those that make it an outlier.
        off = np.zeros(samples.shape[1])
        for distance, limit, _ in judged:
            if distance is not None:
                np.maximum(off, distance, out=off, where=distance > limit)
        usable = off <= 2.0 * step
        if not usable.all():
            far = [
                np.flatnonzero((distance > limit) & ~usable) if distance is not None else np.empty(0, int)
                for distance, limit, _ in judged
            ]
            first = next(int(numbers[0]) for numbers in far if len(numbers))
            k = max(k for k, numbers in enumerate(far) if first in numbers)
            why = f"{channels[k]} reads {samples[k][first]:.6g} where the other samples read {judged[k][2]:.6g}"
            lost, samples = lost + int(np.count_nonzero(~usable)), samples[:, usable]
        return Samples(lost, why, dict(zip(channels, samples, strict=True)))

    @cached_property
    def times(self) -> tuple[float, float] | None:
        """Of the first and the last of its rows that have one, s; None where none has."""
        if self.record.time is None:
            return None
        times = self.rows_of(self.record.time)
        times = times[np.isfinite(times)]
        return (float(times[0]), float(times[-1])) if len(times) else None

    @cached_property
    def temperatures(self) -> tuple[Array, list[float]]:
        """The temperatures of its rows, °C, and those of them that are far off and left out."""
        if self.record.temperature is None:
            return np.empty(0), []
        values = self.rows_of(self.record.temperature)
        values = values[np.isfinite(values)]
        far = outliers(values) if len(values) else np.empty(0, np.intp)
        far = far[np.abs(values[far] - np.median(values)) > TEMPERATURE_JUMP] if len(far) else far
        return np.delete(values, far), values[far].tolist()

    def warming(self, soak: float) -> float:
        """Return by how much the temperature rises in the interval, or up to its end over several soaks, °C.

        A short segment of a steady ramp looks still, and the sensor is as far behind its thermometer as in a long one.
        Without times it is judged over as many times its own rows. ``soak`` is in seconds; 0 judges its rows alone.
        """
        own = rise(self.temperatures[0])
        start, end = self.parts[0].start, self.parts[-1].end
        if self.record.temperature is None or not soak:
            return own
        begin = max(self.previous_end, start - (SOAKS - 1) * (end - start))
        time = self.record.time
        if time is not None and np.isfinite(time[end - 1]):
            early = np.flatnonzero(~(time[:end] >= time[end - 1] - soak))
            begin = int(early[-1]) + 1 if len(early) else 0
        before = np.asarray(self.record.temperature[min(begin, start) : end])
        return own if begin >= start else max(own, rise(before[np.isfinite(before)]), key=abs)


def intervals_in(record: RecordedReadings, segments: Sequence[Segment]) -> list[LogInterval]:
    """Return the intervals of a log: segments of one name that follow each other are parts of one."""
    groups = [list(parts) for _, parts in groupby(segments, key=lambda segment: (segment.name, segment.gravity))]
    ends = [0, *(parts[-1].end for parts in groups)]
    return [
        LogInterval(parts, record, max((end for end in ends if end <= parts[0].start), default=0)) for parts in groups
    ]


def step_of(record: RecordedReadings) -> float:
    """Return the step of the readings, unit: the smallest of a channel in the whole log; 0 where all are alike."""
    return resolution(record.columns)


def rise(values: Array) -> float:
    """Return the rise of a line through values, shape (n,), from first to last, less what their scatter explains."""
    n = len(values)
    if n < FEWEST_FOR_A_RISE:
        return 0.0
    off, places = values - values.mean(), np.arange(n) - (n - 1) / 2
    spread = n * (n**2 - 1.0) / 12.0
    slope = float(off @ places) / spread
    scatter = sqrt(max(float(off @ off) - slope**2 * spread, 0.0) / (n - 2) / spread)
    return float(np.sign(slope)) * max(abs(slope) - CERTAIN * scatter, 0.0) * (n - 1)
