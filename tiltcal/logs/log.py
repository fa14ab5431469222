"""The interface of a log in any format: columns by name, and blocks of rows in order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, BinaryIO, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.errors import InputError
from tiltcal.logs.cf_attributes import in_seconds
from tiltcal.logs.numbers_and_times import (
    are_moments,
    clock_breaks,
    column_numbers,
    column_seconds,
    unit_since_epoch,
    unread_time,
)
from tiltcal.logs.streams import keep_freed_memory, read_ahead, sha256_of
from tiltcal.printable import counted
from tiltcal.units import TEMPERATURES, spelt, split_unit

if TYPE_CHECKING:
    import polars as pl

Table = Mapping[str, Array | NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.int64]]
"""The columns that a calibration adds to some rows, by name."""

NO_ROWS = "the log has columns and no rows"

Progress = Callable[[int, int | None], None]
"""Called with the bytes of a log that have been read, and with its size where that is known."""


@dataclass(frozen=True)
class LogBlock:
    """Some rows of a log, in order.

    ``values`` are the number columns that were asked for, by index, shape (n,), NaN where a value is missing and in
    rows that could not be parsed, which ``faults`` names; ``frame`` has all columns with their types, where these were
    asked for. ``times`` are the cells of the time as they stand, unless the engine has read them as numbers. Of means
    ``counts``, shape (n, sensors), says of how many rows the readings of each sensor are the mean, and ``bad_rows`` how
    many of these could not be parsed.
    """

    values: Mapping[int, Array]
    faults: Collection[int] = ()
    frame: pl.DataFrame | None = None
    times: pl.Series | None = None
    counts: NDArray[np.int64] | None = None
    bad_rows: int = 0

    def __len__(self) -> int:
        return len(next(iter(self.values.values())))

    def framed(self) -> pl.DataFrame:
        """Return all columns with their types, in a block that was asked for them."""
        return cast("pl.DataFrame", self.frame)

    def readings(self, columns: Sequence[int]) -> Array:
        """Return some columns side by side, shape (n, columns), each of them contiguous."""
        return np.stack([self.values[index] for index in columns]).T


@dataclass(frozen=True)
class LogSource:
    """The source of a log: an open file or standard input, its path or ``-``, its name for messages, its size in bytes.

    With ``skip_bad_rows`` rows of CSV that cannot be parsed are kept and named in :attr:`LogBlock.faults`, instead of
    raising.
    """

    stream: BinaryIO
    path: str
    name: str
    size: int | None = None
    skip_bad_rows: bool = False
    progress: Progress | None = None

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C has ended a live stream."""
        return bool(getattr(self.stream, "interrupted", False))


class LogClock:
    """The times of a log on their way to seconds, and what is odd in them."""

    def __init__(self) -> None:
        self._moments: bool | None = None
        self._unit: str | None = None
        self._rows = 0
        self._last: Array = np.empty(0)
        self._breaks, self._first = Counter[str](), dict[str, int]()

    def seconds(
        self, times: Array, cells: pl.Series | None, stated: str | None, file: str
    ) -> tuple[Array, str | None, str]:
        """Return the next times in seconds, the unit that they were in, and how it is known."""
        by = "its name"
        if self._moments is None and np.isfinite(times).any():  # decided once: the first of them show it
            self._moments = are_moments(cells)
            self._unit = unit_since_epoch(times)
        if self._moments:
            stated = None
        elif stated is None:
            stated, by = self._unit, "the size of its numbers"
        if stated is not None:
            times = in_seconds(times, stated, file)
        self._watch(times)
        return times, stated, by

    def _watch(self, times: Array) -> None:
        """Count where the clock starts again, and which rows are out of order or have the time of the row before."""
        shift = self._rows - len(self._last)
        self._rows += len(times)
        times = np.concatenate([self._last, times])
        for kind, found in zip(("starts again", "goes back"), clock_breaks(times), strict=True):
            self._breaks[kind] += len(found)
            if len(found):
                self._first.setdefault(kind, int(found[0]) + shift)
        known = times[np.isfinite(times)]
        self._breaks["stands still"] += int(np.count_nonzero(np.diff(known) == 0.0))
        self._last = known[-1:]

    @property
    def remarks(self) -> list[str]:
        """What is odd in the times that were read: a restart, rows out of order, doubled times."""
        return [
            f"the time {kind} {counted(count, 'time')}"
            + (f", first at row {self._first[kind]}" if kind in self._first else "")
            for kind, count in self._breaks.items()
            if count
        ]


class LogReader(ABC):
    """A recorded log, read once from its beginning to its end.

    ``name`` is the log as the user named it, for messages; ``notes`` is what it states about itself; ``remarks`` are
    sentences on how its rows were read, once they are. Where it ``reads_ahead``, a thread reads and parses the next
    blocks meanwhile, which only a source that never waits may do.
    """

    names: tuple[str, ...]
    header_line: int | None = None
    """The line that names the columns; None where the file has no lines."""
    unnamed: tuple[str, ...] = ()
    """The columns of numbers, but for times, of a log that does not name its columns."""

    def __init__(self, source: LogSource) -> None:
        self.source, self.name, self.clock = source, source.name, LogClock()
        self.notes: Mapping[str, str] = {}
        self.bytes_read = self.rows_read = 0
        self.remarks: list[str] = []
        self.reads_ahead = False

    @property
    def sha256(self) -> str | None:
        """The checksum of the log, hexadecimal; None of a frame."""
        return sha256_of(self.source.path) if self.source.path else None

    def rows(
        self,
        columns: Sequence[int],
        time: int | None = None,
        *,
        temperatures: Collection[int] = (),
        frames: bool = False,
        needs_time: bool = False,
    ) -> Iterator[LogBlock]:
        """Yield the rows, block after block, with the numbers of some columns; with ``frames`` all with their types.

        ``time`` is the one of the columns that may hold moments, which become seconds, as times in another unit do;
        where ``needs_time``, one that begins with what is no time is refused. ``temperatures`` become °C.

        InputError: a row cannot be parsed, a needed column holds no numbers, or the file is damaged; once the iterator
            comes to it.
        """
        keep_freed_memory()
        blocks = self._blocks(tuple(columns), time, frames)
        rows, untimed = 0, time if needs_time else None
        for block in read_ahead(blocks) if self.reads_ahead else blocks:
            if untimed is not None and np.isfinite(block.values[untimed]).any():
                untimed = None
            wrong = None if untimed is None or block.times is None else unread_time(block.times, self.names[untimed])
            if wrong is not None:
                raise self._row_error(wrong[1], rows + wrong[0])
            rows += len(block)
            block = self._converted(block, time, temperatures)
            self.rows_read = rows
            yield block
            if self.source.progress is not None:
                self.source.progress(self.bytes_read, self.source.size)

    def converts(self, column: int) -> bool:
        """Return whether a column of temperatures states another unit than °C, which its values then get."""
        return spelt(self.unit(column) or "°C") in {*TEMPERATURES} - {"°C"}

    def _converted(self, block: LogBlock, time: int | None, temperatures: Collection[int]) -> LogBlock:
        """Return a block with its times in seconds and its temperatures in °C."""
        values = dict(block.values)
        for index in filter(self.converts, temperatures):
            per_degree, zero = TEMPERATURES[spelt(str(self.unit(index)))]
            values[index] = (values[index] - zero) * per_degree
            self._say_unit(index, str(self.unit(index)), "°C")
        if time is not None:
            values[time], unit, by = self.clock.seconds(values[time], block.times, self.unit(time), self.name)
            if unit not in (None, "s"):
                self._say_unit(time, str(unit), "seconds", by)
        return replace(block, values=values)

    def _say_unit(self, column: int, unit: str, used: str, by: str = "its name") -> None:
        said = f"column {self.names[column]!r} is in {unit}, by {by}: {used} are used inside"
        self.remarks += [said] * (said not in self.remarks)

    @abstractmethod
    def _blocks(self, columns: Sequence[int], time: int | None, frames: bool) -> Iterator[LogBlock]: ...

    def _values(self, column: pl.Series, index: int, time: int | None) -> Array:
        """Return a column that has a type as numbers, or as seconds where it is that of the time."""
        values = column_seconds(column) if index == time else column_numbers(column)
        if values is None:
            why = f"column {self.names[index]!r} holds {column.dtype}, not numbers: name another, or make numbers of it"
            raise InputError(why, file=self.name)
        return values

    def _row_error(self, why: str, row: int) -> InputError:
        """Return what is wrong with a row, counted from 0."""
        return InputError(f"row {row}: {why}", file=self.name)

    def has_times(self, name: str, beside: int) -> bool:
        """Return whether there is a column of this name that may be read as times of the rows of another column."""
        return name in self.names

    def unit(self, column: int) -> str | None:
        """Return the unit of a column, here the one in its name; None where the log does not state it."""
        return split_unit(self.names[column])[1]

    def close(self) -> None:  # noqa: B027
        """Let go of what the format's library holds open; nothing where it holds nothing."""


@dataclass
class LogWriter(ABC):
    """The rows of a log on their way out to ``sink``, with the ``added`` columns behind their own.

    ``origin`` is what these were made with: ``software``, ``calibration``, ...; ``units`` has the unit of those that
    have that of a column of the log, None where that one states none; ``frames``: blocks must have columns with types.
    """

    sink: BinaryIO
    log: LogReader
    added: Sequence[str] = ()
    origin: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str | None] = field(default_factory=dict)
    frames: ClassVar[bool] = False

    @abstractmethod
    def write(self, blocks: Iterable[tuple[LogBlock, Table]]) -> None:
        """Write a row for each row of the log's own blocks, in order, with the columns that belong behind theirs.

        UsageError: the format has no place for what a column holds.
        OSError: the disk is full.
        """
