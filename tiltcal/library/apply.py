"""A calibration applied to a recorded log: the library's ``apply_log``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import date, timedelta
from pathlib import Path

from tiltcal.library.calibration import Calibration
from tiltcal.library.calibration_library import CalibrationLibrary
from tiltcal.library.pair_calibration import PairCalibration
from tiltcal.logs.apply import Applied, apply_to_log
from tiltcal.logs.apply_summary import ApplySummary
from tiltcal.logs.log import Progress
from tiltcal.logs.prepared_calibration import ApplyOptions


def apply_log(
    calibration: Calibration | PairCalibration | CalibrationLibrary | str | Path,
    log: str | Path,
    output: str | Path,
    *,
    columns: Mapping[str, str] | str = "",
    uncertainty: bool = False,
    first_order: bool = False,
    reading_noise: float | None = None,
    mounting: Mapping[str, float] | str = "",
    serial: str | None = None,
    stability: float | None = None,
    start: str | date | None = None,
    magnetometer: Sequence[str] | str = (),
    velocity: Sequence[str] | str = (),
    declination: float | None = None,
    magnetometer_noise: float | None = None,
    average: int | None = None,
    every: str | float | timedelta | None = None,
    skip_bad_rows: bool = False,
    say: Callable[[str], None] = lambda line: None,
    progress: Progress | None = None,
) -> ApplySummary:
    """Apply a calibration to a recorded log, whatever its size, and write the result.

    Parameters
    ----------
    calibration : Calibration, PairCalibration, CalibrationLibrary, str or Path
        A calibration, or its file; or a folder of calibrations, of which each row takes that of its time.
    log : str or Path
        CSV, Parquet or NetCDF-4, by the end of its name; ``-`` is CSV on standard input.
    output : str or Path
        Its name selects its format. It appears whole or not at all; ``-`` is CSV on standard output.
    columns : mapping of str to str, or str
        The column of each reading, such as ``{"x": "VoutX"}`` or ``"x=VoutX"``; without it, the column of its name.
    uncertainty : bool
        Add the standard uncertainty of every angle and half of its 95 % interval, degrees.
    first_order : bool
        Use Cross-axis Compensation eq. 6 in place of the whole matrix.
    reading_noise : float, optional
        Standard uncertainty of a reading of the log, in its unit, in place of that of a sample at the bench.
    mounting : mapping of str to float, or str
        How the sensor sits, degrees, such as ``{"roll": 180}`` or ``"roll=180"``, in place of its own mounting.
    serial : str, optional
        With a folder: of the sensor; else that of the log's metadata, or of its column names (``SERIAL_x``).
    stability : float, optional
        With a folder: the standard deviation of the offset's change in one day, mg, in place of half of each change.
    start : str or datetime, optional
        With a folder: when the time of the log is 0, as text in ISO 8601, where its time is relative.
    magnetometer : sequence of str, or str
        The three columns of the magnetic field, such as ``"mx,my,mz"``: adds ``heading``, degrees.
    velocity : sequence of str, or str
        The three columns of a velocity, such as ``"u,v,w"``: adds ``v_east``, ``v_north`` and ``v_up`` in their
        unit. It needs a magnetometer, or a heading among the columns.
    declination : float, optional
        How far magnetic north is east of true north, degrees; added to the heading, of a column as well.
    magnetometer_noise : float, optional
        With `uncertainty`: standard uncertainty of a component of the field, in its unit.
    average : int, optional
        Apply to the means of so many rows each, and add ``count``.
    every : str, float or timedelta, optional
        Apply to the means of so much time each, such as ``"10s"``, or in seconds, and add ``count``.
    skip_bad_rows : bool
        Keep rows that cannot be parsed, with flag 9, instead of raising.
    say : callable
        Called with each remark about what had to be assumed.
    progress : callable, optional
        Called with the bytes that have been read, after each block.

    Returns
    -------
    ApplySummary
        Rows by flag and reason.

    Raises
    ------
    UsageError
        A file cannot be opened or written, or the log has a column of a name that the result needs.
    InputError
        The calibration or the log is wrong, or a column is not there; the message names file and line.

    Notes
    -----
    A damaged Parquet or NetCDF file can end the process in its library, or keep it there: run ``tiltcal apply`` in a
    process of its own for files of doubtful origin.
    """
    options = ApplyOptions(
        first_order=first_order,
        uncertainty=uncertainty,
        reading_noise=reading_noise,
        mounting=mounting,
        serial=serial,
        stability=stability,
        start=start,
        magnetometer=magnetometer,
        velocity=velocity,
        declination=declination,
        magnetometer_noise=magnetometer_noise,
        average=average,
        every=every,
    )
    return apply_to_log(
        _record_of(calibration),
        log,
        output,
        options,
        columns=columns,
        skip_bad_rows=skip_bad_rows,
        say=say,
        progress=progress,
    )


def _record_of(calibration: Calibration | PairCalibration | CalibrationLibrary | str | Path) -> Applied:
    """Return what the layers below know: a record, a folder or the name of a file."""
    if isinstance(calibration, Calibration | PairCalibration):
        return calibration.record
    return calibration.records if isinstance(calibration, CalibrationLibrary) else calibration
