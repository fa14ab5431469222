"""``tiltcal procedures``: list, show and check procedures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from tiltcal.cli import options
from tiltcal.files.procedure import (
    LevelCompletion,
    MountingCompletion,
    PositionProcedure,
    Procedure,
    Ramp,
    Rotation,
    find_procedure,
    shipped_procedures,
)


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
    click.echo(f"{procedure.name}: {procedure.title}")
    if procedure.source:
        click.echo(f"  source      {procedure.source}")
    for line in _sampled(procedure):
        click.echo(line)
    for number, position in enumerate(procedure.positions, start=1):
        click.echo(f"  {number:>2}. {position.name:<12} {position.prompt}")


def _sampled(procedure: Procedure) -> Iterator[str]:
    """Yield what a procedure determines, and how it is sampled."""
    match procedure:
        case Rotation():
            for pair in procedure.pairs:
                yield f"  determines  p and q of {pair.first} and {pair.second}, orthogonal {pair.orthogonal}"
            known = procedure.converged
            enough = "" if known is None else f", fewer where p and q are known to {known:g}"
            yield f"  turns       {procedure.turns} by the stage angle {procedure.phase}{enough}"
            yield f"  prompt      {procedure.prompt}"
            return
        case MountingCompletion():
            yield "  determines  the mounting of a sensor that is calibrated"
        case LevelCompletion():
            yield "  determines  the offset of a sensor that is calibrated; all else stays"
        case PositionProcedure():
            without = "; not the mounting" if procedure.free else ""
            yield f"  determines  {_determined(procedure)}{without}"
    if isinstance(procedure, Ramp):
        pace = f"while the temperature changes by {procedure.pace:g} °C/min"
        yield f"  samples     one every {procedure.interval:g} s, {pace}"
    elif isinstance(procedure, PositionProcedure):
        yield f"  samples     {procedure.samples} per position, still for {procedure.settle:g} s"


def _determined(procedure: PositionProcedure) -> str:
    """Return what set positions determine."""
    axes = f"sensitivity to {', '.join(procedure.axes)}" if procedure.axes else "no sensitivity"
    orders = "".join(
        f", {name} of order {order} over temperature"
        for name, order in (("offset", procedure.drift), ("sensitivity", procedure.gain))
        if order
    )
    bend = ", nonlinearity" if procedure.nonlinearity else ""
    return f"offset, {axes}{bend}{orders}"
