"""``tiltcal devices``: list the sensor models, or show one."""

from __future__ import annotations

from typing import Any

import click

from tiltcal.cli import options
from tiltcal.cli.talk import remark
from tiltcal.drivers import models
from tiltcal.drivers.model import Model
from tiltcal.files.device import model_named, shipped_devices


@options.command(epilog="Example: tiltcal devices sca100t-d02")
@click.argument("model", required=False)
@options.as_json
def command(model: str | None, as_json: bool) -> None:
    """List the sensor models, or show the addresses, their options, the readings and the virtual twin of one."""
    known = [*models(), *(model_named(name) for name in shipped_devices())] if model is None else [model_named(model)]
    if as_json:
        click.echo(options.json_text([_facts(one) for one in known], 2))
    elif model is None:
        width = max(len(one.name) for one in known)
        for one in known:
            click.echo(f"{one.name:<{width}}  {one.title}")
        remark("`tiltcal devices MODEL` shows the addresses of one, and what its virtual twin does not model")
    else:
        _show(known[0])


def _show(model: Model) -> None:
    click.echo(f"{model.name}  {model.title}")
    click.echo(f"  reads      {_readings(model)}")
    if model.channels and model.scaled:
        click.echo(f"  nominal    {model.offset:g} {model.unit} at 0 g, {model.sensitivity:g} {model.unit}/g")
    for number, address in enumerate(model.addresses):
        click.echo(f"  {'' if number else 'address':<10} {address}")
    click.echo("             sim: for the virtual twin (sim:?twin=FILE&seed=N)")
    if model.options:
        click.echo(f"  options    {', '.join(model.options)}")
    click.echo("  the twin does not model")
    for effect in model.omissions:
        click.echo(f"    - {effect}")


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
        "twin_does_not_model": list(model.omissions),
    }
