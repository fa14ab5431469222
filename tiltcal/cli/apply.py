"""``tiltcal apply``: compensate recorded logs, one after another, or one task each on the workers of a cluster."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tiltcal.cli import options
from tiltcal.cli.talk import in_options, progress_bar, remark, talk, unforeseen
from tiltcal.errors import InputError, TiltcalError, UsageError
from tiltcal.extras import how_to_add
from tiltcal.files.atomic import require_apart
from tiltcal.logs.options import ApplyOptions
from tiltcal.options import complete

if TYPE_CHECKING:
    from tiltcal.logs.apply import ApplySummary

    Outcome = tuple[Sequence[str], ApplySummary | TiltcalError]  # the remarks on a log, and its summary or its error

_PATIENCE = "5s"  # for the connection to the scheduler
_EXAMPLE = """\b
Examples:
  tiltcal apply S-0042.yaml night.csv --uncertainty -o night-tilt.csv
  tiltcal apply S-0042.yaml may-*.parquet -o tilt
  tiltcal apply --calibrations calibrations night.csv --serial S-0042 -o night-tilt.csv
  tiltcal apply S-0042.yaml dive.csv --magnetometer mx,my,mz --velocity u,v,w -o currents.csv
  zcat night.csv.gz | tiltcal apply S-0042.yaml - --every 10s | gzip > night-tilt.csv.gz
"""


@options.command(epilog=_EXAMPLE)
@click.argument("files", metavar="CALIBRATION LOG...", nargs=-1, required=True)
@click.option("-o", "--output", default="-", metavar="OUT", help="The file to write [standard output], or the folder.")
@click.option(
    "--calibrations",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    cls=options.Grouped,
    group="Calibrations over time",
    help="A folder in place of CALIBRATION: each row takes those of its time.",
)
@options.topic
@options.declared(ApplyOptions)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    cls=options.Grouped,
    group="Further options",
    help="Process each log on a worker of this dask scheduler.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON (beside rows, on stderr).")
def command(
    files: tuple[str, ...], calibrations: Path | None, output: str, scheduler: str | None, as_json: bool,
    topic: str | None, **how: Any,
) -> int:  # fmt: skip
    """Convert the raw readings of LOG to tilt with quality flags.

    LOG is CSV, Parquet, NetCDF-4, a bag of ROS, or - for CSV on standard input; OUT's name is its format. OUT has the
    columns of LOG, g_x and tilt_x (degrees) of each axis, pitch, roll and inclination of three axes, of pairs the
    matched sums and the gradient; flag (1 pass, 3 suspect, 4 fail, 9 missing), and reason, a sum: 1 arcsine beyond ±1,
    2 temperature and 8 tilt outside the calibrated range, 4 at the rail, 16 no temperature, 32 not a number, 64 outside
    the time of the calibrations, 128 no direction or field of unusual length, 256 gravity is not 1 g. Of several logs,
    into the folder OUT, one that fails is named. A damaged NetCDF-4 or Parquet log may keep a library busy until
    Ctrl-C, or end the command: its name is the last one printed, and the outputs before it are whole.
    """
    from tiltcal.library.recorded import apply_log
    from tiltcal.logs.apply import prepare_any

    calibration, logs = (Path(files[0]), files[1:]) if calibrations is None else (calibrations, files)
    logs = tuple(options.of_topic(log, topic) for log in logs)
    if not logs:
        raise UsageError(f"no LOG is given behind {calibration}; see `tiltcal apply --help`")
    if calibrations is not None and len(logs) > 1:
        from tiltcal.files.calibration_folder import SUFFIXES

        if logs[0].lower().endswith(SUFFIXES):
            raise UsageError(f"{logs[0]} is a calibration, and --calibrations names a folder of them: leave one out")
    if len(logs) > 1 or scheduler is not None or os.path.isdir(output):
        outputs = _outputs_in(output, logs, calibration)
        said: list[str] = []  # remarks on the calibration, or an error of it, come once
        prepare_any(calibration, complete(ApplyOptions, {**how, "say": said.append}))
        for text in said:
            remark(text)
        if scheduler is not None:
            outcomes = _applied_on(scheduler, calibration, outputs, how)
        else:
            outcomes = ((log, _outcome(calibration, log, output, how, shown=True)) for log, output in outputs.items())
        return _reported(outputs, outcomes, said, as_json)
    with progress_bar("apply") as progress:
        summary = apply_log(calibration, logs[0], output, say=remark, progress=progress, **how)
    if as_json:
        (talk if output == "-" else click.echo)(options.json_text(summary.as_data()))
    else:
        remark(str(summary))
    return 0


def _outputs_in(folder: str, logs: Sequence[str], calibration: Path) -> dict[str, str]:
    """Return the output of each log: a file of its name in a folder, which replaces neither log nor calibration."""
    if folder == "-" or os.path.isfile(folder):
        raise UsageError(f"several logs need a folder for their results: name one with -o, not {folder}")
    if "-" in logs:
        raise UsageError("standard input is one log: leave the others out")
    logs_of: dict[str, str] = {}
    for log in logs:
        output = os.path.join(folder, Path(log).name)
        if (other := logs_of.setdefault(output, log)) != log or logs.count(log) > 1:
            raise UsageError(f"{other} and {log} would both be {output}: apply to them one by one")
        require_apart(output, log, calibration)
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError as failure:
        raise UsageError(f"the folder {folder} cannot be made: {failure.strerror}") from failure
    return {log: output for output, log in logs_of.items()}


def _reported(
    outputs: Mapping[str, str], outcomes: Iterator[tuple[str, Outcome]], said: Sequence[str], as_json: bool
) -> int:
    """Report what became of each of several logs, and raise an error at the end if one failed."""
    done = {}
    for log, (remarks, outcome) in outcomes:
        for text in remarks:
            if text not in said:
                remark(f"{log}: {text}")
        if isinstance(outcome, TiltcalError):
            remark(f"{log} failed and is left out: {in_options(outcome)}")
            continue
        done[log] = {"output": outputs[log], **outcome.as_data()}
        if not as_json:
            remark(f"{outputs[log]}: {outcome}")
    if as_json:
        options.print_judged(options.json_text({"logs": {log: done[log] for log in outputs if log in done}}))
    if len(done) < len(outputs):
        rest = "; the others are written" if done else ""
        raise InputError(f"{len(outputs) - len(done)} of {len(outputs)} logs failed{rest}")
    return 0


def _applied_on(
    scheduler: str, calibration: Path, outputs: Mapping[str, str], how: Mapping[str, Any]
) -> Iterator[tuple[str, Outcome]]:
    """Apply a calibration on the workers of a dask scheduler, which must see the same files; yield what is done.

    The task of a worker that is lost runs again on another; its output appears whole or not at all.
    """
    import logging
    from concurrent.futures import CancelledError

    try:
        from distributed import Client, as_completed
    except ImportError as failure:
        raise UsageError(
            f"--scheduler needs dask.distributed ({failure}): {how_to_add('tiltcal[cluster]')}"
        ) from failure
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # each log reports what happened to it
    try:
        client = Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError) as failure:
        raise UsageError(f"--scheduler: no scheduler answers at {scheduler}: {failure}") from failure
    with client:
        # A worker may run in another folder; every log is work of its own, whatever an earlier one of its name came to.
        running = {
            client.submit(_outcome, calibration.absolute(), *map(os.path.abspath, paths), how, pure=False): paths[0]
            for paths in outputs.items()
        }
        for future in as_completed(list(running)):
            try:
                yield running[future], future.result()
            except CancelledError:
                why = "the scheduler was lost before its turn: start one, and repeat the command for what is left"
                yield running[future], ((), UsageError(why))
            except Exception as failure:  # a worker without tiltcal is an error of its log alone
                yield running[future], ((), UsageError(f"its worker failed: {failure!r}"))


def _outcome(calibration: Path, log: str, output: str, how: Mapping[str, Any], *, shown: bool = False) -> Outcome:
    """Apply a calibration to one log of several; where ``shown`` with a bar of progress."""
    from contextlib import nullcontext

    from tiltcal.library.recorded import apply_log

    remarks: list[str] = []
    try:
        with progress_bar("apply") if shown else nullcontext() as progress:
            return remarks, apply_log(calibration, log, output, say=remarks.append, progress=progress, **how)
    except TiltcalError as refusal:
        return remarks, refusal
    except BaseException as failure:
        return remarks, unforeseen(failure, log)
