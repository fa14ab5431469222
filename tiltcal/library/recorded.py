"""What the library does with recorded data: apply one calibration or a folder, fit, match pairs, characterise noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any, Unpack

from tiltcal.calibration.season import CalibrationFolder
from tiltcal.files.moments import moment
from tiltcal.library.calibration import Applicable, Calibration, PairCalibration
from tiltcal.logs.apply import ApplySummary, apply_to_log
from tiltcal.logs.fit import fit_recorded
from tiltcal.logs.log import Progress
from tiltcal.logs.match import match_log, pairs_of
from tiltcal.logs.noise import SensorNoise, characterise_readings, stated_scale
from tiltcal.logs.options import ApplyOptions, FitOptions
from tiltcal.options import complete, takes
from tiltcal.stated_arguments import require_from_zero, require_text_or_none


class CalibrationLibrary(CalibrationFolder, Applicable):
    """The calibrations in a folder, by serial number and date.

    Parameters
    ----------
    folder : str or Path
        Its files and those of the folders below it are indexed at once, and each is read when it is needed.

    Raises
    ------
    UsageError
        It is no folder.

    Examples
    --------
    >>> library = tiltcal.open_calibrations(".")
    >>> cal = library.at("SIM-42", "2000-01-01T12:00:00Z")
    """

    def __repr__(self) -> str:
        return f"<CalibrationLibrary of {self.folder}>"

    def at(self, serial: str, time: str | date, *, stability: float | None = None) -> Calibration:
        """Return the calibration of a sensor at a time: between two of them, or the nearest one.

        Parameters
        ----------
        serial : str
        time : str, datetime or date
            As text in ISO 8601; UTC where it names no zone.
        stability : float, optional
            The standard deviation of the offset's change in one day, mg, in place of half of each change.

        Raises
        ------
        UsageError
            The folder has no calibration of this sensor.
        InputError
            The time is not one, a file is wrong, or two contradict each other.
        """
        require_from_zero("stability", stability)
        return Calibration(self.history(serial).at(moment(time).timestamp(), stability))


def open_calibrations(folder: str | Path) -> CalibrationLibrary:
    """Open a folder of calibration files.

    Raises
    ------
    UsageError
        It is no folder.

    Examples
    --------
    >>> tilted = tiltcal.open_calibrations(".").serials
    """
    return CalibrationLibrary(folder)


@takes(ApplyOptions)
def apply_log(
    calibration: Calibration | PairCalibration | CalibrationLibrary | str | Path,
    log: str | Path,
    output: str | Path,
    *,
    progress: Progress | None = None,
    **options: Unpack[ApplyOptions],
) -> ApplySummary:
    """Apply a calibration to a recorded log, whatever its size, and write the result.

    Parameters
    ----------
    calibration : Calibration, PairCalibration, CalibrationLibrary, str or Path
        A calibration, or its file; or a folder of calibrations, of which each row takes those of its time.
    log : str or Path
        CSV, Parquet or NetCDF-4, by the end of its name; ``-`` is CSV on standard input.
    output : str or Path
        Its name selects its format. It appears whole or not at all; ``-`` is CSV on standard output.
    progress : callable, optional
        Called with the bytes that have been read, after each block.
    **options

    Returns
    -------
    ApplySummary
        Rows by flag and reason.

    Raises
    ------
    UsageError, InputError
        A file cannot be opened or written, or the log has a column of a name that the result needs; the calibration or
        the log is wrong, or a column is not there: the message names file and line.

    Notes
    -----
    A damaged Parquet or NetCDF file can end the process in its library, or keep it there: run ``tiltcal apply`` in a
    process of its own for files of doubtful origin.
    """
    applied = calibration.record if isinstance(calibration, Calibration | PairCalibration) else calibration
    return apply_to_log(applied, log, output, complete(ApplyOptions, options), progress)


@takes(FitOptions)
def fit(
    procedure: str | Path, data: Any, *, progress: Progress | None = None, **options: Unpack[FitOptions]
) -> Calibration:
    """Calibrate a sensor from recorded data, by the positions of a procedure.

    Parameters
    ----------
    procedure : str or Path
        Its name, or the path of your own. With ``free`` the positions need not be known: gravity is 1 g in each.
    data : str, Path or frame
        A log (CSV, Parquet or NetCDF-4), or a table of positions; or a frame of either: polars, pandas, pyarrow, an
        xarray Dataset, a dict of arrays.
    progress : callable, optional
        Called with the bytes of a log that have been read, after each block.
    **options

    Returns
    -------
    Calibration

    Raises
    ------
    UsageError, InputError, EstimateError
        What is asked for contradicts itself; a file is wrong, and the message names file and line; the positions cannot
        determine the coefficients.
    """
    return Calibration(fit_recorded(procedure, data, complete(FitOptions, options), progress))


def match(
    data: Any,
    pairs: Sequence[tuple[str, str, str]],
    *,
    phase: str | None = None,
    online: bool = False,
    loops: bool = False,
    skip_bad_rows: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> PairCalibration:
    """Match pairs of accelerometers on a turning stage: scale factor p and misalignment q.

    Parameters
    ----------
    data : str, Path or frame
        A log (CSV, Parquet or NetCDF-4), or a frame of its columns.
    pairs : sequence of (str, str, str)
        One or two pairs: the columns of the first and the second accelerometer, and of one a quarter turn away.
    phase : str, optional
        The column of the stage angle, degrees. Without it the spin is estimated from the readings and the column
        ``time``.
    online : bool
        Estimate turn by turn, as on a live stream; it takes the ``phase``.
    loops : bool
        With ``online``: by the two PID loops of the source, not the recursive estimator.
    skip_bad_rows : bool
        Leave out rows of a log that cannot be parsed, instead of raising.
    say : callable, optional
        Called with each remark about the data.

    Returns
    -------
    PairCalibration

    Raises
    ------
    UsageError, InputError, EstimateError
        The pairs are not pairs; a column is missing or has no values, or a row cannot be parsed; the stage does not
        turn as it must.

    Examples
    --------
    >>> print(tiltcal.match("disk.csv", [("a1", "a2", "a4")], phase="theta"))
    """
    record, _, _ = match_log(
        data, pairs_of(pairs), phase=phase, online=online, loops=loops, skip_bad_rows=skip_bad_rows, say=say
    )
    return PairCalibration(record)


def noise(
    readings: Any,
    *,
    rate: float | None = None,
    unit: str | None = None,
    sensor: str | None = None,
    calibration: Calibration | str | Path | None = None,
    columns: Mapping[str, str] | str = "",
    target: float | None = None,
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
    target : float, optional
        Standard uncertainty that the mean of a position should have, degrees of an axis near level.
    skip_bad_rows : bool
        Count rows of a log that cannot be parsed as missing.

    Returns
    -------
    SensorNoise

    Raises
    ------
    UsageError, InputError, EstimateError
        What is stated of the sensor contradicts itself, or a target is given and nothing states the scale; a column is
        missing, a row cannot be parsed, or a reading is stuck; the log is too short.

    Examples
    --------
    >>> print(tiltcal.noise(readings, rate=102.4, unit="m/s2"))
    """
    require_text_or_none("unit", unit)
    own = calibration.record if isinstance(calibration, Calibration) else calibration
    scale, channels = stated_scale(sensor, None, own, unit)
    return characterise_readings(
        readings, scale, channels, target, rate=rate, skip_bad_rows=skip_bad_rows, columns=columns
    )
