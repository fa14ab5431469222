"""The tasks of ``tiltcal apply``: one log each, run one after another here or on a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiltcal.cli.progress import progress_bar
from tiltcal.errors import TiltcalError, UsageError
from tiltcal.logs.apply import apply_log
from tiltcal.logs.apply_summary import ApplySummary
from tiltcal.logs.prepared import ApplyOptions
from tiltcal.logs.streams import STANDARD

if TYPE_CHECKING:
    from distributed import Client, Future

_PATIENCE = "10s"
"""Timeout for the connection to the scheduler."""


@dataclass(frozen=True)
class ApplyTask:
    """One log with its options and output.

    Attributes
    ----------
    calibration : Path
        Its file.
    options : ApplyOptions
    log, output : str
        A file, or ``-``.
    columns : str
        The text of ``--columns``.
    skip_bad_rows : bool
    """

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

    def run(self, say: Callable[[str], None] = lambda line: None) -> ApplySummary:
        """Compensate the log; ``say`` is called with each remark about an assumption."""
        with progress_bar("apply") as progress:
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


Outcome = ApplySummary | TiltcalError


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
        if os.path.realpath(output) == os.path.realpath(log):
            raise UsageError(f"{output} is the log itself: name another folder with -o")
        tasks[name] = ApplyTask(calibration, options, log, output, **more)
    return list(tasks.values())


def done_here(tasks: Sequence[ApplyTask]) -> Iterator[tuple[ApplyTask, Outcome]]:
    """Run the tasks one after another; yield each with its summary or its error."""
    return ((task, _outcome(task)) for task in tasks)


def done_on(scheduler: str, tasks: Sequence[ApplyTask]) -> Iterator[tuple[ApplyTask, Outcome]]:
    """Run the tasks on the workers of a dask scheduler, which must see the same files; yield each when it is done.

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
        return task.run()
    except TiltcalError as refusal:
        return refusal


def _result(future: Future[Outcome]) -> Outcome:
    """Return the answer of a worker; a worker without tiltcal, or a lost one, is an error of its log alone."""
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
