"""The choice of an operator: by name, as on the command line, or a Python object that drives a rig."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from tiltcal.bench.operators.operator import PositionOperator, RotationOperator
from tiltcal.errors import UsageError

NAMED = ("terminal", "json", "sim")
"""A person, a program over JSON Lines, the virtual jig."""


@contextmanager
def open_operator(
    chosen: object, *, turns: bool, virtual: bool, say: Callable[[str], None], plain: bool = False
) -> Iterator[PositionOperator | RotationOperator]:
    """Make an operator of the kind that a procedure needs, and give the terminal back at the end of the block.

    Parameters
    ----------
    chosen : str or object
        One of :data:`NAMED`, or a rig (:mod:`tiltcal.bench.operators.rig`).
    turns : bool
        Whether the procedure lets a stage turn.
    virtual : bool
        Whether all sensors are virtual.
    say : callable
        Takes a line of the virtual jig's talk.
    plain : bool
        Whether a terminal gets lines only.

    UsageError: no such operator, or one that the bench cannot have.
    """
    needed = {"terminal": {"input": sys.stdin, "error": sys.stderr}, "json": {"input": sys.stdin, "output": sys.stdout}}
    for name, stream in needed.get(str(chosen), {}).items():
        if stream is None:
            raise UsageError(f"standard {name} is closed, and --operator {chosen} needs it")
    if chosen == "terminal":
        with ExitStack() as stack:
            yield _terminal(stack, turns=turns, plain=plain)
    elif chosen == "sim":
        from tiltcal.bench.operators.sim import SimOperator, SimRotationOperator

        if not virtual:
            raise UsageError("--operator sim moves virtual sensors only; give --address sim:")
        yield SimRotationOperator(say) if turns else SimOperator(say)
    elif isinstance(chosen, str) and chosen != "json":
        raise UsageError(f"there is no operator {chosen!r}: it is {', '.join(NAMED)}, or an object that drives a rig")
    else:
        from tiltcal.bench.operators.json_lines import JsonLinesRig
        from tiltcal.bench.operators.rig import RigPositionOperator, RigRotationOperator

        rig = JsonLinesRig(sys.stdin, sys.stdout) if chosen == "json" else chosen
        yield RigRotationOperator(rig) if turns else RigPositionOperator(rig)


def _terminal(stack: ExitStack, *, turns: bool, plain: bool) -> PositionOperator | RotationOperator:
    """Return a person's operator; single keys need a terminal."""
    from rich.console import Console

    from tiltcal.bench.operators.keys import Keys, LineKeys, TerminalKeys
    from tiltcal.bench.operators.terminal import TerminalOperator, TerminalRotationOperator

    class Talk(Console):
        def on_broken_pipe(self) -> None:
            self.quiet = True  # in place of SystemExit: the session goes on without its talk

    console = Talk(stderr=True, highlight=False, no_color=plain or None)
    live = sys.stdin.isatty() and sys.stderr.isatty() and not (plain or console.is_dumb_terminal)
    keys: Keys = stack.enter_context(TerminalKeys()) if live else LineKeys(sys.stdin)
    operator = (TerminalRotationOperator if turns else TerminalOperator)(console, keys, live=live)
    stack.callback(operator.clear)
    return operator
