"""What a program or a person types line by line, and what the virtual jig says."""

import io
import os

from tiltcal.bench.messages import Accepted, Begin, ShownSensor
from tiltcal.bench.operators import LineReader, VirtualJig


def test_whole_lines_wait_half_ones_do_not_and_the_rest_at_the_end_is_a_line() -> None:
    source, sink = os.pipe()
    with open(source, encoding="utf-8") as stream:
        lines = LineReader(stream)
        assert lines.waiting() == []
        os.write(sink, b"one\ntw")
        assert lines.waiting() == ["one\n"]
        os.write(sink, "o\nthr\u00e9".encode())
        assert lines.waiting() == ["one\n", "two\n"]
        os.close(sink)
        assert [lines.next() for _ in range(4)] == ["one\n", "two\n", "thr\u00e9", ""]
        assert lines.waiting() == []


def test_a_stream_without_a_descriptor_is_read_as_it_is() -> None:
    lines = LineReader(io.StringIO("a\nb"))
    assert lines.waiting() == []
    assert [lines.next(), lines.next(), lines.next()] == ["a\n", "b", ""]


def test_the_virtual_jig_numbers_a_position_that_a_resumed_session_only_reports() -> None:
    """It was accepted before the interruption, so it is not asked for again."""
    said: list[str] = []
    operator, sensors = VirtualJig(said.append), {"S-1": ShownSensor("count", 0.0, 1.0)}
    begin = {"positions": ["first", "level"], "attitudes": {}, "headings": False, "accepted": ["first", "level"]}
    operator.tell(Begin(title="A title", length="2 positions", sensors=sensors, **begin))
    operator.tell(Accepted("level", {"x": 1045.25}, {"x": 0.65}, 20, 24.93))
    assert said[0] == "A title: 2 positions"
    assert said[1].startswith("  2/2 level ")
