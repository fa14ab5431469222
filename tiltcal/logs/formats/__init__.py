"""The formats of logs: the end of a log's name selects it, and any other name is CSV.

A new format is a module with a reader and a writer, and a line in :data:`FORMATS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from tiltcal.errors import UsageError
from tiltcal.logs.log import LogReader, LogSource, LogWriter, Progress
from tiltcal.logs.streams import STANDARD, log_source
from tiltcal.stated_arguments import require_boolean


@dataclass(frozen=True)
class LogFormat:
    """A format of logs.

    Attributes
    ----------
    name : str
        The classes' first half, such as ``Csv`` for ``CsvReader`` and ``CsvWriter`` of the module ``csv`` here; it is
        imported when a log of the format is opened.
    kept : bool
        Whether a log of the format can be written in no other format, and no other log in this one.
    """

    name: str
    kept: bool = False

    def imported(self, half: str) -> Any:
        """Return the ``Reader`` or the ``Writer``."""
        return getattr(import_module(f"{__name__}.{self.name.lower()}"), self.name + half)


_CSV = LogFormat("Csv")
_PARQUET = LogFormat("Parquet")
_NETCDF = LogFormat("Netcdf", kept=True)

FORMATS: Mapping[str, LogFormat] = {
    ".csv": _CSV,
    ".parquet": _PARQUET,
    ".pq": _PARQUET,
    ".nc": _NETCDF,
    ".nc4": _NETCDF,
}
"""The format of a log by the end of its name."""


UNKNOWN = (".gz", ".bz2", ".xz", ".zst", ".zip", ".xlsx", ".xls", ".json", ".feather", ".arrow", ".h5")
"""Ends of names of files that are no CSV, and that no writer makes."""


def log_format(name: str | Path) -> LogFormat:
    """Return the format of a log by its name."""
    return FORMATS.get(Path(name).suffix.lower(), _CSV)


def require_way(log: str | Path, output: str | Path) -> None:
    """Raise UsageError for what cannot be written: NetCDF in another format, another format in NetCDF, or no log."""
    if Path(output).suffix.lower() in UNKNOWN:
        raise UsageError(f"{output}: a log is written as .csv or .parquet, or stays .nc: name one of these")
    read, written = log_format(log), log_format(output)
    if read is written or not (read.kept or written.kept):
        return
    if read.kept:
        raise UsageError(f"{log} is NetCDF and stays it: name an output that ends in .nc, with -o")
    raise UsageError(f"{output} would be NetCDF, and only a NetCDF log becomes that: name a .csv or .parquet")


@contextmanager
def open_log(
    log: object,
    *,
    name: str | None = None,
    skip_bad_rows: bool = False,
    digest: bool = False,
    live: bool = False,
    progress: Progress | None = None,
) -> Iterator[LogReader]:
    """Open a log of any format, or a frame; the other arguments are those of :class:`LogSource`.

    Parameters
    ----------
    log : str, Path or frame
        A file, ``-`` for CSV on standard input, or a frame; see :mod:`tiltcal.logs.frames`.
    name : str, optional
        What messages call the log, in place of its own name.
    live : bool
        Hand on each line of CSV as it arrives, and let Ctrl-C end a stream that has no end of its own.

    Raises
    ------
    InputError
        The file is not what its name says, is empty or damaged.
    UsageError
        The file cannot be opened, or the library that its format takes is not there.

    Notes
    -----
    A damaged Parquet or NetCDF file can end the process in its library, or keep it there.
    """
    require_boolean("--skip-bad-rows", skip_bad_rows)
    if not isinstance(log, str | Path):
        from tiltcal.logs.frames import FrameReader

        yield FrameReader(log, name=name or "the frame")
        return
    path = str(log)
    reader = log_format(path).imported("Reader")
    called = name or ("standard input" if path == STANDARD else path)
    with log_source(path, live=live) as (stream, size):
        opened: LogReader = reader(LogSource(stream, path, called, size, skip_bad_rows, digest, progress))
        try:
            yield opened
        finally:
            opened.close()


def create_log(
    output: str | Path,
    sink: BinaryIO,
    log: LogReader,
    added: Sequence[str] = (),
    origin: Mapping[str, str] | None = None,
    units: Mapping[str, str | None] | None = None,
) -> LogWriter:
    """Return what writes the rows of a log, in the format that the output's name selects.

    The other arguments are those of :class:`LogWriter`; ``-`` is CSV on standard output.
    """
    writer: LogWriter = log_format(output).imported("Writer")(sink, log, added, origin, units)
    return writer
