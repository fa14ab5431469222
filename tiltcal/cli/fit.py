"""``tiltcal fit``: calibrate from a recorded log or a table of positions."""

from __future__ import annotations

import os
from pathlib import Path
from shlex import quote
from typing import Any

import click

from tiltcal.cli import options
from tiltcal.cli.talk import progress_bar, remark
from tiltcal.files.calibration_output import require_replaceable
from tiltcal.logs.options import FitOptions

_EXAMPLES = """\b
Examples:
  tiltcal fit six-face session.csv --segments faces.csv --columns x=acc_x,y=acc_y,z=acc_z \\
      --unit m/s2 --serial IMU1 -o imu1.yaml
  tiltcal fit free moved-by-hand.txt --columns x=2,y=3,z=4 --unit count --gravity 9.81744 \\
      --serial MTI-1 -o mti1.yaml
  tiltcal fit six-face x-up=1.csv x-down=2.csv y-up=3.csv y-down=4.csv z-up=5.csv z-down=6.csv --serial B -o B.yaml
  tiltcal fit six-face means.csv --table --unit V --serial S-7 -o S-7.yaml
"""


@options.command(epilog=_EXAMPLES)
@click.argument("procedure")
@click.argument("logs", metavar="LOG...", nargs=-1, required=True)
@options.file_option("-o", "--output", required=True, help="The calibration file to write.")
@options.topic
@options.declared(FitOptions)
def command(procedure: str, logs: tuple[str, ...], output: Path, topic: str | None, **settings: Any) -> None:
    """Calibrate from a recorded LOG and its segments, by the positions of PROCEDURE.

    LOG is text as its device wrote it, Parquet, NetCDF-4 or a bag of ROS; several are one session, and NAME=FILE is a
    log of the position NAME. PROCEDURE free needs no known positions: a three-axis sensor is held
    still in twelve or more attitudes, and gravity is 1 g in each. It does not determine the mounting.
    """
    from tiltcal.calibration.wording import result_in_words
    from tiltcal.files.procedure import find_procedure
    from tiltcal.library.recorded import fit

    data = [options.of_topic(log, topic) for log in logs]
    files = [log if os.path.exists(log) else log.partition("=")[2] or log for log in logs]
    require_replaceable(output, None, *files, *filter(None, [settings["segments"], settings["base"]]))
    with progress_bar("fit") as progress:
        calibration = fit(procedure, data, say=remark, progress=progress, **settings)
    calibration.save(output, remark)
    record = calibration.record
    click.echo(result_in_words(record, find_procedure(procedure, settings["tilt"])))
    if record.fit.warning:
        remark(f"warning: {record.fit.warning}")
    remark(f"wrote {output}")
    file = quote(str(output))
    remark(f"next: tiltcal apply {file} LOG.csv -o TILT.csv, or tiltcal export {file} --to c -o tilt.h")
