"""The tasks of ``tiltcal apply``: one log each, run in the processes of this machine or on a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiltcal.cli.talk import progress_bar
from tiltcal.errors import InputError, TiltcalError, UsageError
from tiltcal.files.atomic import require_apart
from tiltcal.logs.apply import apply_log
from tiltcal.logs.apply_summary import ApplySummary
from tiltcal.logs.log import Progress
from tiltcal.logs.prepared_calibration import ApplyOptions
from tiltcal.logs.streams import STANDARD
from tiltcal.logs.up_to_date import fingerprint, note_applied, summary_if_current

if TYPE_CHECKING:
    from distributed import Future

WORTH_PROCESSES = 16 << 20
"""Total size of logs from which further processes take less time than they take to start, bytes."""

_PATIENCE = "10s"
"""Timeout for the connection to the scheduler."""


@dataclass(frozen=True)
class ApplyTask:
    """One log with its options and output, each a file or ``-``; ``columns`` is the text of ``--columns``."""

    calibration: Path
    options: ApplyOptions
    log: str
    output: str
    columns: str = ""
    skip_bad_rows: bool = False

    @property
    def anywhere(self) -> ApplyTask:
        """Return the task with absolute paths, for a worker in another folder."""
        return replace(
            self,
            calibration=self.calibration.absolute(),
            log=os.path.abspath(self.log),
            output=os.path.abspath(self.output),
        )

    @property
    def made_of(self) -> str | None:
        """The checksum of all that decides the result."""
        decisive = {name: value for name, value in asdict(self).items() if name not in ("calibration", "log", "output")}
        return fingerprint(self.log, self.calibration, decisive)

    def run(self, say: Callable[[str], None] = lambda line: None, progress: Progress | None = None) -> ApplySummary:
        """Compensate the log; ``say`` is called with each remark about an assumption."""
        return apply_log(
            self.calibration,
            self.log,
            self.output,
            columns=self.columns,
            skip_bad_rows=self.skip_bad_rows,
            say=say,
            progress=progress,
            **asdict(self.options),
        )


@dataclass(frozen=True)
class UpToDate:
    """A result that was there already, made of the same log and calibration with the same options and version."""

    summary: dict[str, Any]

    def as_data(self) -> dict[str, object]:
        """Return the summary of the run that made the result."""
        return {**self.summary, "up_to_date": True}

    def __str__(self) -> str:
        """Return what is said in place of a summary."""
        return "up to date, skipped (--force processes it again)"


Outcome = ApplySummary | UpToDate | TiltcalError


def tasks_of(
    calibration: Path, options: ApplyOptions, logs: Sequence[str], folder: str, **more: Any
) -> list[ApplyTask]:
    """Return a task for each of several logs, whose results go into a folder under the logs' own names.

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
        require_apart(output, log, calibration)
        tasks[name] = ApplyTask(calibration, options, log, output, **more)
    return list(tasks.values())


def done_here(
    tasks: Sequence[ApplyTask], jobs: int | None = None, force: bool = False
) -> Iterator[tuple[ApplyTask, Outcome]]:
    """Run the tasks; yield each with its summary or its error.

    Parameters
    ----------
    jobs : int, optional
        How many run at a time, each in a process of its own, in place of one on each processor core; small logs run
        one after another in this process.
    """
    sizes = {task.log: os.path.getsize(task.log) if os.path.isfile(task.log) else 0 for task in tasks}
    if jobs != 1 and len(tasks) > 1 and sum(sizes.values()) > WORTH_PROCESSES:
        with progress_bar("apply") as progress:
            done = 0
            for task, outcome in _done_by_processes(tasks, jobs, force):
                done += sizes[task.log]
                if progress is not None:
                    progress(done, sum(sizes.values()))
                yield task, outcome
        return
    for task in tasks:
        with progress_bar("apply") as progress:
            outcome = _outcome(task, force, progress)
        yield task, outcome


def _done_by_processes(
    tasks: Sequence[ApplyTask], jobs: int | None, force: bool
) -> Iterator[tuple[ApplyTask, Outcome]]:
    """Run the tasks in processes; a file whose library ends its process is an error of this file alone."""
    from concurrent.futures import as_completed
    from concurrent.futures.process import BrokenProcessPool

    from tiltcal.cli.worker_processes import processor_cores, worker_processes

    jobs = jobs or processor_cores()
    left = list(tasks)
    while left:
        lost = set()
        with worker_processes(min(jobs, len(left))) as pool:
            running = {pool.submit(_outcome, task, force): task for task in left}
            for future in as_completed(running):
                try:
                    yield running[future], future.result()
                except BrokenProcessPool:
                    lost.add(running[future].output)
        # The tasks begin in their order, so that the one that ended its process is among the first that are left.
        left = [task for task in left if task.output in lost]
        suspects, left = left[: jobs + 1], left[jobs + 1 :]
        for task in suspects:
            with worker_processes(1) as pool:
                try:
                    yield task, pool.submit(_outcome, task, force).result()
                except BrokenProcessPool:
                    yield (
                        task,
                        InputError(f"{task.log} cannot be read: its library ended the process; the file is damaged"),
                    )


def done_on(scheduler: str, tasks: Sequence[ApplyTask], force: bool = False) -> Iterator[tuple[ApplyTask, Outcome]]:
    """Run the tasks on the workers of a dask scheduler, which must see the same files; yield each when it is done.

    The task of a worker that is lost runs again on another; its output appears whole or not at all.

    Raises
    ------
    UsageError
        The library is not there, or no scheduler.
    """
    import logging

    try:
        from distributed import Client, as_completed
    except ImportError as failure:
        raise UsageError(f"--scheduler needs dask.distributed ({failure}): pip install 'tiltcal[cluster]'") from failure
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # each log reports what happened to it
    try:
        client = Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError) as failure:
        raise UsageError(f"--scheduler: no scheduler answers at {scheduler}: {failure}") from failure
    with client:
        # Every log is work of its own, whatever an earlier one of that name came to.
        running = {client.submit(_outcome, task.anywhere, force, pure=False): task for task in tasks}
        for future in as_completed(list(running)):
            yield running[future], _result(future)


def _outcome(task: ApplyTask, force: bool, progress: Progress | None = None) -> Outcome:
    try:
        made_of = task.made_of
    except OSError:  # apply_log reports it
        made_of = None
    try:
        if made_of is not None and not force and (known := summary_if_current(task.output, made_of)) is not None:
            return UpToDate(known)
        summary = task.run(progress=progress)
    except TiltcalError as refusal:
        return refusal
    if made_of is not None:
        note_applied(task.output, made_of, summary.as_data())
    return summary


def _result(future: Future[Outcome]) -> Outcome:
    """Return the answer of a worker; a worker without tiltcal, or a lost one, is an error of its log alone."""
    from concurrent.futures import CancelledError

    try:
        return future.result()
    except CancelledError:
        return UsageError("the scheduler was lost before its turn: start one, and repeat the command for what is left")
    except Exception as failure:
        return UsageError(f"its worker failed: {failure!r}")
