"""Which format a log has: its name says so, and what says nothing is CSV."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from tiltcal.errors import UsageError
from tiltcal.logs.csv_log import CsvLog
from tiltcal.logs.netcdf_log import NetcdfLog
from tiltcal.logs.parquet_log import ParquetLog

PARQUET = (".parquet", ".pq")
NETCDF = (".nc", ".nc4")


def is_parquet(name: str | Path) -> bool:
    """Whether a log is in Parquet, or is to be."""
    return str(name).lower().endswith(PARQUET)


def is_netcdf(name: str | Path) -> bool:
    """Whether a log is in NetCDF, or is to be."""
    return str(name).lower().endswith(NETCDF)


def require_way(log: str, output: str) -> None:
    """Refuse what there is no way for: from NetCDF to another format, or to it.

    Raises
    ------
    UsageError
    """
    if is_netcdf(log) and not is_netcdf(output):
        raise UsageError(f"{log} is NetCDF and stays it: name an output that ends in .nc, with -o")
    if is_netcdf(output) and not is_netcdf(log):
        raise UsageError(f"{output} would be NetCDF, and only a NetCDF log becomes that: name a .csv or .parquet")


def is_csv(name: str | Path) -> bool:
    """Whether a log is in CSV, or is to be."""
    return not is_parquet(name) and not is_netcdf(name)


def log_of(stream: BinaryIO, name: str, *, skip_bad_rows: bool = False) -> CsvLog | ParquetLog | NetcdfLog:
    """The log in a stream, behind the door of its format.

    Parameters
    ----------
    stream : BinaryIO
        Standard input, or the file of that name, open.
    name : str
        The log as the user named it.
    skip_bad_rows : bool
        Keep rows that cannot be parsed; in Parquet and NetCDF there are none.

    Raises
    ------
    InputError
        The file is not what its name says, is empty or damaged.
    UsageError
        The library that its format takes is not there.
    """
    if is_netcdf(name):
        return NetcdfLog(name)
    return ParquetLog(name) if is_parquet(name) else CsvLog(stream, name=name, skip_bad_rows=skip_bad_rows)
