"""What every format of log gives: columns by name, and blocks of rows in order."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeVar

from tiltcal.core.model import Array

if TYPE_CHECKING:
    import polars as pl


class LogBlock(Protocol):
    """Some rows of a log.

    Attributes
    ----------
    values : mapping of int to ndarray, shape (n,)
        The number columns that were asked for, by index; NaN where a value is missing.
    faults : collection of int
        Rows that could not be parsed and were kept.
    """

    @property
    def values(self) -> Mapping[int, Array]: ...

    @property
    def faults(self) -> Collection[int]: ...


AnyLogBlock = TypeVar("AnyLogBlock", bound=LogBlock)
AnyLogBlock_co = TypeVar("AnyLogBlock_co", bound=LogBlock, covariant=True)


class Log(Protocol[AnyLogBlock_co]):
    """A recorded log, read once from its beginning to its end.

    Attributes
    ----------
    names : tuple of str
        The columns.
    header_line : int or None
        Where they are named; None where the file has no lines.
    bytes_read : int
        So far, as far as the format lets tell.
    """

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def header_line(self) -> int | None: ...

    @property
    def bytes_read(self) -> int: ...

    def rows(self, columns: Sequence[int], time: int | None = None) -> Iterator[AnyLogBlock_co]: ...


@dataclass(frozen=True)
class FrameBlock:
    """Some rows of a log whose columns have types.

    Attributes
    ----------
    frame : polars.DataFrame
        All columns, as they are.
    values : mapping of int to ndarray, shape (n,)
    faults : collection of int
    """

    frame: pl.DataFrame
    values: Mapping[int, Array]
    faults: Collection[int] = field(default=())


class TypedLog(Log[FrameBlock], Protocol):
    """A log whose columns have types."""

    def schema(self) -> Mapping[str, pl.DataType]: ...
