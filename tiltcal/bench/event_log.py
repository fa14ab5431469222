"""The tape: everything a session cannot know beforehand passes through it.

A session is a program whose only inputs are the bytes of its buses, the operator's answers and the times of both. All
of them come from the tape. Where the journal has a next event, the tape plays it; where it has none, the tape lets
the live thing happen and appends it. So recording, replaying and resuming are one path, and cannot differ.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.bus.link import Link, Recalling
from tiltcal.errors import BusError, JournalError
from tiltcal.files.journal import ANSWER, HARDWARE_ERROR, POSITION, RESUMED, Event, Journal, JournalWriter

Answer = dict[str, Any]

REMEMBERED = 32
"""Transactions that a part's registers may depend on: none polls a conversion more often."""


class Resumed(Exception):
    """The session was interrupted here."""


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
    """

    def __init__(self, clock: Clock, journal: Journal | None = None, writer: JournalWriter | None = None) -> None:
        self._clock = clock
        self._journal = journal
        self._events: tuple[Event, ...] = journal.events if journal else ()
        self._next = 0
        self._writer = writer
        self._now_ns = 0
        self._recorded = False
        # Virtual sensors and their jig stand as they stood; at a real bench anything may have happened meanwhile.
        self._resuming = clock.real and writer is not None and journal is not None

    @property
    def playing(self) -> bool:
        """Whether the next event comes from the journal."""
        return self._next < len(self._events)

    @property
    def resumed_before_here(self) -> bool:
        """Whether what happened last was captured before, and the session goes on from it: played, or resumed here."""
        return self.playing or (self._journal is not None and self._writer is not None and not self._recorded)

    @property
    def silent(self) -> bool:
        """Whether nothing live may be heard yet: it plays, or it has still to note that the session goes on here."""
        return self.playing or self._resuming

    def now_ns(self) -> int:
        """Time of the last event, in nanoseconds since the session began."""
        return self._now_ns

    def next_is_answer(self) -> bool:
        """Whether the next event in the journal is an operator's answer."""
        return self.playing and self._events[self._next].kind == ANSWER

    def answer_waits(self, question: str) -> bool:
        """Whether the next event in the journal is an answer to this question."""
        return self.next_is_answer() and self._events[self._next].payload[0].get("to") == question

    def secure(self) -> None:
        """Have all that was recorded on the disk."""
        if self._writer is not None and not self.playing:
            self._writer.secure()

    def link(self, live: Callable[[], Link], letter: str, number: int) -> RecordedLink:
        """A link that goes through this tape; ``live`` opens the real one when it is first needed."""
        return RecordedLink(self, live, letter, number)

    def exchange(self, letter: str, number: int, out: bytes, live: Callable[[], bytes]) -> bytes:
        """One bus transaction.

        Raises
        ------
        BusError
            It failed, now or when it was captured.
        JournalError
            The journal has something else here.
        Resumed
            The session was interrupted here, and the bench may have been touched since.
        """
        if self._paused():
            raise Resumed
        sent = out.hex()
        device = (number,) if number else ()
        if self.playing:
            event = self._play()
            if event.kind == HARDWARE_ERROR and event.payload[0] == sent and event.payload[2:] == device:
                raise BusError(event.payload[1])
            if event.kind != letter or event.payload[0] != sent or event.payload[2:] != device:
                raise self._mismatch(event, f"the driver sends {letter} {sent or 'nothing'}")
            return bytes.fromhex(event.payload[1])
        self._require_writer()
        try:
            answer = live()
        except BusError as error:
            self._record(HARDWARE_ERROR, sent, str(error), *device)
            raise
        self._record(letter, sent, answer.hex(), *device)
        return answer

    def answer(self, question: str, live: Callable[[], Answer]) -> Answer:
        """What the operator answers to a question (``position``, ``review``, ``write``)."""
        self._pass_pauses()
        if self.playing:
            event = self._play()
            if event.kind != ANSWER or event.payload[0].get("to") != question:
                raise self._mismatch(event, f"the procedure asks for an answer to {question!r}")
            recorded: Answer = event.payload[0]
            return {key: value for key, value in recorded.items() if key != "to"}
        self._require_writer()
        given = live()
        self._record(ANSWER, {"to": question, **given})
        return given

    def position(self, summary: dict[str, Any]) -> None:
        """Note an accepted position, and have all before it on the disk."""
        self._pass_pauses()
        if self.playing:
            event = self._play()
            if event.kind != POSITION or event.payload[0] != summary:
                raise self._mismatch(event, f"the samples give {summary}")
            return
        self._require_writer()
        self._record(POSITION, summary)
        if self._writer is not None:
            self._writer.secure()

    def finish(self) -> str:
        """End the session; the SHA-256 of its journal."""
        self._pass_pauses()
        if self._journal is not None and self._journal.end is not None:
            if self.playing:
                raise self._mismatch(self._events[self._next], "the procedure is at its end")
            return self._journal.sha256
        self._require_writer()
        return self._writer.finish(0) if self._writer is not None else ""

    def _paused(self) -> bool:
        """Whether the session was interrupted at this point; a live one notes that it goes on here."""
        if self.playing:
            if self._events[self._next].kind != RESUMED:
                return False
            self._play()
            return True
        if self._resuming:
            self._resuming = False
            self._record(RESUMED)
            return True
        return False

    def _pass_pauses(self) -> None:
        while self._paused():
            pass

    def _play(self) -> Event:
        event = self._events[self._next]
        self._next += 1
        self._now_ns += event.dt_ns
        self._clock.seek(self._now_ns)
        return event

    def _record(self, kind: str, *payload: Any) -> None:
        now_ns = max(self._clock.now_ns(), self._now_ns)
        self._recorded = True
        if self._writer is not None:
            self._writer.append(now_ns - self._now_ns, kind, *payload)
        self._now_ns = now_ns

    def _require_writer(self) -> None:
        if self._writer is None and self._journal is not None:
            path = self._journal.path
            raise JournalError(
                f"the session was interrupted here; go on with it: tiltcal measure --resume {path}",
                file=path,
                line=len(self._events) + 1,
            )

    def _mismatch(self, event: Event, wanted: str) -> JournalError:
        held = " ".join(str(part) for part in (event.kind, *event.payload))
        return JournalError(
            f"the journal holds {held!r} where {wanted}: another version of tiltcal or of the procedure captured it",
            file=self._journal.path if self._journal else None,
            line=event.line,
        )


class RecordedLink:
    """A link whose transactions are played from, or recorded on, a tape."""

    def __init__(self, tape: EventLog, live: Callable[[], Link], letter: str, number: int) -> None:
        self._tape = tape
        self._open = live
        self._live: Link | None = None
        self._number = number
        self._played: deque[tuple[bytes, int]] = deque(maxlen=REMEMBERED)
        self.letter = letter

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """One transaction; after an error the next one opens the bus anew, so a re-plugged sensor goes on."""
        playing = self._tape.playing
        try:
            answer = self._tape.exchange(self.letter, self._number, out, lambda: self._exchange(out, count))
        except BusError:
            self._played.clear()
            raise
        if playing:
            self._played.append((out, self._tape.now_ns()))
        return answer

    def close(self) -> None:
        if self._live is not None:
            self._live.close()
            self._live = None

    def _exchange(self, out: bytes, count: int) -> bytes:
        try:
            if self._live is None:
                self._live = self._open()
                self._remind(self._live)
            return self._live.exchange(out, count)
        except BusError:
            self.close()
            raise

    def _remind(self, live: Link) -> None:
        """A new twin hears what was sent to the one before it; a real part has heard it."""
        if isinstance(live, Recalling):
            for out, now_ns in self._played:
                live.recall(out, now_ns)
        self._played.clear()


class RecordedClock:
    """The clock that drivers and the runner wait on: while the tape plays, real waits are skipped.

    A virtual clock is moved in both cases, so that after the last event that is played it stands where it stood when
    the session was interrupted.
    """

    def __init__(self, tape: EventLog, clock: Clock) -> None:
        self._tape = tape
        self._clock = clock

    def now_ns(self) -> int:
        return self._tape.now_ns()

    def sleep(self, seconds: float) -> None:
        if not self._tape.playing or not self._clock.real:
            self._clock.sleep(seconds)

    def seek(self, now_ns: int) -> None:
        self._clock.seek(now_ns)

    @property
    def real(self) -> bool:
        """Whether waiting on it takes time."""
        return self._clock.real
