"""The noise of a sensor at rest: the library's ``noise``, which ``tiltcal noise`` calls."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.calibration.calibration import Calibration
from tiltcal.core.disturbances import moved_rows, stuck_rows
from tiltcal.core.model import AXES, Array
from tiltcal.core.noise import FEWEST_SAMPLES, ChannelNoise, NoiseScale, characterise
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.columns import OF_G
from tiltcal.drivers.model import Model
from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.files.calibration import read_calibration
from tiltcal.logs.columns import TIME, locate_columns, locate_readings, named_columns
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import LogReader, Progress
from tiltcal.logs.noise_summary import NoiseTarget, SensorNoise
from tiltcal.logs.numbers import read_columns
from tiltcal.logs.streams import imported_meanwhile
from tiltcal.logs.uniform_sampling import SamplingInterval, evenly_spaced
from tiltcal.stated_arguments import require_above_zero, require_text_or_none, require_whole


def noise(
    readings: Any,
    *,
    rate: float | None = None,
    unit: str | None = None,
    sensor: str | None = None,
    calibration: Calibration | str | Path | None = None,
    columns: Mapping[str, str] | str = "",
    averages: Sequence[int] = (),
    target: float | None = None,
    target_range: float | None = None,
    skip_bad_rows: bool = False,
) -> SensorNoise:
    """Characterise the noise of a sensor at rest, and how many samples its positions need.

    Parameters
    ----------
    readings : str, Path or frame
        A log (CSV, Parquet or NetCDF-4) of a sensor that was not touched, or a frame of its columns.
    rate : float, optional
        Samples a second; without it the column ``time`` shows it.
    unit : str, optional
        Of the readings, where neither model nor calibration states it; of m/s2 and g the scale is known.
    sensor : str, optional
        The sensor's model: its unit and its nominal sensitivity.
    calibration : Calibration, str or Path, optional
        The sensor's own, or its file.
    columns : mapping of str to str, or str
        The column of each reading [x, y, z, as far as there] and of ``time``.
    averages : sequence of int
        More sizes of averages for the table, beside 1, 10, 100.
    target : float, optional
        Standard uncertainty that the mean of a position should have, degrees of an axis near level.
    target_range : float, optional
        Range that 100 means of a position should have, degrees of an axis near level.
    skip_bad_rows : bool
        Count rows of a log that cannot be parsed as missing.

    Returns
    -------
    SensorNoise

    Raises
    ------
    UsageError
        What is stated of the sensor contradicts itself, or a target is given and nothing states the scale.
    InputError
        A column is missing, a row cannot be parsed, or a reading is stuck.
    EstimateError
        The log is too short.

    Examples
    --------
    >>> print(tiltcal.noise(readings, rate=102.4, unit="m/s2"))
    """
    require_text_or_none("--unit", unit)
    facts = NoiseFacts.of(sensor, None, calibration, unit)
    wanted = NoiseTarget(target, target_range)
    facts.require_scale(wanted)
    return characterise_readings(
        readings,
        facts,
        wanted,
        rate=rate,
        columns=columns,
        averages=averages,
        skip_bad_rows=skip_bad_rows,
    )


@dataclass(frozen=True)
class NoiseFacts:
    """What is known of the sensor beside its readings.

    Attributes
    ----------
    channels : tuple of str
        Its readings; empty where the log has to show them.
    sensitivity : dict of str to float
        Unit/g, per channel, or under ``*`` for all of them; empty where it is not known.
    source : str
        Where the sensitivity is from.
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
        calibration: Calibration | str | Path | None,
        unit: str | None,
    ) -> NoiseFacts:
        """Gather what model, address, calibration and user state.

        Raises
        ------
        UsageError
            They contradict each other.
        """
        model = find_model(sensor) if sensor else None
        if model is not None and address is not None:
            model = model.at(parse_address(address))
        known = Calibration(read_calibration(calibration)) if isinstance(calibration, str | Path) else calibration
        if known is not None and not isinstance(known, Calibration):
            raise UsageError(f"--calibration takes a tilt calibration or its file, not {calibration!r}")
        _refuse_contradiction(model, known, unit)
        own_unit = unit or (known.sensor.unit if known else None) or (model.unit if model else None)
        channels = tuple(model.channels) if model else known.sensor.channels if known else ()
        if known is not None:
            own = {channel: value for (channel, axis), value in known.sensitivity.items() if channel == axis}
            return cls(channels, own_unit, own, f"calibration of {known.sensor.serial}")
        if model is not None and model.scaled:
            return cls(channels, own_unit, {"*": model.sensitivity}, f"nominal sensitivity of {model.name}")
        if own_unit in OF_G:
            return cls(channels, own_unit, {"*": OF_G[own_unit]}, f"unit {own_unit}")
        return cls(channels, own_unit, {}, "")

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
    """Characterise readings with the facts that are known; the other arguments are those of :func:`noise`.

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
        with imported_meanwhile("scipy.optimize"):
            samples, pace, faulty = _samples(log, channels, named, rate)
        name = log.name
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        each = threads.map(partial(_noise, file=name, pace=pace, averages=averages), channels, samples)
        noises = dict(zip(channels, each, strict=True))
    missing = {channel: pace.rows - noises[channel].count for channel in channels}
    return SensorNoise(
        pace,
        noises,
        {channel: count for channel, count in missing.items() if count},
        faulty,
        moved_rows(samples, [noise.step for noise in noises.values()]),
        stuck_rows(samples),
        facts.scale(channels),
        target,
    )


def _samples(
    log: LogReader, channels: Sequence[str], named: Mapping[str, str], rate: float | None
) -> tuple[Sequence[Array], SamplingInterval, int]:
    """Read the channels, evenly spaced, shape (n,) each; return with them their pace and the rows not parsed."""
    where = locate_columns(log, channels, named)
    columns = [where[channel] for channel in channels]
    if rate is not None:
        numbers = read_columns(log, columns)
        return numbers.columns, SamplingInterval(1.0 / rate, len(numbers)), numbers.faulty
    time = named.get(TIME, TIME)
    if time not in log.names:
        raise InputError(
            "its sample rate is unknown: there is no column 'time'; name it with --columns time=NAME, or state --rate "
            "HZ",
            file=log.name,
            line=log.header_line,
        )
    index = log.names.index(time)
    numbers = read_columns(log, [*columns, index], index)
    return *evenly_spaced(numbers.columns[:-1], numbers.columns[-1], log.name), numbers.faulty


def _noise(channel: str, samples: Array, file: str, pace: SamplingInterval, averages: Sequence[int]) -> ChannelNoise:
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
        return characterise(samples, pace.interval, averages)


def _refuse_contradiction(model: Model | None, known: Calibration | None, unit: str | None) -> None:
    units = {
        "--sensor": model.unit if model else None,
        "--calibration": known.sensor.unit if known else None,
        "--unit": unit,
    }
    said = {name: known for name, known in units.items() if known is not None}
    if len(set(said.values())) > 1:
        raise UsageError("the readings have one unit: " + ", but ".join(f"{name} says {u}" for name, u in said.items()))
    if model and known and set(known.sensor.channels) - set(model.channels):
        raise UsageError(
            f"--calibration is of {', '.join(known.sensor.channels)}, and {model.name} has {', '.join(model.channels)}"
        )
