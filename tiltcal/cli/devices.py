"""``tiltcal devices``: list the sensor models."""

from __future__ import annotations

from typing import Any

import click

from tiltcal.cli import options
from tiltcal.drivers import models
from tiltcal.drivers.model import Model


@click.command(epilog="Example: tiltcal devices --json")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list.")
def command(as_json: bool) -> None:
    """List the sensor models with their addresses, units, and what their virtual twins do not model."""
    known = list(models())
    if as_json:
        click.echo(options.json_text([_facts(model) for model in known], 2))
        return
    for model in known:
        click.echo(f"{model.name}  {model.title}")
        click.echo(f"  reads      {_readings(model)}")
        if model.channels and model.scaled:
            click.echo(f"  nominal    {model.offset:g} {model.unit} at 0 g, {model.sensitivity:g} {model.unit}/g")
        for number, address in enumerate(model.addresses):
            click.echo(f"  {'' if number else 'address':<10} {address}")
        click.echo("             sim: for the virtual twin (sim:?twin=FILE&seed=N)")
        click.echo("  the twin does not model")
        for effect in model.not_modelled:
            click.echo(f"    - {effect}")
        click.echo()


def _readings(model: Model) -> str:
    if not model.channels:
        return f"the temperature in {model.unit}"
    own = ", and its temperature" if model.thermometer else ""
    return f"{', '.join(model.channels)} in {model.unit}{own}"


def _facts(model: Model) -> dict[str, Any]:
    return {
        "name": model.name,
        "title": model.title,
        "channels": list(model.channels),
        "unit": model.unit,
        "offset": model.offset if model.scaled else None,
        "sensitivity": model.sensitivity if model.scaled else None,
        "thermometer": model.thermometer,
        "addresses": [*model.addresses, "sim:"],
        "twin_does_not_model": list(model.not_modelled),
    }
