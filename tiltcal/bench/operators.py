"""The operator of a session: a person, a program, a Python object or the virtual jig, asked and told by dictionaries.

A session asks, and the answer is ``{"answer": ...}``; it tells what has happened::

    {"ask": "position", "position": "y-tilt1", "tilt": {"y": 30.0}, "gravity": [0, 0.5, 0.866], "heading": 0,
     "temperature": None, "prompt": "Tilt the +Y side up to 30°"}
        -> {"answer": "ready"}            or {"answer": "ready", "tilt": {"y": 30.02}, "temperature": 5.4}
           or {"answer": "redo" | "back" | "quit"}
    {"event": "waiting", "position": "y-tilt1", "seconds": 60, "why": "...", "temperature": 5.4}
    {"event": "accepted", "position": "y-tilt1", "mean": {...}, "std": {...}, "n": 100}
    {"event": "refused", "position": "y-tilt1", "why": "..."}             (followed by the same question)
    {"event": "lost", "sensor": "A-1006", "why": "..."}                   (of several sensors one is given up)
    {"event": "done", "calibrations": ["S-0042.yaml"], "journal": "..."}

The operator of a turning stage is asked once, and may stop it at any time::

    {"ask": "rotation", "pairs": [{"pair": ["a1", "a2"], "orthogonal": "a4"}], "turns": 100, "prompt": "..."}
        -> {"answer": "ready"}            or {"answer": "quit"}
    {"ask": "poll"} -> nothing, {"answer": "stop"} or {"answer": "quit"}
    {"event": "turn", "turn": 12, "of": 100, "p": {"a1_a2": ...}, "q": {...}, "u_p": {...}, "u_q": {...}}
    {"event": "held", "why": "..."}, {"event": "resumed"}
    {"event": "accepted", "position": "rotation", "turns": 25.1, "p": {...}, ..., "suppression": {...}}

``waiting`` comes once a minute. ``redo`` asks for the same position again; ``back`` gives up the position before it and
asks for that one. The position ``tip`` asks once to see that a reading follows, where nothing in a session has changed
it. A person is asked for a review of each position and before the files are written too, and sees every reading.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import dist
from typing import Any, Protocol, TextIO

from tiltcal.bench.keys import LineReader
from tiltcal.core.attitude import gravity_from_tilt, normalised
from tiltcal.core.detection import TEMPERATURES
from tiltcal.core.rounding import plus_minus
from tiltcal.errors import InputError, Stopped, UsageError
from tiltcal.files.procedure import Position
from tiltcal.stated_arguments import of_python

Message = Mapping[str, Any]

NAMED = ("terminal", "json", "sim")
"""A person, a program over JSON Lines, the virtual jig."""

USUAL = {"position": "ready", "rotation": "ready", "review": "accept", "write": "yes"}
"""The answer to a question that an operator leaves to its default."""

WORDS = {
    "position": ("ready", "redo", "back", "quit"),
    "rotation": ("ready", "quit"),
    "poll": ("stop", "quit"),
    "review": ("accept", "redo", "back", "quit"),
    "write": ("yes", "quit"),
}
"""The answers to each question."""

LOOK = "look"
"""The answer of an operator that wants to see a reading before it is asked again."""

HEARD = ("waiting", "accepted", "refused", "lost", "done", "turn", "held", "resumed")
"""The events that a program gets."""

KEYS = {"answer", "tilt", "gravity", "temperature"}
TILT_AXES = ("x", "y")

REPEATS, VIRTUAL_REPEATS = 100, 10
"""How often one position, or the stage, is asked for in vain before the session stops: the virtual jig does the same
again."""

SAME = 1e-4
"""Directions that differ by less are one, g: 0.006°."""


class Operator(Protocol):
    """Who brings the sensors into position."""

    def ask(self, question: Message) -> object:
        """Return the answer to a question; ``Stopped`` where the operator quits."""
        ...

    def tell(self, event: Message) -> None:
        """Take an event; ``Stopped`` where the operator gives up."""
        ...


@dataclass(frozen=True)
class OperatorAnswer:
    """An answer of the operator, as the journal keeps it.

    Attributes
    ----------
    word : str
        One of :data:`WORDS`.
    tilt : dict of str to float
        Angles actually set, degrees; empty where they are as asked.
    gravity : tuple of float or None
        Direction actually set; None where it is as asked.
    temperature : float or None
        °C, typed; None where it is left to the thermometer.
    """

    word: str
    tilt: dict[str, float] = field(default_factory=dict)
    gravity: tuple[float, ...] | None = None
    temperature: float | None = None

    def as_set(self, position: Position) -> Position:
        """Return a position with the angles and the temperature that the operator actually set.

        InputError: no direction has these angles, or they contradict the direction that was set.
        """
        if self.temperature is not None:
            position = replace(position, temperature=self.temperature if position.temperature is not None else None)
        direction = None if self.gravity is None else normalised(self.gravity)
        if self.tilt:
            tilt = {**(position.tilt or {}), **self.tilt}
            reached = gravity_from_tilt(tilt)
            if direction is not None and min(dist(direction, reached), dist(direction, position.gravity)) > SAME:
                raise InputError(
                    "the answer has a tilt and a gravity that contradict each other: give the one that was reached"
                )
            return replace(position, gravity=reached, tilt=tilt)
        return position if direction is None else replace(position, gravity=direction, tilt=None)

    def record(self) -> dict[str, Any]:
        """Return plain data for the journal."""
        return {
            "answer": self.word,
            **({"tilt": self.tilt} if self.tilt else {}),
            **({"gravity": list(self.gravity)} if self.gravity is not None else {}),
            **({"temperature": self.temperature} if self.temperature is not None else {}),
        }

    @classmethod
    def from_record(cls, record: Message) -> OperatorAnswer:
        """Return the answer of a :meth:`record`."""
        gravity = record.get("gravity")
        tilt, direction = dict(record.get("tilt", {})), None if gravity is None else tuple(gravity)
        return cls(record["answer"], tilt, direction, record.get("temperature"))


def understood(said: object, words: Sequence[str] = WORDS["position"]) -> OperatorAnswer:
    """Return the answer of what an operator said; ``words`` are those that it may give.

    InputError: it is not an answer; the message says what is wrong with it.
    """
    if not isinstance(said, Mapping):
        raise InputError('an answer is an object such as {"answer": "ready"}')
    strange = sorted(str(key) for key in set(said) - KEYS)
    if strange:
        raise InputError(f"unknown key {strange[0]!r} in the answer; it may have {', '.join(sorted(KEYS))}")
    word = said.get("answer")
    if not isinstance(word, str) or word not in words:
        raise InputError(f"answer {word!r} is not one of {', '.join(words)}")
    return OperatorAnswer(
        word, _tilt(said.get("tilt")), _gravity(said.get("gravity")), _temperature(said.get("temperature"))
    )


def _tilt(tilt: object) -> dict[str, float]:
    if tilt is None:
        return {}
    if not isinstance(tilt, Mapping):
        raise InputError('tilt is an object of degrees such as {"y": 30.02}')
    other = [axis for axis in tilt if axis not in TILT_AXES]
    if other:
        raise InputError(f"tilt of {other[0]!r} in the answer: an angle is that of {' or '.join(TILT_AXES)}")
    return {axis: _number(angle, f"tilt.{axis}") for axis, angle in tilt.items()}


def _gravity(gravity: object) -> tuple[float, ...] | None:
    gravity = of_python(gravity)
    if gravity is None:
        return None
    if not (isinstance(gravity, list | tuple) and len(gravity) == 3):
        raise InputError("gravity is a list of three numbers")
    return tuple(_number(component, "gravity") for component in gravity)


def _temperature(value: object) -> float | None:
    if value is None:
        return None
    temperature, (low, high) = _number(value, "temperature"), TEMPERATURES
    if not low <= temperature <= high:
        raise InputError(f"temperature in the answer is {temperature:g} °C, not between {low:g} and {high:g}")
    return temperature


def _number(value: object, key: str) -> float:
    value = of_python(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise InputError(f"{key} in the answer is {value!r}, not a number")
    return float(value)


class Attempts:
    """Counts how often one position, or the stage, is asked for in vain; too often in a row raises ``Stopped``."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._position, self._count = "", 0

    def tell(self, event: Message) -> None:
        """Take an event: a refusal counts, and a success ends the count."""
        if event["event"] == "refused":
            self.repeat(event["position"], event["why"])
        elif event["event"] in ("accepted", "turn"):
            self._position = ""

    def repeat(self, position: str, why: str) -> None:
        """Count that a position has to be asked for again."""
        self._count = self._count + 1 if position == self._position else 1
        self._position = position
        if self._count == self._most:
            raise Stopped(f"{position} was asked for {self._most} times in a row in vain, the last time because {why}")


class VirtualJig:
    """The operator of a virtual bench: the virtual jig has taken the position before it is asked.

    say : callable
        Takes one line of talk.
    """

    def __init__(self, say: Callable[[str], None] = lambda line: None) -> None:
        self._say = say
        self._attempts = Attempts(VIRTUAL_REPEATS)
        self._begin: Message = {}

    def ask(self, question: Message) -> object:
        """Return the usual answer."""
        if question["ask"] == "rotation":
            self._say(f"{len(question['pairs'])} pairs, up to {question['turns']} turns of the virtual stage")
        return {"answer": USUAL[question["ask"]]} if question["ask"] in USUAL else None

    def tell(self, event: Message) -> None:
        """Print what a person would like to read afterwards."""
        for line in self._lines(event):
            self._say(line)
        if event["event"] == "refused" and event["position"] == "rotation":
            raise Stopped(event["why"])  # asked again, the virtual stage would do the same
        self._attempts.tell(event)

    def _lines(self, event: Message) -> Iterator[str]:
        match event["event"]:
            case "begin":
                self._begin = event
                yield ": ".join(filter(None, (event["title"], event["length"])))
            case "accepted" if event["position"] == "rotation":
                yield from (f"  {line}" for line in matched_in_words(event))
            case "accepted":
                names = self._begin["positions"]
                number = f"{names.index(event['position']) + 1:{len(str(len(names)))}}/{len(names)}"
                for serial, values in values_by_serial(event, self._begin).items():
                    stated = (f"{name} {mean:.6g} ± {values['std'][name]:.2g}" for name, mean in values["mean"].items())
                    whose = f"{serial}  " if len(self._begin["sensors"]) > 1 else ""
                    warmth = f"  at {values['temperature']:.1f} °C" if "temperature" in values else ""
                    unit = self._begin["sensors"][serial]["unit"]
                    yield f"  {number} {event['position']:<12} {whose}{'  '.join(stated)} {unit}{warmth}"
            case "refused" if event["position"] != "rotation":
                yield f"  {event['position']} refused: {event['why']}"
            case "lost":
                yield f"  {event['sensor']} is dropped, the others continue: {event['why']}"
            case "turn":
                yield f"  {turn_in_words(event)}"
            case "held":
                yield f"  held: {event['why']}"
            case "resumed":
                yield "  goes on"
            case "done":
                yield from (f"wrote {path}" for path in event["calibrations"])
                yield f"journal {event['journal']}"


class Program:
    """A program that speaks JSON Lines on two text streams; it is asked for positions and rotations alone.

    Parameters
    ----------
    answers : text stream
        What the program says; its end, while it is asked, ends the session.
    questions : text stream
        What the program gets.
    """

    def __init__(self, answers: TextIO, questions: TextIO) -> None:
        self._answers, self._questions = LineReader(answers), questions
        self._attempts = Attempts(REPEATS)

    def ask(self, question: Message) -> object:
        """Ask, and wait for the answer; to a poll return what the program has said without being asked."""
        if question["ask"] in ("review", "write"):
            return {"answer": USUAL[question["ask"]]}
        if question["ask"] == "poll":
            return self._next() if self._answers.waiting() else None
        self._send(question)
        return _counted(self._next(), question, self._attempts)

    def tell(self, event: Message) -> None:
        """Send an event, unless it is for a person's eyes."""
        if event["event"] in HEARD:
            self._send(event)
        self._attempts.tell(event)

    def _next(self) -> object:
        line = self._answers.next()
        if not line:
            raise Stopped("the operator program closed its answers")
        return parsed(line)

    def _send(self, message: Message) -> None:
        try:
            self._questions.write(json.dumps(message, ensure_ascii=False, allow_nan=False) + "\n")
            self._questions.flush()
        except BrokenPipeError:
            raise Stopped("the operator program has ended") from None


class PythonObject:
    """An object with a method for each question that it answers, ``position`` or ``rotation``, and each event."""

    def __init__(self, rig: object, question: str) -> None:
        self._rig = rig
        self._attempts = Attempts(REPEATS)
        if not callable(getattr(rig, question, None)):
            raise UsageError(f"the operator ({type(rig).__name__}) has no method {question}(ask)")

    def ask(self, question: Message) -> object:
        """Return what the method returns."""
        name = question["ask"]
        if name == "poll":
            return self._rig.poll() if hasattr(self._rig, "poll") else None
        if name in ("review", "write"):
            return {"answer": USUAL[name]}
        return _counted(getattr(self._rig, name)(question), question, self._attempts)

    def tell(self, event: Message) -> None:
        """Call the method of an event that a program gets, where the object has it."""
        if event["event"] in HEARD and hasattr(self._rig, event["event"]):
            getattr(self._rig, event["event"])(event)
        self._attempts.tell(event)


def _counted(said: object, question: Message, attempts: Attempts) -> object:
    """Return an answer; one that has the position asked for again counts as an attempt in vain."""
    if isinstance(said, Mapping) and said.get("answer") == "redo" and question["ask"] == "position":
        attempts.repeat(question["position"], "the program answered redo")
    return said


def parsed(line: str) -> object:
    """Return the JSON of one line.

    InputError: it is not JSON, or an object has a key twice.
    """
    try:
        return json.loads(line, parse_constant=_no_constant, object_pairs_hook=_once)
    except (ValueError, RecursionError):
        raise InputError(
            f'not understood: {line.strip()[:80]!r}; an answer is one line such as {{"answer": "ready"}}'
        ) from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the object of these keys and values; an InputError where a key is there twice."""
    members = dict(pairs)
    if len(members) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise InputError(f"the key {twice[:80]!r} is there twice in one answer: give each key once")
    return members


def _no_constant(name: str) -> float:
    raise ValueError(name)


def values_by_serial(event: Message, begin: Message) -> Mapping[str, Message]:
    """Return mean, std, n and temperature of each sensor of an accepted position, by serial number."""
    return event["sensors"] if "sensors" in event else {next(iter(begin["sensors"])): event}


def turn_in_words(event: Message) -> str:
    """Return a turn of a stage in a line, with p and q of each pair by then."""
    parts = [f"turn {event['turn']} of {event['of']}", *_pairs_in_words(event)]
    parts += [f"{name}: {why}" for name, why in event.get("unknown", {}).items()]
    if event.get("left_out"):
        parts.append(f"{event['left_out']} samples left out")
    return "   ".join(parts)


def matched_in_words(event: Message) -> list[str]:
    """Return p and q of each matched pair in a line."""
    return [f"{pair} after {event['turns']:.1f} turns" for pair in _pairs_in_words(event)]


def _pairs_in_words(event: Message) -> list[str]:
    p, q, u_p, u_q = (event[key] for key in ("p", "q", "u_p", "u_q"))
    return [f"{name}: p {plus_minus(p[name], u_p[name])}, q {plus_minus(q[name], u_q[name])}" for name in p]
