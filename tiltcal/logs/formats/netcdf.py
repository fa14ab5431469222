"""NetCDF-4: a log whose columns are variables along one dimension, read some thousand rows at a time.

The conventions (CF) define what a number is: packed values are unpacked, the fill value and NaN are a missing value.

To write, the log's file is copied, byte for byte, and the new variables are put into the copy: all that it holds stays
as it was, attributes, packing, groups and all. What is added is described by the CF conventions. Roll and pitch
have no ``standard_name``: those of CF are a platform's, with its bow and its starboard side, and where on it the
sensor's x axis points is unknown.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.errors import InputError, UsageError
from tiltcal.extras import how_to_add
from tiltcal.files.moments import to_the_second
from tiltcal.logs.cf_attributes import COUNT, describe, is_judgement
from tiltcal.logs.foreign_library import foreign_library
from tiltcal.logs.frames import DatasetFrame, FrameReader
from tiltcal.logs.log import NO_ROWS, LogBlock, LogSource, LogWriter, Table
from tiltcal.logs.streams import refusing

_ROWS, _MOST_ROWS = 1 << 16, 1 << 21
"""Of a block: as many, or as a chunk of the file holds, which is unpacked as a whole, and how many at most."""

_CLASSIC = b"CDF"

_DAMAGED, _NO_ROOM = "this is no NetCDF-4 file, or a damaged one", "nothing can be added to this file"


class NetcdfReader(FrameReader):
    """A log in NetCDF-4: its columns are all variables; those that hold readings have one dimension, the same."""

    def __init__(self, source: LogSource) -> None:
        try:
            import h5netcdf  # noqa: F401  (what xarray reads with)
            import xarray
        except ImportError as failure:
            why = f"NetCDF needs xarray and h5netcdf ({failure}): {how_to_add('tiltcal[netcdf]')}"
            raise UsageError(why) from failure
        if source.stream.read(3) == _CLASSIC:
            why = "this is NetCDF-3: make NetCDF-4 of it first, such as with nccopy -k nc4 OLD NEW"
            raise InputError(why, file=source.name)
        with refusing(_DAMAGED, source.name), foreign_library.get()(source.name):
            # An index would hold a whole variable in memory, as many rows as the file declares.
            self.data = xarray.open_dataset(
                Path(source.path),
                engine="h5netcdf",
                decode_times=False,
                decode_coords=False,
                create_default_indexes=False,
            )
        super().__init__(self.data, source=source)

    def close(self) -> None:
        self.data.close()

    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]:
        dimension = self.dimension(columns)
        chunks = [self.data[self.names[index]].encoding.get("chunksizes") or (1,) for index in columns]
        longest = max(int(chunk[0]) for chunk in chunks)
        total, step = self.data.sizes[dimension], min(-(-_ROWS // longest) * longest, _MOST_ROWS)
        if not total:
            raise InputError(NO_ROWS, file=self.name)
        for start in range(0, total, step):
            rows = slice(start, min(start + step, total))
            with refusing(_DAMAGED, self.name), foreign_library.get()(self.name):
                block = self._block(DatasetFrame(self.data.isel({dimension: rows})), columns, time, frames)
            self.bytes_read = (self.source.size or 0) * rows.stop // total
            yield block


class NetcdfWriter(LogWriter):
    """Writes a NetCDF log with variables behind its own; means become a file of their own."""

    def write(self, blocks: Iterable[tuple[LogBlock, Table]]) -> None:
        import h5netcdf

        log = self.log
        if not isinstance(log, NetcdfReader):
            raise UsageError(f"only a NetCDF log becomes NetCDF, and {log.name} is another kind")
        rows = iter(blocks)
        first = next(rows)
        columns, chunk = list(first[0].values), len(first[0])
        history = _history(log.data.attrs.get("history"), self.origin, datetime.now(UTC))
        if first[0].counts is not None:
            means = log.with_columns([first, *rows], columns, self.units)
            with refusing(_NO_ROOM, log.name):
                means.assign_attrs(history=history).to_netcdf(self.sink, engine="h5netcdf")
            return
        log.source.stream.seek(0)
        shutil.copyfileobj(log.source.stream, self.sink, 1 << 20)
        self.sink.flush()
        dimension, like = log.dimension(columns), log.data[log.names[columns[0]]].attrs
        with refusing(_NO_ROOM, log.name), h5netcdf.File(self.sink, "r+") as file:
            for name in self.added:
                self._create(file, name, dimension, like, chunk)
            self._write_tables(file, (table for _, table in chain([first], rows)))
            file.attrs["history"] = history

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
        variable.attrs.update(describe(name, self.added, like, self.units))


def _history(before: Any, origin: Mapping[str, str], moment: datetime) -> str:
    made = ", ".join(f"{key} {value}" for key, value in origin.items() if key != "software")
    line = f"{to_the_second(moment)} {origin['software']} apply: {made}"
    return line if before is None else f"{before}\n{line}"
