"""The noise of a sensor at rest, from a log or a frame of its readings: as evenly spaced samples of each channel."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.detection import moved_rows, stuck_rows
from tiltcal.core.model import AXES, Array
from tiltcal.core.noise import FEWEST_SAMPLES, ChannelNoise, NoiseScale, characterise
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.model import OF_G
from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.logs.columns import TIME, locate_columns, locate_readings, named_columns
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import LogReader, Progress
from tiltcal.logs.noise_summary import NoiseTarget, Pace, SensorNoise
from tiltcal.logs.numbers import read_columns
from tiltcal.stated_arguments import require_above_zero, require_whole

_LATE = 1.5  # rows are missing where the next one is late by so many intervals
_MILLISECOND = 1e-3  # times that are written to the millisecond may be off by as much, seconds
_LONGEST_GAP, _GAP_SHARE = 10_000_000, 100
"""Refuse a gap of more rows than this, and than so many times the rows before it."""


@dataclass(frozen=True)
class NoiseFacts:
    """What is stated of the sensor beside its readings: channels and unit, and sensitivities from a ``source``.

    No ``channels`` are those of the log. ``sensitivity`` is in unit/g, per channel, or under ``*`` for all of them.
    """

    channels: tuple[str, ...]
    unit: str | None
    sensitivity: dict[str, float]
    source: str

    @classmethod
    def of(
        cls,
        sensor: str | None,
        address: str | None,
        calibration: CalibrationRecord | str | Path | None,
        unit: str | None,
    ) -> NoiseFacts:
        """Gather what model, address, calibration and user state; a UsageError where they contradict each other."""
        model = find_model(sensor) if sensor else None
        if model is not None and address is not None:
            model = model.at(parse_address(address))
        if isinstance(calibration, str | Path):
            calibration = read_calibration(calibration)
        if calibration is not None and not isinstance(calibration, CalibrationRecord):
            raise UsageError(f"--calibration takes a tilt calibration or its file, not {calibration!r}")
        units = {
            "--sensor": model.unit if model else None,
            "--calibration": calibration.sensor.unit if calibration else None,
            "--unit": unit,
        }
        units = {option: stated for option, stated in units.items() if stated is not None}
        if len(set(units.values())) > 1:
            contradiction = ", but ".join(f"{option} says {stated}" for option, stated in units.items())
            raise UsageError(f"the readings have one unit: {contradiction}")
        if model and calibration and set(calibration.sensor.channels) - set(model.channels):
            raise UsageError(
                f"--calibration is of {', '.join(calibration.sensor.channels)}, and {model.name} has "
                f"{', '.join(model.channels)}"
            )
        stated = next(iter(units.values()), None)
        channels = tuple(model.channels) if model else calibration.sensor.channels if calibration else ()
        if calibration is not None:
            coefficients = calibration.coefficients
            along = {c: coefficients.own_sensitivity(c) for c in coefficients.channels if c in coefficients.axes}
            return cls(channels, stated, along, f"calibration of {calibration.sensor.serial}")
        if model is not None and model.scaled:
            return cls(channels, stated, {"*": model.sensitivity}, f"nominal sensitivity of {model.name}")
        if stated in OF_G:
            return cls(channels, stated, {"*": OF_G[stated]}, f"unit {stated}")
        return cls(channels, stated, {}, "")

    def require_scale(self, target: NoiseTarget) -> None:
        """Raise UsageError for a target in degrees where nothing states how much a degree is."""
        if target.degrees is not None and not self.sensitivity:
            option = "--target" if target.range is None else "--target-range"
            raise UsageError(
                f"{option} is in degrees, and nothing says how much a degree is: give the --sensor model, a "
                "--calibration, or --unit g or m/s2"
            )

    def scale(self, channels: Sequence[str]) -> NoiseScale:
        """Return the scale of some channels."""
        per_g = {channel: abs(self.sensitivity.get(channel, self.sensitivity.get("*", 0.0))) for channel in channels}
        return NoiseScale(self.unit or "unit", {c: s for c, s in per_g.items() if s}, self.source)


def characterise_readings(
    readings: Any,
    facts: NoiseFacts,
    target: NoiseTarget,
    *,
    rate: float | None = None,
    columns: Mapping[str, str] | str = "",
    averages: Sequence[int] = (),
    skip_bad_rows: bool = False,
    name: str | None = None,
    progress: Progress | None = None,
) -> SensorNoise:
    """Characterise readings with the facts that are known; the other arguments are those of :func:`tiltcal.noise`.

    ``name`` is what messages call the log, in place of its own name.
    """
    require_above_zero("--rate", rate)
    if not isinstance(averages, Iterable):
        raise UsageError(f"--averages takes several sizes, such as [5, 50], not {averages!r}")
    for size in averages:
        require_whole("--averages", size, 1, "samples")
    named = named_columns(columns, AXES)
    with open_log(readings, name=name, skip_bad_rows=skip_bad_rows, progress=progress) as log:
        asked = tuple(axis for axis in AXES if axis in named)
        there = tuple(axis for axis in AXES if axis in log.names)
        # With neither, x is looked for, and the message that it is not there says how to name it.
        channels = asked or facts.channels or there or AXES[:1]
        if facts.unit is not None:
            locate_readings(log, channels, named, facts.unit)
        where = locate_columns(log, channels, named)
        where = {channel: where[channel] for channel in channels}
        if rate is None:
            where[TIME] = _time_column(log, named)
        numbers = read_columns(log, where)
    samples, pace, name = numbers.of(channels), Pace(1.0 / (rate or 1.0), len(numbers)), numbers.name
    if rate is None:
        samples, pace = evenly_spaced(samples, numbers.by_role[TIME], name)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        each = threads.map(partial(_noise, file=name, interval=pace.interval, averages=averages), channels, samples)
        noises = dict(zip(channels, each, strict=True))
    missing = {channel: pace.rows - noise.count for channel, noise in noises.items() if noise.count < pace.rows}
    moved = moved_rows(samples, [noise.step for noise in noises.values()])
    scale = facts.scale(channels)
    return SensorNoise(pace, noises, missing, numbers.faulty, moved, stuck_rows(samples), scale, target)


def _time_column(log: LogReader, named: Mapping[str, str]) -> int:
    time = named.get(TIME, TIME)
    if time not in log.names:
        why = "there is no column 'time'; name it with --columns time=NAME, or state --rate HZ"
        raise InputError(f"its sample rate is unknown: {why}", file=log.name, line=log.header_line)
    return log.names.index(time)


def evenly_spaced(columns: list[Array], times: Array, file: str) -> tuple[list[Array], Pace]:
    """Give each row its place in time: columns of shape (n + lost,), NaN where a row is lost.

    Times, shape (n,), are seconds; a row without one follows the row before it. An InputError where time stands still,
    goes back or leaps, as where a clock is set.
    """
    rows = np.flatnonzero(np.isfinite(times))
    steps = np.diff(times[rows])
    if len(steps) and steps.min() < 0.0:
        row = int(rows[1 + np.argmin(steps)])
        raise InputError(f"time goes back at row {row}: sort the log, or state --rate HZ", file=file)
    steps[np.diff(rows) != 1] = np.nan  # what lies between rows without a time is no step of one interval
    singles = steps[np.isfinite(steps)]
    # Times that are written to the millisecond may stand still between rows that are taken faster.
    usual = (float(np.median(singles)) or float(np.mean(singles))) if len(singles) else 0.0
    if usual <= 0.0:
        why = "its times do not change" if len(singles) else "it has no two rows with a time"
        why = why if len(rows) else "its times are neither seconds nor ISO 8601"
        raise InputError(f"its sample rate is unknown: {why}; state it with --rate HZ", file=file)
    milliseconds = times[rows[:1000]] / _MILLISECOND
    slack = _MILLISECOND if np.all(np.abs(milliseconds - np.round(milliseconds)) < 1e-3) else 0.0
    late = np.flatnonzero(steps > _LATE * usual + slack)
    interval = float(np.nanmean(np.delete(steps, late)))
    lost = np.maximum(np.round(steps[late] / usual), 2).astype(np.int64) - 1
    far = np.flatnonzero(lost > np.maximum(_LONGEST_GAP, _GAP_SHARE * rows[1 + late]))
    if len(far):
        leap = f"the time leaps by {steps[late[far[0]]]:.6g} s at row {rows[1 + late[far[0]]]}"
        raise InputError(f"{leap}: cut the log there, or state --rate HZ", file=file)
    pace = Pace(interval, len(times), len(late), int(lost.sum()))
    if not len(late):
        return columns, pace
    return [np.insert(column, np.repeat(rows[1 + late], lost), np.nan) for column in columns], pace


def _noise(channel: str, samples: Array, file: str, interval: float, averages: Sequence[int]) -> ChannelNoise:
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
        return characterise(samples, interval, averages)
