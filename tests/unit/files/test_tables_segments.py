"""Segments of a recorded log, as CSV and as JSON (SPEC 11, ``fit``)."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.recordings import RECORDINGS, needs

from tiltcal.errors import InputError
from tiltcal.files.tables import Segment, read_segments


def read(tmp_path: Path, text: str) -> list[Segment]:
    path = tmp_path / "seg"
    path.write_text(text)
    return read_segments(path)


def test_csv_with_and_without_directions(tmp_path: Path) -> None:
    text = "position,start,end,gx,gy,gz\r\nx-up, 0,100,2,0,0\r\n0042,100,200,,,\r\n"
    assert read(tmp_path, text) == [Segment("x-up", 0, 100, (1.0, 0.0, 0.0), 2), Segment("0042", 100, 200, None, 3)]


def test_json(tmp_path: Path) -> None:
    text = (
        '[\n\t{"position": "x-up", "start": 5, "end": 9},\n'
        '\t{"position":"b","start":1,"end":5,"gx":0,"gy":0,"gz":-1}\n]'
    )
    assert read(tmp_path, text) == [Segment("x-up", 5, 9, None, 2), Segment("b", 1, 5, (0.0, 0.0, -1.0), 3)]


@needs("ferraris_segments.csv")
def test_real_session() -> None:
    segments = read_segments(RECORDINGS / "ferraris_segments.csv")
    assert [segment.name for segment in segments] == ["x-up", "x-down", "y-up", "y-down", "z-up", "z-down"]
    assert segments[1] == Segment("x-down", 1620, 2361, (-1.0, 0.0, 0.0), 3)


@pytest.mark.parametrize(
    ("text", "line", "key", "about"),
    [
        ("", None, None, "empty"),
        ("position,start,end\n", None, None, "no segment"),
        ("[]", None, None, "no segment"),
        ("position,start\na,1\n", 1, None, "'end' is missing"),
        ("position,strat,end\na,1,2\n", 1, "strat", "did you mean 'start'"),
        ("position,start,end,end\na,1,2,3\n", 1, None, "twice"),
        ("position,start,end\na,1\n", 2, None, "2 fields"),
        ("position,start,end\na,1.5,2\n", 2, "start", "whole number"),
        ("position,start,end\na,one,2\n", 2, "start", "found the text 'one'"),
        ("position,start,end\n\na,,2\n", 3, None, "'start' is missing"),
        ("position,start,end\na,1,2.\n", 2, "end", "found the text '2.'"),
        ("position,start,end\na,-1,2\n", 2, "start", "at least 0"),
        ("position,start,end\na,2,2\n", 2, "end", "not after"),
        ("position,start,end\na,5,9\nb,0,6\n", 2, None, "rows 5 to 5 belong to 'a' and, by line 3, to 'b'"),
        ("position,start,end,gx,gy,gz\na,0,1,1,,0\n", 2, None, "gy is missing"),
        ("position,start,end,gx,gy,gz\na,0,1,0,0,0\n", 2, None, "no direction"),
        ("position,start,end,gx\na,0,1,1\n", 2, None, "gy, gz is missing"),
        ('position,start,end\n"a,0,1\n', 2, None, "not CSV"),
        ('[{"position": "a", "start": "0", "end": 1}]', 1, "[0].start", "found the text '0'"),
        ('[\n{"position": "a", "start": 0}]', 2, "[0]", "'end' is missing"),
        ('{"position": "a"}', 1, None, "a list is needed"),
        ("[1", 1, None, "not JSON"),
    ],
)
def test_error_names_line_and_column(tmp_path: Path, text: str, line: int | None, key: str | None, about: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert (caught.value.file, caught.value.line, caught.value.key) == (str(tmp_path / "seg"), line, key)
    assert about in caught.value.message


def test_rows_that_are_no_file_have_no_lines() -> None:
    rows = [{"position": "a", "start": 5, "end": 9}, {"position": "b", "start": 0, "end": 6}]
    with pytest.raises(InputError, match="rows 5 to 5 belong to 'a' and to 'b'"):
        read_segments(rows)
