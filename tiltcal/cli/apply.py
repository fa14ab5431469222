"""``tiltcal apply``: compensate a recorded log."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tiltcal.cli.log_files import STANDARD, log_sink, log_source, progress_bar, require_csv
from tiltcal.errors import EstimateError, InputError, UsageError

if TYPE_CHECKING:
    from tiltcal.core.angles import UncertainCompensation
    from tiltcal.core.compensate import Compensation
    from tiltcal.files.calibration import Calibration
    from tiltcal.logs.compensated import Kernel

_EXAMPLE = """\b
Examples:
  tiltcal apply S-0042.yaml night.csv -o night-tilt.csv
  tiltcal apply S-0042.yaml night.csv --uncertainty -o night-tilt.csv
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

    LOG is CSV with a header, or - for standard input. Its columns are kept as they are; behind them come g_x and
    tilt_x in degrees for each axis (with three axes also pitch, roll and inclination), and flag and reason. flag: 1
    pass, 3 suspect, 4 fail, 9 missing. reason adds up: 1 arcsine argument beyond ±1, 2 temperature outside the
    calibrated range, 4 reading at the rail, 8 tilt outside the calibrated range, 16 temperature missing, 32 not a
    number. The output appears whole or not at all, on standard output too.

    With --uncertainty there come behind these, in degrees, u_tilt_x (standard uncertainty, k = 1) and U95_tilt_x (the
    truth is within tilt_x ± U95_tilt_x in 95 % of all cases) for every angle: from the calibration's covariance, the
    noise of a reading and the thermometer.

    Where CALIBRATION is of accelerometer pairs (from `tiltcal match`), the columns are the matched sum of each pair
    and, with both pairs, the gradient signal and its components at twice the turning, over the turn before.
    """
    from tiltcal.logs.columns import locate_columns, parse_columns
    from tiltcal.logs.compensated import compensate_log
    from tiltcal.logs.csv_log import CsvLog

    require_csv(log, output)
    if reading_noise is not None and not uncertainty:
        raise UsageError("--reading-noise is for --uncertainty, which is not there")
    compensation, channels, watched = _kernel(calibration, first_order, uncertainty, reading_noise)
    named = parse_columns(columns, channels)
    with log_source(log) as (stream, name, size), log_sink(output) as sink, progress_bar("apply", size) as progress:
        rows = CsvLog(stream, name=name, skip_bad_rows=skip_bad_rows)
        located = locate_columns(rows.names, channels, named, file=name)
        summary = compensate_log(rows, sink, compensation, channels, located, progress, watched)
    if as_json:
        click.echo(json.dumps(summary.as_data()), err=output == STANDARD)
    else:
        click.echo(summary.as_text(), err=True)


def _kernel(
    path: Path, first_order: bool, uncertainty: bool, reading_noise: float | None
) -> tuple[Kernel, tuple[str, ...], tuple[str, ...]]:
    """The kernel for what a calibration file is of, a tilt sensor or pairs of accelerometers.

    Returns
    -------
    kernel : Kernel
    channels : tuple of str
        The readings that it takes.
    watched : tuple of str
        The columns to be summed up.
    """
    from tiltcal.core.compensate import Compensation
    from tiltcal.core.pair.compensate import PairCompensation
    from tiltcal.files.calibration import calibration_of
    from tiltcal.files.document import checked_kind, read_document
    from tiltcal.files.pair import pair_of
    from tiltcal.rails import with_rails

    document = read_document(path)
    kind = document.entries().get("kind")
    if kind is not None and kind.names("pair"):
        for name, given in (("--first-order", first_order), ("--uncertainty", uncertainty)):
            if given:
                raise UsageError(f"{name} is for tilt calibrations; {path} is of pairs, which have no tilt")
        pairs = pair_of(checked_kind(document, "pair"))
        matched = PairCompensation(pairs.matchings, pairs.phase)
        return matched, matched.channels, ()
    known = calibration_of(checked_kind(document, "tilt"))
    channels = known.coefficients.channels
    try:
        compensation = Compensation(known.coefficients, with_rails(known), first_order=first_order)
        if not uncertainty:
            return compensation, channels, ()
        uncertain = _uncertain(known, compensation, reading_noise)
    except EstimateError as failure:
        raise InputError(str(failure), file=path) from failure
    return uncertain, channels, uncertain.expanded


def _uncertain(known: Calibration, compensation: Compensation, reading_noise: float | None) -> UncertainCompensation:
    """The kernel that tells uncertainties too; says what it has to take for granted."""
    from tiltcal.core.angles import UncertainCompensation
    from tiltcal.files.uncertainty import stated_uncertainty

    stated = stated_uncertainty(known.uncertainty, known.coefficients, reading_noise=reading_noise)
    for remark in stated.remarks:
        click.echo(f"note: {remark}", err=True)
    return UncertainCompensation(compensation, known.coefficients, stated.doubt)
