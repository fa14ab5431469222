"""Journals whose checks fit and whose content no session writes: each is refused in our words, none is a traceback."""

import json
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from support import FIXTURES

from tiltcal.errors import JournalError, TiltcalError
from tiltcal.journal.calibrations import calibrations_of
from tiltcal.journal.header import Setup
from tiltcal.journal.lines import Journal
from tiltcal.journal.session import RecordedSession

WRONG: list[Any] = [None, True, -1, 10**19, 1.5, "x", "zz", "", [], ["x"], {}, {"to": 3}, [[]]]


@cache
def lines_of(name: str) -> list[Any]:
    """The lines of a fixture without their checks and without the end record."""
    values = [json.loads(line) for line in (FIXTURES / f"{name}.journal.jsonl").read_text().splitlines()]
    values[0].pop("check")
    return [values[0], *(value[:-1] for value in values[1:-1])]


def written(path: Path, lines: list[Any]) -> Path:
    """A journal of these lines with checks that fit, made from the documented format."""
    crc, texts = 0, []
    for line in lines:
        body = json.dumps(line, ensure_ascii=False, separators=(",", ":"))
        crc = zlib.crc32(body.encode(), crc)
        check = f',"check":"{crc:08x}"}}' if body.endswith("}") else f',"{crc:08x}"]'
        texts.append(body[:-1] + check + "\n")
    path.write_text("".join(texts))
    return path


def replay(path: Path) -> None:
    calibrations_of(RecordedSession(Journal(path)))


def changed(value: Any, depth: int) -> Iterator[Any]:
    """A value with one of its members, or of theirs, left out or replaced."""
    if depth and isinstance(value, dict):
        for key, member in value.items():
            yield {name: kept for name, kept in value.items() if name != key}
            yield from ({**value, key: one} for one in [*WRONG, *changed(member, depth - 1)])
    if depth and isinstance(value, list):
        for place, member in enumerate(value):
            yield value[:place] + value[place + 1 :]
            yield from ([*value[:place], one, *value[place + 1 :]] for one in [*WRONG, *changed(member, depth - 1)])


def test_events_of_wrong_types_are_refused(tmp_path: Path) -> None:
    """The first event of each kind."""
    lines = lines_of("plane")
    first: dict[str, int] = {}
    for number, line in enumerate(lines[1:], start=1):
        first.setdefault(line[1], number)
    wrong = [
        (number, event) for number in first.values() for event in [lines[number] * 2, *changed(lines[number][:3], 2)]
    ]
    assert len(wrong) > 150
    for number, event in wrong:
        path = written(tmp_path / "plane.journal.jsonl", [*lines[:number], event, *lines[number + 1 : number + 3]])
        with pytest.raises(TiltcalError):
            replay(path)


def test_headers_of_wrong_types_are_refused_or_read(tmp_path: Path) -> None:
    header, *events = lines_of("plane")
    for wrong in changed(header, 2):
        if wrong.get("tiltcal-journal") in (1, 2) and wrong.get("journal") == "plane.journal.jsonl":
            path = written(tmp_path / "plane.journal.jsonl", [wrong, *events[:20]])
            with pytest.raises(TiltcalError):
                replay(path)


@pytest.mark.parametrize("number", ["1" * 400, "1e999", "-1e999", "NaN", "Infinity", "[" * 200_000 + "]" * 200_000])
def test_a_number_that_no_session_has(tmp_path: Path, number: str) -> None:
    """It stands in the header, in its settings, where a float is needed; or there are brackets without end."""
    header = json.dumps(lines_of("plane")[0], separators=(",", ":")).replace('"settle":0.006', f'"settle":{number}')
    assert number in header
    path = tmp_path / "plane.journal.jsonl"
    path.write_text(header[:-1] + f',"check":"{zlib.crc32(header.encode()):08x}"}}\n')
    with pytest.raises(TiltcalError, match=r"jsonl:1: " + ("the line is nested too deeply" if "[" in number else "")):
        replay(path)


@pytest.mark.parametrize("end", [{"events": 1, "sha256": ""}, {"events": 2}, {}])
def test_an_end_record_that_does_not_fit_is_refused(tmp_path: Path, end: dict[str, Any]) -> None:
    header, *events = lines_of("plane")
    path = written(tmp_path / "plane.journal.jsonl", [header, *events[:2], [0, "end", end]])
    with pytest.raises(JournalError, match="jsonl:4: the end record does not fit the lines before it"):
        list(Journal(path))


def test_a_line_without_an_end_is_not_read_into_memory(tmp_path: Path) -> None:
    path = tmp_path / "plane.journal.jsonl"
    with path.open("wb") as stream:
        stream.write(b'{"tiltcal-journal":2,')
        stream.truncate(10**9)  # a sparse file: a gigabyte that takes no room
    with pytest.raises(TiltcalError, match="longer than any of a journal"):
        Journal(path)


def test_a_verification_that_completes_a_calibration_is_refused(tmp_path: Path) -> None:
    header, *events = lines_of("level")
    sensors = [{**sensor, "output": ""} for sensor in header["sensors"]]
    header = {key: value for key, value in header.items() if key != "bases"} | {"sensors": sensors}
    with pytest.raises(JournalError, match=r"header cannot be used: level sets no positions to verify with"):
        Setup.of(Journal(written(tmp_path / "j.jsonl", [header, *events])))


def test_a_mean_that_the_recorded_bytes_do_not_give_is_refused(tmp_path: Path) -> None:
    """As where a driver of another version decodes them otherwise; 1e-9 of a mean is the last digit that JSON keeps."""
    lines = lines_of("plane")
    number = next(number for number, line in enumerate(lines) if number and line[1] == "p")
    (serial, values), *_ = lines[number][2]["sensors"].items()
    for channel, mean in (("x", values["mean"]["x"] * (1 + 1e-7)), ("u", 1.0)):
        other = {**values, "mean": {**values["mean"], channel: mean}}
        wrong = [0, "p", {**lines[number][2], "sensors": {serial: other}}]
        path = written(tmp_path / "plane.journal.jsonl", [*lines[:number], wrong, *lines[number + 1 :]])
        with pytest.raises(
            JournalError, match=rf"jsonl:{number + 1}: accepts .* as {channel} of {serial}, and its sam"
        ):
            replay(path)


@pytest.mark.parametrize(
    ("place", "value", "holds"),
    [(1, "r", "r 0800 d5aa"), (2, "0900", "s 0900 d5aa"), (4, 1, "s 0800 d5aa 1"), (4, 0, "s 0800 d5aa 0")],
)
def test_a_request_that_the_driver_does_not_make_is_named(
    place: int, value: object, holds: str, tmp_path: Path
) -> None:
    """Of another bus, other bytes, or another device, which is written only where it is not the first one."""
    lines = lines_of("plane")
    number = next(number for number, line in enumerate(lines) if number and line[1:] == ["s", "0800", "d5aa"])
    changed = [*lines[number], 0][: 5 if place == 4 else 4]
    changed[place] = value
    path = written(tmp_path / "plane.journal.jsonl", [*lines[:number], changed, *lines[number + 1 :]])
    why = f"jsonl:{number + 1}: the journal holds '{holds}' where the driver sends s 0800: another version"
    with pytest.raises(JournalError, match=why):
        replay(path)
