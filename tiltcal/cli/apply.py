"""``tiltcal apply``: compensate a recorded log."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tiltcal.cli.log_files import STANDARD, log_sink, log_source, progress_bar
from tiltcal.errors import UsageError

if TYPE_CHECKING:
    from tiltcal.logs.compensated import Summary
    from tiltcal.logs.kernels import Applied

_EXAMPLE = """\b
Examples:
  tiltcal apply S-0042.yaml night.csv -o night-tilt.csv
  tiltcal apply S-0042.yaml night.csv --uncertainty -o night-tilt.csv
  tiltcal apply S-0042.yaml night.parquet -o night-tilt.parquet
  tiltcal apply S-0042.yaml night.csv --columns x=VoutX,y=VoutY,temperature=T -o night-tilt.csv
  zcat night.csv.gz | tiltcal apply S-0042.yaml - | gzip > night-tilt.csv.gz
"""


@click.command(epilog=_EXAMPLE)
@click.argument("calibration", type=click.Path(path_type=Path))
@click.argument("log")
@click.option("-o", "--output", default=STANDARD, metavar="OUT", help="File to write; standard output by default.")
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
@click.option("--json", "as_json", is_flag=True, help="Summary as JSON: on stdout, or on stderr if the rows go there.")
def command(
    calibration: Path,
    log: str,
    output: str,
    columns: str,
    skip_bad_rows: bool,
    first_order: bool,
    uncertainty: bool,
    reading_noise: float | None,
    as_json: bool,
) -> None:
    """Turn the raw readings of LOG into tilt with quality flags.

    LOG is CSV with a header, Parquet (.parquet, .pq), NetCDF-4 (.nc), or - for CSV on standard input. OUT has the
    format that its name says; a NetCDF log stays NetCDF. The log's columns are kept as they are; behind them come g_x
    and tilt_x in degrees for each axis (with three axes also pitch, roll and inclination), and flag and reason. flag: 1
    pass, 3 suspect, 4 fail, 9 missing. reason adds up: 1 arcsine argument beyond ±1, 2 temperature outside the
    calibrated range, 4 reading at the rail, 8 tilt outside the calibrated range, 16 temperature missing, 32 not a
    number. The output appears whole or not at all, on standard output too.

    With --uncertainty there come behind these, in degrees, u_tilt_x (standard uncertainty, k = 1) and U95_tilt_x (the
    truth is within tilt_x ± U95_tilt_x in 95 % of all cases) for every angle: from the calibration's covariance, the
    noise of a reading and the thermometer.

    Where CALIBRATION is of accelerometer pairs (from `tiltcal match`), the columns are the matched sum of each pair
    and, with both pairs, the gradient signal and its components at twice the turning, over the turn before.
    """
    from tiltcal.logs.kernels import Wish, applied

    if reading_noise is not None and not uncertainty:
        raise UsageError("--reading-noise is for --uncertainty, which is not there")
    known = applied(Wish(calibration, first_order, uncertainty, reading_noise), lambda line: click.echo(line, err=True))
    summary = _apply(known, log, output, columns, skip_bad_rows)
    if as_json:
        click.echo(json.dumps(summary.as_data()), err=output == STANDARD)
    else:
        click.echo(summary.as_text(), err=True)


def _apply(known: Applied, log: str, output: str, columns: str, skip_bad_rows: bool) -> Summary:
    """Compensate one log, from its door to where its rows go; both formats are told by the names."""
    from tiltcal.logs.columns import locate_columns, parse_columns
    from tiltcal.logs.compensated import Summary, compensated
    from tiltcal.logs.csv_log import CsvLog
    from tiltcal.logs.csv_table import CsvTable
    from tiltcal.logs.formats import is_parquet, log_of, require_way
    from tiltcal.logs.netcdf_log import NetcdfLog
    from tiltcal.logs.netcdf_written import write_netcdf
    from tiltcal.logs.written import write_csv, write_csv_of_types, write_parquet

    require_way(log, output)
    named = parse_columns(columns, known.channels)
    summary = Summary.watching(known.watched)
    added = known.kernel.columns
    with log_source(log) as (stream, name, size), progress_bar("apply", size) as progress:
        rows = log_of(stream, name, skip_bad_rows=skip_bad_rows)
        located = locate_columns(rows.names, known.channels, named, file=name, line=rows.header_line)
        needed = sorted(set(located.values()))
        way = (known.kernel, known.channels, located, summary, progress)
        with log_sink(output) as sink:
            if isinstance(rows, NetcdfLog):
                now = datetime.now(UTC)
                write_netcdf(sink, stream, rows, needed, added, compensated(rows, *way), known.origin, now)
            elif is_parquet(output):
                typed = CsvTable(rows, needed, name=name) if isinstance(rows, CsvLog) else rows
                write_parquet(sink, typed, added, compensated(typed, *way), {**typed.notes, **known.as_note})
            elif isinstance(rows, CsvLog):
                write_csv(sink, rows, added, compensated(rows, *way))
            else:
                write_csv_of_types(sink, rows, added, compensated(rows, *way))
    return summary
