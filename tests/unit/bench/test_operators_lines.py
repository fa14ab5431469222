"""Lines that are waited for, and lines that are there already."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator

import pytest

from tiltcal.bench.operators import LineReader
from tiltcal.bench.terminal import ENTER, LineKeys
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


def test_at_the_end_nothing_waits_and_the_rest_is_a_line() -> None:
    source, sink = os.pipe()
    with open(source, encoding="utf-8") as stream:
        lines = LineReader(stream)
        os.write(sink, b"rest")
        os.close(sink)
        assert [lines.next(), lines.next(), lines.next()] == ["rest", "", ""]
        assert lines.waiting() == []


def test_a_stream_without_a_descriptor_is_read_as_it_is() -> None:
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
