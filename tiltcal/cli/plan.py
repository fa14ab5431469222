"""``tiltcal plan``: predict the uncertainty of a procedure."""

from __future__ import annotations

from typing import Any

import click

from tiltcal.bench.options import PlanOptions
from tiltcal.cli import options
from tiltcal.cli.config import defaults_here
from tiltcal.library.measure import plan


@options.command(epilog="Example: tiltcal plan cross-axis --sensor sca100t-d02 --jig 0.05")
@click.argument("procedure")
@options.declared(PlanOptions)
@options.as_json
def command(procedure: str, as_json: bool, **design: Any) -> None:
    """Predict the standard uncertainty of every coefficient of PROCEDURE.

    A procedure that cannot determine its coefficients is refused (exit code 2), with the position to add.
    """
    found = plan(procedure, defaults=defaults_here, **design)
    click.echo(options.json_text(found.as_data()) if as_json else str(found))
