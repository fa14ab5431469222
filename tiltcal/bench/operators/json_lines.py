"""A rig in another process: the asks, answers and events of ``rig.py`` as one JSON object a line."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, TextIO

from tiltcal.bench.operators.line_reader import LineReader
from tiltcal.errors import InputError, Stopped


class JsonLinesRig:
    """A program that speaks JSON Lines on two text streams.

    Parameters
    ----------
    answers : text stream
        What the program says; its end, while it is asked, ends the session.
    asks : text stream
        What the program gets.
    """

    def __init__(self, answers: TextIO, asks: TextIO) -> None:
        self._answers = LineReader(answers)
        self._asks = asks

    def position(self, ask: Mapping[str, Any]) -> object:
        """Ask, and wait for the answer.

        InputError: the line is not JSON.
        Stopped: the program closed its stream, or is gone.
        """
        self._send(ask)
        return self._next()

    rotation = position

    def poll(self) -> object:
        """Return what the program has said without being asked; None where that is nothing."""
        return self._next() if self._answers.waiting() else None

    def accepted(self, event: Mapping[str, Any]) -> None:
        self._send(event)

    waiting = refused = lost = done = turn = held = resumed = accepted

    def _next(self) -> object:
        line = self._answers.next()
        if not line:
            raise Stopped("the operator program closed its answers")
        return parsed(line)

    def _send(self, message: Mapping[str, Any]) -> None:
        try:
            self._asks.write(json.dumps(message, ensure_ascii=False, allow_nan=False) + "\n")
            self._asks.flush()
        except BrokenPipeError:
            raise Stopped("the operator program has ended") from None


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
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise InputError(f"the key {twice[:80]!r} is there twice in one answer: give each key once")
    return found


def _no_constant(name: str) -> float:
    raise ValueError(name)
