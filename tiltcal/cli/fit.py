"""``tiltcal fit``"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

import tiltcal
from tiltcal.drivers import find_model
from tiltcal.errors import UsageError
from tiltcal.files.whole import check_writable

if TYPE_CHECKING:
    from tiltcal.drivers.device import Model
    from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
    from tiltcal.files.procedure import Procedure
    from tiltcal.files.segments import Segment
    from tiltcal.logs.fit_input import FitInput

UNKNOWN_MODEL = "recorded"

_EXAMPLES = """\b
Examples:
  tiltcal fit six-face session.csv --segments faces.csv --columns x=acc_x,y=acc_y,z=acc_z \\
      --unit m/s2 --serial IMU1 -o imu1.yaml
  tiltcal fit free moved-by-hand.txt --columns x=2,y=3,z=4 --unit count --gravity 9.81744 \\
      --serial MTI-1 -o mti1.yaml
  tiltcal fit six-face means.csv --table --unit V --serial S-7 -o S-7.yaml
"""


@click.command(epilog=_EXAMPLES)
@click.argument("procedure")
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--segments",
    type=click.Path(path_type=Path),
    help="Which rows were taken in which position: CSV or JSON with position, start, end (exclusive), and gx, gy, gz "
    "where the position is not the procedure's. With PROCEDURE free the still rows are found where it is left out.",
)
@click.option(
    "--table",
    is_flag=True,
    help="LOG is a table of positions already averaged: position, x, y, z, and where known gx, gy, gz, ux, uy, uz (the "
    "means' standard uncertainties), n, temperature.",
)
@click.option(
    "--columns",
    default="",
    metavar="x=NAME,...",
    help="Which column holds which reading [x, y, z, temperature]; in a log without a header by number from 1.",
)
@click.option("--unit", help="The readings' unit, such as m/s2, V or count.")
@click.option("--serial", required=True, help="The sensor's serial number, for the calibration file.")
@click.option("--sensor", metavar="MODEL", help="The sensor's model, where it is one of `tiltcal devices`.")
@click.option(
    "--jig",
    type=click.FloatRange(0.0),
    metavar="DEGREES",
    help="Standard uncertainty of a set angle; where it is not stated, the positions' scatter says it.",
)
@click.option(
    "--thermometer",
    type=click.FloatRange(0.0),
    metavar="CELSIUS",
    help="Standard uncertainty of a temperature; where it is not stated, the step of the --sensor's own thermometer.",
)
@click.option("--tilt", type=float, metavar="DEGREES", help="The angle that the procedure leaves free.")
@click.option(
    "--gravity",
    type=click.FloatRange(9.7, 9.9),
    metavar="M/S2",
    help="Local gravity, to tell the sensitivity per m/s² beside that per g, and for readings in m/s2 the scale error.",
)
@click.option("--window", type=click.IntRange(4), metavar="ROWS", help="How long still is, where the rows are found.")
@click.option(
    "--segments-out", type=click.Path(path_type=Path), metavar="FILE", help="Write the still rows that were found."
)
@click.option(
    "--base",
    type=click.Path(path_type=Path),
    metavar="CAL",
    help="The sensor's calibration file, which the mounting procedure completes.",
)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="The calibration file to write.")
def command(
    procedure: str,
    log: Path,
    segments: Path | None,
    table: bool,
    columns: str,
    unit: str | None,
    serial: str,
    sensor: str | None,
    jig: float | None,
    thermometer: float | None,
    tilt: float | None,
    gravity: float | None,
    window: int | None,
    segments_out: Path | None,
    base: Path | None,
    output: Path,
) -> None:
    """Calibrate from a recorded LOG (CSV, Parquet or NetCDF-4) and its still segments, by the positions of PROCEDURE.

    With PROCEDURE free nobody has to know the positions: a three-axis sensor is held still in a dozen or more
    attitudes, whatever they are, and gravity is 1 g in each. How the sensor is mounted stays undetermined.
    """
    from tiltcal.calibration.calibrate import MeasuredSensor, Nominal
    from tiltcal.calibration.mounting import base_of, mount
    from tiltcal.calibration.prediction import require_tilt
    from tiltcal.calibration.summary import mounting_summary, summary
    from tiltcal.calibration.temperature_order import calibrate
    from tiltcal.calibration.unit_gravity import require_no_jig, with_verdict
    from tiltcal.files.calibration import write_calibration
    from tiltcal.files.procedure import find_procedure
    from tiltcal.logs import remarks
    from tiltcal.logs.fit_input import FitInput, free_positions, set_positions

    steps = find_procedure(procedure, tilt)
    steps.require_positions()
    free = steps.determines.free
    source = FitInput(log, segments, table, columns, window)
    _refuse_contradictions(source, free)
    require_no_jig(steps, jig)
    if (window is not None or segments_out is not None) and not (free and source.finds):
        raise UsageError("--window and --segments-out are for `tiltcal fit free` without --segments, which finds them")
    model = find_model(sensor) if sensor else None
    if model is not None:
        require_tilt(steps, model)
    mounted = base_of(steps, base, [serial])
    identity = _identity(mounted, model, steps, unit, serial)
    for path in filter(None, (output, segments_out)):
        check_writable(path)
    positions = (
        free_positions(source, identity.channels, identity.unit, lambda line: click.echo(line, err=True))
        if free
        else set_positions(source, identity.channels, steps)
    )
    provenance = {
        "made_by": "fit of a table of positions" if table else "fit of a recorded log",
        **positions.provenance,
        "software": f"tiltcal {tiltcal.__version__}",
    }
    if mounted is not None:
        calibration = replace(mount(mounted, positions.measurements, jig=jig), provenance=provenance)
    else:
        nominal = None if model is None or model.unit != identity.unit else Nominal.of(model)
        warmth = thermometer if model is None or thermometer is not None else model.thermometer_rounding
        subject = MeasuredSensor(identity, positions.measurements, nominal)
        (calibration,) = calibrate([subject], steps, jig=jig, thermometer=warmth, provenance=provenance)
    if free:
        calibration = with_verdict(calibration, positions.measurements)
    if table and mounted is None:
        calibration = remarks.of_table(calibration, positions.measurements)
    if gravity is not None:
        calibration = remarks.of_local_gravity(calibration, gravity)
    write_calibration(output, calibration)
    if segments_out is not None:
        _write_segments(segments_out, positions.found)
        click.echo(f"wrote {segments_out}", err=True)
    click.echo(summary(calibration) if mounted is None else mounting_summary(calibration))
    if free:
        _tell_free(calibration)
    click.echo(f"wrote {output}", err=True)


def _refuse_contradictions(source: FitInput, free: bool) -> None:
    if source.table and source.segments is not None:
        raise UsageError("a --table has its positions already: leave --segments out")
    if source.table and source.columns:
        raise UsageError("a --table names its columns itself (position, x, y, z, ...): leave --columns out")
    if not free and source.finds:
        raise UsageError(
            "say with --segments which rows were taken in which position (or that LOG is a --table of positions); only "
            "`tiltcal fit free` finds them itself, because it need not know the positions"
        )


def _identity(
    base: CalibrationRecord | None, model: Model | None, steps: Procedure, unit: str | None, serial: str
) -> SensorIdentity:
    """Which sensor it is, and in what unit it reads."""
    from tiltcal.files.calibration import SensorIdentity

    if base is not None:
        for what, said, known in (
            ("--unit", unit, base.sensor.unit),
            ("--sensor", model and model.name, base.sensor.model),
        ):
            if said not in (None, known):
                raise UsageError(f"{what} {said} contradicts the --base, which has {known}: leave it out")
        return base.sensor
    if unit is None and model is None:
        raise UsageError("say the readings' --unit (such as m/s2), or the --sensor model that has it")
    if model is not None and unit not in (None, model.unit) and not steps.determines.axes:
        raise UsageError(
            f"{steps.name} takes the nominal sensitivity of {model.name}, which is per g in {model.unit} and not in "
            f"{unit}: name the model that reads {unit}, or leave --unit out"
        )
    channels = tuple(model.channels) if model else steps.determines.axes or ("x", "y", "z")
    if steps.determines.free and channels != ("x", "y", "z"):
        raise UsageError(
            f"unit gravity alone needs three channels x, y and z; {model.name if model else 'it'} has "
            f"{', '.join(channels)}: name a procedure whose positions were set"
        )
    return SensorIdentity(model.name if model else UNKNOWN_MODEL, serial, unit or str(model and model.unit), channels)


def _tell_free(calibration: CalibrationRecord) -> None:
    """What a person should know of a calibration from unit gravity."""
    fit = calibration.fit
    click.echo(
        f"  misfit of gravity's length {fit['misfit_rms_mg']:g} mg rms over {len(calibration.positions)} positions, "
        f"{fit['distinct_attitudes']} different attitudes"
    )
    click.echo(f"mounting {calibration.derived['mounting']}", err=True)
    if "warning" in fit:
        click.echo(f"warning: {fit['warning']}", err=True)


def _write_segments(path: Path, segments: Sequence[Segment]) -> None:
    from tiltcal.files.whole import write_whole

    rows = "".join(f"{segment.name},{segment.start},{segment.end}\n" for segment in segments)
    write_whole(path, "position,start,end\n" + rows)
