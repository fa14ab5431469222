"""The operator of a session: a program, a Python object or the virtual jig; a person has modules of their own."""

from __future__ import annotations

import json
import os
import select
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from queue import SimpleQueue
from threading import Thread
from typing import Protocol, TextIO

import msgspec

from tiltcal.bench import messages
from tiltcal.bench.typed import with_numbers
from tiltcal.core.detection import TEMPERATURES
from tiltcal.core.rounding import plus_minus
from tiltcal.errors import InputError, Stopped, UsageError
from tiltcal.files.document import document_of
from tiltcal.journal.lines import OperatorAnswer
from tiltcal.stated_arguments import of_python

NAMED = ("terminal", "web", "json", "sim")  # a person at the terminal or at a page, a program, the virtual jig
NAMES = ("ready", "again")  # the answers that may name a position

LOOK = "look"  # the answer of an operator that wants to see a reading before it is asked again
CHUNK = LONGEST = 1 << 16  # bytes that are read at once, and of a line without an end that are kept


class Operator(Protocol):
    """Who brings the sensors into position.

    A session stops after ``most_attempts`` failures in a row at one position or at the stage; None is never.
    ``watches`` is whether it is shown every reading, ``speaks_unasked`` whether it may answer while one settles.
    """

    most_attempts: int | None = None
    watches: bool = False
    speaks_unasked: bool = False

    def ask(self, question: messages.Question) -> object:
        """Return the answer to a question; Stopped where the operator quits."""
        ...

    def tell(self, event: messages.SessionEvent) -> None:
        """Take an event; Stopped where the operator gives up."""
        ...

    def to_take_again(self, wrong: Sequence[str], taken: Sequence[str]) -> Sequence[str]:
        """Return which of the positions ``taken`` are to be taken again where some contradict the others."""
        return wrong


def understood(said: object, words: Sequence[str] = messages.PositionQuestion.words) -> OperatorAnswer:
    """Return the answer of what an operator said; ``words`` are those that it may give.

    InputError: it is not an answer; the message says what is wrong with it.
    """
    if isinstance(said, Mapping):
        said = with_numbers({key: of_python(value) for key, value in said.items()})
    answer = document_of(said, "the answer").read(OperatorAnswer)
    if answer.answer not in words:
        raise InputError(f"answer {answer.answer!r} is not one of {', '.join(words)}")
    if (answer.answer == "again" and not answer.position) or (answer.position and answer.answer not in NAMES):
        raise InputError(f"the answer {answer.answer!r} names {'no' if answer.position else 'the'} position")
    low, high = TEMPERATURES
    if answer.temperature is not None and not low <= answer.temperature <= high:
        raise InputError(f"temperature in the answer is {answer.temperature:g} °C, not between {low:g} and {high:g}")
    return answer


class LineReader:
    """The lines of a text stream, waited for or taken where they have arrived.

    It reads the stream's descriptor itself, because Python's buffer cannot be asked without waiting; nothing else may
    read the stream. A stream without a descriptor is read as it is, and has nothing ready. Where select takes sockets
    alone, as on Windows, a thread reads the descriptor.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._ready: deque[str] = deque()
        self._rest = b""
        self._ended = False
        self._pieces: SimpleQueue[bytes] | None = None
        try:
            self._descriptor: int | None = stream.fileno()
        except (OSError, ValueError):
            self._descriptor = None
        if self._descriptor is not None and not hasattr(select, "poll"):
            self._pieces = SimpleQueue()
            Thread(target=self._fetch, args=(self._descriptor, self._pieces), daemon=True).start()

    def next(self) -> str:
        """Wait for the next line and return it with its end; empty at the end of the stream."""
        if self._descriptor is None:
            return self._stream.readline()
        while not self._ready and not self._ended:
            self._read(self._descriptor)
        return self._ready.popleft() if self._ready else ""

    def waiting(self) -> list[str]:
        """Return the lines that have arrived; they stay."""
        if self._descriptor is None or self._ended:
            return list(self._ready)
        if not self._pieces.empty() if self._pieces else select.select([self._descriptor], [], [], 0.0)[0]:
            self._read(self._descriptor)
        return list(self._ready)

    @staticmethod
    def _fetch(descriptor: int, pieces: SimpleQueue[bytes]) -> None:
        with suppress(OSError):  # closed
            while arrived := os.read(descriptor, CHUNK):
                pieces.put(arrived)
        pieces.put(b"")

    def _read(self, descriptor: int) -> None:
        arrived = self._pieces.get() if self._pieces else os.read(descriptor, CHUNK)
        self._ended = not arrived
        *lines, rest = (self._rest + arrived).split(b"\n")
        self._rest = b"" if self._ended else rest[:LONGEST]
        self._ready.extend(line.decode(errors="replace") + "\n" for line in lines)
        if self._ended and rest:
            self._ready.append(rest.decode(errors="replace"))


class VirtualJig(Operator):
    """The operator of a virtual bench, whose jig has taken the position before it is asked; ``say`` takes its talk."""

    most_attempts = 10  # asked again, it does the same again
    _begin: messages.Begin

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say

    def ask(self, question: messages.Question) -> object:
        """Return the usual answer."""
        if isinstance(question, messages.RotationQuestion):
            self._say(f"{len(question.pairs)} pairs, up to {question.turns} turns of the virtual stage")
        return usual(question)

    def tell(self, event: messages.SessionEvent) -> None:
        """Print what a person would like to read afterwards."""
        match event:
            case messages.Begin():
                self._begin = event
                self._say(": ".join(filter(None, (event.title, event.length))))
            case messages.Accepted():
                for line in self._measured(event):
                    self._say(line)
            case messages.Refused("rotation"):
                raise Stopped(event.why)  # asked again, the virtual stage would do the same
            case messages.Refused():
                self._say(f"  {event.position} refused: {event.why}")
            case _:
                for line in in_words(event):
                    self._say(line)

    def _measured(self, event: messages.Accepted) -> Iterator[str]:
        """Yield mean and scatter of each sensor of an accepted position."""
        names, sensors = self._begin.positions, self._begin.sensors
        number = f"{names.index(event.position) + 1:{len(str(len(names)))}}/{len(names)}"
        for serial, one in event.by_serial(sensors).items():
            stated = (f"{name} {mean:.6g} ± {one.std[name]:.2g}" for name, mean in one.mean.items())
            whose = f"{serial}  " if len(sensors) > 1 else ""
            warmth = "" if one.temperature is None else f"  at {one.temperature:.1f} °C"
            warmth += "".join(f"  {axis} set {angle:+.4f}°" for axis, angle in (event.reference or {}).items())
            yield f"  {number} {event.position:<12} {whose}{'  '.join(stated)} {sensors[serial].unit}{warmth}"


class Program(Operator):
    """A program that speaks JSON Lines on two text streams; it is asked for positions and rotations alone.

    The end of its ``answers``, while it is asked, ends the session.
    """

    most_attempts = 100
    speaks_unasked = True

    def __init__(self, answers: TextIO, questions: TextIO) -> None:
        self._answers, self._questions = LineReader(answers), questions

    def ask(self, question: messages.Question) -> object:
        """Ask, and wait for the answer; to a poll return what the program has said without being asked."""
        if isinstance(question, messages.Poll):
            return self._next() if self._answers.waiting() else None
        if not question.heard:
            return self._again() or usual(question)
        self._send(question)
        return self._next()

    def tell(self, event: messages.SessionEvent) -> None:
        """Send an event, unless it is for a person's eyes."""
        if event.heard:
            self._send(event)

    def _again(self) -> object:
        """Return the answer ``again``, which may come unasked; any other waits for its question."""
        for line in self._answers.waiting()[:1]:
            with suppress(InputError):
                if again(parsed(line)):
                    return self._next()
        return None

    def _next(self) -> object:
        line = self._answers.next()
        if not line:
            raise Stopped("the operator program closed its answers")
        return parsed(line)

    def _send(self, message: messages.Message) -> None:
        try:
            self._questions.write(json.dumps(message.as_data(), ensure_ascii=False, allow_nan=False) + "\n")
            self._questions.flush()
        except BrokenPipeError:
            raise Stopped("the operator program has ended") from None


class PythonObject(Operator):
    """An object with a method for each question that it answers, ``position`` or ``rotation``, and each event.

    Its ``poll`` is called while a stage turns, and while a reading settles, where it may answer ``again``.
    """

    most_attempts = 100
    speaks_unasked = True

    def __init__(self, rig: object, question: str) -> None:
        self._rig = rig
        if not callable(getattr(rig, question, None)):
            raise UsageError(f"the operator ({type(rig).__name__}) has no method {question}(ask)")

    def ask(self, question: messages.Question) -> object:
        """Return what the method returns."""
        if isinstance(question, messages.Poll | messages.Settling):
            said = self._rig.poll() if hasattr(self._rig, "poll") else None
            return said if isinstance(question, messages.Poll) or again(said) else None
        if question.heard:
            return getattr(self._rig, question.kind)(question.as_data())
        return usual(question)

    def tell(self, event: messages.SessionEvent) -> None:
        """Call the method of an event that a program gets, where the object has it."""
        if event.heard and hasattr(self._rig, event.kind):
            getattr(self._rig, event.kind)(event.as_data())


def usual(question: messages.Question) -> object:
    """Return the usual answer to a question; nothing where nobody has to answer."""
    return {"answer": question.usual} if question.usual else None


def again(said: object) -> bool:
    """Return whether an answer asks to take an accepted position again."""
    return isinstance(said, Mapping) and said.get("answer") == "again"


def parsed(line: str) -> object:
    """Return the JSON of one line; an InputError where it is none."""
    try:
        return msgspec.json.decode(line)
    except (ValueError, RecursionError, msgspec.MsgspecError):
        raise InputError(
            f'not understood: {line.strip()[:80]!r}; an answer is one line such as {{"answer": "ready"}}'
        ) from None


def in_words(event: messages.SessionEvent) -> list[str]:
    """Return what has happened as lines for a person."""
    match event:
        case messages.Matched():
            return [f"  matched {pair} after {event.turns:.1f} turns" for pair in _pairs_in_words(event)]
        case messages.Accepted():
            return [f"  accepted {event.position}"]
        case messages.Refused():
            return [f"  refused: {event.why}"]
        case messages.Lost():
            return [f"  {event.sensor} is dropped, the others continue: {event.why}"]
        case messages.TurnMade():
            parts = [f"  turn {event.turn} of {event.of}", *_pairs_in_words(event)]
            parts += [f"{name}: {why}" for name, why in event.unknown.items()]
            parts += [f"{event.left_out} samples left out"] if event.left_out else []
            return ["   ".join(parts)]
        case messages.Moved():
            return [f"  {event.why}"]
        case messages.Held():
            return [f"  held: {event.why}"]
        case messages.Resumed():
            return ["  goes on"]
        case messages.Done():
            return [*(f"wrote {path}" for path in event.calibrations), f"journal {event.journal}"]
    return []


def _pairs_in_words(event: messages.Matched | messages.TurnMade) -> list[str]:
    p, q, u_p, u_q = event.p, event.q, event.u_p, event.u_q
    return [f"{name}: p {plus_minus(p[name], u_p[name])}, q {plus_minus(q[name], u_q[name])}" for name in p]
