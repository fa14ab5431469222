"""``tiltcal fit``"""

from __future__ import annotations

from hashlib import file_digest
from pathlib import Path

import click

import tiltcal
from tiltcal.calibrate import Nominal, calibrate
from tiltcal.drivers import find_model
from tiltcal.errors import UsageError
from tiltcal.files.calibration import SensorIdentity, write_calibration
from tiltcal.files.procedure import find_procedure
from tiltcal.files.segments import read_segments
from tiltcal.files.whole import check_writable
from tiltcal.report.summary import summary

UNKNOWN_MODEL = "recorded"


@click.command(
    epilog="Example: tiltcal fit six-face session.csv --segments segments.csv --columns x=acc_x,y=acc_y,z=acc_z "
    "--unit m/s2 --serial IMU1 -o imu1.yaml"
)
@click.argument("procedure")
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--segments",
    required=True,
    type=click.Path(path_type=Path),
    help="Which rows were taken in which position: CSV or JSON with position, start, end (exclusive), and gx, gy, gz "
    "where the position is not the procedure's.",
)
@click.option(
    "--columns", default="", metavar="x=NAME,...", help="Which column holds which reading [x, y, z, temperature]."
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
@click.option("--tilt", type=float, metavar="DEGREES", help="The angle that the procedure leaves free.")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="The calibration file to write.")
def command(
    procedure: str,
    log: Path,
    segments: Path,
    columns: str,
    unit: str | None,
    serial: str,
    sensor: str | None,
    jig: float | None,
    tilt: float | None,
    output: Path,
) -> None:
    """Calibrate from a recorded LOG (CSV) and its still segments, by the positions of PROCEDURE."""
    from tiltcal.logs.columns import parse_columns
    from tiltcal.logs.recorded import measurements_of, read_record

    steps = find_procedure(procedure, tilt)
    model = find_model(sensor) if sensor else None
    if unit is None and model is None:
        raise UsageError("say the readings' --unit (such as m/s2), or the --sensor model that has it")
    check_writable(output)
    held = read_segments(segments)
    channels = model.channels if model else steps.determines.axes or ("x", "y", "z")
    record = read_record(log, channels, parse_columns(columns, channels))
    calibration = calibrate(
        SensorIdentity(sensor or UNKNOWN_MODEL, serial, unit or str(model and model.unit), tuple(channels)),
        steps,
        measurements_of(record, held, steps, file=str(segments)),
        nominal=Nominal(model.sensitivity, model.sensitivity * model.sensitivity_spread, model.rails)
        if model
        else None,
        jig=jig,
        provenance={
            "made_by": "fit of a recorded log",
            "log": {"name": log.name, "rows": record.rows, "sha256": _sha256(log)},
            "segments": {"name": segments.name, "sha256": _sha256(segments)},
            "software": f"tiltcal {tiltcal.__version__}",
        },
    )
    write_calibration(output, calibration)
    click.echo(summary(calibration))
    click.echo(f"wrote {output}", err=True)


def _sha256(path: Path) -> str:
    with open(path, "rb") as stream:
        return file_digest(stream, "sha256").hexdigest()
