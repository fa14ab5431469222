"""From recorded data to a calibration: the library's ``fit``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Unpack

from tiltcal.library.calibration import Calibration
from tiltcal.logs.fit import fit_recorded
from tiltcal.logs.log import Progress
from tiltcal.logs.options import FitOptions
from tiltcal.options import complete, takes


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
    UsageError
        What is asked for contradicts itself, or cannot be done.
    InputError
        A file is wrong; the message names file and line.
    EstimateError
        The positions cannot determine the coefficients.
    """
    return Calibration(fit_recorded(procedure, data, complete(FitOptions, options), progress))
