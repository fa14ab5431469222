"""``tiltcal procedures``: list, show and check procedures."""

from __future__ import annotations

from pathlib import Path

import click

from tiltcal.cli import options
from tiltcal.files.procedure import Procedure, find_procedure, shipped_procedures
from tiltcal.files.procedure_file import Determines, Rotation


@options.command(
    epilog="Example: tiltcal procedures plane --source > mine.yaml; edit it; run it: tiltcal measure ./mine.yaml ..."
)
@click.argument("procedure", required=False)
@click.option("--source", is_flag=True, help="Print the procedure file, to copy and edit.")
@options.as_json
def command(procedure: str | None, source: bool, as_json: bool) -> None:
    """List the procedures, or show the positions of one (its name, or the path of your own)."""
    if procedure is None:
        shown = [find_procedure(name) for name in shipped_procedures()]
    else:
        shown = [find_procedure(procedure)]
    if source and procedure is not None:
        click.echo(Path(shipped_procedures().get(procedure, Path(procedure))).read_text(encoding="utf-8"), nl=False)
    elif as_json:
        click.echo(options.json_text([dict(found.record) for found in shown], 2))
    elif procedure is None:
        width = max(len(found.name) for found in shown)
        for found in shown:
            click.echo(f"{found.name:<{width}} {found.title} ({found.length})")
    else:
        _show(shown[0])


def _show(procedure: Procedure) -> None:
    determines = procedure.determines
    click.echo(f"{procedure.name}: {procedure.title}")
    if procedure.source:
        click.echo(f"  source      {procedure.source}")
    if procedure.rotation is not None:
        _show_rotation(procedure.rotation)
        return
    click.echo(f"  determines  {_determined(determines)}")
    if procedure.ramp is None:
        click.echo(f"  samples     {procedure.samples} per position, still for {procedure.settle:g} s")
    else:
        ramp = procedure.ramp
        click.echo(
            f"  samples     one every {ramp.interval:g} s, while the temperature changes by {ramp.pace:g} °C/min"
        )
    for number, position in enumerate(procedure.positions, start=1):
        click.echo(f"  {number:>2}. {position.name:<12} {position.prompt}")


def _determined(determines: Determines) -> str:
    """Return what a procedure determines, as text."""
    if determines.mounting:
        return "the mounting of a sensor that is calibrated"
    if determines.level:
        return "the offset of a sensor that is calibrated; all else stays"
    axes = f"sensitivity to {', '.join(determines.axes)}" if determines.axes else "no sensitivity"
    orders = "".join(
        f", {name} of order {order} over temperature"
        for name, order in (("offset", determines.drift), ("sensitivity", determines.gain))
        if order
    )
    bend = ", nonlinearity" if determines.nonlinearity else ""
    return f"offset, {axes}{bend}{orders}{'; not the mounting' if determines.free else ''}"


def _show_rotation(rotation: Rotation) -> None:
    for pair in rotation.pairs:
        click.echo(f"  determines  p and q of {pair.first} and {pair.second}, orthogonal {pair.orthogonal}")
    enough = "" if rotation.converged is None else f", fewer where p and q are known to {rotation.converged:g}"
    click.echo(f"  turns       {rotation.turns} by the stage angle {rotation.phase}{enough}")
    click.echo(f"  prompt      {rotation.prompt}")
