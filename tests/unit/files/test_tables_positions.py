"""A table of positions: means worked out elsewhere (SPEC 4, ``fit``)."""

from __future__ import annotations

from pathlib import Path

import pytest

from tiltcal.errors import InputError
from tiltcal.files.tables import TabledPosition, read_positions


def read(tmp_path: Path, text: str, channels: tuple[str, ...] = ("x", "y")) -> list[TabledPosition]:
    path = tmp_path / "means.csv"
    path.write_text(text)
    return read_positions(path, channels)


def test_everything_that_a_table_may_say(tmp_path: Path) -> None:
    text = "position,gx,gy,gz,x,y,ux,uy,n,temperature\nup,0,0,2,1.5,-2,0.1,0.2,100,21.5\n"
    assert read(tmp_path, text) == [
        TabledPosition("up", (0.0, 0.0, 1.0), {"x": 1.5, "y": -2.0}, {"x": 0.1, "y": 0.2}, 100, 21.5, 2)
    ]


def test_the_least(tmp_path: Path) -> None:
    assert read(tmp_path, "y,position,x\n2,up,1\n") == [
        TabledPosition("up", None, {"x": 1.0, "y": 2.0}, None, None, None, 2)
    ]


def test_json(tmp_path: Path) -> None:
    assert read(tmp_path, '[{"position": "up", "x": 1, "y": 2, "n": 3}]') == [
        TabledPosition("up", None, {"x": 1.0, "y": 2.0}, None, 3, None, 1)
    ]


@pytest.mark.parametrize(
    ("text", "line", "about"),
    [
        ("", None, "empty"),
        ("position,x,y\n", None, "no position"),
        ("position;x;y\nup;1;2\n", 1, "is a single column: separate the columns with commas"),
        ("position,x\nup,1\n", 1, "'y' is missing"),
        ("position,x,y,temp\nup,1,2,3\n", 1, "unknown key 'temp'"),
        ("position,x,y\nup,1,two\n", 2, "found the text 'two'"),
        ("position,x,y\nup,1,\n", 2, "'y' is missing"),
        ("position,x,y,ux\nup,1,2,0.1\n", 2, "uy is missing"),
        ("position,x,y,ux,uy\nup,1,2,0.1,0\n", 2, "0"),
        ("position,x,y,ux,uy\nup,1,2,0.1,0.1\ndown,1,2,,\n", 3, "down has no uncertainty"),
        ("position,x,y,gx\nup,1,2,1\n", 2, "gy, gz is missing"),
        ("position,x,y,n\nup,1,2,0\n", 2, "at least 1"),
        ("position,x,y,temperature\nup,1,2,-300\n", 2, "-273.15"),
    ],
)
def test_error_names_line(tmp_path: Path, text: str, line: int | None, about: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert (caught.value.file, caught.value.line) == (str(tmp_path / "means.csv"), line)
    assert about in str(caught.value)
