"""``tiltcal export``: write a calibration as other programs hold it."""

from __future__ import annotations

import re
from pathlib import Path

import click

from tiltcal.calibration.record import limits_of
from tiltcal.cli import options
from tiltcal.cli.talk import remark
from tiltcal.errors import UsageError
from tiltcal.export.targets import Source, exported
from tiltcal.files.atomic import check_writable, write_whole
from tiltcal.files.calibration import read_calibration

TARGETS = ("c", "fusion", "ros", "px4", "ardupilot", "iio", "python", "json")


@options.command(epilog="Example: tiltcal export S-0042.yaml --to c -o tilt.h")
@click.argument("calibration", type=options.FILE)
@click.option("--to", required=True, type=click.Choice(TARGETS), help="The program that is to hold the calibration.")
@options.file_option("-o", "--output", help="The file to write; without it, the result is printed.")
@click.option("--name", default="tilt", show_default=True, help="With c: what the names of its functions begin with.")
@click.option("--fixed", is_flag=True, help="With c: integers alone, for processors without floating point.")
@click.option(
    "--allow",
    type=float,
    default=0.1,
    show_default=True,
    metavar="DEGREES",
    help="Refuse an export whose angles differ from those of apply by more than this.",
)
def command(calibration: Path, to: str, output: Path | None, name: str, fixed: bool, allow: float) -> None:
    """Write a calibration as other programs hold it: g = A (u - b), with more where they can.

    \b
    c          C99 header: gravity, tilts, pitch and roll; --fixed: gravity in integers
    fusion     matrix, sensitivity and offset of x-io Fusion
    ros        the YAML of imu_calib, and the covariance of sensor_msgs/Imu
    px4        parameter file: offset and scale (not flown)
    ardupilot  parameter file: offset and scale (not flown)
    iio        shell script that sets calibbias and calibscale
    python     a module without imports but math, for MicroPython and CircuitPython too
    json       all numbers, with the formula that they belong to, and {A, b}

    What a target does not hold is named, with the largest error of an angle that this costs in the calibrated range.
    """
    if fixed and to != "c":
        raise UsageError(f"--fixed is for c; {to} has one form: leave it out")
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        raise UsageError(f"--name {name!r} is no name in C: a letter, then letters, digits and _")
    if not allow >= 0.0:
        raise UsageError(f"--allow {allow:g}: it is at least 0 degrees")
    if output is not None:
        check_writable(output, calibration)
    record = read_calibration(calibration)
    found = exported(Source(record, limits_of(record), name), "c-fixed" if fixed else to)
    if found.left_out:
        remark(f"{to} does not hold {', '.join(found.left_out)}")
    error = f"angles differ from those of apply by at most {found.bound:.2g}° in the calibrated range"
    if not found.bound <= allow:
        raise UsageError(f"{error}, more than --allow {allow:g}: take another target, or allow it")
    remark(error)
    if output is None:
        click.echo(found.text, nl=False)
    else:
        write_whole(output, found.text)
        remark(f"wrote {output}")
