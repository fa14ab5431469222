"""A recorded log as positions: what the sensor read while it was held still, ready for the estimator."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from difflib import get_close_matches
from itertools import groupby
from math import sqrt
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tiltcal.calibration.measurement import Measurement, rail_in_words
from tiltcal.calibration.wording import LOST_HOLDS
from tiltcal.column_names import TEMPERATURE, TIME
from tiltcal.core.detection import LEFT_OUT, TEMPERATURE_JUMP, identical_by_chance, noise_of_positions, outliers
from tiltcal.core.model import Array
from tiltcal.core.samples import SampleSummary, resolution, summarise
from tiltcal.errors import InputError
from tiltcal.files.moments import stamp_of
from tiltcal.files.procedure import PositionProcedure
from tiltcal.files.tables import Segment, TabledPosition
from tiltcal.logs.columns import RecordedColumns
from tiltcal.logs.numbers_and_times import clock_breaks
from tiltcal.printable import distinct

FEWEST_ROWS = 2  # samples that a segment needs for a standard deviation
UP = (0.0, 0.0, 1.0)  # stands for a direction that nothing has said yet
MOST_FAULTS = 2  # holds in which one channel may be at its rail or stand still before the sensor is not credible
STEP_BLOCKS, STEP = 8, 4.0  # blocks of a hold; a jump between them exceeds their wandering so many times
AGAIN = "{} ({})"  # how a position is called that is taken again; position_of gives back its name
SOAKS = 3  # soaks up to the end of a segment over which the temperature is judged
FEWEST_FOR_A_RISE, CERTAIN = 4, 3.0
"""The least number of samples that can show a rise, and the standard deviations by which it exceeds their scatter."""


Rails = Mapping[str, tuple[float, float]]  # the lowest and the highest reading of channels, unit


def position_of(name: str) -> str:
    """Return the position whose name a segment has, be it taken again."""
    return name.partition(" (")[0]


@dataclass(frozen=True)
class StaticInterval:
    """The readings of a sensor while it was held in one attitude, as a measurement whose direction is not yet known.

    ``stated`` is what the file says of it: its name, the same where the sensor was put there again, and perhaps up.
    ``warming`` is by how much the temperature rose, °C; ``times`` are those of its first and last row, s.
    """

    measurement: Measurement
    stated: Segment | TabledPosition
    warming: float = 0.0
    times: tuple[float, float] | None = None


def intervals_of(
    record: RecordedColumns,
    channels: Sequence[str],
    segments: Sequence[Segment],
    rails: Rails,
    *,
    file: str,
    soak: float,
) -> list[StaticInterval]:
    """Return what the sensor read in each interval, without the samples that are far off the others or missing.

    Segments of one name that follow each other are parts of one interval. One that reaches beyond the log, has samples
    at a rail or too many far off or missing, or is stuck is refused; ``file`` is where the segments stand, and a
    temperature is judged over ``soak`` seconds.
    """
    step = resolution(record.of(channels))
    groups = [list(parts) for _, parts in groupby(segments, key=lambda segment: (segment.name, segment.gravity))]
    names = list(distinct((parts[0].name for parts in groups), AGAIN))
    ends = [0, *(parts[-1].end for parts in groups)]
    restarts = [0, *(clock_breaks(record.by_role[TIME])[0].tolist() if TIME in record.by_role else ())]
    intervals = []
    for parts, name in zip(groups, names, strict=True):
        interval = _LogInterval(record, channels, parts, file)
        previous, begun = (max(row for row in rows if row <= parts[0].start) for rows in (ends, restarts))
        intervals.append(interval.read(name, step, rails, soak, previous, begun))
    _require_not_stuck(intervals, step, file)
    return intervals


@dataclass(frozen=True)
class Trimmed:
    """What is left of so many holds that were found: segments, and by name why rows or the whole hold do not count.

    ``faults`` are the channels by hold that was at a rail or stood at one value.
    """

    holds: int
    segments: tuple[Segment, ...]
    trimmed: Mapping[str, str]
    left_out: Mapping[str, str]
    faults: Mapping[str, str]

    def in_words(self) -> Iterator[str]:
        """Yield which holds are trimmed or left out, and why."""
        for what, named in (("left out", self.left_out), ("trimmed", self.trimmed)):
            if named:
                each = ", ".join(f"{name} ({why})" for name, why in named.items())
                yield f"{len(named)} of {self.holds} holds {'is' if len(named) == 1 else 'are'} {what}: {each}"

    @property
    def not_credible(self) -> str | None:
        """What speaks against the sensor: holds lost by rail or standstill; None where little does."""
        often = Counter(self.faults.values()).most_common(1)
        if 3 * len(self.faults) > self.holds or (often and often[0][1] > MOST_FAULTS):
            return f"{len(self.faults)} of {self.holds} {LOST_HOLDS} ({', '.join(sorted({*self.faults.values()}))})"
        return None


def trimmed(
    record: RecordedColumns, channels: Sequence[str], segments: Sequence[Segment], rails: Rails, fewest: int
) -> Trimmed:
    """Trim holds that were found to what stands still, at least ``fewest`` rows, or leave them out.

    Only a hold's own samples decide: a rail, one value, a step, samples far off or missing.
    """
    step = resolution(record.of(channels))
    groups = [list(parts) for _, parts in groupby(segments, key=lambda segment: segment.name)]
    names = list(distinct((parts[0].name for parts in groups), AGAIN))
    holds = [np.concatenate([np.arange(part.start, part.end) for part in parts]) for parts in groups]
    noise = {}
    for channel in channels:
        values = (record.by_role[channel][rows] for rows in holds)
        finite = [one[np.isfinite(one)] for one in values]
        noise[channel] = noise_of_positions([summarise(one, step) for one in finite if len(one) > 1], step)
    kept, shorter, gone, faults = list[Segment](), dict[str, str](), dict[str, str](), dict[str, str]()
    for name, parts, rows in zip(names, groups, holds, strict=True):
        samples = {channel: record.by_role[channel][rows] for channel in channels}
        if fault := _standing_fault(samples, rails, noise, step):
            gone[name], faults[name] = fault
            continue
        usable, why = _usable(samples, step)
        if not why:
            kept += parts
            continue
        start, end = _longest(rows, usable)
        if end - start < fewest:
            gone[name] = why
        else:
            shorter[name] = f"{why}: rows {start} to {end}"
            kept.append(replace(parts[0], start=start, end=end))
    return Trimmed(len(groups), tuple(kept), shorter, gone, faults)


def _standing_fault(
    samples: Mapping[str, Array], rails: Rails, noise: Mapping[str, float], step: float
) -> tuple[str, str] | None:
    """Return why a hold says nothing, and the channel: at its rail, or at one value that noise would have changed."""
    for channel, values in samples.items():
        finite = values[np.isfinite(values)]
        low, high = rails.get(channel, (-np.inf, np.inf))
        if len(finite) and not ((low < finite) & (finite < high)).all():
            return f"{channel} is at its rail", channel
        if len(finite) > 1 and np.ptp(finite) == 0.0 and not identical_by_chance(len(finite), noise[channel], step):
            return f"{channel} stood at one value", channel
    return None


def _usable(samples: Mapping[str, Array], step: float) -> tuple[NDArray[np.bool_], str]:
    """Return which rows of a hold stand still and are there, and why the others do not count, if they are not few."""
    usable = np.logical_and.reduce([np.isfinite(values) for values in samples.values()])
    count, why = len(usable), ""
    far = np.zeros(count, dtype=bool)
    for values in samples.values():
        there = np.flatnonzero(np.isfinite(values))
        far[there[outliers(values[there], step)]] = True
    lost = int((far | ~usable).sum())
    if lost > max(1, LEFT_OUT * count):
        why = f"{lost} of its {count} samples are far off or missing"
    usable &= ~far
    for channel, values in samples.items():
        if (cut := _step_at(values[usable])) is not None:
            at = int(np.flatnonzero(usable)[cut])
            side = np.arange(count) < at if 2 * cut >= int(usable.sum()) else np.arange(count) >= at
            usable &= side
            why = f"{channel} jumps in it"
    return usable, why


def _step_at(values: Array) -> int | None:
    """Return where the mean of a channel at rest jumps, by far more than it wanders on either side; None if nowhere."""
    size = len(values) // STEP_BLOCKS
    if size < FEWEST_FOR_A_RISE:
        return None
    means = values[: size * STEP_BLOCKS].reshape(STEP_BLOCKS, size).mean(axis=1)
    noise = float(np.std(np.diff(values))) / sqrt(2.0)
    for cut in range(2, STEP_BLOCKS - 1):
        left, right = means[:cut], means[cut:]
        wander = max(float(np.ptp(left)), float(np.ptp(right)), noise / sqrt(size))
        if abs(float(left.mean() - right.mean())) > max(STEP * wander, 2.0 * noise):
            return cut * size
    return None


def _longest(rows: NDArray[np.intp], usable: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first row and the row behind the last of the longest run of rows that are usable."""
    good = rows[usable]
    if not len(good):
        return 0, 0
    runs = np.split(good, np.flatnonzero(np.diff(good) != 1) + 1)
    longest = max(runs, key=len)
    return int(longest[0]), int(longest[-1]) + 1


def intervals_of_table(positions: Sequence[TabledPosition]) -> list[StaticInterval]:
    """Return what a table of positions states of each."""
    means = [Decimal(repr(float(mean))) for position in positions for mean in position.mean.values()]
    step = 10.0 ** min(0, *(cast(int, mean.normalize().as_tuple().exponent) for mean in means))
    intervals = []
    for position, name in zip(positions, distinct((position.name for position in positions), AGAIN), strict=True):
        where = {} if position.line is None else {"line": position.line}
        measured = Measurement(name, UP, None, position.temperature, _tabled(position, step), where)
        intervals.append(StaticInterval(measured, position))
    return intervals


def placed(intervals: Sequence[StaticInterval], procedure: PositionProcedure, *, file: str) -> list[Measurement]:
    """Return measurements in known directions; free ones have none.

    The procedure says the direction of a position that is only named, and its temperature where none was recorded.
    Refused is a temperature that did not stand still where it counts, or is missing in some.
    """
    known = procedure.known
    if not known:
        return [interval.measurement for interval in intervals]
    if procedure.thermal:
        for interval in intervals:
            _require_steady(interval, procedure, file)
        _require_temperatures(intervals, file)
    measurements = []
    for interval in intervals:
        stated, measured = interval.stated, interval.measurement
        position = known.get(stated.name)
        if position is not None:
            measured = replace(measured, heading=position.heading)
        if stated.gravity is not None:
            measured = replace(measured, gravity=stated.gravity)
        elif position is not None:
            measured = replace(measured, gravity=position.gravity, tilt=position.tilt, stage=position.stage)
            if measured.temperature is None:
                measured = replace(measured, temperature=position.temperature)
        measurements.append(measured)
    return measurements


def require_positions(
    named: Iterable[Segment] | Iterable[TabledPosition], procedure: PositionProcedure, *, file: str
) -> None:
    """Refuse segments or tabled positions without a direction whose names the procedure does not have."""
    known = list(procedure.known)
    for segment in named:
        if known and segment.gravity is None and segment.name not in known:
            near = get_close_matches(segment.name, known, n=1)
            meant = f" (did you mean {near[0]!r}?)" if near else f"; it has {', '.join(known)}"
            why = f"{procedure.name} has no position {segment.name!r}{meant}, and no gx, gy, gz are given for it"
            raise InputError(why, file=file, line=segment.line)


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


@dataclass(frozen=True)
class _LogInterval:
    """One attitude of a log: segments of one name that follow each other."""

    record: RecordedColumns
    channels: Sequence[str]
    parts: Sequence[Segment]
    file: str

    def read(self, name: str, step: float, rails: Rails, soak: float, previous: int, begun: int) -> StaticInterval:
        """Return what the sensor read; ``previous`` is the row behind the last one, at ``begun`` its clock began."""
        for part in self.parts:
            if part.end > len(self.record):
                raise self._refusal(f"ends at row {part.end}; {self.record.name} has {len(self.record)} rows", part)
            if part.end - part.start < FEWEST_ROWS:
                why = f"has {part.end - part.start} row; at least {FEWEST_ROWS} are needed"
                raise self._refusal(why, part)
        samples, left_out = self._samples(step)
        for channel, (low, high) in rails.items():
            values = samples[channel]
            beyond = values[~((low < values) & (values < high))]
            if len(beyond):
                raise self._refusal(
                    rail_in_words(channel, f"{beyond[0]:.6g} in {len(beyond)} of its rows", (low, high))
                )
        temperatures, times = self._temperatures(), self._finite(TIME)
        rows = tuple((part.start, part.end) for part in self.parts)
        where: dict[str, Any] = {"rows": rows if len(rows) > 1 else rows[0]}
        if left_out:
            where["left_out"] = left_out
        if len(times):
            where["time"] = stamp_of(float(times[-1]))
        return StaticInterval(
            Measurement(
                name,
                UP,
                None,
                summarise(temperatures).mean if len(temperatures) else None,
                {channel: summarise(values, step) for channel, values in samples.items()},
                where,
            ),
            self.parts[0],
            self._warming(rise(temperatures), soak, previous, begun),
            (float(times[0]), float(times[-1])) if len(times) else None,
        )

    def _rows_of(self, column: Array) -> Array:
        parts = sorted(self.parts, key=lambda part: part.start)
        return np.concatenate([column[part.start : part.end] for part in parts])

    def _finite(self, role: str) -> Array:
        values = self._rows_of(self.record.by_role[role]) if role in self.record.by_role else np.empty(0)
        return values[np.isfinite(values)]

    def _samples(self, step: float) -> tuple[dict[str, Array], int]:
        """Return the samples that count by channel, and how many rows are missing or far off, which are few."""
        columns = {channel: self._rows_of(self.record.by_role[channel]) for channel in self.channels}
        there = np.logical_and.reduce([np.isfinite(values) for values in columns.values()])
        why = next((f"{c} has no number" for c, values in columns.items() if not np.isfinite(values).all()), "")
        columns = {channel: values[there] for channel, values in columns.items()}
        usable = np.ones(int(there.sum()), dtype=bool)
        for channel, values in columns.items():
            far = outliers(values, step)
            usable[far] = False
            if len(far):
                why = f"{channel} reads {values[far[0]]:.6g} where the other samples read {np.median(values):.6g}"
        left_out = len(there) - int(usable.sum())
        self._require_few(left_out, why)
        return {channel: values[usable] for channel, values in columns.items()}, left_out

    def _temperatures(self) -> Array:
        """Return the temperatures, °C, without the few that jump."""
        values = self._finite(TEMPERATURE)
        far = outliers(values)
        far = far[np.abs(values[far] - np.median(values)) > TEMPERATURE_JUMP] if len(far) else far
        if len(far):
            self._require_few(len(far), f"the thermometer reads {values[far[0]]:g} °C")
        return np.delete(values, far)

    def _warming(self, own: float, soak: float, previous: int, begun: int) -> float:
        """Return by how much the temperature rises in the interval, or up to its end over several soaks, °C.

        A short segment of a steady ramp looks still, and the sensor is as far behind its thermometer as in a long one.
        Without times it is judged over as many times its own rows. ``soak`` is in seconds; 0 judges its rows alone.
        """
        start, end, time = self.parts[0].start, self.parts[-1].end, self.record.by_role.get(TIME)
        if TEMPERATURE not in self.record.by_role or not soak:
            return own
        begin = max(previous, start - (SOAKS - 1) * (end - start))
        if time is not None and np.isfinite(time[end - 1]):
            early = np.flatnonzero(~(time[:end] >= time[end - 1] - soak))
            begin = max([begun, *(early[-1:] + 1).tolist()])
        before = self.record.by_role[TEMPERATURE][min(begin, start) : end]
        return own if begin >= start else max(own, rise(before[np.isfinite(before)]), key=abs)

    def _require_few(self, count: int, why: str) -> None:
        rows = sum(part.end - part.start for part in self.parts)
        if count > max(1, LEFT_OUT * rows) or rows - count < FEWEST_ROWS:
            raise self._refusal(f"{count} of its {rows} samples are far off or missing: {why}; choose other rows")

    def _refusal(self, why: str, part: Segment | None = None) -> InputError:
        part = part or self.parts[0]
        return InputError(f"segment {part.name}: {why}", file=self.file, line=part.line)


def soak_of(procedure: PositionProcedure) -> float:
    """Return over how many seconds a temperature is judged."""
    return procedure.soak.thermometer or SOAKS * procedure.soak.seconds


def _require_steady(interval: StaticInterval, procedure: PositionProcedure, file: str) -> None:
    """Refuse a temperature point at which thermometer and sensor were still on their way, each at its own pace."""
    allowed = procedure.soak.drift
    if abs(interval.warming) > allowed:
        raise InputError(
            f"segment {interval.measurement.position}: the temperature drifts by {interval.warming:+.2f} °C up to its "
            f"end, more than the {allowed:g} °C that {procedure.name} allows in {soak_of(procedure):g} s: thermometer "
            "and sensor are apart while they change; take rows where both stand still, or go slower",
            file=file,
            line=interval.stated.line,
        )


def _require_temperatures(intervals: Sequence[StaticInterval], file: str) -> None:
    """Refuse intervals of which only some have a temperature: the procedure's is no stand-in for one that was lost."""
    warm = [interval for interval in intervals if interval.measurement.temperature is not None]
    silent = next((interval for interval in intervals if interval.measurement.temperature is None), None)
    if warm and silent is not None:
        raise InputError(
            f"segment {silent.measurement.position}: there is no temperature in its rows, and "
            f"{warm[0].measurement.position} has one; choose rows that have it, or fill it in",
            file=file,
            line=silent.stated.line,
        )


def _require_not_stuck(intervals: Sequence[StaticInterval], step: float, file: str) -> None:
    """Refuse a channel that stood at one value where its own noise would have moved it.

    The noise is that of all segments before rounding: a converter that is coarser than the noise stands still, too.
    """
    for channel in intervals[0].measurement.summaries:
        summaries = [interval.measurement.summaries[channel] for interval in intervals]
        noise = noise_of_positions(summaries, step)
        for interval, summary in zip(intervals, summaries, strict=True):
            if summary.std == 0.0 and not identical_by_chance(summary.n, noise, step):
                raise InputError(
                    f"segment {interval.stated.name}: all samples of {channel} are identical, and elsewhere they "
                    f"scatter by {noise:.3g}: it was stuck, not still; choose other rows",
                    file=file,
                    line=interval.stated.line,
                )


def _tabled(position: TabledPosition, step: float) -> dict[str, SampleSummary]:
    """Summaries as far as a table gives them: without a stated uncertainty, means are known to its last digit."""
    means, n, rounding = position.mean.items(), position.n or 1, step / sqrt(12)
    if position.u is None:
        return {name: SampleSummary(mean, 0.0, n, rounding, rounding, resolution=step) for name, mean in means}
    return {name: SampleSummary(mean, position.u[name] * sqrt(n), n, position.u[name]) for name, mean in means}
