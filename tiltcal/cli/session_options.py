"""What the commands that lead a session share: who leads it, where it is captured, how it is gone on with."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import click

from tiltcal.bench.operators.operator import Operator
from tiltcal.bench.session import Session
from tiltcal.errors import HardwareError, Stopped, TiltcalError, UsageError
from tiltcal.files.journal import Journal, read_journal

LEADERS = click.Choice(["terminal", "json", "sim"])


@contextmanager
def led(session: Session, lead: str, *, plain: bool, again: str) -> Iterator[Operator]:
    """Check the bench, then hand out the operator; whatever stops the session tells how to go on.

    Parameters
    ----------
    session : Session
    lead : str
        ``terminal``, ``json`` or ``sim``.
    plain : bool
        Lines only.
    again : str
        The command that resumes, with its arguments before ``--resume``.
    """
    session.preflight()
    go_on = f"what was measured is kept; go on with: tiltcal {again} --resume {session.path}"
    with ExitStack() as stack:
        try:
            yield _operator(lead, session, plain, stack)
        except KeyboardInterrupt:
            raise Stopped(f"interrupted; {go_on}") from None
        except Stopped as error:
            raise Stopped(f"{error}; {go_on}") from None
        except HardwareError as error:
            if session.finished:
                raise
            raise HardwareError(f"{error}; {go_on}") from None
        except TiltcalError:
            click.echo(go_on, err=True)
            raise


def captured(path: Path) -> Journal:
    """A journal that is there, with a warning where its last line was torn off."""
    journal = read_journal(path)
    if journal.torn:
        click.echo(f"{path}: the last line was torn off and is dropped", err=True)
    return journal


def left_at_default(option: str) -> bool:
    """Whether the command line does not name an option."""
    context = click.get_current_context()
    return context.get_parameter_source(option) is click.core.ParameterSource.DEFAULT


def free_journal(output: Path) -> Path:
    """A journal's name beside the calibration file; an earlier session's journal is never touched."""
    path = output.with_name(f"{output.stem}.journal.jsonl")
    number = 2
    while path.exists():
        path = output.with_name(f"{output.stem}.{number}.journal.jsonl")
        number += 1
    if number > 2:
        click.echo(f"an earlier journal is kept; this session is captured in {path}", err=True)
    return path


def _operator(kind: str, session: Session, plain: bool, stack: ExitStack) -> Operator:
    if kind == "json":
        from tiltcal.bench.operators.json_lines import JsonOperator

        return JsonOperator(sys.stdin, sys.stdout)
    if kind == "sim":
        from tiltcal.bench.operators.sim import SimOperator

        if not session.plan.virtual:
            raise UsageError("--operator sim moves virtual sensors only; give --address sim:")
        return SimOperator(lambda line: click.echo(line, err=True))
    from rich.console import Console

    from tiltcal.bench.operators.keys import Keys, LineKeys, TerminalKeys
    from tiltcal.bench.operators.terminal import TerminalOperator

    live = sys.stdin.isatty() and sys.stderr.isatty() and not plain
    keys: Keys = stack.enter_context(TerminalKeys()) if live else LineKeys(sys.stdin)
    return TerminalOperator(
        Console(stderr=True, highlight=False, no_color=plain or None), keys, session.models, live=live
    )
