"""``tiltcal apply``: compensate a recorded log."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tiltcal.cli import options
from tiltcal.cli.talk import progress_bar, remark, talk
from tiltcal.errors import InputError, TiltcalError, UsageError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from tiltcal.cli.apply_several import Outcome

_EXAMPLE = """\b
Examples:
  tiltcal apply S-0042.yaml night.csv -o night-tilt.csv
  tiltcal apply S-0042.yaml night.csv --uncertainty -o night-tilt.csv
  tiltcal apply S-0042.yaml night.parquet -o night-tilt.parquet
  tiltcal apply S-0042.yaml night.csv --columns x=VoutX,y=VoutY,temperature=T -o night-tilt.csv
  tiltcal apply S-0042.yaml may-*.parquet -o tilt
  tiltcal apply --calibrations calibrations night.csv --serial S-0042 -o night-tilt.csv
  tiltcal apply S-0042.yaml night.csv --mounting roll=180 -o hanging.csv
  tiltcal apply S-0042.yaml dive.csv --magnetometer mx,my,mz --declination -14.3 --velocity u,v,w -o currents.csv
  tiltcal apply S-0042.yaml night.csv --every 10s --uncertainty -o night-means.csv
  zcat night.csv.gz | tiltcal apply S-0042.yaml - | gzip > night-tilt.csv.gz
"""


@click.command(epilog=_EXAMPLE)
@click.argument("files", metavar="CALIBRATION LOG...", nargs=-1, required=True)
@click.option(
    "--calibrations",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="DIR",
    help="In place of CALIBRATION: a folder of calibrations, of which each row takes that of its sensor and its time.",
)
@click.option(
    "--serial", metavar="S", help="With --calibrations: the sensor, where neither LOG nor its columns (S_x) name it."
)
@options.at_least_zero(
    "--stability",
    metavar="MG",
    help="With --calibrations --uncertainty: how far the offset wanders in one day, as a standard deviation in mg "
    "(over n days √n times as far), instead of half of its change between two calibrations.",
)
@click.option(
    "--start",
    metavar="TIME",
    help="With --calibrations: when the time of LOG is 0, such as 2026-05-01T12:00:00Z, where it is relative.",
)
@click.option(
    "-o",
    "--output",
    default="-",
    metavar="OUT",
    help="The file to write [standard output]; for several logs a folder, where each keeps its name.",
)
@click.option(
    "--columns",
    default="",
    metavar="ROLE=NAME,…",
    help="The column of each reading, such as x=VoutX,y=VoutY,temperature=T; without a header a number from 1.",
)
@click.option(
    "--skip-bad-rows", is_flag=True, help="Keep rows that cannot be parsed, with flag 9, instead of an error."
)
@click.option("--first-order", is_flag=True, help="Use Cross-axis Compensation, eq. 6, instead of the whole matrix.")
@click.option(
    "--uncertainty",
    is_flag=True,
    help="Add the standard uncertainty of each angle, such as u_tilt_x, and half of its 95 % interval, U95_tilt_x.",
)
@options.at_least_zero(
    "--reading-noise",
    metavar="UNIT",
    help="With --uncertainty: standard uncertainty of a reading of LOG, in its unit, instead of that of a single "
    "sample at the bench; 0 gives the uncertainty of the calibration alone.",
)
@click.option(
    "--mounting",
    default="",
    metavar="roll=DEG,…",
    help="How the sensor sits, such as roll=180 for upside down (pitch=, yaw=): roll first, then pitch, then yaw. It "
    "replaces the mounting of CALIBRATION and counts as exact.",
)
@click.option(
    "--magnetometer",
    default="",
    metavar="MX,MY,MZ",
    help="The columns of the magnetic field along x, y and z of the sensor: adds heading, degrees clockwise "
    "from north.",
)
@click.option(
    "--velocity",
    default="",
    metavar="U,V,W",
    help="The columns of a velocity along x, y and z: adds v_east, v_north and v_up in their unit. The heading comes "
    "from --magnetometer, or from a column (--columns heading=NAME).",
)
@click.option(
    "--declination",
    type=float,
    metavar="DEG",
    help="How far magnetic north is east of true north. It is added to every heading, also to that of a column.",
)
@options.at_least_zero(
    "--magnetometer-noise",
    metavar="UNIT",
    help="With --uncertainty: standard uncertainty of a component of the magnetic field, in its unit [0].",
)
@click.option(
    "--average",
    type=options.Count(1, "rows"),
    metavar="N",
    help="Average the readings of each N rows before they are converted; adds count.",
)
@click.option(
    "--every",
    metavar="TIME",
    help="Average the readings of each TIME, such as 10s, 5min or 1h, before they are converted; adds count.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Process each log on a worker of this dask scheduler, such as tcp://10.0.0.1:8786; the workers must see the "
    "same files.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print the summary as JSON: on stdout, or on stderr if the rows go to stdout.",
)
def command(
    files: tuple[str, ...],
    calibrations: Path | None,
    output: str,
    columns: str,
    skip_bad_rows: bool,
    scheduler: str | None,
    as_json: bool,
    **how: Any,
) -> int:
    """Convert the raw readings of LOG to tilt with quality flags.

    LOG is CSV with a header, Parquet (.parquet, .pq), NetCDF-4 (.nc), or - for CSV on standard input. The name
    of OUT selects its format; a NetCDF log stays NetCDF. OUT has the columns of LOG unchanged, then g_x and tilt_x
    (degrees) of each axis (with three axes also pitch, roll and inclination), then flag and reason. flag: 1 pass, 3
    suspect, 4 fail, 9 missing. reason is a sum: 1 arcsine argument beyond ±1, 2 temperature outside the calibrated
    range, 4 reading at the rail, 8 tilt outside the calibrated range, 16 temperature missing, 32 not a number, 64
    outside the time of --calibrations, 128 no direction or its sign unknown, or a magnetic field of unusual length, 256
    length of gravity of three axes is not 1 g. OUT is written whole or not at all.

    Several logs are processed into the folder -o, one after another, or with --scheduler on the workers of a cluster.
    If a log fails, it is named, and the others are processed.

    --uncertainty adds, in degrees, u_tilt_x (standard uncertainty, k = 1) and U95_tilt_x (the true tilt is within
    tilt_x ± U95_tilt_x in 95 % of all cases) of every angle, from the covariance of the calibration, the noise of a
    reading and the thermometer; likewise of heading and velocities.

    --magnetometer adds heading, how far the horizontal part of +X points clockwise from north, 0 to 360; --velocity
    adds v_east, v_north and v_up. The magnetometer has the axes of the sensor, and a mounting turns both; the velocity
    is in the application frame. A heading from a column counts as true unless --declination is there.

    --average and --every put the readings of several rows into their mean before they are converted: OUT has a row for
    each mean, and count. Rows with a missing reading are left out; a row at the rail gives its mean flag 4. Columns of
    numbers and times get their mean, all others the value of the first row. --uncertainty then adds u_random_tilt_x,
    which falls with √count, and u_common_tilt_x, which no averaging makes less.

    With --calibrations each row takes the calibration of its time: between two calibrations of the sensor
    gravity is interpolated from both, and before the first and after the last one the nearest is taken and the row has
    flag 3 and reason 64. The serial number is that of --serial, of the log's metadata, or of its columns: in a
    log of several sensors S-1_x gives S-1_tilt_x, all sensors in one pass. --uncertainty then includes how far the
    coefficients wander.

    If CALIBRATION contains accelerometer pairs (from `tiltcal match`), the new columns are the matched sum of each pair
    and, with two pairs, the gradient signal and its components at twice the spin frequency over the previous turn.
    """
    from tiltcal.library.apply import apply_log
    from tiltcal.logs.apply import prepare_any
    from tiltcal.logs.prepared_calibration import ApplyOptions

    calibration, logs = (Path(files[0]), files[1:]) if calibrations is None else (calibrations, files)
    if not logs:
        raise UsageError(f"no LOG is given behind {calibration}; see `tiltcal apply --help`")
    if calibrations is not None and len(logs) > 1:
        from tiltcal.files.calibration_folder import SUFFIXES

        if logs[0].lower().endswith(SUFFIXES):
            raise UsageError(f"{logs[0]} is a calibration, and --calibrations names a folder of them: leave one out")
    given = ApplyOptions(**how)
    how |= {"columns": columns, "skip_bad_rows": skip_bad_rows}
    if len(logs) > 1 or scheduler is not None or os.path.isdir(output):
        from tiltcal.cli.apply_several import applied_here, applied_on, outputs_in

        outputs = outputs_in(output, logs, calibration)
        said: list[str] = []  # remarks on the calibration, or an error of it, come once
        prepare_any(calibration, given, said.append)
        for text in said:
            remark(text)
        task = (calibration, outputs, how)
        return _reported(
            outputs, applied_here(*task) if scheduler is None else applied_on(scheduler, *task), said, as_json
        )
    with progress_bar("apply") as progress:
        summary = apply_log(calibration, logs[0], output, say=remark, progress=progress, **how)
    if as_json:
        (talk if output == "-" else click.echo)(options.json_text(summary.as_data()))
    else:
        remark(str(summary))
    return 0


def _reported(
    outputs: Mapping[str, str], outcomes: Iterable[tuple[str, Outcome]], said: Sequence[str], as_json: bool
) -> int:
    """Report what became of each of several logs, and raise an error at the end if one failed."""
    done = {}
    for log, (remarks, outcome) in outcomes:
        for text in remarks:
            if text not in said:
                remark(f"{log}: {text}")
        if isinstance(outcome, TiltcalError):
            remark(f"{log} failed and is left out: {outcome}")
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
