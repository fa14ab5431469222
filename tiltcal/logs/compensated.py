"""A log on its way through the compensation: read rows, compensate, write rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

import numpy as np

from tiltcal.core.compensate import FLAGS, REASONS
from tiltcal.core.overview import count_flags
from tiltcal.errors import UsageError
from tiltcal.logs.columns import TEMPERATURE
from tiltcal.logs.widths import Widths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiltcal.core.model import Array
    from tiltcal.logs.csv_log import CsvLog
    from tiltcal.logs.csv_rows import Rows


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

    def table(self, compensated: Any, /) -> Mapping[str, NDArray[np.float64] | NDArray[np.uint8]]: ...


@dataclass
class Summary:
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
    widths : dict of str to Widths
        The columns that were to be watched, half widths of 95 % intervals in degrees.
    """

    rows: int = 0
    flags: Counter[int] = field(default_factory=Counter)
    reasons: Counter[int] = field(default_factory=Counter)
    bad_rows: int = 0
    widths: dict[str, Widths] = field(default_factory=dict)

    def add(self, flag: NDArray[np.uint8], reason: NDArray[np.uint8], bad_rows: int) -> None:
        """Count some rows."""
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


def compensate_log(
    log: CsvLog,
    sink: BinaryIO,
    compensation: Kernel,
    channels: Sequence[str],
    columns: Mapping[str, int],
    progress: Callable[[int], None] | None = None,
    watched: Sequence[str] = (),
) -> Summary:
    """Write a log's rows with the compensated columns behind their own.

    Parameters
    ----------
    log : CsvLog
        Its columns pass through byte for byte.
    sink : BinaryIO
        Takes the header and one row for each row of the log, in order.
    compensation : Kernel
        Called with the rows in order, block after block.
    channels : sequence of str
        The readings, in the order of the calibration.
    columns : mapping of str to int
        Where each channel and, if there is one, the temperature stands in the log.
    progress : callable, optional
        Told how many bytes of the log have been read.
    watched : sequence of str
        Columns of the result whose median and largest value belong in the summary.

    Returns
    -------
    Summary

    Raises
    ------
    UsageError
        The log has a column of a name that the result needs.
    InputError
        See :class:`CsvLog`.
    """
    taken = [name for name in compensation.columns if name in log.names]
    if taken:
        raise UsageError(
            f"the log has a column {taken[0]!r} already: rename it, or apply to the log as it was recorded"
        )
    summary = Summary(widths={name: Widths() for name in watched})
    # One block is written while the next is read and compensated; a single writer keeps the order.
    with ThreadPoolExecutor(max_workers=1) as writer:
        added = f",{','.join(compensation.columns)}{log.line_end}".encode()
        written: Future[object] | None = None
        for rows in log.rows(sorted(set(columns.values()))):
            readings = np.stack([rows.values[columns[channel]] for channel in channels]).T
            readings[list(rows.faults)] = np.nan
            temperature = rows.values[columns[TEMPERATURE]] if TEMPERATURE in columns else None
            result = compensation(readings, temperature)
            if written is None:
                sink.write(log.header + added)
            else:
                written.result()
            table = compensation.table(result)
            written = writer.submit(_write, sink, rows, table, log.line_end)
            summary.add(result.flag, result.reason, len(rows.faults))
            for name, widths in summary.widths.items():
                widths.add(np.asarray(table[name], dtype=float))
            if progress is not None:
                progress(log.bytes_read)
        if written is not None:
            written.result()
    return summary


def _write(
    sink: BinaryIO, rows: Rows, table: Mapping[str, NDArray[np.float64] | NDArray[np.uint8]], line_end: str
) -> None:
    """The rows' own text and the columns behind it."""
    import polars as pl

    text = BytesIO()
    frame = pl.DataFrame({"": rows.lines, **table})
    frame.write_csv(text, include_header=False, quote_style="never", line_terminator=line_end)
    sink.write(text.getbuffer() if rows.encoding == "utf-8" else text.getvalue().decode().encode(rows.encoding))


def _told(name: str, widths: Widths) -> str:
    if widths.median is None or widths.largest is None:
        return f"{name} none"
    return f"{name} {widths.median:.2g}° ({widths.largest:.2g}°)"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"
