"""The desk: the operator, asked and told through the tape."""

from __future__ import annotations

from collections.abc import Callable

from tiltcal.bench.event_log import EventLog
from tiltcal.bench.operators.answer import OperatorAnswer


class RecordedOperator:
    """Asks and tells, so that a session that is played again asks nobody and tells nothing twice.

    Parameters
    ----------
    tape : EventLog
    """

    def __init__(self, tape: EventLog) -> None:
        self._tape = tape

    def ask(self, question: str, live: Callable[[], OperatorAnswer]) -> OperatorAnswer:
        """An answer from the tape, or else from the operator."""
        return OperatorAnswer.from_record(self._tape.answer(question, lambda: live().record()))

    def poll(self, question: str, look: Callable[[], OperatorAnswer | None]) -> OperatorAnswer | None:
        """What the operator has said without being asked, at its place on the tape; None where that is nothing.

        Parameters
        ----------
        question : str
            What such a word belongs to, other at every place where one may come.
        look : callable
            Returns at once.
        """
        if self._tape.answer_waits(question):
            return OperatorAnswer.from_record(self._tape.answer(question, dict))
        said = None if self._tape.silent else look()
        return None if said is None else self.ask(question, lambda: said)

    def tell(self, tell: Callable[[], None]) -> None:
        """The operator is not told again what it was told before the session was interrupted."""
        if not self._tape.playing:
            tell()
