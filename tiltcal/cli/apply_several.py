"""``tiltcal apply`` to several logs, one after another, or one task each on the workers of a cluster."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiltcal.cli.talk import progress_bar
from tiltcal.cli.unforeseen import unforeseen
from tiltcal.errors import TiltcalError, UsageError
from tiltcal.files.atomic import require_apart
from tiltcal.library.apply import apply_log
from tiltcal.logs.apply_summary import ApplySummary
from tiltcal.logs.log import Progress
from tiltcal.logs.streams import STANDARD

if TYPE_CHECKING:
    from distributed import Future

Outcome = tuple[Sequence[str], ApplySummary | TiltcalError]
"""The remarks on a log, and its summary or its error."""

_PATIENCE = "10s"  # for the connection to the scheduler


def outputs_in(folder: str, logs: Sequence[str], calibration: Path) -> dict[str, str]:
    """Return the output of each log: a file of its name in a folder, which replaces neither log nor calibration."""
    if not os.path.isdir(folder):
        raise UsageError(f"several logs need a folder for their results: make one and name it with -o, not {folder}")
    if STANDARD in logs:
        raise UsageError("standard input is one log: leave the others out")
    logs_of: dict[str, str] = {}
    for log in logs:
        output = os.path.join(folder, Path(log).name)
        if (other := logs_of.setdefault(output, log)) != log or logs.count(log) > 1:
            raise UsageError(f"{other} and {log} would both be {output}: apply to them one by one")
        require_apart(output, log, calibration)
    return {log: output for output, log in logs_of.items()}


def applied_here(
    calibration: Path, outputs: Mapping[str, str], options: Mapping[str, Any]
) -> Iterator[tuple[str, Outcome]]:
    """Apply a calibration to one log after another; yield each with its outcome."""
    for log, output in outputs.items():
        with progress_bar("apply") as progress:
            outcome = _outcome(calibration, log, output, options, progress)
        yield log, outcome


def applied_on(
    scheduler: str, calibration: Path, outputs: Mapping[str, str], options: Mapping[str, Any]
) -> Iterator[tuple[str, Outcome]]:
    """Apply a calibration on the workers of a dask scheduler, which must see the same files; yield what is done.

    The task of a worker that is lost runs again on another; its output appears whole or not at all.
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
        # A worker may run in another folder; every log is work of its own, whatever an earlier one of its name came to.
        running = {
            client.submit(_outcome, calibration.absolute(), *map(os.path.abspath, paths), options, pure=False): paths[0]
            for paths in outputs.items()
        }
        for future in as_completed(list(running)):
            yield running[future], _answer(future)


def _outcome(
    calibration: Path, log: str, output: str, options: Mapping[str, Any], progress: Progress | None = None
) -> Outcome:
    remarks: list[str] = []
    try:
        return remarks, apply_log(calibration, log, output, say=remarks.append, progress=progress, **options)
    except TiltcalError as refusal:
        return remarks, refusal
    except BaseException as failure:
        return remarks, unforeseen(failure, log)


def _answer(future: Future[Outcome]) -> Outcome:
    """Return the answer of a worker; a worker without tiltcal, or a lost one, is an error of its log alone."""
    from concurrent.futures import CancelledError

    try:
        return future.result()
    except CancelledError:
        why = "the scheduler was lost before its turn: start one, and repeat the command for what is left"
    except Exception as failure:
        why = f"its worker failed: {failure!r}"
    return (), UsageError(why)
