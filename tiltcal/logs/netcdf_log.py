"""The NetCDF door: a recorded log whose columns are variables along one dimension, read some thousand rows at a time.

The conventions (CF) say what a number is: packed values are unpacked, the fill value and NaN are a missing value.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from tiltcal.core.model import Array
from tiltcal.errors import InputError, UsageError

_ROWS = 1 << 16
"""Of a block, or as many as a chunk of the file holds, which is unpacked as a whole."""

_CLASSIC = b"CDF"
_SECONDS = {"milliseconds": 1e-3, "seconds": 1.0, "minutes": 60.0, "hours": 3600.0, "days": 86400.0}
"""Of the units in which a time is counted since some moment; anything else counts as seconds."""


@dataclass(frozen=True)
class SlicedBlock:
    """Some rows of a log that stays where it is.

    Attributes
    ----------
    rows : slice
        Where they stand.
    values : mapping of int to ndarray, shape (n,)
    faults : tuple
        None.
    """

    rows: slice
    values: Mapping[int, Array]
    faults: tuple[int, ...] = field(default=())


class NetcdfLog:
    """A log in NetCDF-4.

    Parameters
    ----------
    path : str or Path
        As the user named it.

    Attributes
    ----------
    names : tuple of str
        All variables; those that hold readings have one dimension, the same.
    header_line : None
        There are no lines.
    bytes_read : int
        So far: of the file's size, the share that the rows so far are of all rows.

    Raises
    ------
    UsageError
        The libraries are not there.
    InputError
        The file is no NetCDF-4, or damaged.
    """

    header_line: None = None

    def __init__(self, path: str | Path) -> None:
        xarray = _library()
        self._name = str(path)
        with open(path, "rb") as stream:
            if stream.read(3) == _CLASSIC:
                self._refuse("this is NetCDF-3: make NetCDF-4 of it first, such as with nccopy -k nc4 OLD NEW")
        with self._told():
            self._size = os.stat(path).st_size
            self._data = xarray.open_dataset(
                Path(path), engine="h5netcdf", decode_times=False, decode_coords=False, cache=False
            )
        self.names = tuple(str(name) for name in self._data.variables)
        self.bytes_read = 0

    def dimension(self, columns: Sequence[int]) -> str:
        """Along which the columns have their rows.

        Raises
        ------
        InputError
            A column has none or several, they differ, or there is no row.
        """
        along: dict[str, str] = {}
        for name in (self.names[index] for index in columns):
            dimensions = self._data[name].dims
            if len(dimensions) != 1:
                self._refuse(
                    f"variable {name!r} has {len(dimensions)} dimensions ({', '.join(map(str, dimensions))}): a log's "
                    "columns have one, such as time"
                )
            along[str(dimensions[0])] = name
        if len(along) > 1:
            told = " and ".join(f"{name!r} along {dimension!r}" for dimension, name in along.items())
            self._refuse(f"the variables have rows of different kinds: {told}")
        dimension = next(iter(along))
        if not self._data.sizes[dimension]:
            self._refuse(f"the log has no rows: dimension {dimension!r} is empty")
        return dimension

    def said_of(self, name: str) -> Mapping[str, Any]:
        """The attributes of a variable that its decoding has left."""
        variable = self._data[name]
        return {
            **variable.attrs,
            **{key: variable.encoding[key] for key in ("coordinates",) if key in variable.encoding},
        }

    def rows(self, columns: Sequence[int], time: int | None = None) -> Iterator[SlicedBlock]:
        """The rows, block after block.

        Parameters
        ----------
        columns : sequence of int
            Indices of the variables that hold needed numbers.
        time : int, optional
            Of them, the one that may count days or hours, which become seconds.

        Yields
        ------
        SlicedBlock

        Raises
        ------
        InputError
            A needed variable holds something else than numbers, they have no dimension in common, or the file is
            damaged.
        """
        dimension = self.dimension(columns)
        for index in columns:
            self._require_numbers(self.names[index])
        total, step = self._data.sizes[dimension], self._step(columns)
        for start in range(0, total, step):
            rows = slice(start, min(start + step, total))
            with self._told():
                values = {index: self._numbers(self.names[index], {dimension: rows}) for index in columns}
            if time is not None:
                values[time] = values[time] * self._seconds(self.names[time])
            self.bytes_read = self._size * rows.stop // total
            yield SlicedBlock(rows, values)
        self._data.close()

    def _seconds(self, name: str) -> float:
        """In one of the units that a time is counted in."""
        unit, _, _ = str(self._data[name].attrs.get("units", "")).partition(" since ")
        return _SECONDS.get(unit, 1.0)

    def _numbers(self, name: str, rows: Mapping[str, slice]) -> Array:
        return np.asarray(self._data[name].isel(rows).values, dtype=float)

    def _step(self, columns: Sequence[int]) -> int:
        """Rows of a block: whole chunks, or each would be unpacked for every block that has a part of it."""
        chunks = [self._data[self.names[index]].encoding.get("chunksizes") or (1,) for index in columns]
        longest = max(int(chunk[0]) for chunk in chunks)
        return -(-_ROWS // longest) * longest

    def _require_numbers(self, name: str) -> None:
        kind = self._data[name].dtype
        if kind.kind not in "iuf":
            self._refuse(f"variable {name!r} holds {kind}, not numbers: name another, or make numbers of it")

    def _refuse(self, why: str) -> NoReturn:
        raise InputError(why, file=self._name)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Put the libraries' complaints as ours."""
        try:
            yield
        except (OSError, ValueError, KeyError, RuntimeError) as failure:
            raise InputError(f"this is no NetCDF-4 file, or a damaged one: {failure}", file=self._name) from failure


def _library() -> Any:
    try:
        import h5netcdf  # noqa: F401  (what xarray reads with)
        import xarray
    except ImportError as failure:
        raise UsageError(f"NetCDF needs xarray and h5netcdf ({failure}): pip install 'tiltcal[netcdf]'") from failure
    return xarray
