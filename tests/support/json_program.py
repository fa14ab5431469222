"""A program that leads a session over JSON Lines, in the process of the session itself.

The session's standard output is an object that answers as soon as a line is complete, so that nothing runs beside the
test and nothing waits.
"""

import io
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from support.command import called

Event = dict[str, Any]

GONE = object()
"""The answer of a program that has closed its stream."""


@dataclass
class ProgramSession:
    """What the program was told, and how the session ended."""

    told: list[Event] = field(default_factory=list)
    errors: str = ""
    exit_code: int = -1

    @property
    def asks(self) -> list[Event]:
        return [message for message in self.told if "ask" in message]

    def events(self, kind: str) -> list[Event]:
        return [message for message in self.told if message.get("event") == kind]


def ready(message: Event) -> Event | None:
    """Take every position that is asked for."""
    return {"answer": "ready"} if "ask" in message else None


def lead(*args: str | Path, cwd: Path, answer: Callable[[Event], object] = ready) -> ProgramSession:
    """Call ``tiltcal`` with ``--operator json``, and answer each message with what a function returns.

    That is an object, a line of text, ``None`` for nothing, or ``GONE``.
    """
    session = ProgramSession()
    reading, writing = os.pipe()
    answers = _Answers(writing, answer, session.told)
    with open(reading, encoding="utf-8") as stdin, answers, io.StringIO() as stderr:
        session.exit_code = called([*args, "--operator", "json"], cwd, stdin, answers, stderr)
        session.errors = stderr.getvalue()
    return session


class _Answers(io.TextIOBase):
    """Standard output of a session: every line is a message, and its answer goes into the pipe."""

    def __init__(self, descriptor: int, answer: Callable[[Event], object], told: list[Event]) -> None:
        self._pipe = open(descriptor, "w", encoding="utf-8")  # noqa: SIM115 (closed with this stream)
        self._answer = answer
        self._told = told
        self._begun = ""

    def write(self, text: str) -> int:
        *lines, self._begun = (self._begun + text).split("\n")
        for line in lines:
            self._told.append(json.loads(line))
            said = self._answer(self._told[-1])
            if said is GONE:
                self._pipe.close()
            elif said is not None:
                self._pipe.write((said if isinstance(said, str) else json.dumps(said)) + "\n")
                self._pipe.flush()
        return len(text)

    def close(self) -> None:
        self._pipe.close()
        super().close()
