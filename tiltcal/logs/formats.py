"""Which format a log has: its name says so, and what says nothing is CSV."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from tiltcal.logs.csv_log import CsvLog
from tiltcal.logs.parquet_log import ParquetLog

PARQUET = (".parquet", ".pq")


def is_parquet(name: str | Path) -> bool:
    """Whether a log is in Parquet, or is to be."""
    return str(name).lower().endswith(PARQUET)


def log_of(stream: BinaryIO, name: str, *, skip_bad_rows: bool = False) -> CsvLog | ParquetLog:
    """The log in a stream, behind the door of its format.

    Parameters
    ----------
    stream : BinaryIO
        Standard input, or the file of that name, open.
    name : str
        The log as the user named it.
    skip_bad_rows : bool
        Keep rows that cannot be parsed; in Parquet there are none.

    Raises
    ------
    InputError
        The file is not what its name says, is empty or damaged.
    """
    return ParquetLog(name) if is_parquet(name) else CsvLog(stream, name=name, skip_bad_rows=skip_bad_rows)
