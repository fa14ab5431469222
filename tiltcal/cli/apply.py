"""``tiltcal apply``: compensate a recorded log."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import TYPE_CHECKING, BinaryIO, cast

import click

from tiltcal.errors import EstimateError, InputError, UsageError

if TYPE_CHECKING:
    from tiltcal.core.model import Limits
    from tiltcal.files.calibration import Calibration

_STANDARD = "-"
_SPOOL = 64 << 20  # bytes of a result for standard output that stay in memory
_LATER = (".parquet", ".nc")

_EXAMPLE = """\b
Examples:
  tiltcal apply S-0042.yaml night.csv -o night-tilt.csv
  tiltcal apply S-0042.yaml night.csv --columns x=VoutX,y=VoutY,temperature=T -o night-tilt.csv
  zcat night.csv.gz | tiltcal apply S-0042.yaml - | gzip > night-tilt.csv.gz
"""


@click.command(epilog=_EXAMPLE)
@click.argument("calibration", type=click.Path(path_type=Path))
@click.argument("log")
@click.option("-o", "--output", default=_STANDARD, metavar="OUT", help="File to write; standard output by default.")
@click.option(
    "--columns",
    default="",
    metavar="ROLE=NAME,…",
    help="Which column holds which reading, such as x=VoutX,y=VoutY,temperature=T.",
)
@click.option(
    "--skip-bad-rows", is_flag=True, help="Keep rows that cannot be parsed, with flag 9, instead of stopping."
)
@click.option("--first-order", is_flag=True, help="Use Cross-axis Compensation eq. 6 instead of the whole matrix.")
@click.option("--json", "as_json", is_flag=True, help="Summary as JSON: on stdout, or on stderr if the rows go there.")
def command(
    calibration: Path, log: str, output: str, columns: str, skip_bad_rows: bool, first_order: bool, as_json: bool
) -> None:
    """Turn the raw readings of LOG into tilt with quality flags.

    LOG is CSV with a header, or - for standard input. Its columns are kept as they are; behind them come g_x and
    tilt_x in degrees for each axis (with three axes also pitch, roll and inclination), and flag and reason. flag: 1
    pass, 3 suspect, 4 fail, 9 missing. reason adds up: 1 arcsine argument beyond ±1, 2 temperature outside the
    calibrated range, 4 reading at the rail, 8 tilt outside the calibrated range, 16 temperature missing, 32 not a
    number. The output appears whole or not at all, on standard output too.
    """
    from tiltcal.core.compensate import Compensation
    from tiltcal.files.calibration import read_calibration
    from tiltcal.logs.columns import locate_columns, parse_columns
    from tiltcal.logs.compensated import compensate_log
    from tiltcal.logs.csv_log import CsvLog

    for name in (log, output):
        if name.lower().endswith(_LATER):
            raise UsageError(f"{name}: logs are CSV for now; convert it to CSV first")
    known = read_calibration(calibration)
    channels = known.coefficients.channels
    named = parse_columns(columns, channels)
    try:
        compensation = Compensation(known.coefficients, _with_rails(known), first_order=first_order)
    except EstimateError as failure:
        raise InputError(str(failure), file=calibration) from failure
    with _source(log) as (stream, name, size), _sink(output) as sink, _progress(size) as progress:
        rows = CsvLog(stream, name=name, skip_bad_rows=skip_bad_rows)
        located = locate_columns(rows.names, channels, named, file=name)
        summary = compensate_log(rows, sink, compensation, channels, located, progress)
    if as_json:
        click.echo(json.dumps(summary.as_data()), err=output == _STANDARD)
    else:
        click.echo(summary.as_text(), err=True)


def _with_rails(calibration: Calibration) -> Limits:
    """The calibration's limits, with the rails of its model where the file itself names none."""
    from tiltcal.drivers import find_model

    limits, sensor = calibration.limits, calibration.sensor
    if limits.reading:
        return limits
    try:
        model = find_model(sensor.model)
    except UsageError:
        return limits  # a model that nobody knows has no rails that anybody knows
    if model.unit != sensor.unit:
        return limits
    return replace(limits, reading=dict.fromkeys(sensor.channels, model.rails))


@contextmanager
def _source(log: str) -> Iterator[tuple[BinaryIO, str, int | None]]:
    """The log's bytes, what to call it in messages, and its size where it has one."""
    if log == _STANDARD:
        yield sys.stdin.buffer, "standard input", None
        return
    try:
        stream = open(log, "rb")  # noqa: SIM115 (only what opening raises is about opening)
    except OSError as failure:
        raise UsageError(f"cannot read {log}: {failure.strerror}") from failure
    with stream:
        yield stream, log, os.fstat(stream.fileno()).st_size or None


@contextmanager
def _sink(output: str) -> Iterator[BinaryIO]:
    """Where the rows go, all of them or none."""
    if output != _STANDARD:
        from tiltcal.files.whole import whole_file

        with whole_file(output) as stream:
            yield stream
        return
    with SpooledTemporaryFile(_SPOOL) as spool:
        yield cast("BinaryIO", spool)
        spool.seek(0)
        stdout = sys.stdout.buffer
        shutil.copyfileobj(spool, stdout)
        stdout.flush()


@contextmanager
def _progress(size: int | None) -> Iterator[Callable[[int], None] | None]:
    """A bar for a person who watches; nothing for a program."""
    if size is None or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("apply", total=size)
        yield lambda done: bar.update(task, completed=done)
