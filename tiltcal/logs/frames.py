"""Frames as logs: polars, pandas, pyarrow and xarray ones and dicts of arrays, given back as their own kind.

None of these libraries is imported here: a frame brings its own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, date, timedelta
from decimal import Decimal
from io import BytesIO
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.errors import InputError, UsageError
from tiltcal.logs.cf_attributes import describe, seconds_since_1970
from tiltcal.logs.columns import TIME
from tiltcal.logs.log import LogBlock, LogReader, LogSource, Table
from tiltcal.stated_arguments import of_python

if TYPE_CHECKING:
    import polars as pl

Units = Mapping[str, str | None]


class FrameReader(LogReader):
    """A frame, read like a log of one block.

    UsageError: it is of no known kind.
    InputError: it has no row, or its columns are not of one length.
    """

    def __init__(self, frame: Any, *, name: str = "the frame") -> None:
        super().__init__(LogSource(BytesIO(), "", name))
        self._frame = _columns_of(frame, name)
        self.names = self._frame.names
        self.notes = {str(key): str(note) for key, note in dict(getattr(frame, "attrs", None) or {}).items()}

    def has_times(self, name: str, beside: int) -> bool:
        frame = self._frame
        return (
            super().has_times(name, beside)
            and frame.dimensions(name) == frame.dimensions(self.names[beside])
            and frame.times(name) is not None
        )

    def unit(self, column: int) -> str | None:
        return self._frame.unit(self.names[column])

    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]:
        values, along, wrong = {}, {}, None
        for index in columns:
            name = self.names[index]
            along[self._dimension(name)] = name
            found = self._frame.times(name) if index == time else self._frame.numbers(name)
            if found is None:
                raise InputError(
                    f"column {name!r} holds {self._frame.kind(name)}, not numbers: name another, or make numbers of it",
                    file=self.name,
                )
            values[index] = found
            if index == time and not np.isfinite(found).any():
                wrong = self._wrong_time(self._frame.polars(name)[name], index, 0)
        if len(along) > 1:
            kinds = " and ".join(f"{name!r} along {dimension!r}" for dimension, name in along.items())
            raise InputError(f"the variables have rows of different kinds: {kinds}", file=self.name)
        frame = self._frame.polars(self.names[columns[0]]) if frames else None
        block = LogBlock(values, frame=frame, wrong_time=wrong)
        if values and not len(block):
            raise InputError("the log has columns and no rows", file=self.name)
        if len({len(found) for found in values.values()}) > 1:
            raise InputError("the columns differ in length", file=self.name)
        yield block

    def _dimension(self, name: str) -> str:
        """Return along what a column has its rows."""
        dimensions = self._frame.dimensions(name)
        if len(dimensions) != 1:
            listed = ", ".join(dimensions) or "a single value"
            raise InputError(
                f"column {name!r} has {len(dimensions)} dimensions ({listed}): a log's columns have one, such as time",
                file=self.name,
            )
        return dimensions[0]

    def of_means(self, blocks: Sequence[tuple[LogBlock, Table]], channels: Sequence[int], units: Units) -> Any:
        """Return the means of a frame, of its own kind, with columns behind them; see :meth:`with_columns`."""
        import polars as pl

        frame = pl.concat([block.frame for block, _ in blocks if block.frame is not None])
        table = {name: np.concatenate([block[name] for _, block in blocks]) for name in blocks[0][1]}
        return self._frame.of_rows(frame).with_columns(table, [self.names[index] for index in channels], units)

    def with_columns(self, table: Table, channels: Sequence[int], units: Units) -> Any:
        """Return the frame, of its own kind, with columns behind its own.

        Parameters
        ----------
        channels : sequence of int
            Where the readings stand that they were made of.
        units : mapping of str to str or None
            The unit of those that have that of a column of the frame.
        """
        return self._frame.with_columns(table, [self.names[index] for index in channels], units)


def rows_of(frame: Any, name: str, keys: Collection[str] = ()) -> list[dict[str, Any]]:
    """Return the rows of a frame, or of a sequence of mappings, without the cells that are empty.

    Parameters
    ----------
    name : str
        What messages call it.
    keys : collection of str
        The coordinates of an xarray Dataset that are columns, as all of its data variables are.

    UsageError: the frame is of no known kind.
    """
    if hasattr(frame, "data_vars"):
        frame = {key: frame[key].values for key in frame.variables if key in frame.data_vars or key in keys}
    if isinstance(frame, Mapping):
        arrays = [_array(values) for values in frame.values()]
        if len({values.shape[:1] or None for values in arrays}) > 1 or any(values.ndim == 0 for values in arrays):
            raise InputError("the columns differ in length", file=name)
        columns = [values.tolist() for values in arrays]
        rows = [dict(zip(frame, cells, strict=True)) for cells in zip(*columns, strict=True)]
    elif isinstance(frame, Sequence):
        if not all(isinstance(row, Mapping) for row in frame):
            raise UsageError(f"{name} is a list of rows: each is a mapping, such as {{'position': 'level', 'x': 2.5}}")
        rows = [dict(row) for row in frame]
    else:
        rows = _Table(_eager(frame, name)).rows()
    return [{key: _cell(cell) for key, cell in row.items() if not _is_missing(cell)} for row in rows]


def _columns_of(frame: Any, name: str) -> _Table | _Arrays | _Dataset:
    """Return the columns of a frame by name; numbers or times are None where a column holds something else."""
    if hasattr(frame, "data_vars") and hasattr(frame, "dims"):
        return _Dataset(frame)
    if isinstance(frame, Mapping):
        return _Arrays(frame)
    return _Table(_eager(frame, name))


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


class _Table:
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
        self._named = {str(name): name for name in self._frame.columns}  # a pandas frame may have numbers for names
        self.names = tuple(self._named)

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows, by the names of the columns; an index without a name is none of them."""
        return list((self._given if self._index_name is None else self._frame).rows(named=True))

    def unit(self, name: str) -> str | None:
        return None

    def kind(self, name: str) -> object:
        own = self._column(name).to_native()
        return own.type if hasattr(own, "type") else own.dtype

    def _column(self, name: str) -> Any:
        return self._frame.get_column(self._named[name])

    def _objects(self, column: Any) -> NDArray[Any] | None:
        """Return a column of Python's own values as an array; None where it holds others, or has another type."""
        import narwhals.stable.v2 as nw

        untyped = isinstance(column.dtype, nw.Object | nw.Unknown) or column.null_count() == len(column)
        return _of_objects(column.to_list()) if untyped else None

    def dimensions(self, name: str) -> tuple[str, ...]:
        """Return along what a column has its values; a column of a log has one."""
        return ("row",)

    def numbers(self, name: str) -> Array | None:
        import narwhals.stable.v2 as nw

        column = self._column(name)
        if column.dtype.is_numeric():
            return _floats(column.cast(nw.Float64))
        values = self._objects(column)
        return None if values is None else _numeric(values)

    def times(self, name: str) -> Array | None:
        import narwhals.stable.v2 as nw

        column = self._column(name)
        if column.dtype == nw.Date:  # its midnight
            column = column.cast(nw.Datetime("us"))
        kind = column.dtype
        if isinstance(kind, nw.Datetime | nw.Duration):
            moment = isinstance(kind, nw.Datetime)
            micros = column.dt.timestamp("us") if moment else column.dt.total_microseconds()
            return _floats(micros.cast(nw.Float64)) / 1e6
        values = self._objects(column)
        if values is not None:
            return _timed(values)
        if not isinstance(kind, nw.String):
            return self.numbers(name)
        return _seconds([cell if isinstance(cell, str) else None for cell in column.to_list()])  # pandas has NaN, too

    def polars(self, reading: str) -> pl.DataFrame:
        """Return the columns that have the rows of a reading."""
        import polars as pl

        frame = pl.DataFrame({name: _polars_column(self._column(name)) for name in self.names})
        objects = [name for name, kind in frame.schema.items() if kind == pl.Object]
        typed = {name: _of_objects(frame[name].to_list()) for name in objects}
        return frame.with_columns(**{name: pl.Series(values) for name, values in typed.items() if values is not None})

    def of_rows(self, rows: pl.DataFrame) -> _Table:
        """Return other rows as a frame of this kind."""
        import narwhals.stable.v2 as nw

        backend = self._frame.implementation
        made = (
            nw.from_native(rows)
            if backend.is_polars()
            else nw.from_dict(rows.to_dict(as_series=False), backend=backend)
        )
        if self._index is not None:
            made = nw.maybe_set_index(made, self._index)
            native: Any = made.to_native()
            native.index.name = self._index_name
        return _Table(nw.from_native(_with_notes(made.to_native(), self._given.to_native())))

    def with_columns(self, table: Table, readings: Sequence[str], units: Units) -> Any:
        import narwhals.stable.v2 as nw

        backend = self._given.implementation
        added = [nw.new_series(name, np.ascontiguousarray(values), backend=backend) for name, values in table.items()]
        return _with_notes(self._given.with_columns(*added).to_native(), self._given.to_native())


def _polars_column(column: Any) -> pl.Series:
    """Return a narwhals column; one of values of several kinds, or of a kind that polars has not, as objects."""
    import narwhals.stable.v2 as nw
    import polars as pl

    if not isinstance(column.dtype, nw.Object | nw.Unknown):  # of unknown ones a decimal of 256 bits ends in a panic
        with suppress(TypeError, ValueError, NotImplementedError, pl.exceptions.PolarsError):
            return column.to_polars()  # type: ignore[no-any-return]
    return pl.Series(column.to_list(), dtype=pl.Object)


def _with_notes(made: Any, given: Any) -> Any:
    """Return a frame with what another of its kind states about itself: attributes of pandas, metadata of pyarrow."""
    if hasattr(given, "attrs"):
        made.attrs = dict(given.attrs)
    metadata = getattr(getattr(given, "schema", None), "metadata", None)
    return made if metadata is None else made.replace_schema_metadata(metadata)


class _Arrays:
    """A dict of arrays."""

    def __init__(self, arrays: Mapping[str, Any]) -> None:
        self._given = dict(arrays)
        self._arrays = {str(name): _typed(_array(values)) for name, values in arrays.items()}
        self.names = tuple(self._arrays)

    def unit(self, name: str) -> str | None:
        return None

    def kind(self, name: str) -> object:
        return self._arrays[name].dtype

    def dimensions(self, name: str) -> tuple[str, ...]:
        return tuple(f"axis {number}" for number in range(self._arrays[name].ndim))

    def numbers(self, name: str) -> Array | None:
        return _numeric(self._arrays[name])

    def times(self, name: str) -> Array | None:
        return _timed(self._arrays[name])

    def polars(self, reading: str) -> pl.DataFrame:
        rows = self._arrays[reading].shape
        return _polars({name: values for name, values in self._arrays.items() if values.shape == rows})

    def of_rows(self, rows: pl.DataFrame) -> _Arrays:
        return _Arrays({name: rows[name].to_numpy() for name in rows.columns})

    def with_columns(self, table: Table, readings: Sequence[str], units: Units) -> dict[str, Any]:
        return self._given | {name: np.ascontiguousarray(values) for name, values in table.items()}


class _Dataset:
    """An xarray Dataset, whose readings are variables along one dimension and state their unit."""

    def __init__(self, data: Any) -> None:
        self._data = data
        self._named = {str(variable): variable for variable in data.variables}  # a number may be a name
        self.names = tuple(self._named)

    def _variable(self, name: str) -> Any:
        return self._data[self._named[name]]

    def unit(self, name: str) -> str | None:
        unit = self._variable(name).attrs.get("units")
        return None if unit is None else str(unit)

    def kind(self, name: str) -> object:
        return self._variable(name).dtype

    def dimensions(self, name: str) -> tuple[str, ...]:
        return tuple(map(str, self._variable(name).dims))

    def numbers(self, name: str) -> Array | None:
        return _numeric(_typed(self._variable(name).values))

    def times(self, name: str) -> Array | None:
        found = _timed(_typed(self._variable(name).values))
        return None if found is None else seconds_since_1970(found, self.unit(name))

    def polars(self, reading: str) -> pl.DataFrame:
        dims = self._variable(reading).dims
        alike = {name: variable for name in self.names if (variable := self._variable(name)).dims == dims}
        return _polars({name: _typed(variable.values) for name, variable in alike.items()})

    def of_rows(self, rows: pl.DataFrame) -> _Dataset:
        (dimension,) = self._variable(rows.columns[0]).dims
        columns = {
            self._named[name]: (dimension, rows[name].to_numpy(), self._variable(name).attrs) for name in rows.columns
        }
        made = self._data.drop_dims(dimension).assign(columns)
        return _Dataset(made.set_coords([name for name in columns if name in self._data.coords]))

    def with_columns(self, table: Table, readings: Sequence[str], units: Units) -> Any:
        (dimension,) = self._variable(readings[0]).dims
        like = self._variable(readings[0]).attrs
        return self._data.assign(
            {
                name: (
                    dimension,
                    np.ascontiguousarray(values),
                    describe(name, tuple(table), like, units, str(dimension)),
                )
                for name, values in table.items()
            }
        )


def _array(values: Any) -> NDArray[Any]:
    """Return values as an array, which keeps its mask."""
    if isinstance(values, np.ma.MaskedArray):
        return values
    try:
        return np.asarray(values)
    except ValueError:  # lists of different lengths
        found = np.empty(len(values), object)
        found[:] = values
        return found


def _typed(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array of Python's own numbers, moments or durations as one of that type, every other as it is."""
    if values.dtype.kind != "O" or values.ndim != 1 or np.ma.isMaskedArray(values):
        return values
    found = _of_objects(values.tolist())
    return values if found is None else found


def _cell(cell: Any) -> Any:
    """Return a number of numpy or a Decimal as one of Python, whole where it is.

    A column of whole numbers is one of floats where pandas or an array has none for a row.
    """
    cell = float(cell) if isinstance(cell, Decimal) else of_python(cell)
    return int(cell) if isinstance(cell, float) and cell.is_integer() else cell


def _is_missing(cell: Any) -> bool:
    """Return whether a cell is None, NaN, or NA or NaT of pandas."""
    return type(cell).__name__ in ("NoneType", "NAType", "NaTType") or (isinstance(cell, float) and cell != cell)


def _of_objects(cells: Sequence[Any]) -> NDArray[Any] | None:
    """Return Python's own numbers, moments or durations as an array of that type; None where they are something else.

    A moment without a zone is UTC.
    """
    there = [not _is_missing(cell) for cell in cells]
    present = [cell for cell in cells if not _is_missing(cell)]
    if all(isinstance(cell, Real | Decimal) and not isinstance(cell, bool) for cell in present):
        found = np.full(len(cells), np.nan)
    elif all(isinstance(cell, date) for cell in present):
        present = [
            cell.astimezone(UTC).replace(tzinfo=None) if getattr(cell, "tzinfo", None) else cell for cell in present
        ]
        found = np.full(len(cells), np.datetime64("NaT", "us"))
    elif all(isinstance(cell, timedelta) for cell in present):
        found = np.full(len(cells), np.timedelta64("NaT", "us"))
    else:
        return None
    found[there] = present
    return found


def _polars(columns: Mapping[str, NDArray[Any]]) -> pl.DataFrame:
    """Return arrays as a frame; text beside values of another kind, such as NaN, becomes a column of objects."""
    import polars as pl

    taken = {}
    for name, values in columns.items():
        if values.dtype.kind in "mM":
            values = _moments(values)
        elif np.ma.isMaskedArray(values):
            numbers = _numeric(values)
            values = (
                np.where(np.ma.getmaskarray(values), np.array(None), np.ma.getdata(values))
                if numbers is None
                else numbers
            )
        try:
            taken[name] = pl.Series(values)
        except TypeError:
            taken[name] = pl.Series(values.tolist(), dtype=pl.Object)
    return pl.DataFrame(taken)


def _moments(values: NDArray[Any]) -> NDArray[Any]:
    """Return moments or durations in a unit that polars has, without a mask."""
    if np.datetime_data(values.dtype) not in (("ms", 1), ("us", 1), ("ns", 1)):
        values = values.astype(f"{values.dtype.kind}8[us]")
    return np.where(np.ma.getmaskarray(values), np.array("NaT", values.dtype), np.ma.getdata(values))


def _floats(column: Any) -> Array:
    """Return a narwhals column of doubles as an array; NaN where a value is missing."""
    return np.asarray(column.fill_null(float("nan")).to_numpy(), dtype=float)


def _numeric(values: NDArray[Any]) -> Array | None:
    if values.dtype.kind not in "iuf":
        return None
    return np.ma.filled(values.astype(float, copy=np.ma.isMaskedArray(values)), np.nan)


def _timed(values: NDArray[Any]) -> Array | None:
    if values.dtype.kind in "mM":
        values = _moments(values)
        seconds = values.astype(f"{values.dtype.kind}8[us]").astype(np.int64) / 1e6
        return np.where(np.isnat(values), np.nan, seconds)
    if values.dtype.kind in "OUT":
        return _seconds([str(value) for value in values])
    return _numeric(values)


def _seconds(cells: Sequence[str | None]) -> Array:
    import polars as pl

    from tiltcal.logs.text_to_numbers import seconds

    return seconds(pl.Series("", cells, dtype=pl.String))
