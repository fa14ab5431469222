"""``tiltcal plan``: predict the uncertainty of a procedure."""

from __future__ import annotations

from typing import Any

import click

from tiltcal.bench.options import MeasureOptions
from tiltcal.cli import options


@options.command(epilog="Example: tiltcal plan cross-axis --sensor sca100t-d02 --jig 0.05")
@click.argument("procedure")
@click.option("--sensor", metavar="MODEL", help="The sensor's model; `tiltcal devices` lists them [that of --base].")
@options.file_option(
    "--base",
    metavar="CAL",
    help="The calibration file of the sensor, for level and for procedures that determine no sensitivity.",
)
@click.option("--address", help="Its address, if an option of it changes the model, such as counts_per_g.")
@options.degrees("--jig", help="Standard uncertainty of a set angle.")
@options.at_least_zero("--thermometer", metavar="CELSIUS", help="Standard uncertainty of a temperature.")
@options.degrees("--table-lean", help="Standard uncertainty of the table's lean.")
@options.at_least_zero("--noise", help="Standard deviation of one sample, in the sensor's unit.")
@options.declared(MeasureOptions, "samples tilt closing")
@options.as_json
def command(procedure: str, as_json: bool, **design: Any) -> None:
    """Predict the standard uncertainty of every coefficient of PROCEDURE.

    A procedure that cannot determine its coefficients is refused (exit code 2), with the position to add.
    """
    from tiltcal.library.plan import plan

    found = plan(procedure, **design)
    click.echo(options.json_text(found.as_data()) if as_json else str(found))
