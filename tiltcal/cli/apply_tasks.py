"""What ``tiltcal apply`` does to one log, and to several: one after another here, or each a task on a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiltcal.cli.log_files import STANDARD, log_sink, log_source, progress_bar
from tiltcal.errors import TiltcalError, UsageError
from tiltcal.logs.apply import ApplySummary, apply_blocks
from tiltcal.logs.columns import locate_columns, parse_columns
from tiltcal.logs.csv_log import CsvLog
from tiltcal.logs.csv_types import TypedCsvLog
from tiltcal.logs.csv_writer import write_csv, write_csv_of_types, write_parquet
from tiltcal.logs.formats import is_parquet, log_of, require_way
from tiltcal.logs.netcdf_log import NetcdfLog
from tiltcal.logs.netcdf_writer import write_netcdf
from tiltcal.logs.prepared import ApplyOptions, prepare

if TYPE_CHECKING:
    from distributed import Client, Future

_PATIENCE = "10s"
"""To reach the scheduler."""


@dataclass(frozen=True)
class ApplyTask:
    """One log and what is to be done to it.

    Attributes
    ----------
    wish : ApplyOptions
    log : str
        A file, or ``-``.
    output : str
        A file, or ``-``.
    columns : str
        What ``--columns`` says.
    skip_bad_rows : bool
    """

    wish: ApplyOptions
    log: str
    output: str
    columns: str = ""
    skip_bad_rows: bool = False

    @property
    def anywhere(self) -> ApplyTask:
        """The same, whatever folder a worker is in."""
        wish = replace(self.wish, calibration=self.wish.calibration.absolute())
        return replace(self, wish=wish, log=os.path.abspath(self.log), output=os.path.abspath(self.output))


Outcome = ApplySummary | TiltcalError


def apply_to_log(task: ApplyTask, say: Callable[[str], None] = lambda line: None) -> ApplySummary:
    """Compensate one log, from its door to where its rows go; both formats are told by the names.

    Parameters
    ----------
    task : ApplyTask
    say : callable
        Told what had to be taken for granted.
    """
    require_way(task.log, task.output)
    known = prepare(task.wish, say)
    named = parse_columns(task.columns, known.channels)
    summary = ApplySummary.watching(known.watched)
    added = known.kernel.columns
    with log_source(task.log) as (stream, name, size), progress_bar("apply", size) as progress:
        rows = log_of(stream, name, skip_bad_rows=task.skip_bad_rows)
        located = locate_columns(rows.names, known.channels, named, file=name, line=rows.header_line)
        needed = sorted(set(located.values()))
        way = (known.kernel, known.channels, located, summary, progress)
        with log_sink(task.output) as sink:
            if isinstance(rows, NetcdfLog):
                now = datetime.now(UTC)
                write_netcdf(sink, stream, rows, needed, added, apply_blocks(rows, *way), known.origin, now)
            elif is_parquet(task.output):
                typed = TypedCsvLog(rows, needed, name=name) if isinstance(rows, CsvLog) else rows
                write_parquet(sink, typed, added, apply_blocks(typed, *way), {**typed.notes, **known.as_note})
            elif isinstance(rows, CsvLog):
                write_csv(sink, rows, added, apply_blocks(rows, *way))
            else:
                write_csv_of_types(sink, rows, added, apply_blocks(rows, *way))
    return summary


def tasks_of(wish: ApplyOptions, logs: Sequence[str], folder: str, **more: Any) -> list[ApplyTask]:
    """A task for each of several logs, whose results go into a folder under the logs' own names.

    Raises
    ------
    UsageError
        There is no such folder, two logs have one name, or a result would replace its log.
    """
    if not os.path.isdir(folder):
        raise UsageError(f"several logs need a folder for their results: make one and name it with -o, not {folder}")
    tasks: dict[str, ApplyTask] = {}
    for log in logs:
        name = Path(log).name
        output = os.path.join(folder, name)
        if log == STANDARD:
            raise UsageError("standard input is one log: leave the others out")
        if name in tasks:
            raise UsageError(f"{tasks[name].log} and {log} would both be {output}: apply to them one by one")
        if os.path.realpath(output) == os.path.realpath(log):
            raise UsageError(f"{output} is the log itself: name another folder with -o")
        tasks[name] = ApplyTask(wish, log, output, **more)
    return list(tasks.values())


def done_here(tasks: Sequence[ApplyTask]) -> Iterator[tuple[ApplyTask, Outcome]]:
    """Each task with its summary, or with why it could not be done; one after another."""
    return ((task, _outcome(task)) for task in tasks)


def done_on(scheduler: str, tasks: Sequence[ApplyTask]) -> Iterator[tuple[ApplyTask, Outcome]]:
    """The same on the workers of a dask scheduler, as they come; they must see the same files.

    Parameters
    ----------
    scheduler : str
        Such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    UsageError
        The library is not there, or no scheduler.
    """
    with _cluster(scheduler) as client:
        from distributed import as_completed

        # Every log is work of its own, whatever an earlier one of that name came to.
        running = {client.submit(_outcome, task.anywhere, pure=False): task for task in tasks}
        for future in as_completed(list(running)):
            yield running[future], _result(future)


def _outcome(task: ApplyTask) -> Outcome:
    try:
        return apply_to_log(task)
    except TiltcalError as refusal:
        return refusal


def _result(future: Future[Outcome]) -> Outcome:
    """What a worker answers; where it has no tiltcal, or is gone, that is its log's failure alone."""
    try:
        return future.result()
    except Exception as failure:
        return UsageError(f"its worker failed: {failure!r}")


@contextmanager
def _cluster(scheduler: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError as failure:
        raise UsageError(f"--scheduler needs dask.distributed ({failure}): pip install 'tiltcal[cluster]'") from failure
    try:
        client = Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError) as failure:
        raise UsageError(f"--scheduler: no scheduler answers at {scheduler}: {failure}") from failure
    with client:
        yield client
