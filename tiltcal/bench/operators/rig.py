"""A rig: a program or a Python object that sets positions itself, such as a tilt table or a chamber.

A rig is any object with methods of the protocol's names; each takes one dictionary, and returns one where an answer
is due::

    position({"ask": "position", "position": "y-tilt1", "tilt": {"y": 30.0}, "gravity": [0, 0.5, 0.866],
              "heading": 0, "temperature": None, "prompt": "Tilt the +Y side up to 30°"})
        -> {"answer": "ready"}            or {"answer": "ready", "tilt": {"y": 30.02}, "temperature": 5.4}
           or {"answer": "redo" | "back" | "quit"}
    waiting({"event": "waiting", "position": "y-tilt1", "seconds": 60, "why": "...", "temperature": 5.4})
    accepted({"event": "accepted", "position": "y-tilt1", "mean": {...}, "std": {...}, "n": 100})
    refused({"event": "refused", "position": "y-tilt1", "why": "..."})        (followed by the same ask)
    lost({"event": "lost", "sensor": "A-1006", "why": "..."})                 (of several sensors one is given up)
    done({"event": "done", "calibrations": ["S-0042.yaml"], "journal": "..."})

A rig that turns a stage is asked once, and may stop it at any time::

    rotation({"ask": "rotation", "pairs": [{"pair": ["a1", "a2"], "orthogonal": "a4"}], "turns": 100, "prompt": "..."})
        -> {"answer": "ready"}            or {"answer": "quit"}
    poll() -> None, {"answer": "stop"} or {"answer": "quit"}
    turn({"event": "turn", "turn": 12, "of": 100, "p": {"a1_a2": ...}, "q": {...}, "u_p": {...}, "u_q": {...}})
    held({"event": "held", "why": "..."}), resumed({"event": "resumed"})
    accepted({"event": "accepted", "position": "rotation", "turns": 25.1, "p": {...}, ..., "suppression": {...}})

``waiting`` comes once a minute. Only ``position``, or ``rotation``, is needed; an event whose method is missing is left
out. ``redo`` asks for the same position again; ``back`` gives up the position before it and asks for that one. The
position ``tip`` asks once to see that a reading follows, where nothing in a session has changed it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tiltcal.bench.operators.operator import Live, OperatorAnswer, StageTurn
from tiltcal.core.detection import TEMPERATURES
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import InputError, Stopped, UsageError
from tiltcal.files.procedure import Position, Procedure
from tiltcal.stated_arguments import of_python

if TYPE_CHECKING:
    from tiltcal.bench.position_result import PositionResult
    from tiltcal.core.pair.matching import Matching, PairCoefficients
    from tiltcal.core.pair.model import Pair

T = TypeVar("T")

ROTATION = "rotation"
"""The ask of a turning stage, and what its refusals belong to."""

TO_POSITION = ("ready", "redo", "back", "quit")
TO_ROTATION = ("ready", "quit")
WHILE_TURNING = ("stop", "quit")
TILT_AXES = ("x", "y")
KEYS = {"answer", "tilt", "gravity", "temperature"}

WAITING = 60.0
"""Seconds between two events while a chamber soaks or a reading settles."""

REPEATS = 100
"""How often one position, or the stage, is asked for in vain before the session stops."""


class _Rig:
    """The two operators' common part: asks and events as dictionaries."""

    def __init__(self, rig: object) -> None:
        self._rig = rig
        self._repeated = ""
        self._repeats = 0

    def confirm_write(self, files: list[Path]) -> OperatorAnswer:
        return OperatorAnswer("yes")

    def done(self, files: list[Path], journal: Path) -> None:
        self._send("done", calibrations=[str(path) for path in files], journal=str(journal))

    def _method(self, name: str) -> Callable[..., Any]:
        method = getattr(self._rig, name, None)
        if not callable(method):
            raise UsageError(f"the operator ({type(self._rig).__name__}) has no method {name}(ask)")
        return method  # type: ignore[no-any-return]

    def _send(self, event: str, **fields: Any) -> None:
        method = getattr(self._rig, event, None)
        if method is not None:
            method({"event": event, **fields})

    def _ask(self, ask: Mapping[str, Any], words: Sequence[str], about: str) -> OperatorAnswer:
        """Ask until there is an answer that can be understood, with one of these words."""
        method = self._method(ask["ask"])
        return self._understood(lambda: _unless_quit(understood(method(ask), words)), about)

    def _understood(self, answer: Callable[[], T], about: str) -> T:
        """Return an answer; one that cannot be understood is refused and given again."""
        while True:
            try:
                return answer()
            except InputError as error:
                self._refuse(about, str(error))

    def _refuse(self, about: str, why: str) -> None:
        """Refuse what the rig answered or set; it is asked again."""
        self._send("refused", position=about, why=why)
        self._repeat(about, why)

    def _repeat(self, about: str, why: str) -> None:
        """Count that a position, or the stage, has to be asked for again; too often in a row raises Stopped."""
        self._repeats = self._repeats + 1 if about == self._repeated else 1
        self._repeated = about
        if self._repeats == REPEATS:
            raise Stopped(f"{about} was asked for {REPEATS} times in a row in vain, the last time because {why}")

    def _accept(self, event: str, **fields: Any) -> None:
        """Send the event of a success; asks in vain count anew from here on."""
        self._repeated = ""
        self._send(event, **fields)


class RigPositionOperator(_Rig):
    """Asks a rig for positions.

    Parameters
    ----------
    rig : object
        Has ``position(ask)``, and a method for each event that it handles.
    """

    def __init__(self, rig: object) -> None:
        super().__init__(rig)
        self._method("position")
        self._next_event = WAITING

    def begin(self, procedure: Procedure, models: Mapping[str, Model]) -> None:
        pass

    def position(self, position: Position, number: int, live: Live) -> OperatorAnswer:
        ask = {
            "ask": "position",
            "position": position.name,
            "tilt": position.tilt,
            "gravity": [round(component, 9) + 0.0 for component in position.gravity],
            "heading": position.heading or 0,
            "temperature": position.temperature,
            **({} if position.stage is None else {"stage": position.stage}),
            "prompt": position.prompt,
        }
        answer = self._ask(ask, TO_POSITION, position.name)
        self._next_event = WAITING
        if answer.word == "redo":
            self._repeat(position.name, "the program answered redo")
        return answer

    def look(self, position: Position, readings: Mapping[str, Reading], why: str, seconds: float) -> None:
        if seconds >= self._next_event:
            self._next_event = (seconds // WAITING + 1) * WAITING
            temperature = next((one.temperature for one in readings.values() if one.temperature is not None), None)
            self._send("waiting", position=position.name, seconds=round(seconds), why=why, temperature=temperature)

    def review(self, result: PositionResult) -> OperatorAnswer:
        return OperatorAnswer("accept")

    def accepted(self, result: PositionResult) -> None:
        values = {serial: _values(result, serial) for serial in result.measurements}
        event = {"position": result.position.name, **next(iter(values.values()))}
        if len(values) > 1:
            event["sensors"] = values
        self._accept("accepted", **event)

    def refused(self, position: Position, why: str) -> None:
        self._refuse(position.name, why)

    def lost(self, serial: str, why: str) -> None:
        self._send("lost", sensor=serial, why=why)


class RigRotationOperator(_Rig):
    """Asks a rig to turn a stage.

    Parameters
    ----------
    rig : object
        Has ``rotation(ask)``, ``poll()`` where it may stop the stage, and a method for each event that it handles.
    """

    def __init__(self, rig: object) -> None:
        super().__init__(rig)
        self._method(ROTATION)

    def begin(self, title: str) -> None:
        pass

    def turning(self, prompt: str, pairs: Sequence[Pair], turns: int) -> OperatorAnswer:
        shown = [{"pair": [pair.first, pair.second], "orthogonal": pair.orthogonal} for pair in pairs]
        return self._ask({"ask": ROTATION, "pairs": shown, "turns": turns, "prompt": prompt}, TO_ROTATION, ROTATION)

    def poll(self) -> OperatorAnswer | None:
        look = getattr(self._rig, "poll", None)
        if look is None:
            return None

        def answer() -> OperatorAnswer | None:
            said = look()
            return None if said is None else _unless_quit(understood(said, WHILE_TURNING))

        return self._understood(answer, ROTATION)

    def turn_completed(self, turn: StageTurn) -> None:
        remarks: dict[str, Any] = {"unknown": turn.unknown, "left_out": turn.left_out}
        remarks = {name: remark for name, remark in remarks.items() if remark}
        self._accept("turn", turn=turn.number, of=turn.of, **_coefficients(turn.pairs), **remarks)

    def paused(self, why: str) -> None:
        self._send("held", why=why)

    def resumed(self) -> None:
        self._send("resumed")

    def refused(self, why: str) -> None:
        self._refuse(ROTATION, why)

    def matched(self, turns: float, matchings: Sequence[Matching]) -> None:
        by_name = {matching.pair.name: matching for matching in matchings}
        suppression = {name: matching.suppression for name, matching in by_name.items()}
        self._send("accepted", position=ROTATION, turns=turns, **_coefficients(by_name), suppression=suppression)


def understood(said: object, words: Sequence[str] = TO_POSITION) -> OperatorAnswer:
    """Return the answer of what a rig returned; ``words`` are the answers that it may give.

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


def _unless_quit(answer: OperatorAnswer) -> OperatorAnswer:
    """Return an answer; ``quit`` ends the session."""
    if answer.word == "quit":
        raise Stopped("the operator program answered quit")
    return answer


def _values(result: PositionResult, serial: str) -> dict[str, Any]:
    return {key: value for key, value in result.values(serial).items() if value is not None}


def _coefficients(pairs: Mapping[str, PairCoefficients | Matching]) -> dict[str, dict[str, float]]:
    """Return p, q and their uncertainties, each by the name of the pair."""
    return {key: {name: getattr(pair, key) for name, pair in pairs.items()} for key in ("p", "q", "u_p", "u_q")}
