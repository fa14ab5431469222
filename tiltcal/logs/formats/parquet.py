"""Parquet: a log whose columns have types, read some thousand rows at a time, and written with columns behind its own.

A reading is a column of whole or decimal numbers; null and NaN are a missing value. All other columns pass through,
whatever they hold.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, cast

from tiltcal.errors import InputError
from tiltcal.logs.foreign_library import foreign_library
from tiltcal.logs.log import NO_ROWS, LogBlock, LogReader, LogSource, LogWriter, Table
from tiltcal.logs.streams import read_ahead, refusing

if TYPE_CHECKING:
    import polars as pl

_ROWS = 1 << 16  # of a block: as many as stay in the cache on their way through the kernel, twice over
_ROW_GROUP = 1 << 18  # rows of a written file that are packed together; so many are in memory at once
_DAMAGED = "this is no Parquet file, or a damaged one"
_LEVEL = 1  # of the compression: readings with noise are 2 % larger than at the engine's own level, in half the time
_OF_THE_ENGINE = "ARROW:schema"
"""The key under which a writer keeps the types in its own words; the next one writes its own."""


class ParquetReader(LogReader):
    """A log in Parquet; an InputError where the file is none, damaged, or without a row."""

    def __init__(self, source: LogSource) -> None:
        import polars as pl

        super().__init__(source)
        path = Path(source.path)
        with refusing(_DAMAGED, self.name), foreign_library.get()(self.name):
            self._scan = pl.scan_parquet(path, glob=False, hive_partitioning=False)
            self._schema = self._scan.collect_schema()
            self.notes = {key: note for key, note in pl.read_parquet_metadata(path).items() if key != _OF_THE_ENGINE}
            self._rows = self._scan.select(pl.len()).collect().item()
        self.reads_ahead = bool(self._rows > _ROWS)
        self.names = tuple(self._schema)
        if not self._rows:
            raise InputError(NO_ROWS, file=self.name)

    def has_times(self, name: str, beside: int) -> bool:
        return super().has_times(name, beside) and not self._schema[name].is_nested()

    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]:
        done = 0
        scan = self._scan if frames else self._scan.select([self.names[index] for index in columns])
        with refusing(_DAMAGED, self.name):
            for frame in scan.collect_batches(chunk_size=_ROWS, maintain_order=True):
                values = {index: self._values(frame[self.names[index]], index, time) for index in columns}
                done += len(frame)
                self.bytes_read = cast(int, self.source.size) * done // self._rows
                times = None if time is None else frame[self.names[time]]
                yield LogBlock(values, frame=frame if frames else None, times=times)
        if done != self._rows:
            # The engine ends in silence where one of its threads fails on a damaged page.
            raise InputError(f"the file is damaged: it gives {done} of {self._rows} rows", file=self.name)


class ParquetWriter(LogWriter):
    """Writes Parquet: the log's columns keep their types; flag takes a byte, reason two, all others are doubles.

    The engine packs and writes while a thread of ours compensates the next row group; were that done in the call by
    which the engine asks for it, one of the engine's own threads would wait. It is handed the blocks one by one: were
    the kernel handed to it, it would call it on several blocks at once, and a pair's needs theirs in order.
    """

    frames = True

    def write(self, blocks: Iterable[tuple[LogBlock, Table]]) -> None:
        from polars.io.plugins import register_io_source

        whole = (_widened(block, table) for block, table in blocks)
        first = next(whole)
        frames = chain([first], read_ahead(whole, _ROW_GROUP // _ROWS))
        notes = {**self.log.notes, **({"tiltcal": json.dumps(self.origin)} if self.origin else {})}
        with refusing("this log cannot become Parquet", self.log.name):
            register_io_source(lambda *_: frames, schema=first.schema).sink_parquet(
                self.sink,
                compression_level=_LEVEL,
                row_group_size=_ROW_GROUP,
                maintain_order=True,
                metadata=notes,
                engine="streaming",
            )


def _widened(block: LogBlock, table: Table) -> pl.DataFrame:
    """Return all columns of a block, and those that belong behind them."""
    import polars as pl

    return block.framed().hstack([pl.Series(name, column) for name, column in table.items()])
