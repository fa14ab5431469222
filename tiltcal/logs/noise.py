"""The noise of a sensor at rest: a log or a frame of its readings as evenly spaced samples, and what they show."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from math import radians, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.column_names import TIME
from tiltcal.core.detection import Span, moved_rows, stuck_spans
from tiltcal.core.model import AXES, Array
from tiltcal.core.noise import (
    FEWEST_SAMPLES,
    FLICKER,
    ChannelNoise,
    Limit,
    NoiseScale,
    characterise,
    sample_size,
    sample_size_by_range,
)
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.model import OF_G
from tiltcal.errors import Argument, EstimateError, InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.device import model_named
from tiltcal.logs.columns import column_names, locate_readings, named_columns, read_columns, readings_header
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import LogReader, Progress
from tiltcal.logs.numbers_and_times import clock_breaks
from tiltcal.logs.recordings import unit_of_length
from tiltcal.printable import counted, in_html
from tiltcal.stated_arguments import require_above_zero

_LATE = 1.5  # rows are missing where the next one is late by so many intervals
_MILLISECOND = 1e-3  # times that are written to the millisecond may be off by as much, seconds
_LONGEST_GAP, _GAP_SHARE = 10_000_000, 100
"""Refuse a gap of more rows than this, and than so many times the rows before it."""

_FEWEST_SAMPLES = 2  # fewest samples of a position of `measure`
_KINDS = {
    "N": ("white noise", sqrt(2.0), "/√Hz"),
    "B": ("flicker noise at any time", FLICKER, ""),
    "K": ("random walk", 1.0, "/√s"),
    "R": ("drift", 1.0, "/s"),
}
"""Of each coefficient of the Allan variance: its name, and factor and unit of what is shown."""

_WHY: dict[Limit, str] = {
    "target": "the smallest number that meets the target",
    "record": "the longest that this record supports; more samples still help: record longer",
    "rounding": "more samples do not help: noise is too low to dither the rounding",
    "flicker": "doubling the samples gains less than 10 %: flicker noise stays, however long the average",
    "walk": "doubling the samples gains less than 10 %: random walk",
    "drift": "doubling the samples gains less than 10 %: drift",
    "unknown": "doubling the samples gains less than 10 %; the cause fits no standard noise type",
}


@dataclass(frozen=True)
class Pace:
    """The interval between the rows of a log in seconds, its rows, its gaps, and the rows that are lost in them."""

    interval: float
    rows: int
    gaps: int = 0
    lost: int = 0


def stated_scale(
    sensor: str | None, address: str | None, calibration: CalibrationRecord | str | Path | None, unit: str | None
) -> tuple[NoiseScale, tuple[str, ...]]:
    """Return the scale that model, address, calibration and unit state, and the channels, none where nothing does.

    A UsageError where they contradict each other.
    """
    model = model_named(sensor) if sensor else None
    if model is not None and address is not None:
        model = model.at(parse_address(address))
    if isinstance(calibration, str | Path):
        calibration = read_calibration(calibration)
    if calibration is not None and not isinstance(calibration, CalibrationRecord):
        raise UsageError(option="calibration", why=f"takes a tilt calibration or its file, not {calibration!r}")
    units = {
        "sensor": model.unit if model else None,
        "calibration": calibration.sensor.unit if calibration else None,
        "unit": unit,
    }
    units = {option: stated for option, stated in units.items() if stated is not None}
    if len(set(units.values())) > 1:
        said = [part for name, one in units.items() for part in (", but ", Argument(name), f" says {one}")]
        raise UsageError(("the readings have one unit: ", *said[1:]))
    stated = next(iter(units.values()), None)
    channels = tuple(model.channels) if model else calibration.sensor.channels if calibration else ()
    if calibration is not None:
        coefficients = calibration.coefficients
        along = {c: coefficients.own_sensitivity(c) for c in coefficients.channels if c in coefficients.axes}
        return NoiseScale(stated, along, f"calibration of {calibration.sensor.serial}"), channels
    if model is not None and model.scaled:
        return NoiseScale(stated, {"*": model.sensitivity}, f"nominal sensitivity of {model.name}"), channels
    return scale_of(stated), channels


def scale_of(unit: str | None) -> NoiseScale:
    """Return the scale that a unit implies; none where it is no unit of acceleration."""
    return NoiseScale(unit, {"*": OF_G[unit]}, f"unit {unit}") if unit in OF_G else NoiseScale(unit, {})


def _unit_at_rest(columns: Sequence[Array]) -> str | None:
    """Return the unit in which three channels at rest are as long as gravity; None where they are not."""
    if any(not np.isfinite(column).any() for column in columns):
        return None
    return unit_of_length(np.array([[np.nanmean(column) for column in columns]]), columns, alone=True)


RATE = Argument("rate", "HZ")


def require_target(target: float | None, scale: NoiseScale) -> None:
    """Raise UsageError for a target in degrees where nothing states how much a degree is."""
    require_above_zero("target", target)
    if target is not None and not scale.per_g:
        raise UsageError(
            option="target",
            why="is in degrees, and nothing says how much a degree is",
            advice=(
                "give the ",
                Argument("sensor"),
                " model, a ",
                Argument("calibration"),
                ", or ",
                Argument("unit", "g or m/s2"),
            ),
        )


def characterise_readings(
    readings: Any,
    scale: NoiseScale,
    channels: Sequence[str],
    target: float | None,
    *,
    rate: float | None,
    columns: Mapping[str, str] | str,
    skip_bad_rows: bool,
    name: str | None = None,
    progress: Progress | None = None,
) -> SensorNoise:
    """Characterise readings of a stated scale; the other arguments are those of :func:`tiltcal.noise`.

    ``name`` is what messages call the log, in place of its own name.
    """
    require_above_zero("rate", rate)
    named = named_columns(columns, AXES)
    with open_log(readings, name=name, skip_bad_rows=skip_bad_rows, progress=progress) as log:
        header = readings_header(log, columns)
        named |= header.guessed
        asked = tuple(axis for axis in AXES if axis in named)
        there = tuple(axis for axis in AXES if axis in header.columns)
        # With neither, x is looked for, and the message that it is not there says how to name it.
        channels = asked or channels or there or AXES[:1]
        if scale.unit is None and header.unit is not None:
            scale = scale_of(header.unit)
        if scale.unit is not None:
            require_target(target, scale)
        located = locate_readings(log, channels, named, scale.unit or "1")  # which fits every unit
        where = {channel: located[channel] for channel in channels}
        if rate is None:
            where[TIME] = _time_column(log, named)
        numbers = read_columns(log, where, needs_time=True)
    said = [*log.remarks, *log.clock.remarks]
    if scale.unit is None and not header.units and (unit := _unit_at_rest(numbers.of(channels))):
        scale = scale_of(unit)
        said.append(f"the unit is {unit} if these are accelerations: at rest they are as long as gravity")
    require_target(target, scale)
    samples, name = numbers.of(channels), numbers.name
    if rate is None:
        samples, pace = evenly_spaced(samples, numbers.by_role[TIME], name)
    else:
        pace = Pace(1.0 / rate, len(numbers))
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        each = threads.map(partial(_noise, file=name, interval=pace.interval), channels, samples)
        noises = dict(zip(channels, each, strict=True))
    missing = {channel: pace.rows - noise.count for channel, noise in noises.items() if noise.count < pace.rows}
    moved = moved_rows(samples, [noise.step for noise in noises.values()])
    stuck = max(stuck_spans(samples), key=lambda span: span[1] - span[0], default=None)
    return SensorNoise(pace, noises, missing, numbers.faulty, moved, stuck, scale.of(channels), target, said)


def _time_column(log: LogReader, named: Mapping[str, str]) -> int:
    time = column_names(log.names, (TIME,), named).get(TIME)
    if time is None:
        why = f"its sample rate is unknown: there is no column {named.get(TIME, TIME)!r}; name it with "
        where = Argument("columns", "time=NAME")
        raise InputError((why, where, ", or state ", RATE), file=log.name, line=log.header_line)
    return log.names.index(time)


def evenly_spaced(columns: list[Array], times: Array, file: str) -> tuple[list[Array], Pace]:
    """Give each row its place in time: columns of shape (n + lost,), NaN where a row is lost.

    Times, shape (n,), are seconds; a row without one follows the row before it. An InputError where time stands still,
    goes back or leaps, as where a clock is set.
    """
    rows = np.flatnonzero(np.isfinite(times))
    steps = np.diff(times[rows])
    restarts, disorder = clock_breaks(times)
    again = np.isin(rows[1:], restarts)
    steps[again] = np.nan
    if len(disorder):
        row = int(disorder[0])
        raise InputError((f"time goes back at row {row}: sort the log, or state ", RATE), file=file)
    steps[np.diff(rows) != 1] = np.nan  # what lies between rows without a time is no step of one interval
    singles = steps[np.isfinite(steps)]
    # Times that are written to the millisecond may stand still between rows that are taken faster.
    usual = (float(np.median(singles)) or float(np.mean(singles))) if len(singles) else 0.0
    if usual <= 0.0:
        why = "its times do not change" if len(singles) else "it has no two rows with a time"
        why = why if len(rows) else "no row has a time"
        raise InputError((f"its sample rate is unknown: {why}; state it with ", RATE), file=file)
    # So do those to the second, where most of them stand still.
    written = 1.0 if float(np.median(singles)) == 0.0 and np.all(times[rows] % 1.0 == 0.0) else _MILLISECOND
    units = times[rows[:1000]] / written
    steps[again] = 2.0 * usual  # where the clock starts again, at least a row is lost
    slack = written if np.all(np.abs(units - np.round(units)) < 1e-3) else 0.0
    late = np.flatnonzero(steps > _LATE * usual + slack)
    interval = float(np.nanmean(np.delete(steps, late)))
    lost = np.maximum(np.round(steps[late] / usual), 2).astype(np.int64) - 1
    far = np.flatnonzero(lost > np.maximum(_LONGEST_GAP, _GAP_SHARE * rows[1 + late]))
    if len(far):
        leap = f"the time leaps by {steps[late[far[0]]]:.6g} s at row {rows[1 + late[far[0]]]}"
        raise InputError((f"{leap}: cut the log there, or state ", RATE), file=file)
    pace = Pace(interval, len(times), len(late), int(lost.sum()))
    if not len(late):
        return columns, pace
    return [np.insert(column, np.repeat(rows[1 + late], lost), np.nan) for column in columns], pace


def _noise(channel: str, samples: Array, file: str, interval: float) -> ChannelNoise:
    """Characterise one channel; refuse one that has no noise to characterise."""
    there = np.isfinite(samples)
    values = samples if there.all() else samples[there]
    if not len(values):
        raise InputError(f"column {channel!r} has no value in any row: is {channel} connected?", file=file)
    if len(values) < FEWEST_SAMPLES:
        raise EstimateError(
            f"{file}: {channel} has {len(values)} samples; nothing is said of noise from fewer than {FEWEST_SAMPLES}"
        )
    if values.min() == values.max():
        raise InputError(
            f"{channel} reads {values[0]:g} in all {len(values)} samples: identical samples are not still, they are "
            "stuck (or the noise is far below the step of the reading, and no averaging helps)",
            file=file,
        )
    with np.errstate(over="ignore", invalid="ignore"):  # noise beyond any number is refused by its variance
        return characterise(samples, interval)


@dataclass(frozen=True)
class SensorNoise:
    """The noise of a sensor at rest.

    Attributes
    ----------
    pace : Pace
        How the readings follow each other.
    channels : mapping of str to ChannelNoise
        Averages, Allan deviation and kinds of noise of each channel, in its unit.
    missing, faulty : mapping of str to int, int
        Values that are missing in the log's own rows, per channel that lacks some; rows that could not be parsed.
    moved, stuck : sequence of (start, end), (start, end) or None
        Rows at an even pace, missing ones counted: where the sensor was moved, and where no channel changed.
    scale, target : NoiseScale, float or None
        How much of the readings' unit a g is, where that is stated, and the standard uncertainty that the mean of a
        position should have, degrees of an axis near level.
    of_log : sequence of str
        How the log was read: sentences.
    """

    pace: Pace
    channels: Mapping[str, ChannelNoise]
    missing: Mapping[str, int]
    faulty: int
    moved: Sequence[Span]
    stuck: Span | None
    scale: NoiseScale
    target: float | None
    of_log: Sequence[str] = ()

    @property
    def remarks(self) -> list[str]:
        """What limits the numbers, in words."""
        remarks = [*self.of_log]
        if self.moved:
            begin, end = self._seconds(self.moved[0])
            more = f", and {len(self.moved) - 1} times more" if len(self.moved) > 1 else ""
            remarks.append(
                f"it was not still: moved or knocked from {begin:.4g} to {end:.4g} s{more}; the numbers are of noise "
                "and motion together: take a record at rest, or its rows at rest"
            )
        if self.stuck is not None:
            begin, end = self._seconds(self.stuck)
            remarks.append(f"the readings were stuck from {begin:.4g} to {end:.4g} s: no channel changed")
        if self.pace.gaps:
            remarks.append(f"{counted(self.pace.gaps, 'gap')} in its times, {counted(self.pace.lost, 'row')} long")
        remarks += [f"{channel} is missing in {counted(count, 'row')}" for channel, count in self.missing.items()]
        remarks += [
            f"{channel}: no sum of white noise, flicker noise, random walk and drift follows its Allan deviation; a "
            "vibration may be in it, or a filter"
            for channel, noise in self.channels.items()
            if not noise.terms.follows
        ]
        return remarks

    def _seconds(self, rows: Span) -> list[float]:
        """Return the times at which rows begin and end, seconds from the beginning of the log."""
        return [row * self.pace.interval for row in rows]

    @cached_property
    def _targets(self) -> dict[str, float]:
        """The standard uncertainty that the mean of each channel of known scale must have, unit."""
        return {name: radians(self.target) * size for name, size in self.scale.per_g.items()} if self.target else {}

    @cached_property
    def advice(self) -> dict[str, tuple[int, Limit]]:
        """How many samples each channel needs; one that misses the target comes first, then by their number."""
        interval, targets = self.pace.interval, self._targets
        sizes = {name: sample_size(noise, interval, targets.get(name)) for name, noise in self.channels.items()}
        settles = max(sizes, key=lambda name: (name in targets and sizes[name][1] != "target", sizes[name][0]))
        return {settles: sizes[settles]} | sizes

    @property
    def by_range(self) -> dict[str, int | None]:
        """How many samples each channel needs by the range of averages, as the source's Table I judges too."""
        return {name: sample_size_by_range(one, self._targets.get(name)) for name, one in self.channels.items()}

    @property
    def samples(self) -> int:
        """How many samples a position needs."""
        return max(_FEWEST_SAMPLES, next(iter(self.advice.values()))[0])

    @cached_property
    def uncertainty(self) -> dict[str, float]:
        """The standard uncertainty of each channel's mean of so many samples, unit."""
        tau = np.array([self.samples * self.pace.interval])
        return {channel: float(noise.uncertainty(tau)[0]) for channel, noise in self.channels.items()}

    @property
    def met(self) -> dict[str, bool]:
        """Whether that is as good as the target, of each channel that has one."""
        return {name: self.uncertainty[name] <= wanted for name, wanted in self._targets.items()}

    def __str__(self) -> str:
        interval = self.pace.interval
        extent = (
            f"{self.pace.rows} samples of {', '.join(self.channels)}, {interval:.4g} s apart "
            f"({1.0 / interval:.4g} Hz), {(self.pace.rows + self.pace.lost) * interval:.6g} s"
        )
        kinds = (line for channel, noise in self.channels.items() for line in _kinds(channel, noise, self.scale))
        return "\n".join([extent, *self._averages(), "", *kinds, "", *self._recommendation()])

    __repr__ = __str__
    _repr_html_ = in_html

    def _averages(self) -> Iterator[str]:
        """Averages of 1, 10, 100 (the source's Table I)."""
        unit, scale = self.scale.unit, self.scale
        angles = "" if not scale.per_g else f"  {'std [°]':>10}  {'range [°]':>10}"
        yield (
            f"{'':3} {'samples':>8} {'averages':>9}  {f'std [{unit}]':>14}  {'if white':>10}  {f'range [{unit}]':>14}"
            + angles
        )
        for channel, noise in self.channels.items():
            for row, one in enumerate(noise.averages):
                cells = [f"{one.std:>14.4g}", f"{noise.white(one):>10.4g}", f"{one.range:>14.4g}"]
                sizes = (scale.degrees(channel, value) for value in (one.std, one.range))
                cells += [f"{angle:>10.3g}" for angle in sizes if angle is not None]
                yield f"{channel if row == 0 else '':3} {one.samples:>8} {one.count:>9}  " + "  ".join(cells)

    def _recommendation(self) -> Iterator[str]:
        interval, (settles, (_, limit)) = self.pace.interval, next(iter(self.advice.items()))
        yield f"measure --samples {self.samples}: a position takes {self.samples * interval:.4g} s at this pace"
        sizes = ", ".join(f"{channel} {_sized(channel, u, self.scale)}" for channel, u in self.uncertainty.items())
        yield f"  its mean is uncertain by {sizes}"
        yield f"  {settles}: {_WHY[limit]}"
        ranges = ", ".join(f"{channel} {n or 'more than there are'}" for channel, n in self.by_range.items())
        yield f"  samples by the range of averages: {ranges}"
        yield from (f"  {channel} does not meet {self.target:g}°" for channel, met in self.met.items() if not met)
        if self.scale.source:
            yield f"  degrees of an axis near level, by the {self.scale.source}"

    def as_data(self) -> dict[str, Any]:
        """Everything as plain data, with the whole Allan deviation."""
        scale, pace, met = self.scale, self.pace, self.met
        settles, (_, limit) = next(iter(self.advice.items()))
        return {
            "samples": pace.rows,
            "interval": pace.interval,
            "seconds": (pace.rows + pace.lost) * pace.interval,
            "gaps": {"count": pace.gaps, "rows": pace.lost},
            "missing": dict(self.missing),
            "bad_rows": self.faulty,
            "moved": [self._seconds(rows) for rows in self.moved],
            "hung": None if self.stuck is None else self._seconds(self.stuck),
            "remarks": self.remarks,
            "unit": scale.unit,
            "sensitivity": {"source": scale.source, **scale.per_g} if scale.per_g else None,
            "channels": {channel: _channel_data(channel, noise, scale) for channel, noise in self.channels.items()},
            "recommendation": {
                "samples": self.samples,
                "seconds": self.samples * pace.interval,
                "channel": settles,
                "limit": limit,
                "target_degrees": self.target,
                "met": all(met.values()) if met else None,
                "channels": {
                    channel: {
                        "samples": self.advice[channel][0],
                        "limit": self.advice[channel][1],
                        "samples_by_range": self.by_range[channel],
                        **_both("uncertainty", channel, u, scale),
                        "met": met.get(channel),
                    }
                    for channel, u in self.uncertainty.items()
                },
            },
        }


def _channel_data(channel: str, noise: ChannelNoise, scale: NoiseScale) -> dict[str, Any]:
    def coefficient(term: str, factor: float = 1.0) -> dict[str, float] | None:
        value = noise.terms.value
        return {"value": factor * value[term]} if term in value else None

    tau_lowest, lowest = noise.lowest
    allan = {"tau": noise.tau, "deviation": noise.deviation, "low": noise.low, "high": noise.high}
    allan["dof"] = noise.terms.dof
    return {
        "mean": noise.mean,
        "samples": noise.count,
        "step": noise.step or None,
        "averages": [
            {
                "samples": average.samples,
                "averages": average.count,
                **_both("std", channel, average.std, scale),
                **_both("range", channel, average.range, scale),
            }
            for average in noise.averages
        ],
        "allan": [dict(zip(allan, row, strict=True)) for row in np.stack(list(allan.values()), axis=1).tolist()],
        "noise_density": coefficient("N", sqrt(2.0)),
        "velocity_random_walk": coefficient("N"),
        "flicker": coefficient("B"),
        "bias_random_walk": coefficient("K"),
        "drift": coefficient("R"),
        "bias_instability": {
            "reached": noise.settled,
            "tau": tau_lowest,
            **_both("deviation", channel, lowest, scale),
            "coefficient": lowest / FLICKER,
        },
        "rounding": noise.rounding,
    }


def _both(name: str, channel: str, value: float, scale: NoiseScale) -> dict[str, float]:
    angle = scale.degrees(channel, value)
    return {name: value} if angle is None else {name: value, f"{name}_degrees": angle}


def _kinds(channel: str, noise: ChannelNoise, scale: NoiseScale) -> Iterator[str]:
    """Yield the kinds of noise of a channel, and where averaging ends."""
    lines = []
    for term, value in noise.terms.value.items():
        kind, factor, per = _KINDS[term]
        lines.append(f"{kind} {_sized(channel, factor * value, scale, per)}")
    tau, low = noise.lowest
    if noise.settled:
        lines.append(f"bias instability {_sized(channel, low, scale)} at {tau:.3g} s")
    else:
        below = _sized(channel, float(noise.high[-1]), scale)
        lines.append(f"bias instability not reached: below {below} after {float(noise.tau[-1]):.3g} s")
    if noise.step:
        lines.append(f"step {noise.step:.4g} {scale.unit}, of which averaging leaves {noise.rounding:.2g} {scale.unit}")
    for row, line in enumerate(lines):
        yield f"{channel if row == 0 else '':3} {line}"


def _sized(channel: str, value: float, scale: NoiseScale, per: str = "") -> str:
    """Return a size of noise in the unit of the readings, and where that is known in mg and degrees."""
    angle = scale.degrees(channel, value)
    in_g = "" if angle is None else f" ({1e3 * value / scale.per_g[channel]:.3g} mg{per}, {angle:.3g} °{per})"
    return f"{value:.3g} {scale.unit}{per}{in_g}"
