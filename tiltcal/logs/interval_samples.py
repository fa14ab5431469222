"""The samples of a log's still intervals, judged and summed up piece by piece while the log is read.

A piece has a quarter of a million rows, the last piece of an interval up to twice as many, so an interval of less than
half a million rows is one piece. Samples are far off where they are by the median and the scatter of their piece.

Whether a sample is far off also depends on the step of the reading, which the whole log shows, where the noise is less
than a third of it. A piece is summed up for every step that makes a difference; these are few.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from math import sqrt
from sys import maxsize
from typing import Any

import numpy as np

from tiltcal.core.detection import TEMPERATURE_JUMP, distances, outliers
from tiltcal.core.model import Array
from tiltcal.core.quantisation import DifferentValues, resolution
from tiltcal.core.samples import BLOCKS, Moments, moments_of
from tiltcal.files.tables import Segment
from tiltcal.logs.recorded_readings import RecordedReadings

PIECE = 1 << 18
"""Rows of a piece."""

TO_THE_END = maxsize
"""The end of a segment that has the rest of the log."""

SOAKS = 3
"""Soaks up to the end of a segment over which the temperature is judged."""

FEWEST_FOR_A_RISE, CERTAIN = 4, 3.0
"""The least number of samples that can show a rise, and the standard deviations by which it exceeds their scatter."""

_ROWS = 1 << 10  # of the blocks of an interval whose length is not known
_RECENT = 1 << 21  # rows of temperatures that are kept
_THREADS = 2  # each holds several copies of a piece

Rails = Mapping[str, tuple[float, float]]
"""The lowest and the highest reading of channels, unit."""


@dataclass(frozen=True)
class Sums:
    """The sums over the samples of a piece without those that are far off or have no number.

    Attributes
    ----------
    limit : float
        Two steps of the reading are at least so much, unit.
    far : int
        Samples that are left out.
    why : str
        Which, and by how much it is off; empty without.
    beyond : mapping of str to (float, int)
        The first reading of a channel at a rail, and how many are.
    channels : mapping of str to Moments
        Empty where no sample has a number.
    """

    limit: float
    far: int
    why: str
    beyond: Mapping[str, tuple[float, int]]
    channels: Mapping[str, Moments]


@dataclass(frozen=True)
class Line:
    """A straight line through some values, one after the other: their sums.

    Attributes
    ----------
    product, squares : float
        Sums of the products with the places and of the squares, both about their means.
    """

    n: int
    mean: float
    product: float
    squares: float

    @classmethod
    def through(cls, values: Array) -> Line:
        """Sum up some values, shape (n,)."""
        off = values - (mean := float(values.mean()) if len(values) else 0.0)
        return cls(len(values), mean, float(off @ (np.arange(len(off)) - (len(off) - 1) / 2)), float(off @ off))

    def followed_by(self, other: Line) -> Line:
        """Return the line through the values of both."""
        n = self.n + other.n
        if not n:
            return self
        share, step = self.n * other.n / n, other.mean - self.mean
        return Line(
            n,
            self.mean + step * other.n / n,
            self.product + other.product + share * step * n / 2,
            self.squares + other.squares + share * step**2,
        )

    @property
    def rise(self) -> float:
        """The rise from the first value to the last, less what their scatter explains."""
        if self.n < FEWEST_FOR_A_RISE:
            return 0.0
        places = self.n * (self.n**2 - 1.0) / 12.0
        slope = self.product / places
        scatter = sqrt(max(self.squares - slope * self.product, 0.0) / (self.n - 2) / places)
        return float(np.sign(slope)) * max(abs(slope) - CERTAIN * scatter, 0.0) * (self.n - 1)


@dataclass(frozen=True)
class Temperatures:
    """The temperatures of a piece without those that are far off, which have ``jumped``."""

    jumped: Sequence[float]
    line: Line
    moments: Moments | None


@dataclass(frozen=True)
class Piece:
    """Some samples of an interval.

    Attributes
    ----------
    sums : sequence of Sums
        By rising limit.
    temperatures : Temperatures or None
        None without a thermometer.
    """

    sums: Sequence[Sums]
    temperatures: Temperatures | None

    def summed(self, step: float) -> Sums:
        """Return the sums for a step of the reading."""
        return next(found for found in reversed(self.sums) if found.limit <= 2.0 * step)


class IntervalSamples:
    """The samples of one interval, summed up in a thread as they come.

    Parameters
    ----------
    channels : sequence of str
        Of the rows that are added; behind them may be the temperature.
    submit : callable
        Calls a function in a thread.

    Attributes
    ----------
    before : Line or None
        Of the temperature up to the interval's end, where it is judged over more rows than these.
    times : (float, float) or None
        Of the first and the last of its rows that have one, s; None where none has.
    """

    def __init__(
        self, parts: Sequence[Segment], channels: Sequence[str], rails: Rails, submit: Callable[..., Future[Piece]]
    ) -> None:
        self.parts = parts
        self.last = max(parts, key=lambda part: part.start)
        self.pieces: list[Future[Piece]] = []
        self.before: Line | None = None
        self.times: tuple[float, float] | None = None
        self.rails = rails
        self._channels, self._submit = channels, submit
        self._block = sum(part.end - part.start for part in parts) // BLOCKS if self.last.end < TO_THE_END else _ROWS
        self._piece: list[Sequence[Array]] = []
        self._next: list[Sequence[Array]] = []
        self._rows = self._begun = 0

    def add(self, values: Sequence[Array], start: int, end: int) -> None:
        """Take some rows of a block: of each column, shape (n,)."""
        while start < end:
            taken = min(end - start, PIECE - self._rows)
            self._next.append([column[start : start + taken] for column in values])
            self._rows += taken
            start += taken
            if self._rows == PIECE:
                if self._piece:
                    self._sum_up(self._piece, self._block)
                    self._begun += PIECE
                self._piece, self._next, self._rows = self._next, [], 0

    def add_times(self, times: Array) -> None:
        """Take the times of some rows, shape (n,), s."""
        if not (len(times) and np.isfinite(times[[0, -1]]).all()):
            times = times[np.isfinite(times)]
        if len(times):
            self.times = (float(times[0]) if self.times is None else self.times[0], float(times[-1]))

    def end(self) -> None:
        """Sum up the last rows."""
        rows, self._piece, self._next = self._piece + self._next, [], []
        if rows:
            self._sum_up(rows, self._block if self.pieces else 0)

    def _sum_up(self, rows: Sequence[Sequence[Array]], block: int) -> None:
        self.pieces.append(self._submit(piece_of, rows, self._channels, self.rails, self._begun, block))


def sampled(
    record: RecordedReadings, segments: Sequence[Segment], rails: Rails, soak: float = 0.0
) -> tuple[list[IntervalSamples], float]:
    """Read a log, and sum up what it has in each segment.

    Parameters
    ----------
    segments : sequence of Segment
        Segments of one name that follow each other are parts of one interval.
    rails : mapping of str to (float, float)
        The lowest and the highest reading of each channel, where they are known, unit.
    soak : float
        Seconds over which a temperature must stand still: the rise is also judged over the rows before a segment.

    Returns
    -------
    intervals : list of IntervalSamples
    step : float
        Of the readings, unit; 0 where all are alike.
    """
    different = [DifferentValues() for _ in record.channels]
    recent = RecentTemperatures(soak, timed=record.timed) if soak and record.thermometer else None
    columns = len(record.channels) + record.thermometer
    unfinished: deque[Future[Piece]] = deque()
    with ThreadPoolExecutor(_THREADS) as threads:

        def submit(*work: Any) -> Future[Piece]:
            if len(unfinished) > _THREADS:
                unfinished.popleft().result()
            unfinished.append(threads.submit(*work))
            return unfinished[-1]

        groups = groupby(segments, key=lambda segment: (segment.name, segment.gravity))
        intervals = [IntervalSamples(list(parts), record.channels, rails, submit) for _, parts in groups]
        ends = [0, *(interval.parts[-1].end for interval in intervals)]
        coming = deque(sorted(((part, one) for one in intervals for part in one.parts), key=lambda pair: pair[0].start))
        for first, values in record.blocks():
            for channel, found in zip(values, different, strict=False):
                found.add(channel)
            if recent is not None:
                recent.add(values[len(record.channels) :])
            while coming and coming[0][0].start < record.rows:
                part, interval = coming[0]
                start, end = max(part.start - first, 0), min(part.end, record.rows) - first
                interval.add(values[:columns], start, end)
                if record.timed:
                    interval.add_times(values[columns][start:end])
                if part.end > record.rows:
                    break
                coming.popleft()
                if part is interval.last:
                    interval.end()
                    start = interval.parts[0].start
                    if recent is not None:
                        before = max((end for end in ends if end <= start), default=0)
                        interval.before = recent.line_before(start, interval.parts[-1].end, before)
        for interval in intervals:
            interval.end()
    return intervals, min(filter(None, (found.step() for found in different)), default=0.0)


def piece_of(
    rows: Sequence[Sequence[Array]], channels: Sequence[str], rails: Rails, begun: int = 0, block: int = 0
) -> Piece:
    """Judge some samples of an interval, and sum up the others.

    Parameters
    ----------
    rows : sequence of sequence of ndarray, shape (n,)
        The channels and, where there is one, the temperature, of one block after the other.
    begun : int
        Samples of the interval before these.
    block : int
        Samples of the interval that make one block of a mean; 0 where these are all and make ten.
    """
    values = np.empty((len(rows[0]), sum(len(part[0]) for part in rows)))
    for row, parts in zip(values, zip(*rows, strict=True), strict=True):
        np.concatenate(parts, out=row)
    temperatures = _temperatures(values[len(channels)]) if len(values) > len(channels) else None
    samples, lost, places = values[: len(channels)], 0, np.arange(begun, begun + values.shape[1])
    empty = ""
    if not (there := np.isfinite(samples)).all():
        empty = f"{channels[int(np.argmin(there.all(axis=1)))]} has no number"
        complete = there.all(axis=0)
        samples, places, lost = samples[:, complete], places[complete], int(np.count_nonzero(~complete))
    if not len(places):
        return Piece([Sums(0.0, lost, empty, {}, {})], temperatures)
    judged = [distances(channel) for channel in samples]
    # How far a sample is off in the channel in which it is farthest of those that make it an outlier.
    off = np.zeros(samples.shape[1])
    for distance, limit, _ in judged:
        if distance is not None:
            np.maximum(off, distance, out=off, where=distance > limit)
    doubtful = np.compress(off > 0.0, off)
    if len(doubtful):
        doubtful = np.unique(doubtful[doubtful <= 2.0 * resolution(samples)])
    sums = []
    for limit in (0.0, *doubtful.tolist()):
        kept = off <= limit
        why, left = empty, samples
        if not kept.all():
            far = [
                np.flatnonzero((distance > least) & ~kept) if distance is not None else np.empty(0, int)
                for distance, least, _ in judged
            ]
            first = next(int(numbers[0]) for numbers in far if len(numbers))
            k = max(k for k, numbers in enumerate(far) if first in numbers)
            reads, centre = samples[k][first], judged[k][2]
            why = f"{channels[k]} reads {reads:.6g} where the other samples read {centre:.6g}"
            left = samples[:, kept]
        number, edges = 0, ()
        if block:
            taken = places[kept]
            number = int(taken[0]) // block
            bounds = np.arange(number + 1, int(taken[-1]) // block + 1) * block
            edges = (0, *np.searchsorted(taken, bounds).tolist(), len(taken))
        moments = {name: moments_of(channel, number, edges) for name, channel in zip(channels, left, strict=True)}
        beyond = {}
        for name, (low, high) in rails.items():
            channel = left[list(channels).index(name)]
            at = channel[~((low < channel) & (channel < high))]
            if len(at):
                beyond[name] = (float(at[0]), len(at))
        sums.append(Sums(limit, lost + len(kept) - int(kept.sum()), why, beyond, moments))
    return Piece(sums, temperatures)


def _temperatures(values: Array) -> Temperatures:
    known = values[np.isfinite(values)]
    if not len(known):
        return Temperatures((), Line.through(known), None)
    far = outliers(known)
    far = far[np.abs(known[far] - np.median(known)) > TEMPERATURE_JUMP] if len(far) else far
    jumped = known[far].tolist()
    known = np.delete(known, far) if jumped else known
    return Temperatures(jumped, Line.through(known), moments_of(known))


class RecentTemperatures:
    """The temperatures of the latest rows, two million at most, for so many seconds."""

    def __init__(self, soak: float, *, timed: bool) -> None:
        self._soak, self._timed = soak, timed
        self._blocks: deque[Array] = deque()
        self._first = self._end = 0

    def add(self, values: Sequence[Array]) -> None:
        """Take the next rows, shape (n,): temperatures, °C, and behind them times, s, where there are some."""
        self._blocks.append(np.stack(values))
        self._end += len(values[0])
        while self._end - self._first - self._blocks[0].shape[1] >= _RECENT:
            self._first += self._blocks.popleft().shape[1]

    def line_before(self, start: int, end: int, first: int) -> Line | None:
        """Return the line up to the end of a segment: over several soaks, or over as many times its own rows.

        None where it would begin with the segment.

        A short segment of a steady ramp looks still, and the sensor is as far behind its thermometer as in a long one.

        Parameters
        ----------
        start, end : int
            The segment's rows, of which the last has just come.
        first : int
            The row behind the segment before, from which on rows are of this one where the log has no times.
        """
        values = np.concatenate(self._blocks, axis=1)[:, : end - self._first]
        begin = max(first, start - (SOAKS - 1) * (end - start))
        if self._timed and np.isfinite(values[1, -1]):
            early = np.flatnonzero(~(values[1] >= values[1, -1] - self._soak))
            begin = self._first + (int(early[-1]) + 1 if len(early) else 0)
        if begin >= start:
            return None
        known = values[0, max(begin - self._first, 0) :]
        return Line.through(known[np.isfinite(known)])
