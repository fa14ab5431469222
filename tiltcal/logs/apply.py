"""A log on its way through the compensation, block after block: one way for every format."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tiltcal.core.compensation import FLAGS, REASONS
from tiltcal.core.overview import count_flags
from tiltcal.errors import UsageError
from tiltcal.logs.column_widths import ColumnWidths
from tiltcal.logs.columns import TEMPERATURE
from tiltcal.logs.log import AnyLogBlock, Log

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiltcal.core.model import Array
    from tiltcal.logs.csv_writer import Table


class Flagged(Protocol):
    """What a kernel makes of some rows."""

    @property
    def flag(self) -> NDArray[np.uint8]: ...

    @property
    def reason(self) -> NDArray[np.uint8]: ...


class Kernel(Protocol):
    """What compensates rows: of a tilt sensor, or of pairs of accelerometers."""

    @property
    def columns(self) -> tuple[str, ...]: ...

    def __call__(self, readings: Array, temperature: Array | None = None) -> Flagged: ...

    def table(self, apply_blocks: Any, /) -> Table: ...


@dataclass
class ApplySummary:
    """What came out of a log.

    Attributes
    ----------
    rows : int
        Written, every one that was read.
    flags : Counter
        Rows by flag.
    reasons : Counter
        Rows by bit of the reason; a row may have several.
    bad_rows : int
        Rows that could not be parsed and were kept as missing.
    widths : dict of str to ColumnWidths
        The columns that were to be watched, half widths of 95 % intervals in degrees.
    """

    rows: int = 0
    flags: Counter[int] = field(default_factory=Counter)
    reasons: Counter[int] = field(default_factory=Counter)
    bad_rows: int = 0
    widths: dict[str, ColumnWidths] = field(default_factory=dict)

    @classmethod
    def watching(cls, columns: Sequence[str]) -> ApplySummary:
        """One that keeps the median and the largest value of some columns of the result."""
        return cls(widths={name: ColumnWidths() for name in columns})

    def add(self, flag: NDArray[np.uint8], reason: NDArray[np.uint8], bad_rows: int, table: Table) -> None:
        """Count some rows."""
        for name, widths in self.widths.items():
            widths.add(np.asarray(table[name], dtype=float))
        self.rows += len(flag)
        self.bad_rows += bad_rows
        count_flags(self.flags, self.reasons, flag, reason)

    def as_data(self) -> dict[str, object]:
        """The counts as plain data, every flag and reason that occurred."""
        widths = {name: {"median": one.median, "largest": one.largest} for name, one in self.widths.items()}
        return {
            "rows": self.rows,
            "flags": {str(flag): self.flags[flag] for flag in FLAGS if self.flags[flag]},
            "reasons": {str(bit): self.reasons[bit] for bit in REASONS if self.reasons[bit]},
            "bad_rows": self.bad_rows,
            **({"uncertainty": widths} if widths else {}),
        }

    def as_text(self) -> str:
        """The counts in words, one line for each."""
        lines = [_counted(self.rows, "row")]
        lines += [f"  flag {flag} {name}: {self.flags[flag]}" for flag, name in FLAGS.items() if self.flags[flag]]
        lines += [f"  reason {bit} {why}: {self.reasons[bit]}" for bit, why in REASONS.items() if self.reasons[bit]]
        if self.bad_rows:
            lines.append(f"  {_counted(self.bad_rows, 'row')} could not be parsed and kept as missing")
        if self.widths:
            lines.append(f"  median (largest) {', '.join(_told(name, one) for name, one in self.widths.items())}")
        return "\n".join(lines)


def apply_blocks(
    log: Log[AnyLogBlock],
    kernel: Kernel,
    channels: Sequence[str],
    columns: Mapping[str, int],
    summary: ApplySummary,
    progress: Callable[[int], None] | None = None,
) -> Iterator[tuple[AnyLogBlock, Table]]:
    """A log's rows with what a kernel makes of them.

    Parameters
    ----------
    log : Log
    kernel : Kernel
        Called with the rows in order, block after block.
    channels : sequence of str
        The readings, in the order of the calibration.
    columns : mapping of str to int
        Where each channel and, if there is one, the temperature stands in the log.
    summary : ApplySummary
        Told of every row.
    progress : callable, optional
        Told how many bytes of the log have been read.

    Returns
    -------
    iterator of (Block, mapping of str to ndarray)
        The log's own blocks, in order, and the columns that belong behind theirs.

    Raises
    ------
    UsageError
        The log has a column of a name that the result needs.
    InputError
        A row cannot be parsed, or the log is damaged; once the iterator comes to it.
    """
    taken = [name for name in kernel.columns if name in log.names]
    if taken:
        raise UsageError(
            f"the log has a column {taken[0]!r} already: rename it, or apply to the log as it was recorded"
        )
    return _compensated(log, kernel, channels, columns, summary, progress)


def _compensated(
    log: Log[AnyLogBlock],
    kernel: Kernel,
    channels: Sequence[str],
    columns: Mapping[str, int],
    summary: ApplySummary,
    progress: Callable[[int], None] | None,
) -> Iterator[tuple[AnyLogBlock, Table]]:
    for rows in log.rows(sorted(set(columns.values()))):
        readings = np.stack([rows.values[columns[channel]] for channel in channels]).T
        readings[list(rows.faults)] = np.nan
        temperature = rows.values[columns[TEMPERATURE]] if TEMPERATURE in columns else None
        result = kernel(readings, temperature)
        table = kernel.table(result)
        summary.add(result.flag, result.reason, len(rows.faults), table)
        yield rows, table
        if progress is not None:
            progress(log.bytes_read)


def _told(name: str, widths: ColumnWidths) -> str:
    if widths.median is None or widths.largest is None:
        return f"{name} none"
    return f"{name} {widths.median:.2g}° ({widths.largest:.2g}°)"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"
