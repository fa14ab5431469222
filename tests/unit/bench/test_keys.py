"""What is typed: lines that are waited for or there already, and single keys of a terminal, which is a pty here."""

from __future__ import annotations

import io
import os
import pty
import sys
from collections.abc import Iterator

import pytest
from tiltcal.bench.keys import ENTER, LineKeys, LineReader, TerminalKeys

from tiltcal.errors import Stopped


@pytest.fixture
def pipe() -> Iterator[tuple[int, io.TextIOWrapper]]:
    """The end that is written to, and the stream that is read."""
    source, sink = os.pipe()
    with open(source, encoding="utf-8") as stream:
        yield sink, stream
    os.close(sink)


def test_whole_lines_wait_and_half_ones_do_not(pipe) -> None:
    sink, stream = pipe
    lines = LineReader(stream)
    assert lines.waiting() == []
    os.write(sink, b"one\ntw")
    assert lines.waiting() == ["one\n"]
    os.write(sink, "o\nthr\u00e9".encode())
    assert lines.waiting() == ["one\n", "two\n"]
    assert lines.next() == "one\n"
    os.write(sink, b"e\n")
    assert [lines.next(), lines.next()] == ["two\n", "thr\u00e9e\n"]


def test_the_rest_at_the_end_is_a_line_and_a_stream_without_a_descriptor_is_read_as_it_is() -> None:
    source, sink = os.pipe()
    with open(source, encoding="utf-8") as stream:
        lines = LineReader(stream)
        os.write(sink, b"rest")
        os.close(sink)
        assert [lines.next(), lines.next(), lines.next()] == ["rest", "", ""]
        assert lines.waiting() == []
    lines = LineReader(io.StringIO("a\nb"))
    assert lines.waiting() == []
    assert [lines.next(), lines.next(), lines.next()] == ["a\n", "b", ""]


def test_a_key_is_taken_where_it_waits_and_other_lines_are_left(pipe) -> None:
    sink, stream = pipe
    keys = LineKeys(stream)
    os.write(sink, b"\n\n")
    assert keys.pressed("sq") is None
    os.write(sink, b"stop\ny\n")
    # What was typed before the key was typed in vain.
    assert keys.pressed("sq") == "s"
    assert keys.pressed("sq") is None
    assert keys.choice(None) == "y"
    os.write(sink, b"\n")
    assert keys.choice(None) == ENTER


def test_the_end_of_the_input_is_told_when_a_question_is_asked() -> None:
    source, sink = os.pipe()
    os.close(sink)
    with open(source, encoding="utf-8") as stream:
        keys = LineKeys(stream)
        assert keys.pressed("sq") is None
        with pytest.raises(Stopped, match="the input has ended"):
            keys.choice(None)


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
