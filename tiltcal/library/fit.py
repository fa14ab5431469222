"""From recorded data to a calibration: the library's ``fit``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tiltcal.library.calibration import Calibration
from tiltcal.logs.fit import FitOptions, fit_recorded
from tiltcal.logs.log import Progress


def fit(
    procedure: str | Path,
    data: Any,
    *,
    serial: str | None = None,
    unit: str | None = None,
    sensor: str | None = None,
    segments: Any = None,
    table: bool | None = None,
    columns: Mapping[str, str] | str = "",
    jig: float | None = None,
    thermometer: float | None = None,
    table_lean: float | None = None,
    heading: float | None = None,
    tilt: float | None = None,
    gravity: float | None = None,
    window: int | None = None,
    alignment: float | None = None,
    base: str | Path | None = None,
    say: Callable[[str], None] = lambda line: None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a sensor from recorded data, by the positions of a procedure.

    Parameters
    ----------
    procedure : str or Path
        Its name, or the path of your own. With ``free`` the positions need not be known: gravity is 1 g in each.
    data : str, Path or frame
        A log (CSV, Parquet or NetCDF-4), or a table of positions; or a frame of either: polars, pandas, pyarrow, an
        xarray Dataset, a dict of arrays.
    serial : str, optional
        The sensor's serial number; without it that of the ``base``.
    unit : str, optional
        Of the readings, such as ``m/s2``, ``V`` or ``count``; a known ``sensor`` has its own.
    sensor : str, optional
        The sensor's model, where it is one of ``tiltcal devices``.
    segments : str, Path, frame or sequence of mapping, optional
        Which rows were taken in which position: CSV or JSON with position, start, end (exclusive), and gx, gy, gz where
        the position is not the procedure's. With ``free`` the static intervals are found where it is left out.
    table : bool, optional
        ``data`` is a table of positions already averaged: position, x, y, z, and where known gx, gy, gz, ux, uy, uz
        (the means' standard uncertainties), n, temperature. Of a frame without segments it is taken to be one where it
        has a column ``position``.
    columns : mapping of str to str, or str
        Which column holds which reading, such as ``{"x": "acc_x"}`` or ``"x=acc_x,y=acc_y"``; in a log without a header
        by number from 1.
    jig : float, optional
        Standard uncertainty of a set angle, degrees; where it is not stated, the positions' scatter shows it.
    thermometer : float, optional
        Standard uncertainty of a temperature, °C; where it is not stated, the step of the sensor's own thermometer.
    table_lean : float, optional
        Standard uncertainty of the lean of the table that all positions share, degrees per axis.
    heading : float, optional
        Standard uncertainty of a heading, degrees.
    tilt : float, optional
        The angle that the procedure leaves free, degrees.
    gravity : float, optional
        Local gravity, m/s²: adds the sensitivity per m/s² beside that per g.
    window : int, optional
        Rows over which the sensor must be still, where static intervals are found; several are tried without it.
    alignment : float, optional
        With ``level``: by how much at most the sensor may sit askew since its calibration, degrees about each axis.
    base : str or Path, optional
        The sensor's calibration file: a mounting completes it, and its sensitivity stands in where the procedure
        determines none.
    say : callable, optional
        Called with each line of what is found on the way.
    progress : callable, optional
        Called with the bytes of a log that have been read, after each block.

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
    options = FitOptions(
        serial=serial,
        unit=unit,
        sensor=sensor,
        segments=segments,
        table=table,
        columns=columns,
        jig=jig,
        thermometer=thermometer,
        table_lean=table_lean,
        heading=heading,
        tilt=tilt,
        gravity=gravity,
        window=window,
        alignment=alignment,
        base=base,
    )
    return Calibration(fit_recorded(procedure, data, options, say, progress))
