"""The judgement of a session: positions that contradict the others are taken again.

The positions are judged as the fit judges them, before the operator is asked to write. What contradicts the others is
withdrawn and asked for again; after a few takes without agreement the session stops, and keeps what it has.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.bench.messages import Refused, StopAndKeep
from tiltcal.bench.operators import Operator
from tiltcal.errors import EstimateError, HardwareError, Stopped, TiltcalError, WrongPositions
from tiltcal.journal.calibrations import fitted
from tiltcal.journal.lines import OperatorAnswer

if TYPE_CHECKING:
    from tiltcal.bench.session import Session
    from tiltcal.journal.positions import PositionResult

MOST_TAKES = 3  # takes of one position without agreement, after which the session stops


class Judgement:
    """The judgement of a session's positions before its files are written."""

    def __init__(self, session: Session, operator: Operator) -> None:
        self._session, self._operator = session, operator
        self._takes: dict[str, list[str]] = {}  # what each position read in every take that contradicted the others

    def require_agreement(self) -> None:
        """Withdraw positions that contradict the others as the fit judges it, so that they are asked for again.

        HardwareError: one was taken a few times without agreement, or no position can be taken again.
        EstimateError: what the fit refuses is in no position alone.
        """
        session = self._session
        steps = session.setup.steps
        if not steps.agrees:
            return
        try:
            fitted(session.recorded)
        except EstimateError as error:
            wrong = error.positions if isinstance(error, WrongPositions) else ()
            for result in session.recorded.accepted:
                if result.position.name in wrong:
                    self._takes.setdefault(result.position.name, []).append(_in_words(result))
            most = max(wrong, key=lambda name: len(self._takes[name]), default="")
            if not wrong or steps.why_not_again or len(self._takes[most]) >= MOST_TAKES:
                self._stop(error, most)
                return
            names = self._operator.to_take_again(wrong, [result.position.name for result in session.recorded.accepted])
            for name in names:
                session.talk.note(OperatorAnswer(to="judgement", answer="again", position=name), chooses=False)
            why, _, _ = str(error).partition(":")
            for name in reversed(names):  # the whole reason stands before the next question
                session.talk.tell(Refused(name, str(error) if name == names[0] else why))

    def _stop(self, error: EstimateError, position: str) -> None:
        """Ask whether to stop and keep; return where the operator names a position to take again instead."""
        end: TiltcalError = error
        why = str(error)
        if position:
            *_, before, now = ["", *self._takes[position]]
            jig = "" if self._session.setup.settings.jig else "; no jig is stated"
            if before:
                takes = f"{len(self._takes[position])} takes without agreement: {position} read {now}; before, it read "
                why = f"{takes}{before}; {why}{jig}"
            else:
                why = f"{position} read {now}; {self._session.setup.steps.why_not_again}; {why}{jig}"
            end = HardwareError(why)
        try:
            self._session.talk.ask(StopAndKeep(position, why))
        except Stopped:
            raise end from None
        self._takes.clear()


def _in_words(result: PositionResult) -> str:
    """Return the mean readings of a position by channel, behind the serial number where there are several sensors."""
    several = len(result.measurements) > 1
    return "; ".join(
        " ".join([f"{serial}:"] * several + [f"{name} {one.mean:.6g}" for name, one in measured.summaries.items()])
        for serial, measured in result.measurements.items()
    )
