"""The event log of a session: everything that the session cannot compute passes through it.

A session is a program whose only inputs are the bytes of its buses, the operator's answers and the times of both. All
of them come from the event log. Where the journal has a next event, the log plays it; where it has none, the log lets
the live thing happen and appends it. So recording, replaying and resuming are one path, and cannot differ.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum
from shlex import quote
from typing import Any, ParamSpec

from tiltcal.bench.operators.operator import OperatorAnswer
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.bus.link import CaptureEnded, Continuing, Interruption, Link, Recalling
from tiltcal.errors import BusError, JournalError
from tiltcal.files.journal import ANSWER, HARDWARE_ERROR, LIVE_READING, POSITION, RESUMED, Event, Journal, JournalWriter

P = ParamSpec("P")

REMEMBERED = 32
"""Transactions that a part's registers may depend on: none polls a conversion more often."""


class SessionState(Enum):
    """The position of a session on its event log."""

    PLAYING = "the next event is in the journal"
    RESUMING = "the journal is played, and nothing has happened since"
    LIVE = "what happens is recorded"


class EventLog:
    """Plays a journal to its end, then records what happens live.

    Parameters
    ----------
    clock : Clock
        Stamps live events; is set to the time of each event that is played.
    journal : Journal, optional
        What was captured before.
    writer : JournalWriter, optional
        Where live events go. Without one nothing live may happen: that is a replay.

    Attributes
    ----------
    interruptions : int
        How often the session has been resumed so far.
    """

    def __init__(self, clock: Clock, journal: Journal | None = None, writer: JournalWriter | None = None) -> None:
        self._clock = clock
        self._journal = journal
        self._writer = writer
        self._events: Sequence[Event] = journal.events if journal else ()
        self._next = 0
        self._now_ns = 0
        self.interruptions = 0
        if journal is not None and writer is not None and clock.real:
            self._events = journal.events.followed_by(self._resumption(writer))
        self.state = SessionState.PLAYING if self._events else SessionState.LIVE

    def now_ns(self) -> int:
        """Return the time of the last event, in nanoseconds since the session began."""
        return self._now_ns

    def secure(self) -> None:
        """Wait until all that was recorded is on the disk."""
        if self._writer is not None and self.state is not SessionState.PLAYING:
            self._writer.secure()

    def ask(
        self, question: str, operator: Callable[P, OperatorAnswer], *args: P.args, **kwargs: P.kwargs
    ) -> OperatorAnswer:
        """Return the answer to a question: from the journal, or else from the operator's method.

        Parameters
        ----------
        question : str
            ``position``, ``review``, ``write``, ``rotation`` or a place of :meth:`poll`.
        operator : callable
            Asked with the arguments that follow.
        """
        self._pass_interruptions()
        if self.state is SessionState.PLAYING:
            event = self._play()
            if event.kind != ANSWER or event.payload[0].get("to") != question:
                raise self._mismatch(event, f"the procedure asks for an answer to {question!r}")
            return OperatorAnswer.from_record(event.payload[0])
        self.require_writer()
        answer = operator(*args, **kwargs)
        self.record(ANSWER, {"to": question, **answer.record()})
        return answer

    def poll(self, question: str, operator: Callable[[], OperatorAnswer | None]) -> OperatorAnswer | None:
        """Return what the operator said without being asked, at its place in the journal; None where that is nothing.

        Parameters
        ----------
        question : str
            The identifier of this call in the journal, another one for each place that polls.
        operator : callable
            Returns at once.
        """
        if self.state is SessionState.PLAYING:
            event = self._events[self._next]
            if event.kind != ANSWER or event.payload[0].get("to") != question:
                return None
            return OperatorAnswer.from_record(self._play().payload[0])
        said = operator() if self.state is SessionState.LIVE else None
        if said is not None:
            self.record(ANSWER, {"to": question, **said.record()})
        return said

    def next_question(self) -> str | None:
        """Return the question that the journal answers next; empty before an accepted position, None at the end."""
        for place in range(self._next, len(self._events)):
            event = self._events[place]
            if event.kind in (ANSWER, POSITION):
                return str(event.payload[0].get("to", ""))
        return None

    def report(self, operator: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Report an event to the operator, unless it was reported before the session was interrupted."""
        if self.state is not SessionState.PLAYING:
            operator(*args, **kwargs)

    def live_reading(self) -> None:
        """Note that a reading follows that only the operator looks at."""
        self.require_writer()
        self.record(LIVE_READING)

    def plays_live_reading(self) -> bool:
        """Pass the note of a live reading, where it is the next event."""
        self._pass_interruptions()
        if self.state is not SessionState.PLAYING or self._events[self._next].kind != LIVE_READING:
            return False
        self._play()
        return True

    def position(self, summary: dict[str, Any]) -> None:
        """Note an accepted position, and wait until it is on the disk."""
        self._pass_interruptions()
        if self.state is SessionState.PLAYING:
            event = self._play()
            if event.kind != POSITION or event.payload[0] != summary:
                raise self._mismatch(event, f"the samples give {summary}")
            return
        self.require_writer()
        self.record(POSITION, summary)
        self.secure()

    def finish(self) -> str:
        """End the session; return the SHA-256 of its journal."""
        self._pass_interruptions()
        if self._journal is not None and self._journal.end is not None:
            if self.state is SessionState.PLAYING:
                raise self._mismatch(self._events[self._next], "the procedure is at its end")
            return self._journal.sha256
        self.require_writer()
        return self._writer.finish(0) if self._writer is not None else ""

    def play_transaction(self, letter: str, number: int, out: bytes) -> bytes:
        """Return what a device answered to ``out``, from the journal.

        BusError: it failed when it was captured, or the session was interrupted here.
        JournalError: the journal has something else here.
        """
        event = self._play()
        if event.kind == RESUMED:
            raise Interruption
        sent, device = out.hex(), (number,) if number else ()
        if event.kind == HARDWARE_ERROR and event.payload[0] == sent and event.payload[2:] == device:
            raise BusError(event.payload[1])
        if event.kind != letter or event.payload[0] != sent or event.payload[2:] != device:
            raise self._mismatch(event, f"the driver sends {letter} {sent or 'nothing'}")
        return bytes.fromhex(event.payload[1])

    def record(self, kind: str, *payload: Any) -> None:
        """Append what has just happened."""
        now_ns = max(self._clock.now_ns(), self._now_ns)
        self.state = SessionState.LIVE
        if self._writer is not None:
            self._writer.append(now_ns - self._now_ns, kind, *payload)
        self._now_ns = now_ns

    def require_writer(self) -> None:
        """Refuse that anything live happens in a replay.

        JournalError: the journal ends here, and the session does not.
        """
        if self._writer is None and self._journal is not None:
            path = self._journal.path
            raise JournalError(
                f"the session was interrupted here; `tiltcal check {quote(str(path))}` names the command to continue",
                file=path,
                line=len(self._events) + 1,
            )

    def _resumption(self, writer: JournalWriter) -> Event:
        """Record that the session goes on: at a real bench anything may have happened meanwhile.

        Virtual sensors and their jig stand as they stood; their journals have no such event.
        """
        stopped_ns = sum(event.dt_ns for event in self._events)
        self._clock.seek(stopped_ns)
        pause_ns = max(self._clock.now_ns() - stopped_ns, 0)
        writer.append(pause_ns, RESUMED)
        return Event(len(self._events) + 2, pause_ns, RESUMED, ())

    def _pass_interruptions(self) -> None:
        while self.state is SessionState.PLAYING and self._events[self._next].kind == RESUMED:
            self._play()

    def _play(self) -> Event:
        event = self._events[self._next]
        self._next += 1
        self.interruptions += event.kind == RESUMED
        self._now_ns += event.dt_ns
        self._clock.seek(self._now_ns)
        if self._next == len(self._events):
            self.state = SessionState.RESUMING
        return event

    def _mismatch(self, event: Event, wanted: str) -> JournalError:
        held = " ".join(str(part) for part in (event.kind, *event.payload))
        return JournalError(
            f"the journal holds {held!r} where {wanted}: another version of tiltcal or of the procedure recorded it",
            file=self._journal.path if self._journal else None,
            line=event.line,
        )


class RecordedLink:
    """A link whose transactions are played from, or recorded on, an event log.

    Parameters
    ----------
    connect : callable
        Opens the real link; called when it is first needed.
    letter : str
        The bus in the journal.
    number : int
        The device in the journal.
    """

    def __init__(self, log: EventLog, connect: Callable[[], Link], letter: str, number: int) -> None:
        self.letter = letter
        self._log = log
        self._connect = connect
        self._number = number
        self._live: Link | None = None
        self._played: deque[tuple[bytes, int]] = deque(maxlen=REMEMBERED)
        self._last_answer = b""

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Carry out one transaction; after an error the next one opens the bus anew, so a re-plugged sensor goes on."""
        log = self._log
        if log.state is SessionState.PLAYING:
            try:
                answer = log.play_transaction(self.letter, self._number, out)
            except BusError:
                self._played.clear()
                raise
            self._played.append((out, log.now_ns()))
            self._last_answer = answer or self._last_answer
            return answer
        log.require_writer()
        device = (self._number,) if self._number else ()
        try:
            if self._live is None:
                self._live = self._connect()
                self._restore(self._live)
            answer = self._live.exchange(out, count)
        except BusError as error:
            if not isinstance(error, CaptureEnded):
                self.close()
            self._played.clear()
            log.record(HARDWARE_ERROR, out.hex(), str(error), *device)
            raise
        log.record(self.letter, out.hex(), answer.hex(), *device)
        self._last_answer = answer or self._last_answer
        return answer

    def close(self) -> None:
        if self._live is not None:
            self._live.close()
            self._live = None

    def _restore(self, live: Link) -> None:
        """Send a new twin what the twin before it got, because a real part keeps its registers; continue a capture."""
        if isinstance(live, Continuing) and self._last_answer:
            live.go_on_after(self._last_answer)
        if isinstance(live, Recalling):
            for out, now_ns in self._played:
                live.recall(out, now_ns)
        self._played.clear()


class RecordedClock:
    """The clock that drivers and the runner wait on: while the log plays, real waits are skipped.

    A virtual clock is moved in both cases, so that after the last event that is played it stands where it stood when
    the session was interrupted.
    """

    def __init__(self, log: EventLog, clock: Clock) -> None:
        self._log = log
        self._clock = clock

    def now_ns(self) -> int:
        return self._log.now_ns()

    def sleep(self, seconds: float) -> None:
        if self._log.state is not SessionState.PLAYING or not self._clock.real:
            self._clock.sleep(seconds)

    def seek(self, now_ns: int) -> None:
        self._clock.seek(now_ns)

    @property
    def real(self) -> bool:
        """Whether waiting on it takes time."""
        return self._clock.real
