"""A session from its begin to the end of its journal, and the calibrations that the journal gives."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial

from tiltcal.bench.journal import SessionResult, calibrations_of, positions_of
from tiltcal.bench.operators import NAMED, Operator, Program, PythonObject, VirtualJig
from tiltcal.bench.ramp import take_leg
from tiltcal.bench.sensors import RECOVERY
from tiltcal.bench.session import Session
from tiltcal.bench.settle import Unsettled
from tiltcal.errors import HardwareError, InputError, JournalError, SensorError, UsageError
from tiltcal.files.journal import JournalWriter, read_journal
from tiltcal.files.moments import moment_after
from tiltcal.files.procedure import Position

FIRST = "this is the first position: there is none before it to go back to"


@contextmanager
def open_operator(
    chosen: object, *, turns: bool, virtual: bool, say: Callable[[str], None], plain: bool = False
) -> Iterator[Operator]:
    """Make an operator, and give the terminal back at the end of the block.

    Parameters
    ----------
    chosen : str or object
        One of :data:`NAMED`, or an object with the methods of the protocol.
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
        from tiltcal.bench.terminal import open_terminal

        with ExitStack() as stack:
            yield open_terminal(stack, plain=plain)
    elif chosen == "sim":
        if not virtual:
            raise UsageError("--operator sim moves virtual sensors only; give --address sim:")
        yield VirtualJig(say)
    elif chosen == "json":
        yield Program(sys.stdin, sys.stdout)
    elif isinstance(chosen, str):
        raise UsageError(f"there is no operator {chosen!r}: it is {', '.join(NAMED)}, or an object that drives a rig")
    else:
        yield PythonObject(chosen, "rotation" if turns else "position")


def run_session(session: Session, operator: Operator) -> SessionResult:
    """Carry a session out, or go on with it, to the end of its journal, and return what the journal gives.

    TiltcalError: what stopped it; everything that was measured is in the journal.
    """
    if session.journal is not None and session.journal.end is not None:
        session.finished = True
        return calibrations_of(session.journal)
    recorded = None if session.journal is None else positions_of(session.journal)
    with ExitStack() as stack:
        writer = session.open(stack, operator, recorded)
        if session.setup.steps.rotation is None:
            _take_positions(session)
        elif recorded is None or recorded.turned is None:
            from tiltcal.bench.rotation import TurningStage

            TurningStage(session, session.setup.steps.rotation, session.setup.channel_map(), recorded).turn()
        return _end(session, writer)


def _end(session: Session, writer: JournalWriter) -> SessionResult:
    """Make the calibrations, have them written, and end the journal; there is nothing to resume then."""
    setup, files = session.setup, session.files
    result = calibrations_of(read_journal(files.journal))
    if not setup.verifies:
        session.ask({"ask": "write", "files": [str(files.outputs[serial]) for serial in result.calibrations]})
    ended = moment_after(setup.began, session.recorder.now_ns)
    sha256 = writer.finish(0)
    session.finished = True
    return result.ended(setup.journal, ended, sha256)


def _take_positions(session: Session) -> None:
    """Take every position of the procedure, in its order."""
    positions, ramp = session.setup.steps.positions, session.setup.steps.ramp
    attempt: Callable[[Position], str] = session.attempt if ramp is None else partial(take_leg, session, ramp)
    while len(session.accepted) < len(positions):
        position = positions[len(session.accepted)]
        try:
            if attempt(position) == "back":
                if not session.accepted:
                    raise InputError(FIRST)
                session.accepted.pop()
        except JournalError:
            raise
        except (Unsettled, InputError, HardwareError) as error:
            if isinstance(error, SensorError):
                session.sensors.failed(error)
            session.refuse(position.name, str(error))
            if isinstance(error, SensorError) and error.serial in session.sensors.lost:
                session.tell("lost", sensor=error.serial, why=session.sensors.lost[error.serial])
            if isinstance(error, HardwareError):
                session.clock.sleep(RECOVERY)
