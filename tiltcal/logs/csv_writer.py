"""Compensated rows on their way out: as CSV, or as Parquet.

Each writer takes the blocks of a log and what the kernel made of them, in order, and writes one row for each of theirs.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from io import BytesIO
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.errors import UsageError

if TYPE_CHECKING:
    import polars as pl

    from tiltcal.logs.csv_log import CsvLog
    from tiltcal.logs.csv_rows import CsvBlock
    from tiltcal.logs.log import FrameBlock, TypedLog

Table = Mapping[str, Array | NDArray[np.uint8]]
"""The columns that a kernel adds, by name."""

_ROW_GROUP = 1 << 18
"""Rows of a Parquet file that are packed together; so many are in memory at once."""
_OF_THE_SYSTEM = re.compile(r"\(os error (\d+)\)$")
"""How the engine ends its words on a full disk, and on all else that the system refuses."""


def write_csv(sink: BinaryIO, log: CsvLog, added: Sequence[str], blocks: Iterable[tuple[CsvBlock, Table]]) -> None:
    """Write the rows of a CSV log as they stand, byte for byte, with columns behind their own.

    Parameters
    ----------
    sink : BinaryIO
    log : CsvLog
    added : sequence of str
        Names of the columns behind the log's own.
    blocks : iterable of (CsvBlock, mapping)
    """

    def text(rows: CsvBlock, table: Table) -> BytesIO:
        import polars as pl

        made = _csv(pl.DataFrame({"": rows.lines, **table}), quote_style="never", line_terminator=log.line_end)
        return made if rows.encoding == "utf-8" else BytesIO(made.getvalue().decode().encode(rows.encoding))

    _write_behind(sink, log.header + f",{','.join(added)}{log.line_end}".encode(), text, blocks)


def write_csv_of_types(
    sink: BinaryIO, log: TypedLog, added: Sequence[str], blocks: Iterable[tuple[FrameBlock, Table]]
) -> None:
    """Write the rows of a log whose columns have types as CSV.

    Numbers are written with the digits that bring them back, moments in ISO 8601, missing values as nothing.

    Parameters
    ----------
    sink : BinaryIO
    log : TypedLog
    added : sequence of str
        Names of the columns behind the log's own.
    blocks : iterable of (FrameBlock, mapping)

    Raises
    ------
    UsageError
        A column holds what has no place in a cell.
    """
    import polars as pl

    for name, kind in log.schema().items():
        if kind.is_nested() or kind in (pl.Binary, pl.Object):
            raise UsageError(f"column {name!r} holds {kind}, which CSV has no place for: write Parquet instead")

    def text(rows: FrameBlock, table: Table) -> BytesIO:
        return _csv(rows.frame.with_columns(*map(_in_words, rows.frame)).with_columns(**_series(table)))

    header = _csv(pl.DataFrame(schema=[*log.names, *added]), include_header=True).getvalue()
    _write_behind(sink, header, text, blocks)


def write_parquet(
    sink: BinaryIO,
    log: TypedLog,
    added: Sequence[str],
    blocks: Iterable[tuple[FrameBlock, Table]],
    notes: Mapping[str, str],
) -> None:
    """Write the rows of a log whose columns have types as Parquet.

    The columns keep their types; flag and reason take a byte, all others that are added are doubles.

    Parameters
    ----------
    sink : BinaryIO
    log : TypedLog
    added : sequence of str
        Names of the columns behind the log's own.
    blocks : iterable of (FrameBlock, mapping)
    notes : mapping of str to str
        What the file is to say of itself, its key-value metadata.

    Raises
    ------
    OSError
        The disk is full.

    Notes
    -----
    The engine packs and writes while the next block is read and compensated. It is handed the blocks one by one: were
    the kernel handed to it, it would call it on several blocks at once, and a pair's needs theirs in order.
    """
    import polars as pl
    from polars.io.plugins import register_io_source

    def frames(*_: object) -> Iterator[pl.DataFrame]:
        for rows, table in blocks:
            yield rows.frame.with_columns(**_series(table))

    schema = {**log.schema(), **{name: _type(name) for name in added}}
    try:
        register_io_source(frames, schema=schema).sink_parquet(
            sink, row_group_size=_ROW_GROUP, maintain_order=True, metadata=dict(notes), engine="streaming"
        )
    except pl.exceptions.ComputeError as failure:
        if found := _OF_THE_SYSTEM.search(str(failure)):
            code = int(found[1])
            raise OSError(code, os.strerror(code)) from failure
        raise


def _write_behind(
    sink: BinaryIO, header: bytes, text: Callable[..., BytesIO], blocks: Iterable[tuple[Any, Table]]
) -> None:
    """Write each block while the next is read and compensated; a single writer keeps the order."""

    def write(rows: Any, table: Table) -> None:
        sink.write(text(rows, table).getbuffer())

    with ThreadPoolExecutor(max_workers=1) as writer:
        written: Future[None] | None = None
        for rows, table in blocks:
            if written is None:
                sink.write(header)
            else:
                written.result()
            written = writer.submit(write, rows, table)
        if written is not None:
            written.result()


def _csv(frame: pl.DataFrame, *, include_header: bool = False, **options: Any) -> BytesIO:
    text = BytesIO()
    frame.write_csv(text, include_header=include_header, **options)
    return text


def _series(table: Table) -> dict[str, pl.Series]:
    import polars as pl

    return {name: pl.Series(name, column) for name, column in table.items()}


def _type(name: str) -> pl.DataType:
    import polars as pl

    return pl.UInt8() if name in ("flag", "reason") else pl.Float64()


def _in_words(column: pl.Series) -> pl.Series:
    """A column as its cells are to be written, where the engine has a way of its own."""
    import polars as pl

    kind = column.dtype
    if not isinstance(kind, pl.Datetime):
        return column
    if kind.time_zone is None:
        return column.dt.to_string("%Y-%m-%dT%H:%M:%S%.f")
    return column.dt.convert_time_zone("UTC").dt.to_string("%Y-%m-%dT%H:%M:%S%.fZ")
