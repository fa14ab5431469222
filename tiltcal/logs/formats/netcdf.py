"""NetCDF-4: a log whose columns are variables along one dimension, read some thousand rows at a time.

The conventions (CF) define what a number is: packed values are unpacked, the fill value and NaN are a missing value.

To write, the log's file is copied, byte for byte, and the new variables are put into the copy: all that it holds stays
as it was, attributes, packing, groups and all. What is added is described by the CF conventions. Roll and pitch
have no ``standard_name``: those of CF are a platform's, with its bow and its starboard side, and where on it the
sensor's x axis points is unknown.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from tiltcal.errors import InputError, TiltcalError, UsageError
from tiltcal.files.moments import to_the_second
from tiltcal.logs.cf_attributes import COUNT, describe, is_judgement, seconds_since_1970
from tiltcal.logs.columns import common_dimension
from tiltcal.logs.log import LogBlock, LogReader, LogSource, LogWriter, Table
from tiltcal.logs.text_to_numbers import seconds

if TYPE_CHECKING:
    import polars as pl

_ROWS = 1 << 16
"""Of a block, or as many as a chunk of the file holds, which is unpacked as a whole."""

_MOST_ROWS = 1 << 21
"""Of a block, however long the chunks are that a file declares."""

_CLASSIC = b"CDF"

_TEXT = "OSUT"
"""The kinds of a column of text."""

_OF_THE_SYSTEM = re.compile(r"errno = (\d+)")
"""What the library's message holds on a full disk, and on all else that the system refuses."""


class NetcdfReader(LogReader):
    """A log in NetCDF-4: its columns are all variables; those that hold readings have one dimension, the same.

    UsageError: the libraries are not there.
    InputError: the file is no NetCDF-4, or damaged.
    """

    def __init__(self, source: LogSource) -> None:
        super().__init__(source)
        try:
            import h5netcdf  # noqa: F401  (what xarray reads with)
            import xarray
        except ImportError as failure:
            why = f"NetCDF needs xarray and h5netcdf ({failure}): pip install 'tiltcal[netcdf]'"
            raise UsageError(why) from failure
        if source.stream.read(3) == _CLASSIC:
            self._refuse("this is NetCDF-3: make NetCDF-4 of it first, such as with nccopy -k nc4 OLD NEW")
        with self._refusing_damage():
            self._require_own_data()
            # An index would hold a whole variable in memory, as many rows as the file declares.
            self._data = xarray.open_dataset(
                Path(source.path),
                engine="h5netcdf",
                decode_times=False,
                decode_coords=False,
                create_default_indexes=False,
            )
        self.names = tuple(str(name) for name in self._data.variables)
        self.file_attributes = dict(self._data.attrs)
        self.notes = {str(name): str(note) for name, note in self.file_attributes.items()}

    def _require_own_data(self) -> None:
        """Refuse a file whose data stand in other files, which HDF5 would read wherever they are."""
        import h5py

        with h5py.File(self.source.path) as file:
            for name in file:
                link = file.get(name, getlink=True)
                variable = None if isinstance(link, h5py.ExternalLink) else file[name]
                if variable is None or getattr(variable, "external", None) or getattr(variable, "is_virtual", False):
                    self._refuse(f"variable {name!r} keeps its data in another file: copy them into this one")

    def close(self) -> None:
        self._data.close()

    def unit(self, column: int) -> str | None:
        unit = self._data[self.names[column]].attrs.get("units")
        return None if unit is None else str(unit)

    def has_times(self, name: str, beside: int) -> bool:
        if not super().has_times(name, beside) or self._data[name].dims != self._data[self.names[beside]].dims:
            return False
        try:
            seconds_since_1970(np.empty(0), self.unit(self.names.index(name)))
        except InputError:
            return False
        return self._data[name].dtype.kind in f"iuf{_TEXT}"

    def dimension(self, columns: Sequence[int]) -> str:
        """Along which the columns have their rows.

        InputError: a column has none or several, they differ, or there is no row.
        """
        names = [self.names[index] for index in columns]
        dimension = common_dimension({name: self._data[name].dims for name in names}, self.name)
        if not self._data.sizes[dimension]:
            self._refuse(f"the log has no rows: dimension {dimension!r} is empty")
        return dimension

    def attributes(self, name: str) -> Mapping[str, Any]:
        """Return the attributes of a variable that its decoding has left."""
        return dict(self._data[name].attrs)

    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]:
        dimension = self.dimension(columns)
        text = time if time is not None and self._data[self.names[time]].dtype.kind in _TEXT else None
        numbers = [index for index in columns if index != text]
        for index in numbers:
            self._require_numbers(self.names[index])
        total, step, timed = self._data.sizes[dimension], self._step(columns), False
        for start in range(0, total, step):
            rows, wrong = slice(start, min(start + step, total)), None
            with self._refusing_damage():
                read = {index: self._data[self.names[index]].isel({dimension: rows}).values for index in columns}
                values = {index: np.asarray(read[index], dtype=float) for index in numbers}
            if text is not None:
                cells = _cells(read[text])
                values[text] = seconds(cells)
                timed = timed or bool(np.isfinite(values[text]).any())
                wrong = None if timed else self._wrong_time(cells, text, start)
            if time is not None:
                values[time] = seconds_since_1970(values[time], self.unit(time), self.name)
            self.bytes_read = (self.source.size or 0) * rows.stop // total
            yield LogBlock(values, frame=self._frame(dimension, rows) if frames else None, wrong_time=wrong)

    def _frame(self, dimension: str, rows: slice) -> pl.DataFrame:
        """Return some rows of every variable that has this dimension alone."""
        import polars as pl

        with self._refusing_damage():
            along = [name for name in self.names if self._data[name].dims == (dimension,)]
            return pl.DataFrame({name: self._data[name].isel({dimension: rows}).values for name in along})

    def _step(self, columns: Sequence[int]) -> int:
        """Rows of a block: whole chunks, or each would be unpacked for every block that has a part of it."""
        chunks = [self._data[self.names[index]].encoding.get("chunksizes") or (1,) for index in columns]
        longest = max(int(chunk[0]) for chunk in chunks)
        return min(-(-_ROWS // longest) * longest, _MOST_ROWS)

    def _require_numbers(self, name: str) -> None:
        kind = self._data[name].dtype
        if kind.kind not in "iuf":
            self._refuse(f"variable {name!r} holds {kind}, not numbers: name another, or make numbers of it")
        for attribute in ("scale_factor", "add_offset"):
            packed = self._data[name].encoding.get(attribute, 1.0)
            if np.asarray(packed).dtype.kind not in "iuf":
                self._refuse(f"variable {name!r}: its attribute {attribute} is {packed!r}, no number: correct it")

    def _refuse(self, why: str) -> NoReturn:
        raise InputError(why, file=self.name)

    @contextmanager
    def _refusing_damage(self) -> Iterator[None]:
        """Put the libraries' complaints as ours."""
        try:
            yield
        except InputError:
            raise
        except Exception as failure:
            raise InputError(f"this is no NetCDF-4 file, or a damaged one: {failure}", file=self.name) from failure


def _cells(values: NDArray[Any]) -> pl.Series:
    """Return text as text, also where the file has it as bytes."""
    import polars as pl

    cells = values.tolist()
    return pl.Series([cell.decode(errors="replace") if isinstance(cell, bytes) else str(cell) for cell in cells])


class NetcdfWriter(LogWriter):
    """Writes a NetCDF log with variables behind its own; means become a file of their own."""

    def write(self, blocks: Iterable[tuple[LogBlock, Table]]) -> None:
        import h5netcdf

        log = self._log
        if not isinstance(log, NetcdfReader):
            raise UsageError(f"only a NetCDF log becomes NetCDF, and {log.name} is another kind")
        rows = iter(blocks)
        first = next(rows)
        columns, chunk = list(first[0].values), len(first[0])
        dimension, like = log.dimension(columns), log.attributes(log.names[columns[0]])
        are_means = first[0].counts is not None
        if not are_means:
            log.source.stream.seek(0)
            shutil.copyfileobj(log.source.stream, self._sink, 1 << 20)
            self._sink.flush()
        with _refusing_to_add(log.name), h5netcdf.File(self._sink, "w" if are_means else "r+") as file:
            if are_means:
                means = [first, *rows]
                _write_frames(file, log, dimension, [block.framed() for block, _ in means])
                rows = iter(means[1:])
            for name in self._added:
                self._create(file, name, dimension, like, chunk)
            self._write_tables(file, (table for _, table in chain([first], rows)))
            file.attrs["history"] = _history(file.attrs.get("history"), self._origin, datetime.now(UTC))

    def _write_tables(self, file: Any, tables: Iterable[Table]) -> None:
        """Write the columns of each table behind those of the one before, while the next is compensated.

        The library writes through a Python stream, where Ctrl-C would be lost: it comes in the main thread alone.
        """

        def write(start: int, table: Table) -> int:
            stop = start + len(next(iter(table.values())))
            for name, values in table.items():
                file.variables[name][start:stop] = values
            return stop

        with ThreadPoolExecutor(max_workers=1) as thread:
            written = thread.submit(int)
            for table in tables:
                written = thread.submit(write, written.result(), table)
            written.result()

    def _create(self, file: Any, name: str, dimension: str, like: Mapping[str, Any], chunk: int) -> None:
        """Create a variable; ``like`` are the attributes of a reading, ``chunk`` is the most rows of a chunk."""
        whole = is_judgement(name) or name == COUNT
        variable = file.create_variable(
            name,
            (dimension,),
            "u4" if name == COUNT else "f8" if not whole else "u2" if name.endswith("reason") else "u1",
            chunks=(min(file.dimensions[dimension].size, chunk),),
            compression="gzip",
            compression_opts=1,
            shuffle=True,
            fillvalue=None if whole else np.nan,
        )
        for key, value in describe(name, self._added, like, self._units, dimension).items():
            variable.attrs[key] = value


def _write_frames(file: Any, log: NetcdfReader, dimension: str, frames: Sequence[pl.DataFrame]) -> None:
    """Write means with the attributes of the log and of its variables."""
    import h5py
    import polars as pl

    frame = pl.concat(frames)
    file.dimensions[dimension] = len(frame)
    for name in frame.columns:
        values = frame[name].to_numpy()
        kind = {"i": "f8", "u": "f8", "f": "f8", "b": "i1"}.get(values.dtype.kind)
        variable = file.create_variable(name, (dimension,), kind or h5py.string_dtype())
        variable[...] = values.astype(kind or object)
        variable.attrs.update(log.attributes(name))
        if values.dtype.kind == "b":
            variable.attrs["dtype"] = "bool"  # as xarray marks it
    file.attrs.update(log.file_attributes)


@contextmanager
def _refusing_to_add(log: str) -> Iterator[None]:
    """Put the library's complaints about what it copied as ours, and a full disk as the system's."""
    try:
        yield
    except TiltcalError:
        raise
    except Exception as failure:
        if quoted := _OF_THE_SYSTEM.search(str(failure)):
            code = int(quoted[1])
            raise OSError(code, os.strerror(code)) from failure
        raise InputError(f"nothing can be added to this file: {failure}", file=log) from failure


def _history(before: Any, origin: Mapping[str, str], moment: datetime) -> str:
    made = ", ".join(f"{key} {value}" for key, value in origin.items() if key != "software")
    line = f"{to_the_second(moment)} {origin['software']} apply: {made}"
    return line if before is None else f"{before}\n{line}"
