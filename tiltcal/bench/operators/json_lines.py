"""A program that drives a tilt table or a chamber, over JSON Lines.

One object a line. The bench asks, the program answers; the bench tells what became of it::

    → {"ask": "position", "position": "y-tilt1", "tilt": {"y": 30.0}, "gravity": [0, 0.5, 0.866],
       "heading": 0, "temperature": null, "prompt": "Tilt the +Y side up to 30°"}
    ← {"answer": "ready"}            or {"answer": "ready", "tilt": {"y": 30.02}, "temperature": 5.4}
       or {"answer": "redo" | "back" | "quit"}
    → {"event": "accepted", "position": "y-tilt1", "mean": {...}, "std": {...}, "n": 100}
    → {"event": "refused", "position": "y-tilt1", "why": "..."}      (followed by the same ask)
    → {"event": "lost", "sensor": "A-1006", "why": "..."}           (of several sensors one is given up)
    → {"event": "done", "calibrations": ["S-0042.yaml"], "journal": "..."}

Of a stage that turns, one question, and a word at any time while it turns::

    → {"ask": "rotation", "pairs": [{"pair": ["a1", "a2"], "orthogonal": "a4"}], "turns": 100, "prompt": "..."}
    ← {"answer": "ready"}            or {"answer": "quit"}
    → {"event": "turn", "turn": 12, "of": 100, "p": {"a1_a2": ...}, "q": {...}, "u_p": {...}, "u_q": {...}}
    → {"event": "held", "why": "..."}                                (until {"event": "resumed"})
    ← {"answer": "stop"}             or {"answer": "quit"}           (without being asked)
    → {"event": "accepted", "position": "rotation", "turns": 25.1, "p": {...}, ..., "suppression": {...}}

``redo`` asks for the same position again; ``back`` gives up the position before it and asks for that one.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, TextIO

from tiltcal.bench.operators.answer import OperatorAnswer
from tiltcal.bench.operators.line_reader import LineReader
from tiltcal.bench.operators.operator import Live, MeasuredPosition
from tiltcal.bench.operators.sim_stage import QUESTION, StageTurn
from tiltcal.core.pair.matching import Matching, PairCoefficients
from tiltcal.core.pair.model import Pair
from tiltcal.drivers.device import Reading
from tiltcal.errors import InputError, Stopped
from tiltcal.files.procedure import Position

WORDS = ("ready", "redo", "back", "quit")
TO_TURN = ("ready", "quit")
WHILE_TURNING = ("stop", "quit")
KEYS = {"answer", "tilt", "gravity", "temperature"}


class JsonOperator:
    """Speaks JSON Lines on two text streams.

    Parameters
    ----------
    answers : text stream
        What the program says; its end is taken as ``quit``.
    asks : text stream
        What the program is told.
    """

    def __init__(self, answers: TextIO, asks: TextIO) -> None:
        self._answers = LineReader(answers)
        self._asks = asks

    def begin(self, title: str, positions: int) -> None:
        pass

    def position(self, position: Position, number: int, live: Live) -> OperatorAnswer:
        """Ask until there is an answer that can be understood.

        Raises
        ------
        Stopped
            The program said ``quit``, or closed its stream.
        """
        while True:
            self._tell(
                ask="position",
                position=position.name,
                tilt=position.tilt,
                gravity=[round(component, 9) + 0.0 for component in position.gravity],
                heading=position.heading or 0,
                temperature=position.temperature,
                prompt=position.prompt,
            )
            try:
                return self._answered(WORDS)
            except InputError as error:
                self.refused(position, str(error))

    def look(self, position: Position, readings: Mapping[str, Reading], why: str) -> None:
        pass

    def review(self, position: Position, measured: list[MeasuredPosition]) -> OperatorAnswer:
        return OperatorAnswer("accept")

    def accepted(self, position: Position, measured: list[MeasuredPosition]) -> None:
        first = measured[0]
        told = {"event": "accepted", "position": position.name, **_values(first)}
        if len(measured) > 1:
            told["sensors"] = {one.serial: _values(one) for one in measured}
        self._tell(**told)

    def refused(self, position: Position, why: str) -> None:
        self._tell(event="refused", position=position.name, why=why)

    def lost(self, serial: str, why: str) -> None:
        self._tell(event="lost", sensor=serial, why=why)

    def turning(self, prompt: str, pairs: Sequence[Pair], turns: int) -> OperatorAnswer:
        shown = [{"pair": [pair.first, pair.second], "orthogonal": pair.orthogonal} for pair in pairs]
        while True:
            self._tell(ask=QUESTION, pairs=shown, turns=turns, prompt=prompt)
            try:
                return self._answered(TO_TURN)
            except InputError as error:
                self.turning_refused(str(error))

    def poll(self) -> OperatorAnswer | None:
        while self._answers.waiting():
            try:
                return self._answered(WHILE_TURNING)
            except InputError as error:
                self.turning_refused(str(error))
        return None

    def turned(self, turn: StageTurn) -> None:
        doubts: dict[str, Any] = {"unknown": turn.unknown, "left_out": turn.left_out}
        doubts = {name: doubt for name, doubt in doubts.items() if doubt}
        self._tell(event="turn", turn=turn.number, of=turn.of, **_coefficients(turn.pairs), **doubts)

    def held(self, why: str) -> None:
        self._tell(event="held", why=why)

    def resumed(self) -> None:
        self._tell(event="resumed")

    def turning_refused(self, why: str) -> None:
        self._tell(event="refused", position=QUESTION, why=why)

    def matched(self, turns: float, matchings: Sequence[Matching]) -> None:
        by_name = {one.pair.name: one for one in matchings}
        suppression = {name: one.suppression for name, one in by_name.items()}
        self._tell(event="accepted", position=QUESTION, turns=turns, **_coefficients(by_name), suppression=suppression)

    def write(self, files: list[Path]) -> OperatorAnswer:
        return OperatorAnswer("yes")

    def done(self, files: list[Path], journal: Path) -> None:
        self._tell(event="done", calibrations=[str(path) for path in files], journal=str(journal))

    def _answered(self, words: Sequence[str]) -> OperatorAnswer:
        """The next answer.

        Raises
        ------
        InputError
            It is none of the words.
        Stopped
            It is ``quit``, or the program closed its stream.
        """
        line = self._answers.next()
        if not line:
            raise Stopped("the program that leads the session closed its answers")
        answer = understood(line, words)
        if answer.word == "quit":
            raise Stopped("the program that leads the session said quit")
        return answer

    def _tell(self, **message: Any) -> None:
        try:
            self._asks.write(json.dumps(message, ensure_ascii=False, allow_nan=False) + "\n")
            self._asks.flush()
        except BrokenPipeError:
            raise Stopped("the program that leads the session is gone") from None


def understood(line: str, words: Sequence[str] = WORDS) -> OperatorAnswer:
    """One line of the program as an answer.

    Parameters
    ----------
    line : str
    words : sequence of str
        What may be answered.

    Raises
    ------
    InputError
        It is not an answer; the message says what is wrong with it.
    """
    try:
        said = json.loads(line, parse_constant=_no_constant)
    except (ValueError, RecursionError):
        raise InputError(
            f'not understood: {line.strip()[:80]!r}; an answer is one line such as {{"answer": "ready"}}'
        ) from None
    if not isinstance(said, dict):
        raise InputError('an answer is an object such as {"answer": "ready"}')
    strange = sorted(set(said) - KEYS)
    if strange:
        raise InputError(f"unknown key {strange[0]!r} in the answer; it may have {', '.join(sorted(KEYS))}")
    word = said.get("answer")
    if not isinstance(word, str) or word not in words:
        raise InputError(f"answer {word!r} is none of {', '.join(words)}")
    tilt = said.get("tilt") or {}
    if not isinstance(tilt, dict):
        raise InputError('tilt is an object of degrees such as {"y": 30.02}')
    gravity = said.get("gravity")
    if gravity is not None and not (isinstance(gravity, list) and len(gravity) == 3):
        raise InputError("gravity is a list of three numbers")
    temperature = said.get("temperature")
    return OperatorAnswer(
        word,
        {axis: _number(angle, f"tilt.{axis}") for axis, angle in tilt.items()},
        tuple(_number(component, "gravity") for component in gravity) if gravity is not None else None,
        None if temperature is None else _number(temperature, "temperature"),
    )


def _coefficients(pairs: Mapping[str, PairCoefficients | Matching]) -> dict[str, dict[str, float]]:
    """p, q and their uncertainties, each by the name of the pair."""
    return {key: {name: getattr(one, key) for name, one in pairs.items()} for key in ("p", "q", "u_p", "u_q")}


def _number(value: object, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise InputError(f"{key} in the answer is {value!r}, not a number")
    return float(value)


def _no_constant(name: str) -> float:
    raise ValueError(name)


def _values(measured: MeasuredPosition) -> dict[str, Any]:
    values: dict[str, Any] = {"mean": measured.mean, "std": measured.std, "n": measured.n}
    if measured.temperature is not None:
        values["temperature"] = measured.temperature
    return values
