"""A recorded log as positions: what the sensor read while it was held still, ready for the estimator."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from difflib import get_close_matches
from math import sqrt
from typing import Any

from tiltcal.calibration.measurement import Measurement, at_rail
from tiltcal.core.attitude import Vector
from tiltcal.core.detection import LEFT_OUT, TILTED, identical_by_chance, noise_of_positions
from tiltcal.core.model import AXES
from tiltcal.core.samples import SampleSummary, summarise
from tiltcal.errors import InputError
from tiltcal.files.moments import stamp_of
from tiltcal.files.procedure import Position, Procedure
from tiltcal.files.tables import Segment, TabledPosition
from tiltcal.logs.interval_samples import SOAKS, TO_THE_END, LogInterval, Rails, intervals_in, step_of
from tiltcal.logs.recorded_readings import RecordedReadings

FEWEST_ROWS = 2
"""Samples that a segment needs for a standard deviation."""


@dataclass(frozen=True)
class StaticInterval:
    """The readings of a sensor while it was held in one attitude.

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
        How it is found again: rows and time of the log, or the line of a table.
    times : (float, float) or None
        Of the first and the last of its rows that have one, s.
    """

    name: str
    position: str
    gravity: Vector | None
    summaries: Mapping[str, SampleSummary]
    temperature: float | None
    line: int | None
    warming: float = 0.0
    where: Mapping[str, Any] = field(default_factory=dict)
    times: tuple[float, float] | None = None


def intervals_of(
    record: RecordedReadings, segments: Sequence[Segment], rails: Rails, *, file: str, soak: float = 0.0
) -> list[StaticInterval]:
    """Return what the sensor read in each interval, without the samples that are far off the others or missing.

    A segment that reaches beyond the log, has samples at a rail or too many far off or missing, or is stuck is refused;
    ``file`` is where the segments stand, and a temperature is judged over ``soak`` seconds.
    """
    step = step_of(record)
    whole = [replace(one, end=len(record)) if one.end == TO_THE_END else one for one in segments]
    found = intervals_in(record, whole)
    names = _distinct([one.parts[0].name for one in found])
    intervals = [_interval(one, step, rails, soak, name, file) for one, name in zip(found, names, strict=True)]
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

    The procedure says the direction of a position that is only named, and its temperature where none was recorded.
    Refused are a temperature that did not stand still where it counts or is missing in some, and a stuck channel.
    """
    known = {position.name: position for position in procedure.positions}
    if procedure.determines.drift or procedure.determines.gain:
        for interval in intervals:
            _require_steady(interval, procedure, file)
        _require_temperatures(intervals, file)
    measurements = [_placed(interval, known) for interval in intervals]
    _require_not_stuck_everywhere(measurements, file)
    return measurements


def unplaced(intervals: Sequence[StaticInterval]) -> list[Measurement]:
    """Holds in free positions, whose directions a fit will find."""
    return [
        Measurement(interval.name, (0.0, 0.0, 1.0), None, interval.temperature, interval.summaries, interval.where)
        for interval in intervals
    ]


def require_positions(named: Iterable[Segment] | Iterable[TabledPosition], procedure: Procedure, *, file: str) -> None:
    """Refuse segments or tabled positions without a direction whose names the procedure does not have."""
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


def _placed(interval: StaticInterval, known: Mapping[str, Position]) -> Measurement:
    """Return what was measured in the direction that the file states, or in that of the procedure's position."""
    if interval.gravity is None:
        position = known[interval.position]
    else:
        heading = known[interval.position].heading if interval.position in known else None
        position = Position(interval.position, "", interval.gravity, heading=heading)
    return Measurement(
        interval.name,
        position.gravity,
        position.tilt,
        position.temperature if interval.temperature is None else interval.temperature,
        interval.summaries,
        interval.where,
        position.heading,
        position.stage,
    )


def _require_steady(interval: StaticInterval, procedure: Procedure, file: str) -> None:
    """Refuse a temperature point at which thermometer and sensor were still on their way, each at its own pace."""
    allowed, seconds = procedure.soak.drift, procedure.soak.thermometer or SOAKS * procedure.soak.seconds
    if abs(interval.warming) > allowed:
        raise InputError(
            f"segment {interval.name}: the temperature drifts by {interval.warming:+.2f} °C up to its end, more than "
            f"the {allowed:g} °C that {procedure.name} allows in {seconds:g} s: thermometer and sensor are apart while "
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

    The noise is that of all segments before rounding: a converter that is coarser than the noise stands still, too.
    """
    for channel in intervals[0].summaries:
        noise = noise_of_positions([interval.summaries[channel] for interval in intervals], step)
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
        read = [measurement for measurement in measurements if channel in measurement.summaries]
        reach = [measurement.gravity[axis] for measurement in read]
        means = {measurement.summaries[channel].mean for measurement in read}
        if len(means) == 1 and max(reach) - min(reach) > TILTED:
            raise InputError(
                f"{channel} reads {means.pop():g} in every position: it is stuck; is it connected?", file=file
            )


def _interval(interval: LogInterval, step: float, rails: Rails, soak: float, name: str, file: str) -> StaticInterval:
    parts, record = interval.parts, interval.record
    _require_rows(parts, record, file)
    samples = interval.samples(step)
    _require_few(samples.left_out, samples.why, parts, file)
    for channel, (low, high) in rails.items():
        values = samples.channels[channel]
        beyond = values[~((low < values) & (values < high))]
        if len(beyond):
            reads = f"{beyond[0]:.6g} in {len(beyond)} of its rows"
            raise _refusal(parts[0], at_rail(channel, reads, (low, high)), file)
    temperatures, jumped = interval.temperatures
    _require_few(len(jumped), f"the thermometer reads {jumped[0]:g} °C" if jumped else "", parts, file)
    rows = tuple((part.start, part.end) for part in parts)
    return StaticInterval(
        name,
        parts[0].name,
        parts[0].gravity,
        {channel: summarise(values, step) for channel, values in samples.channels.items()},
        summarise(temperatures).mean if len(temperatures) else None,
        parts[0].line,
        interval.warming(soak),
        {"rows": rows if len(rows) > 1 else rows[0], **({"left_out": samples.left_out} if samples.left_out else {})}
        | ({} if interval.times is None else {"time": stamp_of(interval.times[1])}),
        interval.times,
    )


def _require_few(count: int, why: str, parts: Sequence[Segment], file: str) -> None:
    """Refuse a segment of which too many samples are far off the others or missing."""
    rows = sum(part.end - part.start for part in parts)
    if count > max(1, LEFT_OUT * rows) or rows - count < FEWEST_ROWS:
        raise _refusal(
            parts[0], f"{count} of its {rows} samples are far off or missing: {why}; choose other rows", file
        )


def _require_rows(parts: Sequence[Segment], record: RecordedReadings, file: str) -> None:
    for part in parts:
        if part.end > len(record):
            raise _refusal(part, f"ends at row {part.end}; {record.name} has {len(record)} rows", file)
        if part.end - part.start < FEWEST_ROWS:
            raise _refusal(part, f"has {part.end - part.start} row; at least {FEWEST_ROWS} are needed", file)


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
