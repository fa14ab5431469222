"""A recorded log as positions: what the sensor read while it was held still, ready for the estimator."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from decimal import Decimal
from difflib import get_close_matches
from itertools import groupby
from math import sqrt
from typing import Any

import numpy as np

from tiltcal.calibration.measurement import Measurement, at_rail
from tiltcal.core.detection import LEFT_OUT, TEMPERATURE_JUMP, TILTED, identical_by_chance, outliers
from tiltcal.core.gravity_direction import Vector
from tiltcal.core.model import AXES, Array
from tiltcal.core.quantisation import noise_under_rounding, resolution
from tiltcal.core.statistics import SampleSummary, drift, summarise
from tiltcal.errors import InputError
from tiltcal.files.positions import TabledPosition
from tiltcal.files.procedure import Position, Procedure
from tiltcal.files.segments import Segment
from tiltcal.logs.columns import TEMPERATURE, TIME
from tiltcal.logs.recorded_readings import RecordedReadings

FEWEST_ROWS = 2
"""Samples that a segment needs for a standard deviation."""

FEWEST_FOR_A_RISE, CERTAIN = 4, 3.0
"""Samples that tell a rise from their scatter, and by how many of its standard deviations."""

SOAKS = 3
"""Soaks up to the end of a segment over which the temperature is judged."""

_THREADS = 2  # each holds several copies of an interval

Rails = Mapping[str, tuple[float, float]]
"""The lowest and the highest reading of channels, unit."""

FLICKER = 0.5
"""Standard deviation of a reading that takes two neighbouring values, at most, in steps."""


@dataclass(frozen=True)
class StaticInterval:
    """What a sensor read while it was held in one place.

    Attributes
    ----------
    name : str
        Of the position; another one for each interval.
    position : str
        As the file names it; the same where the sensor was put there again.
    gravity : tuple of float or None
        Up in the sensor frame as the file says it; None where it does not.
    summaries : mapping of str to SampleSummary
        Per channel.
    temperature : float or None
        °C.
    line : int or None
        Where it stands in its file.
    warming : float
        By how much the temperature rose from beginning to end, °C.
    where : mapping of str to Any
        How it is found again: rows of the log, or the line of a table.
    """

    name: str
    position: str
    gravity: Vector | None
    summaries: Mapping[str, SampleSummary]
    temperature: float | None
    line: int | None
    warming: float = 0.0
    where: Mapping[str, Any] = field(default_factory=dict)


def intervals_of(
    record: RecordedReadings, segments: Sequence[Segment], *, file: str, soak: float = 0.0, rails: Rails | None = None
) -> list[StaticInterval]:
    """Return what the sensor read in each segment, without the samples that are far off the others.

    Parameters
    ----------
    segments : sequence of Segment
        Segments of one name that follow each other are parts of one interval.
    file : str
        Where the segments stand, for messages.
    soak : float
        Seconds over which a temperature must stand still: the rise is also judged over the rows before a segment.
    rails : mapping of str to (float, float)
        The lowest and the highest reading of each channel, where they are known, unit.

    Raises
    ------
    InputError
        A segment reaches beyond the log, has a missing value, samples at a rail or too many far off, or is stuck.
    """
    parts = [list(group) for _, group in groupby(segments, key=lambda segment: (segment.name, segment.gravity))]
    names = _distinct([part[0].name for part in parts])
    with ThreadPoolExecutor(_THREADS) as threads:
        steps = threads.map(lambda values: resolution([values]), record.different)
        step = min(filter(None, steps), default=0.0)
        intervals = list(
            threads.map(lambda part, name: _interval(record, step, part, name, rails or {}, file), parts, names)
        )
    if soak and TEMPERATURE in record.columns:
        ends = [0, *(part[-1].end for part in parts)]
        before = [max((end for end in ends if end <= part[0].start), default=0) for part in parts]
        intervals = [
            replace(interval, warming=max(interval.warming, _rise_before(record, part, first, soak), key=abs))
            for interval, part, first in zip(intervals, parts, before, strict=True)
        ]
    _require_not_stuck(intervals, step, file)
    return intervals


def intervals_of_table(positions: Sequence[TabledPosition]) -> list[StaticInterval]:
    """Return what a table of positions states of each."""
    step = 10.0 ** -max(_digits(mean) for position in positions for mean in position.mean.values())
    names = _distinct([position.name for position in positions])
    return [
        StaticInterval(
            name,
            position.name,
            position.gravity,
            _tabled(position, step),
            position.temperature,
            position.line,
            where={} if position.line is None else {"line": position.line},
        )
        for position, name in zip(positions, names, strict=True)
    ]


def placed(intervals: Sequence[StaticInterval], procedure: Procedure, *, file: str) -> list[Measurement]:
    """Holds in known directions.

    Parameters
    ----------
    procedure : Procedure
        Says the direction of a position that is only named, and its temperature where none was recorded.
    file : str
        Where the positions are named, for messages.

    Raises
    ------
    InputError
        The temperature did not stand still where it counts or is missing in some, or a channel is the same in all.
    """
    known = {position.name: position for position in procedure.positions}
    if procedure.determines.drift or procedure.determines.gain:
        for interval in intervals:
            _require_steady(interval, procedure, file)
        _require_temperatures(intervals, file)
    measurements = [_placed(interval, _place(interval, known)) for interval in intervals]
    _require_not_stuck_everywhere(measurements, file)
    return measurements


def oriented(intervals: Sequence[StaticInterval], attitudes: Array) -> list[Measurement]:
    """Holds in the directions that a fit has found.

    Parameters
    ----------
    attitudes : ndarray, shape (intervals, 3)
        Unit vectors, up in the sensor frame.
    """
    return [
        Measurement(interval.name, (x, y, z), None, interval.temperature, interval.summaries, interval.where)
        for interval, (x, y, z) in zip(intervals, attitudes.tolist(), strict=True)
    ]


def require_positions(named: Iterable[Segment] | Iterable[TabledPosition], procedure: Procedure, *, file: str) -> None:
    """Refuse segments or tabled positions without a direction whose names the procedure does not have.

    Raises
    ------
    InputError
        The message names the line, and a similar name.
    """
    known = [position.name for position in procedure.positions]
    for segment in named:
        if segment.gravity is None and segment.name not in known:
            near = get_close_matches(segment.name, known, n=1)
            raise InputError(
                f"{procedure.name} has no position {segment.name!r}"
                + (f" (did you mean {near[0]!r}?)" if near else f"; it has {', '.join(known)}")
                + ", and no gx, gy, gz are given for it",
                file=file,
                line=segment.line,
            )


def _place(interval: StaticInterval, known: Mapping[str, Position]) -> Position:
    """Return the position of a still interval."""
    if interval.gravity is None:
        return known[interval.position]
    heading = known[interval.position].heading if interval.position in known else None
    return Position(interval.position, "", interval.gravity, heading=heading)


def _placed(interval: StaticInterval, position: Position) -> Measurement:
    temperature = position.temperature if interval.temperature is None else interval.temperature
    return Measurement(
        interval.name,
        position.gravity,
        position.tilt,
        temperature,
        interval.summaries,
        interval.where,
        position.heading,
        position.stage,
    )


def _require_steady(interval: StaticInterval, procedure: Procedure, file: str) -> None:
    """Refuse a temperature point at which thermometer and sensor were still on their way, each at its own pace."""
    if abs(interval.warming) > procedure.soak_drift:
        raise InputError(
            f"segment {interval.name}: the temperature drifts by {interval.warming:+.2f} °C up to its end, more than "
            f"the {procedure.soak_drift:g} °C that {procedure.name} allows: thermometer and sensor are apart while "
            "they change; take rows where both stand still, or go slower",
            file=file,
            line=interval.line,
        )


def _require_temperatures(intervals: Sequence[StaticInterval], file: str) -> None:
    """Refuse intervals of which only some have a temperature: the procedure's is no stand-in for one that was lost."""
    measured = [interval for interval in intervals if interval.temperature is not None]
    silent = next((interval for interval in intervals if interval.temperature is None), None)
    if measured and silent is not None:
        raise InputError(
            f"segment {silent.name}: there is no temperature in its rows, and {measured[0].name} has one; choose rows "
            "that have it, or fill it in",
            file=file,
            line=silent.line,
        )


def _require_not_stuck(intervals: Sequence[StaticInterval], step: float, file: str) -> None:
    """Refuse a channel that stood at one value where its own noise would have moved it.

    The noise is that of all segments before rounding: a converter that is coarser than the noise stands still, too. A
    reading that flickers between two values scatters by up to half a step however small its noise is: it tells nothing
    of a segment in which another reading stands still.
    """
    for channel in intervals[0].summaries:
        scatters = [interval.summaries[channel].std ** 2 for interval in intervals]
        if step and np.median(scatters) <= (FLICKER * step) ** 2:
            continue
        scatter = float(np.mean(scatters))
        noise = noise_under_rounding(scatter, step) if step else sqrt(scatter)
        for interval in intervals:
            summary = interval.summaries[channel]
            if summary.std == 0.0 and not identical_by_chance(summary.n, noise, step):
                raise InputError(
                    f"segment {interval.position}: all samples of {channel} are identical, and elsewhere they scatter "
                    f"by {noise:.3g}: it was stuck, not still; choose other rows",
                    file=file,
                    line=interval.line,
                )


def _require_not_stuck_everywhere(measurements: Sequence[Measurement], file: str) -> None:
    """Refuse a channel that reads the same however far its axis is tilted."""
    for axis, channel in enumerate(AXES):
        reach = {measurement.gravity[axis] for measurement in measurements if channel in measurement.summaries}
        means = {
            measurement.summaries[channel].mean for measurement in measurements if channel in measurement.summaries
        }
        if len(means) == 1 and max(reach) - min(reach) > TILTED:
            raise InputError(
                f"{channel} reads {means.pop():g} in every position: it is stuck; is it connected?", file=file
            )


def _interval(
    record: RecordedReadings, step: float, parts: Sequence[Segment], name: str, rails: Rails, file: str
) -> StaticInterval:
    samples = {role: _samples(record, role, parts) for role in record.columns}
    temperature = samples.pop(TEMPERATURE, None)
    samples.pop(TIME, None)
    for part in parts:
        _require_readings(record, part, list(samples), file)
    wrong = {
        number: f"{channel} reads {values[number]:.6g} where the other samples read {np.median(values):.6g}"
        for channel, values in samples.items()
        for number in outliers(values, step).tolist()
    }
    _require_few(wrong, parts, file)
    if wrong:
        samples = {channel: np.delete(values, list(wrong)) for channel, values in samples.items()}
    for channel, (low, high) in rails.items():
        beyond = np.flatnonzero(~((low < samples[channel]) & (samples[channel] < high)))
        if len(beyond):
            reads = f"{samples[channel][beyond[0]]:.6g} in {len(beyond)} of its rows"
            raise _refusal(parts[0], at_rail(channel, reads, (low, high)), file)
    known = None if temperature is None else temperature[np.isfinite(temperature)]
    if known is not None:
        far = [n for n in outliers(known).tolist() if abs(known[n] - np.median(known)) > TEMPERATURE_JUMP]
        _require_few({n: f"the thermometer reads {known[n]:g} °C" for n in far}, parts, file)
        known = np.delete(known, far)
    return StaticInterval(
        name,
        parts[0].name,
        parts[0].gravity,
        {channel: summarise(values, step) for channel, values in samples.items()},
        None if known is None or not len(known) else summarise(known).mean,
        parts[0].line,
        0.0 if known is None else _rise(known),
        {"rows": tuple((part.start, part.end) for part in parts), **({"left_out": len(wrong)} if wrong else {})},
    )


def _require_few(wrong: Mapping[int, str], parts: Sequence[Segment], file: str) -> None:
    """Refuse a segment of which too many samples are far off the others."""
    count = sum(part.end - part.start for part in parts)
    if len(wrong) > max(1, LEFT_OUT * count):
        why = f"{len(wrong)} of its {count} samples are far off: {next(iter(wrong.values()))}; choose other rows"
        raise _refusal(parts[0], why, file)


def _rise_before(record: RecordedReadings, parts: Sequence[Segment], first: int, soak: float) -> float:
    """Return the rise up to the end of a segment, °C: over several soaks, or over as many times its own rows.

    A short segment of a steady ramp looks still, and the sensor is as far behind its thermometer as in a long one.

    Parameters
    ----------
    first : int
        The row behind the segment before, from which on rows are of this one where the log has no times.
    soak : float
        s.
    """
    start, end = parts[0].start, parts[-1].end
    times = record.columns.get(TIME)
    if times is None:
        start = max(first, start - (SOAKS - 1) * (end - start))
    else:
        early = np.flatnonzero(~(times[:end] >= times[end - 1] - SOAKS * soak))
        start = min(start, int(early[-1]) + 1 if len(early) else 0)
    temperature = record.columns[TEMPERATURE][start:end]
    return _rise(temperature[np.isfinite(temperature)])


def _rise(values: Array) -> float:
    """Return the rise along the straight line through all values, less what their scatter explains."""
    count = len(values)
    if count < FEWEST_FOR_A_RISE:
        return 0.0
    rise, uncertainty = drift(range(count), values.tolist())
    return float(np.sign(rise)) * max(abs(rise) - CERTAIN * uncertainty, 0.0)


def _samples(record: RecordedReadings, role: str, parts: Iterable[Segment]) -> Array:
    return np.concatenate([record.columns[role][part.start : part.end] for part in parts])


def _require_readings(record: RecordedReadings, segment: Segment, channels: Iterable[str], file: str) -> None:
    if segment.end > record.rows:
        raise _refusal(segment, f"ends at row {segment.end}; {record.name} has {record.rows} rows", file)
    if segment.end - segment.start < FEWEST_ROWS:
        raise _refusal(segment, f"has {segment.end - segment.start} row; at least {FEWEST_ROWS} are needed", file)
    for channel in channels:
        lost = np.flatnonzero(~np.isfinite(record.columns[channel][segment.start : segment.end]))
        if len(lost):
            row = segment.start + int(lost[0])
            raise _refusal(segment, f"{channel} has no number in row {row} of {record.name}", file)


def _refusal(segment: Segment, why: str, file: str) -> InputError:
    return InputError(f"segment {segment.name}: {why}", file=file, line=segment.line)


def _tabled(position: TabledPosition, step: float) -> dict[str, SampleSummary]:
    """Summaries as far as a table gives them: without a stated uncertainty, means are known to its last digit."""
    means, n, rounding = position.mean.items(), position.n or 1, step / sqrt(12)
    if position.u is None:
        return {name: SampleSummary(mean, 0.0, n, rounding, rounding, resolution=step) for name, mean in means}
    return {name: SampleSummary(mean, position.u[name] * sqrt(n), n, position.u[name]) for name, mean in means}


def _digits(number: float) -> int:
    """Return how many digits a number has behind the point."""
    exponent = Decimal(repr(float(number))).normalize().as_tuple().exponent
    return max(0, -exponent) if isinstance(exponent, int) else 0


def _distinct(names: Sequence[str]) -> list[str]:
    """Return the names, numbered from the second of a kind on."""
    seen: Counter[str] = Counter()
    distinct = []
    for name in names:
        seen[name] += 1
        distinct.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return distinct
