"""From recorded data to the noise of a sensor at rest: the library's ``noise``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tiltcal.library.calibration import Calibration
from tiltcal.logs.noise import NoiseFacts, characterise_readings
from tiltcal.logs.noise_summary import NoiseTarget, SensorNoise
from tiltcal.stated_arguments import require_text_or_none


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
    own = calibration.record if isinstance(calibration, Calibration) else calibration
    facts = NoiseFacts.of(sensor, None, own, unit)
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
