"""Frames as logs: polars, pandas, pyarrow and xarray ones and dicts of arrays, given back as their own kind.

None of these libraries but polars is imported here: a frame brings its own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from decimal import Decimal
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from tiltcal.column_names import TIME
from tiltcal.errors import InputError, UsageError
from tiltcal.logs.cf_attributes import describe, in_seconds
from tiltcal.logs.log import NO_ROWS, LogBlock, LogReader, LogSource, Table
from tiltcal.stated_arguments import of_python

if TYPE_CHECKING:
    import polars as pl

Units = Mapping[str, str | None]


class FrameReader(LogReader):
    """A frame, read like a log of one block; ``source`` is the log whose rows it has, if it is none by itself."""

    def __init__(self, frame: Any, *, name: str = "the frame", source: LogSource | None = None) -> None:
        super().__init__(source or LogSource(BytesIO(), "", name))
        self._frame: TableFrame | ArrayFrame | DatasetFrame
        if hasattr(frame, "data_vars") and hasattr(frame, "dims"):
            self._frame = DatasetFrame(frame)
        else:
            self._frame = ArrayFrame(frame) if isinstance(frame, Mapping) else TableFrame(_eager(frame, name))
        self.names = tuple(self._frame.named)
        self.notes = {str(key): str(note) for key, note in dict(getattr(frame, "attrs", None) or {}).items()}

    def has_times(self, name: str, beside: int) -> bool:
        dimensions = self._frame.dimensions
        if not super().has_times(name, beside) or dimensions(name) != dimensions(self.names[beside]):
            return False
        with suppress(InputError):
            in_seconds(np.empty(0), self._frame.unit(name))
            return True
        return False

    def unit(self, column: int) -> str | None:
        return self._frame.unit(self.names[column])

    def dimension(self, columns: Sequence[int]) -> str:
        """Return along what columns have their rows; an InputError where one has none or several, or they differ."""
        along: dict[str, str] = {}
        for name in (self.names[column] for column in columns):
            each = self._frame.dimensions(name)
            if len(each) != 1:
                listed = ", ".join(each) or "a single value"
                why = f"column {name!r} has {len(each)} dimensions ({listed}): a log's columns have one, such as time"
                raise InputError(why, file=self.name)
            along[each[0]] = name
        if len(along) > 1:
            kinds = " and ".join(f"{name!r} along {dimension!r}" for dimension, name in along.items())
            raise InputError(f"the columns have rows of different kinds: {kinds}", file=self.name)
        return next(iter(along), "")

    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]:
        yield self._block(self._frame, columns, time, frames)

    def _block(
        self, frame: TableFrame | ArrayFrame | DatasetFrame, columns: Sequence[int], time: int | None, frames: bool
    ) -> LogBlock:
        """Return the rows of a frame."""
        import polars as pl

        dimension, values, times = self.dimension(columns), {}, None
        for index in columns:
            column = frame.column(self.names[index])
            absent = column.null_count() == len(column)  # a column without a value may have any type
            values[index] = np.full(len(column), np.nan) if absent else self._values(column, index, time)
            if index == time:
                times = column
        rows = {len(column) for column in values.values()}
        if len(rows) > 1:
            raise InputError("the columns differ in length", file=self.name)
        if 0 in rows:
            raise InputError(NO_ROWS, file=self.name)
        if not frames:
            return LogBlock(values, times=times)
        alike = {name: frame.column(name) for name in self.names if frame.dimensions(name) == (dimension,)}
        typed = pl.DataFrame({name: column for name, column in alike.items() if len(column) in rows})
        return LogBlock(values, frame=typed, times=times)

    def cells(self, keys: Collection[str]) -> list[dict[str, Any]]:
        """Return the rows of a small table, by column, without the cells that are empty."""
        names = [name for name in self.names if name in keys or name not in self._frame.beside]
        self.dimension([self.names.index(name) for name in names])
        columns = [self._frame.column(name).to_list() for name in names]
        if len({*map(len, columns)}) > 1:
            raise InputError("the columns differ in length", file=self.name)
        return [_present(dict(zip(names, row, strict=True))) for row in zip(*columns, strict=True)]

    def with_columns(self, blocks: Sequence[tuple[LogBlock, Table]], channels: Sequence[int], units: Units) -> Any:
        """Return the frame, or means of its rows, of its own kind, with columns made of its ``channels`` behind."""
        import polars as pl

        frame, table = self._frame, blocks[0][1]
        if blocks[0][0].counts is not None:
            frame = frame.of_rows(pl.concat([block.framed() for block, _ in blocks]))
            table = {name: np.concatenate([block[name] for _, block in blocks]) for name in table}
        return frame.with_columns(table, self.names[channels[0]], units)


def rows_of(frame: Any, name: str, keys: Collection[str] = ()) -> list[dict[str, Any]]:
    """Return the rows of a frame, or of a sequence of mappings, without the cells that are empty.

    Messages call it ``name``; coordinates of a Dataset and an index without a name are columns where ``keys`` has them.
    """
    if not isinstance(frame, Sequence):
        return FrameReader(frame, name=name).cells(keys)
    if not all(isinstance(row, Mapping) for row in frame):
        raise UsageError(f"{name} is a list of rows: each is a mapping, such as {{'position': 'level', 'x': 2.5}}")
    return [_present(row) for row in frame]


def _eager(frame: Any, name: str) -> Any:
    """Return a polars, pandas or pyarrow frame as narwhals takes it."""
    import narwhals.stable.v2 as nw

    try:
        return nw.from_native(frame, eager_only=True)
    except nw.exceptions.DuplicateError as failure:
        raise InputError(f"two columns have one name: {' '.join(str(failure).split())}", file=name) from None
    except TypeError:
        raise UsageError(
            f"{name} is a {type(frame).__module__.partition('.')[0]}.{type(frame).__name__}: give a polars, pandas or "
            "pyarrow frame (collected, not lazy), an xarray Dataset, or a dict of arrays"
        ) from None


class TableFrame:
    """A polars, pandas or pyarrow frame, by way of narwhals.

    The index of pandas is a column where it has a name; one of moments or durations without a name is ``time``.
    """

    def __init__(self, frame: Any) -> None:
        import narwhals.stable.v2 as nw

        index = nw.maybe_get_index(frame)
        self._index_name = name = getattr(index, "name", None)
        if name is None and getattr(getattr(index, "dtype", None), "kind", "") in ("m", "M"):
            name = TIME
        self._index = name if isinstance(name, str) and name not in frame.columns else None
        self._given = frame
        self._frame = frame if self._index is None else nw.from_native(frame.to_native().reset_index(names=name))
        self.named = {str(name): name for name in self._frame.columns}  # a pandas frame may have numbers for names
        self.beside = {self._index} if self._index_name is None else set()  # are no columns of a small table

    def unit(self, name: str) -> str | None:
        return None

    def dimensions(self, name: str) -> tuple[str, ...]:
        return ("row",)

    def column(self, name: str) -> pl.Series:
        import polars as pl

        column = self._frame.get_column(self.named[name])
        # Without pyarrow polars takes nothing from pandas that numpy has no type for.
        with _suppress_failures(), suppress(ImportError):
            typed: pl.Series = column.to_polars()
            if typed.dtype != pl.Object:
                return typed
        if zone := getattr(column.dtype, "time_zone", None):
            plain: pl.Series = column.dt.convert_time_zone("UTC").dt.replace_time_zone(None).to_polars()
            return plain.dt.replace_time_zone("UTC").dt.convert_time_zone(zone)
        return _of_objects(column.to_list())

    def of_rows(self, rows: pl.DataFrame) -> TableFrame:
        """Return other rows as a frame of this kind."""
        import narwhals.stable.v2 as nw

        kind = self._frame.implementation
        made: Any = nw.from_native(rows)
        if not kind.is_polars():
            made = nw.from_dict(rows.to_dict(as_series=False), backend=kind)
        if self._index is not None:
            made = nw.maybe_set_index(made, self._index)
            made.to_native().index.name = self._index_name
        return TableFrame(made)

    def with_columns(self, table: Table, reading: str, units: Units) -> Any:
        import narwhals.stable.v2 as nw

        kind = self._given.implementation
        added = [nw.new_series(name, np.ascontiguousarray(values), backend=kind) for name, values in table.items()]
        made, given = self._given.with_columns(*added).to_native(), self._given.to_native()
        if hasattr(made, "attrs"):
            made.attrs = dict(given.attrs)
        return made


class ArrayFrame:
    """A dict of arrays."""

    def __init__(self, arrays: Mapping[str, Any]) -> None:
        self._given, self.beside = dict(arrays), set[str]()
        self.named = {str(name): _array(values) for name, values in arrays.items()}

    def unit(self, name: str) -> str | None:
        return None

    def dimensions(self, name: str) -> tuple[str, ...]:
        return tuple(f"axis {number}" for number in range(self.named[name].ndim))

    def column(self, name: str) -> pl.Series:
        return _series(self.named[name])

    def of_rows(self, rows: pl.DataFrame) -> ArrayFrame:
        return ArrayFrame({name: rows[name].to_numpy() for name in rows.columns})

    def with_columns(self, table: Table, reading: str, units: Units) -> dict[str, Any]:
        return self._given | {name: np.ascontiguousarray(values) for name, values in table.items()}


class DatasetFrame:
    """An xarray Dataset, whose readings are variables along one dimension and state their unit."""

    def __init__(self, data: Any) -> None:
        self._data = data
        self.named = {str(variable): variable for variable in data.variables}  # a number may be a name
        self.beside = {str(name) for name in data.coords}

    def _variable(self, name: str) -> Any:
        return self._data[self.named[name]]

    def unit(self, name: str) -> str | None:
        unit = self._variable(name).attrs.get("units")
        return None if unit is None else str(unit)

    def dimensions(self, name: str) -> tuple[str, ...]:
        return tuple(map(str, self._variable(name).dims))

    def column(self, name: str) -> pl.Series:
        return _series(self._variable(name).values)

    def of_rows(self, rows: pl.DataFrame) -> DatasetFrame:
        (dimension,) = self._variable(rows.columns[0]).dims
        columns = {
            self.named[name]: (dimension, rows[name].to_numpy(), self._variable(name).attrs) for name in rows.columns
        }
        made = self._data.drop_dims(dimension).assign(columns)
        return DatasetFrame(made.set_coords([name for name in columns if name in self._data.coords]))

    def with_columns(self, table: Table, reading: str, units: Units) -> Any:
        variable = self._variable(reading)
        (dimension,) = variable.dims
        attributes = {name: describe(name, tuple(table), variable.attrs, units) for name in table}
        return self._data.assign(
            {name: (dimension, np.ascontiguousarray(values), attributes[name]) for name, values in table.items()}
        )


def _array(values: Any) -> Any:
    """Return values as an array, which keeps its mask."""
    if isinstance(values, np.ma.MaskedArray):
        return values
    try:
        return np.asarray(values)
    except ValueError:  # lists of different lengths
        return np.array(values, dtype=object)


def _series(values: Any) -> pl.Series:
    """Return an array as a column; what is masked in it is null."""
    import polars as pl

    array, masked = np.ma.getdata(values), np.flatnonzero(np.ma.getmaskarray(values).ravel())
    if array.dtype.kind == "O":
        return _of_objects(np.ma.filled(values, None).tolist())
    if array.dtype.kind == "S":
        array = np.char.decode(array, errors="replace")
    if array.dtype.kind in "mM" and np.datetime_data(array.dtype) not in (("ms", 1), ("us", 1), ("ns", 1)):
        array = array.astype(f"{array.dtype.kind}8[us]")
    return pl.Series(array).scatter(masked, None) if len(masked) else pl.Series(array)


def _of_objects(cells: Sequence[Any]) -> pl.Series:
    """Return values of Python as a column of the type that holds them, else as objects."""
    import polars as pl

    cells = [None if _is_missing(cell) else of_python(cell) for cell in cells]
    with _suppress_failures():
        return pl.Series("", cells, strict=False)
    return pl.Series("", cells, dtype=pl.Object)


def _suppress_failures() -> suppress:
    """Leave out what polars says of values that it has no type for."""
    import polars as pl

    panic, error = pl.exceptions.PanicException, pl.exceptions.PolarsError
    return suppress(TypeError, ValueError, NotImplementedError, panic, error)


def _present(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the cells that are not empty, as Python has them, whole numbers whole.

    A column of whole numbers is one of floats where pandas or an array has none for a row.
    """
    cells = {key: of_python(cell) for key, cell in row.items() if not _is_missing(cell)}
    cells = {key: float(cell) if isinstance(cell, Decimal) else cell for key, cell in cells.items()}
    return {key: int(cell) if isinstance(cell, float) and cell.is_integer() else cell for key, cell in cells.items()}


def _is_missing(cell: Any) -> bool:
    """Return whether a cell is None, NaN, or NA or NaT of pandas."""
    return type(cell).__name__ in ("NoneType", "NAType", "NaTType") or (isinstance(cell, float) and cell != cell)
