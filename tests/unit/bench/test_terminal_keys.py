"""Single keys of a terminal, which is a pty here."""

from __future__ import annotations

import os
import pty
import sys
from collections.abc import Iterator

import pytest

from tiltcal.bench.terminal import ENTER, TerminalKeys
from tiltcal.errors import Stopped


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[TerminalKeys, int]]:
    """Keys of a terminal, and where they are typed."""
    person, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with TerminalKeys() as keys:
            yield keys, person
    os.close(person)


def test_a_key_is_a_choice_at_once(typed: tuple[TerminalKeys, int]) -> None:
    keys, person = typed
    os.write(person, b"B\r")
    assert [keys.choice(1.0), keys.choice(1.0), keys.choice(0.0)] == ["b", ENTER, None]


@pytest.mark.parametrize(
    "sequence", [b"\x1b[B", b"\x1bOQ", b"\x1b[15~", b"\x1b[1;5A", b"\x1b[[B", b"\x1b\x1b[B", b"\x1b"]
)
def test_an_arrow_or_a_function_key_is_no_choice(sequence: bytes, typed: tuple[TerminalKeys, int]) -> None:
    """xterm's down, F2, F5 and Ctrl-up, F2 of the Linux console, Alt-down of rxvt, and the escape key alone."""
    keys, person = typed
    os.write(person, sequence)
    assert keys.choice(1.0) == "\x1b"
    os.write(person, b"r")
    assert keys.choice(1.0) == "r"


def test_the_end_of_the_input_ends_the_session(typed: tuple[TerminalKeys, int]) -> None:
    keys, person = typed
    os.write(person, b"\x04")
    with pytest.raises(Stopped, match="has ended"):
        keys.choice(1.0)
