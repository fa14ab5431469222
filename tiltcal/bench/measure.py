"""A session from its begin to the end of its journal, and the calibrations that the journal gives."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial

from tiltcal.bench.devices import RECOVERY
from tiltcal.bench.judgement import Judgement
from tiltcal.bench.messages import Lost, WriteQuestion
from tiltcal.bench.operators import NAMED, Operator, Program, PythonObject, VirtualJig
from tiltcal.bench.options import MeasureOptions
from tiltcal.bench.ramp import RampLegs
from tiltcal.bench.session import Session
from tiltcal.bench.settle import Unsettled
from tiltcal.errors import (
    Argument,
    HardwareError,
    InputError,
    JournalError,
    SensorError,
    Stopped,
    TiltcalError,
    UsageError,
)
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.pair import PairRecord
from tiltcal.files.procedure import Ramp, Rotation
from tiltcal.journal.calibrations import calibrations_of
from tiltcal.journal.lines import Journal
from tiltcal.journal.session import RecordedSession


@contextmanager
def led_by(
    chosen: object,
    session: Session,
    command: str,
    remark: Callable[[str], None],
    options: MeasureOptions,
) -> Iterator[Operator]:
    """Yield the operator of a session whose files can be written and whose devices answer.

    Of the ``options`` of ``measure``, ``plain``, ``listen`` and ``hands_free`` say how it is asked.

    An error that ends the block says how to go on, with the ``command`` that resumes, where the journal has a begin and
    no end.

    UsageError: no such operator, or one that the bench cannot have.
    """
    files = session.files
    files.require_writable(session.before)
    go_on = files.go_on(command)
    try:
        session.probe()
        with ExitStack() as stack:
            operator = _operator(chosen, session, remark, stack, options)
            yield _with_machines(operator, session, stack)
    except (KeyboardInterrupt, TiltcalError) as error:
        if not session.captured:
            raise
        if isinstance(error, KeyboardInterrupt):
            raise Stopped(f"interrupted; {go_on}") from None
        if isinstance(error, Stopped):
            raise Stopped((*error.words, f"; {go_on}")) from None
        if not isinstance(error, HardwareError):
            remark(go_on)
        elif not session.finished:
            raise HardwareError((*error.words, f"; {go_on}")) from None
        raise


def _operator(
    chosen: object, session: Session, say: Callable[[str], None], stack: ExitStack, options: MeasureOptions
) -> Operator:
    """Return an operator: one of :data:`NAMED`, or an object with the methods of the protocol.

    A terminal is given back at the end of the stack; ``say`` takes a line of the virtual jig's talk.
    """
    plain, listen, hands_free = options["plain"], options["listen"], options["hands_free"]
    if chosen != "web" and (listen is not None or hands_free):
        raise UsageError(
            option="hands_free" if hands_free else "listen",
            why="is for the page in a browser",
            advice=("give ", Argument("operator", "web")),
        )
    needed = {"terminal": {"input": sys.stdin, "error": sys.stderr}, "json": {"input": sys.stdin, "output": sys.stdout}}
    for name, stream in needed.get(str(chosen), {}).items():
        if stream is None:
            raise UsageError((f"standard {name} is closed, and ", Argument("operator", str(chosen)), " needs it"))
    match chosen:
        case "terminal":
            from tiltcal.bench.terminal import open_terminal

            return open_terminal(stack, plain=plain)
        case "web":
            from tiltcal.bench.web import open_web

            return open_web(stack, say, session, listen=listen, hands_free=hands_free)
        case "sim" if not session.setup.simulated:
            raise UsageError(
                option="operator", why="sim moves virtual sensors only", advice=("give ", Argument("address", "sim:"))
            )
        case "sim":
            return VirtualJig(say)
        case "json":
            return Program(sys.stdin, sys.stdout)
        case str():
            raise UsageError(
                f"there is no operator {chosen!r}: it is {', '.join(NAMED)}, or an object that drives a rig"
            )
    return PythonObject(chosen, "position" if session.setup.steps.positions else "rotation")


def _with_machines(operator: Operator, session: Session, stack: ExitStack) -> Operator:
    """Return an operator that moves the machines of the bench, where it has any and a position is to be set."""
    setup = session.setup
    if not setup.machines or session.finished:
        return operator
    from tiltcal.bench.drives import open_drive
    from tiltcal.bench.machines import Machines, Mover

    movers = [
        Mover(name, machine, session.clock, partial(open_drive, machine, session.clock))
        for name, machine in setup.machines.items()
    ]
    thermometer = any(device.wired.thermometer for device in setup.devices)
    moved = Machines(operator, movers, setup.steps, session.clock, thermometer=thermometer)
    stack.callback(moved.close)
    moved.probe()
    return moved


def run_session(session: Session, operator: Operator) -> dict[str, CalibrationRecord | PairRecord]:
    """Carry a session out, or go on with it, to the end of its journal; return the calibrations that this gives.

    TiltcalError: what stopped it; everything that was measured is in the journal.
    """
    if session.finished:
        return calibrations_of(session.recorded)
    steps = session.setup.steps
    with ExitStack() as stack:
        session.open(stack, operator)
        if isinstance(steps, Rotation) and session.recorded.turned is None:
            from tiltcal.bench.rotation import TurningStage

            TurningStage(session, steps).turn()
        judgement = Judgement(session, operator)
        take = RampLegs(session, steps).take if isinstance(steps, Ramp) else session.attempt
        while not _measured(session, judgement):
            position = session.talk.next
            try:
                take(position)
            except JournalError:
                raise
            except (Unsettled, InputError, HardwareError) as error:
                _refuse(session, position.name, error)
        session.recorded = RecordedSession(Journal(session.files.journal))
        calibrations = calibrations_of(session.recorded)
        session.writer.finish(0)
        session.finished = True
    return calibrations


def _measured(session: Session, judgement: Judgement) -> bool:
    """Return whether all positions are taken and agree, and the files are to be written."""
    if not session.recorded.open:
        judgement.require_agreement()
    if session.recorded.open or session.setup.verifies:
        return not session.recorded.open
    outputs = [session.files.outputs.get(sensor.serial) for sensor in session.sensors.sensors]
    files = [str(output) for output in outputs if output is not None]
    return session.talk.ask(WriteQuestion(files)).answer == "yes"


def _refuse(session: Session, position: str, error: Exception) -> None:
    """Refuse a position, and give up a sensor that has failed too often, or end the session with its error."""
    if isinstance(error, SensorError):
        session.sensors.failed(error)
    session.talk.refuse(position, str(error))
    if isinstance(error, SensorError) and error.serial in session.sensors.lost:
        session.talk.tell(Lost(error.serial, session.sensors.lost[error.serial]))
    if isinstance(error, HardwareError):
        session.clock.sleep(RECOVERY)
