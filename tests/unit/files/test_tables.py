"""Small tables in CSV and JSON: positions with means worked out elsewhere, and segments of a log (SPEC 11, ``fit``)."""

from pathlib import Path

import pytest

from tiltcal.errors import InputError
from tiltcal.files.tables import Segment, TabledPosition, read_positions, read_segments


def positions(tmp_path: Path, text: str) -> list[TabledPosition]:
    path = tmp_path / "table"
    path.write_text(text)
    return read_positions(path, ("x", "y"))


def segments(tmp_path: Path, text: str) -> list[Segment]:
    path = tmp_path / "table"
    path.write_text(text)
    return read_segments(path)


def test_everything_that_a_table_of_positions_may_say(tmp_path: Path) -> None:
    text = "position,gx,gy,gz,x,y,ux,uy,n,temperature\nup,0,0,2,1.5,-2,0.1,0.2,100,21.5\n"
    assert positions(tmp_path, text) == [
        TabledPosition("up", (0.0, 0.0, 1.0), {"x": 1.5, "y": -2.0}, {"x": 0.1, "y": 0.2}, 100, 21.5, 2)
    ]
    least = TabledPosition("up", None, {"x": 1.0, "y": 2.0}, None, None, None, 2)
    assert positions(tmp_path, "y,position,x\n2,up,1\n") == [least]
    known = TabledPosition("up", None, {"x": 1.0, "y": 2.0}, None, 3, None, 1)
    assert positions(tmp_path, '[{"position": "up", "x": 1, "y": 2, "n": 3}]') == [known]


def test_segments_with_and_without_directions(tmp_path: Path) -> None:
    text = "position,start,end,gx,gy,gz\r\nx-up, 0,100,2,0,0\r\n0042,100,200,,,\r\n"
    found = [Segment("x-up", 0, 100, (1.0, 0.0, 0.0), 2), Segment("0042", 100, 200, None, 3)]
    assert segments(tmp_path, text) == found
    text = (
        '[\n\t{"position": "x-up", "start": 5, "end": 9},\n'
        '\t{"position":"b","start":1,"end":5,"gx":0,"gy":0,"gz":-1}\n]'
    )
    assert segments(tmp_path, text) == [Segment("x-up", 5, 9, None, 2), Segment("b", 1, 5, (0.0, 0.0, -1.0), 3)]


def test_what_is_wrong_with_positions_is_told_with_its_line(tmp_path: Path) -> None:
    for text, line, about in (
        ("", None, "empty"),
        ("position,x,y\n", None, "no position"),
        ("position,x\nup,1\n", 1, "'y' is missing"),
        ("position,x,y,temp\nup,1,2,3\n", 1, "unknown key 'temp'; known here: position, x, y, gx, gy, gz, ux, uy, n"),
        ("position,x,y\nup,1,\n", 2, "'y' is missing"),
        ("position,x,y,ux\nup,1,2,0.1\n", 2, "uy is missing"),
        ("position,x,y,ux,uy\nup,1,2,0.1,0.1\ndown,1,2,,\n", 3, "down has no uncertainty"),
        ("position,x,y,gx\nup,1,2,1\n", 2, "gy, gz is missing"),
    ):
        with pytest.raises(InputError) as caught:
            positions(tmp_path, text)
        assert (caught.value.file, caught.value.line) == (str(tmp_path / "table"), line), text
        assert about in str(caught.value)


def test_what_is_wrong_with_segments_is_told_with_line_and_column(tmp_path: Path) -> None:
    for text, line, key, about in (
        ("", None, None, "empty"),
        ("position,start,end\n", None, None, "no segment"),
        ("[]", None, None, "no segment"),
        ("position,start\na,1\n", 1, None, "'end' is missing"),
        ("position,start,end,end\na,1,2,3\n", 1, None, "twice"),
        ("position,start,end\na,1\n", 2, None, "2 fields"),
        ("position,start,end\n\na,,2\n", 3, None, "'start' is missing"),
        ("position,start,end\na,2,2\n", 2, "end", "not after"),
        ("position,start,end\na,5,9\nb,0,6\n", 2, None, "rows 5 to 5 belong to 'a' and, by line 3, to 'b'"),
        ("position,start,end,gx,gy,gz\na,0,1,1,,0\n", 2, None, "gy is missing"),
        ("position,start,end,gx,gy,gz\na,0,1,0,0,0\n", 2, None, "no direction"),
        ("position,start,end,gx\na,0,1,1\n", 2, None, "gy, gz is missing"),
        ('position,start,end\n"a,0,1\n', 2, None, "not CSV"),
        ('[\n{"position": "a", "start": 0}]', 2, "[0]", "'end' is missing"),
        ('{"position": "a"}', 1, None, "a list is needed"),
        ("[1", 1, None, "not YAML"),
    ):
        with pytest.raises(InputError) as caught:
            segments(tmp_path, text)
        assert (caught.value.file, caught.value.line, caught.value.key) == (str(tmp_path / "table"), line, key), text
        assert about in caught.value.message


def test_rows_that_are_no_file_have_no_lines() -> None:
    rows = [{"position": "a", "start": 5, "end": 9}, {"position": "b", "start": 0, "end": 6}]
    with pytest.raises(InputError, match="rows 5 to 5 belong to 'a' and to 'b'"):
        read_segments(rows)
