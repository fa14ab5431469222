"""The formats of logs: the end of a log's name selects it, and any other name is CSV.

A new format is a module with a reader and a writer, and a line in :data:`FORMATS`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

from tiltcal.errors import Argument, UsageError
from tiltcal.logs.log import LogReader, LogSource, LogWriter, Progress
from tiltcal.logs.streams import STANDARD, log_source
from tiltcal.stated_arguments import require_boolean

CSV, PARQUET, NETCDF, ROSBAG = "csv", "parquet", "netcdf", "rosbag"

FORMATS: Mapping[str, str] = {
    ".csv": CSV,
    ".parquet": PARQUET,
    ".pq": PARQUET,
    ".nc": NETCDF,
    ".nc4": NETCDF,
    **dict.fromkeys((".mcap", ".db3", ".bag"), ROSBAG),
}
"""The format of a log by the end of its name: a module here, imported when a log of the format is opened."""

UNKNOWN = (".gz", ".bz2", ".xz", ".zst", ".zip", ".xlsx", ".xls", ".json", ".feather", ".arrow", ".h5")
"""Ends of names of files that are no CSV, and that no writer makes."""


def log_format(name: str | Path) -> str:
    """Return the format of a log by its name; a folder, and a file with a topic behind ``::``, are a bag of ROS."""
    place, topic, _ = str(name).partition("::")
    return ROSBAG if topic or os.path.isdir(place) else FORMATS.get(Path(name).suffix.lower(), CSV)


def _imported(format_name: str, half: str) -> Any:
    """Return the ``Reader`` or the ``Writer`` of a format."""
    return getattr(import_module(f"{__name__}.{format_name}"), format_name.capitalize() + half)


def require_way(log: str | Path, output: str | Path) -> None:
    """Raise UsageError for what cannot be written: NetCDF in another format, another format in NetCDF, or no log."""
    if Path(output).suffix.lower() in UNKNOWN:
        raise UsageError(f"{output}: a log is written as .csv or .parquet, or stays .nc: name one of these")
    before, after = log_format(log), log_format(output)
    if after == ROSBAG:
        raise UsageError(f"{output}: no bag is written: name a .csv or .parquet")
    if NETCDF in (before, after) and before != after:
        end = ".nc" if before == NETCDF else ".csv or .parquet"
        raise UsageError(
            "a NetCDF log stays NetCDF, and no other becomes it",
            advice=(f"name an output that ends in {end}, with ", Argument("output")),
        )


@contextmanager
def open_log(
    log: object,
    *,
    name: str | None = None,
    skip_bad_rows: bool = False,
    live: bool = False,
    progress: Progress | None = None,
) -> Iterator[LogReader]:
    """Open a log of any format by its path, ``-`` for CSV on standard input, or a frame, as :class:`LogSource` has it.

    ``name`` is what messages call it, in place of its own name; where ``live``, Ctrl-C ends a stream that has no end.

    InputError: the file is not what its name says, is empty or damaged.
    UsageError: the file cannot be opened, or the library that its format takes is not there.
    """
    require_boolean("skip_bad_rows", skip_bad_rows)
    if not isinstance(log, str | Path):
        from tiltcal.logs.frames import FrameReader

        yield FrameReader(log, name=name or "the frame")
        return
    path = str(log)
    reader = _imported(log_format(path), "Reader")
    called = name or ("standard input" if path == STANDARD else path)
    bag = log_format(path) == ROSBAG
    with nullcontext((BytesIO(), None)) if bag else log_source(path, live=live) as (stream, size):
        opened: LogReader = reader(LogSource(stream, path, called, size, skip_bad_rows, progress))
        try:
            yield opened
        finally:
            opened.close()


def create_log(output: str | Path, *parts: Any) -> LogWriter:
    """Return what writes the rows of a log, in the format of the output's name; ``parts`` as :class:`LogWriter` has."""
    writer: LogWriter = _imported(log_format(output), "Writer")(*parts)
    return writer
