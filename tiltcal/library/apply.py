"""A calibration applied to a recorded log: the library's ``apply_log``."""

from __future__ import annotations

from pathlib import Path
from typing import Unpack

from tiltcal.library.calibration import Calibration
from tiltcal.library.calibration_library import CalibrationLibrary
from tiltcal.library.pair_calibration import PairCalibration
from tiltcal.logs.apply import Applied, apply_to_log
from tiltcal.logs.apply_summary import ApplySummary
from tiltcal.logs.log import Progress
from tiltcal.logs.options import ApplyOptions
from tiltcal.options import complete, takes


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
    UsageError
        A file cannot be opened or written, or the log has a column of a name that the result needs.
    InputError
        The calibration or the log is wrong, or a column is not there; the message names file and line.

    Notes
    -----
    A damaged Parquet or NetCDF file can end the process in its library, or keep it there: run ``tiltcal apply`` in a
    process of its own for files of doubtful origin.
    """
    return apply_to_log(_record_of(calibration), log, output, complete(ApplyOptions, options), progress)


def _record_of(calibration: Calibration | PairCalibration | CalibrationLibrary | str | Path) -> Applied:
    """Return what the layers below know: a record, a folder or the name of a file."""
    if isinstance(calibration, Calibration | PairCalibration):
        return calibration.record
    return calibration.records if isinstance(calibration, CalibrationLibrary) else calibration
