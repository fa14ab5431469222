"""``tiltcal plan``"""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command(epilog="Example: tiltcal plan cross-axis --sensor sca100t-d02 --jig 0.05")
@click.argument("procedure")
@click.option("--sensor", metavar="MODEL", help="The sensor's model; `tiltcal devices` lists them [that of --base].")
@click.option(
    "--base",
    type=click.Path(path_type=Path),
    metavar="CAL",
    help="The calibration file of the sensor, for level and for procedures that determine no sensitivity.",
)
@click.option("--address", help="Its address, if an option of it changes the model, such as counts_per_g.")
@click.option("--jig", type=click.FloatRange(0.0), metavar="DEGREES", help="Standard uncertainty of a set angle.")
@click.option(
    "--thermometer", type=click.FloatRange(0.0), metavar="CELSIUS", help="Standard uncertainty of a temperature."
)
@click.option(
    "--table-lean", type=click.FloatRange(0.0), metavar="DEGREES", help="Standard uncertainty of the table's lean."
)
@click.option("--noise", type=click.FloatRange(0.0), help="Standard deviation of one sample, in the sensor's unit.")
@click.option("--samples", type=click.IntRange(2), help="Samples per position; overrides the procedure.")
@click.option("--tilt", type=float, metavar="DEGREES", help="The angle of a procedure with a free angle.")
@click.option("--closing", is_flag=True, help="Visit the first position again at the end.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def command(
    procedure: str,
    sensor: str | None,
    base: Path | None,
    address: str | None,
    jig: float | None,
    thermometer: float | None,
    table_lean: float | None,
    noise: float | None,
    samples: int | None,
    tilt: float | None,
    closing: bool,
    as_json: bool,
) -> None:
    """Predict the standard uncertainty of every coefficient of PROCEDURE.

    A procedure that cannot determine its coefficients is refused (exit code 2), with the position to add.
    """
    from tiltcal.bench.plan import plan

    found = plan(
        procedure,
        sensor=sensor,
        address=address,
        jig=jig,
        thermometer=thermometer,
        table_lean=table_lean,
        noise=noise,
        samples=samples,
        tilt=tilt,
        closing=closing,
        base=base,
    )
    click.echo(json.dumps(found.as_data()) if as_json else str(found))
