"""``tiltcal apply``: compensate a recorded log."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tiltcal.errors import InputError, TiltcalError, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tiltcal.cli.apply_tasks import ApplyTask

_EXAMPLE = """\b
Examples:
  tiltcal apply S-0042.yaml night.csv -o night-tilt.csv
  tiltcal apply S-0042.yaml night.csv --uncertainty -o night-tilt.csv
  tiltcal apply S-0042.yaml night.parquet -o night-tilt.parquet
  tiltcal apply S-0042.yaml night.csv --columns x=VoutX,y=VoutY,temperature=T -o night-tilt.csv
  tiltcal apply S-0042.yaml may-*.parquet -o tilt
  zcat night.csv.gz | tiltcal apply S-0042.yaml - | gzip > night-tilt.csv.gz
"""


@click.command(epilog=_EXAMPLE)
@click.argument("calibration", type=click.Path(path_type=Path))
@click.argument("logs", metavar="LOG...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    default="-",
    metavar="OUT",
    help="File to write, standard output by default; of several logs the folder, where each keeps its name.",
)
@click.option(
    "--columns",
    default="",
    metavar="ROLE=NAME,…",
    help="Which column holds which reading, such as x=VoutX,y=VoutY,temperature=T; in a log without a header by number "
    "from 1.",
)
@click.option(
    "--skip-bad-rows", is_flag=True, help="Keep rows that cannot be parsed, with flag 9, instead of stopping."
)
@click.option("--first-order", is_flag=True, help="Use Cross-axis Compensation eq. 6 instead of the whole matrix.")
@click.option(
    "--uncertainty",
    is_flag=True,
    help="Add for each angle its standard uncertainty, such as u_tilt_x, and half of its 95 % interval, U95_tilt_x.",
)
@click.option(
    "--reading-noise",
    type=click.FloatRange(0.0),
    metavar="UNIT",
    help="With --uncertainty: the standard uncertainty of a reading of LOG, in its unit, in place of that of a single "
    "sample at the bench; 0 for the uncertainty of the calibration alone.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Do each log on a worker of the dask scheduler there, such as tcp://10.0.0.1:8786; the workers must see the "
    "same files.",
)
@click.option("--json", "as_json", is_flag=True, help="Summary as JSON: on stdout, or on stderr if the rows go there.")
def command(
    calibration: Path,
    logs: tuple[str, ...],
    output: str,
    columns: str,
    skip_bad_rows: bool,
    first_order: bool,
    uncertainty: bool,
    reading_noise: float | None,
    scheduler: str | None,
    as_json: bool,
) -> int:
    """Turn the raw readings of LOG into tilt with quality flags.

    LOG is CSV with a header, Parquet (.parquet, .pq), NetCDF-4 (.nc), or - for CSV on standard input. OUT has the
    format that its name says; a NetCDF log stays NetCDF. The log's columns are kept as they are; behind them come g_x
    and tilt_x in degrees for each axis (with three axes also pitch, roll and inclination), and flag and reason. flag: 1
    pass, 3 suspect, 4 fail, 9 missing. reason adds up: 1 arcsine argument beyond ±1, 2 temperature outside the
    calibrated range, 4 reading at the rail, 8 tilt outside the calibrated range, 16 temperature missing, 32 not a
    number. The output appears whole or not at all, on standard output too.

    Several logs go one after another into the folder -o, or with --scheduler on the workers of a cluster, one task for
    each; one that cannot be done is named, and the others are done.

    With --uncertainty there come behind these, in degrees, u_tilt_x (standard uncertainty, k = 1) and U95_tilt_x (the
    truth is within tilt_x ± U95_tilt_x in 95 % of all cases) for every angle: from the calibration's covariance, the
    noise of a reading and the thermometer.

    Where CALIBRATION is of accelerometer pairs (from `tiltcal match`), the columns are the matched sum of each pair
    and, with both pairs, the gradient signal and its components at twice the turning, over the turn before.
    """
    from tiltcal.cli.apply_tasks import ApplyTask, tasks_of
    from tiltcal.logs.prepared import ApplyOptions, prepare_file

    if reading_noise is not None and not uncertainty:
        raise UsageError("--reading-noise is for --uncertainty, which is not there")
    options = ApplyOptions(first_order, uncertainty, reading_noise)
    if len(logs) > 1 or scheduler is not None or os.path.isdir(output):
        tasks = tasks_of(calibration, options, logs, output, columns=columns, skip_bad_rows=skip_bad_rows)
        prepare_file(calibration, options, _say)  # what is wrong with the calibration is wrong once
        return _each(tasks, scheduler, as_json)
    summary = ApplyTask(calibration, options, logs[0], output, columns, skip_bad_rows).run(_say)
    if as_json:
        click.echo(json.dumps(summary.as_data()), err=output == "-")
    else:
        _say(summary.as_text())
    return 0


def _each(tasks: Sequence[ApplyTask], scheduler: str | None, as_json: bool) -> int:
    """Do several logs, tell of each when it is done, and fail at the end where one could not be."""
    from tiltcal.cli.apply_tasks import done_here, done_on

    told = {}
    for task, outcome in done_here(tasks) if scheduler is None else done_on(scheduler, tasks):
        if isinstance(outcome, TiltcalError):
            _say(f"{task.log} is left out: {outcome}")
            continue
        told[task.log] = {"output": task.output, **outcome.as_data()}
        if not as_json:
            _say(f"{task.output}: {outcome.as_text()}")
    if as_json:
        click.echo(json.dumps({"logs": {task.log: told[task.log] for task in tasks if task.log in told}}))
    if len(told) < len(tasks):
        raise InputError(f"{len(tasks) - len(told)} of {len(tasks)} logs could not be done; the others are there")
    return 0


def _say(line: str) -> None:
    click.echo(line, err=True)
