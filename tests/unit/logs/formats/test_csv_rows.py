"""What a row of a CSV log is, how a log is written, and what is said of what is none."""

import csv
import io
import random
from hashlib import sha256
from io import BytesIO
from math import inf, nan
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.row_grammar import cells_of, readings_of
from tiltcal.core.model import Array
from tiltcal.dialect import Dialect
from tiltcal.errors import InputError
from tiltcal.log_head import dialect_of
from tiltcal.logs.formats import csv_rows
from tiltcal.logs.formats.csv import CsvReader
from tiltcal.logs.formats.csv_rows import RowGrammar
from tiltcal.logs.log import LogSource

NAMES = ("time", "x", "y")


def log(content: bytes, *, skip: bool = False, block: int = 1 << 20) -> CsvReader:
    return CsvReader(LogSource(io.BytesIO(content), "night.csv", "night.csv", skip_bad_rows=skip), block=block)


def column(content: bytes, name: str = "x", *, skip: bool = False, block: int = 1 << 20) -> list[float]:
    door = log(content, skip=skip, block=block)
    index = door.names.index(name)
    return [value for rows in door.rows([index]) for value in rows.values[index].tolist()]


def lines(content: bytes, *, skip: bool = False, block: int = 1 << 20) -> list[str]:
    return [line for rows in log(content, skip=skip, block=block).rows([1]) for line in rows.lines.to_list()]


def complaint(content: bytes, block: int = 1 << 20) -> str:
    with pytest.raises(InputError) as raised:
        column(content, block=block)
    return str(raised.value)


def same(found: Array | list[float], expected: list[float]) -> bool:
    return np.array_equal(np.array(found), np.array(expected), equal_nan=True)


class TestNumbers:
    def test_a_number_or_a_missing_value(self) -> None:
        cells = {"2": 2.0, "-2.5": -2.5, "+2.5e-3": 0.0025, "1E5": 1e5, ".5": 0.5, "007": 7.0, " 2.5 ": 2.5}
        cells |= {"1e400": inf, "inf": inf, "0.1000000000000000055511151231257827021181583404541015625": 0.1}
        cells |= dict.fromkeys(["", " ", "NaN", "nan", "-nan", "NA", "N/A", "null", "NULL", "None"], nan)
        for cell, value in cells.items():
            assert same(column(f"time,x,y\n1,{cell},3\n1,2,3\n".encode()), [value, 2.0]), cell

    def test_anything_else_is_an_error_that_names_file_line_column_and_text(self) -> None:
        for cell in ("abc", "2.", "1.e3", "1_000", "0x1F", "1e", "-", ".", "2;5", "٣", "1 2", "--1"):
            said = complaint(f"time,x,y\n1,2,3\n1,{cell},3\n".encode())
            assert said == f"night.csv:3: column 'x': {cell!r} is no number"


class TestRowsThatAreNone:
    @pytest.mark.parametrize(
        ("row", "said"),
        [
            (b"1,2", "the row has 2 fields, the header 3"),
            (b"1,2,3,4", "the row has 4 fields, the header 3"),
            (b"1", "the row has 1 field, the header 3"),
            (b"1,2\n1,2,3,4", "the row has 2 fields, the header 3"),
            (b"6,7,8,9\n4,5\n1,2,", "the row has 4 fields, the header 3"),
            (b"1,2\0,3", "the row holds a NUL byte or a bare CR"),
            (b"1,2\r,3", "the row holds a NUL byte or a bare CR"),
            (
                b'"1"x,2,3',
                "the row cannot be parsed, a line end inside quotes being none of it: ',' expected after '\"'",
            ),
            (b'"1",2', "the row has 2 fields, the header 3"),
            (
                b'1,2,"two\nlines"',
                "the row cannot be parsed, a line end inside quotes being none of it: unexpected end of data",
            ),
        ],
    )
    def test_are_named_with_file_and_line(self, row: bytes, said: str) -> None:
        content = b"time,x,y\n1,2,3\n" + row + b"\n4,5,6\n"
        assert complaint(content) == f"night.csv:3: {said}"
        assert complaint(content, block=5) == f"night.csv:3: {said}"

    def test_a_torn_last_row(self) -> None:
        """It is kept as missing and said, with and without --skip-bad-rows."""
        for tail in (b"2,2.5,2.", b"2,2.5,2.5e", b"2,2.5,-", b"2,2.5,", b"2,2.5", b"2", b'"2",2.5,1e-'):
            for block in (4, 1 << 20):
                door = log(b"time,x,y\n1,2,3\n" + tail, block=block)
                assert same([value for rows in door.rows([1]) for value in rows.values[1]], [2.0, nan]), tail
                assert door.remarks == ["1 row cut short while it was written: kept as missing"]

    def test_a_comment_as_long_as_a_row(self) -> None:
        for content in (b"#1,5,3\n4,2,5\n", b"4,2,5\n#1,5,3\n", b"4,2,5\n// 1,5,3\n"):
            door = log(b"time,x,y\n" + content)
            assert [value for rows in door.rows([1]) for value in rows.values[1]] == [2.0]
            assert door.remarks == ["1 line between the rows left out: 1 comment"]

    def test_a_last_row_that_only_lacks_its_line_end(self) -> None:
        for tail in (b"2,2.5,2", b"2,2.5,2.25", b"2,2.5,done", b"2,2.5,2\r"):
            assert column(b"time,x,y\n1,2,3\n" + tail) == [2.0, 2.5], tail


class TestSkippedRows:
    def test_keep_their_text_and_their_place_and_have_no_numbers(self) -> None:
        rows = {b"1,2": '"1,2",,', b"1,2,3,4": '"1,2,3,4",,', b"1,oops,3": '"1,oops,3",,'}
        rows |= {b"1,2\0,3": '"1,2\0,3",,', b'"1"x,2,3': '"""1""x,2,3",,', b'"1,2",3': '"""1,2"",3",,'}
        for row, text in rows.items():
            content = b"time,x,y\n1,2,3\n" + row + b"\n4,5,6\n"
            assert lines(content, skip=True) == ["1,2,3", text, "4,5,6"]
            assert same(column(content, skip=True), [2.0, nan, 5.0])
            assert len(next(csv.reader([text]))) == 3

    @pytest.mark.parametrize(
        ("content", "line"),
        [
            (b"time,x,y\n1,2,3\n" + b"1" * 500, 3),
            (b"\0" * 500, 1),
        ],
    )
    def test_what_does_not_end_is_refused_before_it_fills_the_memory(
        self, content: bytes, line: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("tiltcal.logs.formats.csv_text._LONGEST_ROW", 100)
        stream = io.BytesIO(content)
        with pytest.raises(InputError, match="does not end") as raised:
            list(CsvReader(LogSource(stream, "night.csv", "night.csv", skip_bad_rows=True), block=20).rows([1]))
        assert raised.value.line == line
        assert stream.tell() < 200


class TestText:
    CONTENTS: ClassVar = {
        "quotes": b'time,x,y\n"a, ""b""",2,3\n"two, commas",5,6\n7" pipe,8,9\n',
        "crlf": b"time,x,y\r\n1,2,3\r\n4,5,6\r\n",
        "quotes and crlf": b'time,x,y\r\n"1",2,3\r\n"4,4",5,6\r\n',
        "utf-8": "time,x,y\n20 °C,2,3\n".encode(),
        "comment signs": b"time,x,y\n1,2,#3\n1,2,//\n",
        "blanks": b"time, x, y\n 1 , 2 , 3 \n",
        "every separator the engine could be given": bytes(range(1, 10))
        + bytes(range(14, 32))
        + b",x,y\n\x1f\x1e,2,3\n",
    }

    @pytest.mark.parametrize("block", [1, 7, 1 << 20])
    def test_passes_through_byte_for_byte_in_utf_8(self, block: int) -> None:
        latin = ['time,x,y °\n20 °C,2,3\n"°",2,3\n'.encode("latin-1")]
        for content in (*self.CONTENTS.values(), *latin):
            door = log(content, block=block)
            end = door.text.line_end.encode()
            rows = [line.encode() for rows in door.rows([1]) for line in rows.lines.to_list()]
            assert door.sha256 == sha256(content).hexdigest()
            found = b"".join(line + end for line in (door.header, *rows))
            assert found == (content.decode("latin-1").encode() if content in latin else content)

    @pytest.mark.parametrize("block", [2, 7, 1 << 20])
    def test_a_mark_belongs_to_no_name_and_utf_16_needs_none(self, block: int) -> None:
        for encoding, mark in (("UTF-16-le", b"\xff\xfe"), ("UTF-16-be", b"\xfe\xff"), ("UTF-8", b"\xef\xbb\xbf")):
            for begin in (b"", mark):
                door = log(begin + "time,x,y°\r\n1,2,3\n4,5,6".encode(encoding), block=block)
                assert (door.names, door.text.encoding) == (("time", "x", "y°"), encoding[:6].rstrip("-"))
                assert door.header == (begin if encoding == "UTF-8" else b"") + "time,x,y°".encode()
                rows = [row for block in door.rows([1]) for row in zip(block.values[1], block.lines, strict=True)]
                assert rows == [(2.0, "1,2,3"), (5.0, "4,5,6")]


class TestHeader:
    @pytest.mark.parametrize(
        ("content", "said"),
        [
            (b"", "night.csv: the log is empty"),
            (b"\n\n", "night.csv: the log is empty"),
            (b"\xef\xbb\xbf", "night.csv: the log is empty"),
            (b"time,x,y", "night.csv:2: the log has a header and no rows"),
            (b"time,x,y\n\n\n", "night.csv:4: the log has a header and no rows"),
            (
                b"a night\ntime,x,x\n1,2,3\n4,5,6\n",
                "night.csv:2: the header names column 'x' twice: rename one of them",
            ),
            (b"x\0,y\n1,2\n", "night.csv:1: this is no CSV text: save the log as CSV in UTF-8"),
            (b"time,x,y\r1,2,3\r", "night.csv:1: the lines end in CR alone: save the log with LF or CRLF"),
        ],
    )
    def test_what_is_no_log(self, content: bytes, said: str) -> None:
        with pytest.raises(InputError) as raised:
            list(log(content).rows([]))
        assert str(raised.value) == said


plain_cells = st.text(st.characters(codec="utf-8", exclude_characters='\0\r\n,"'), max_size=6)
any_cells = st.text(st.characters(codec="utf-8", exclude_characters="\0\r\n"), max_size=6)
numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(
    rows=st.lists(st.tuples(any_cells, numbers, plain_cells), min_size=1, max_size=20),
    block=st.integers(1, 60),
    end=st.sampled_from(["\n", "\r\n"]),
)
@example(rows=[('"', 0.0, "")], block=1, end="\n")
def test_what_the_csv_module_writes_is_read_whatever_the_block(
    rows: list[tuple[str, float, str]], block: int, end: str
) -> None:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator=end)
    writer.writerow(NAMES)
    writer.writerows(rows)
    content = text.getvalue().encode()
    assert column(content, block=block) == [number for _, number, _ in rows]
    kept = end.join(["time,x,y", *lines(content, block=block), ""])
    assert kept.encode() == content


STATION_COLUMNS = ("time", "station", "x", "y")
ODD = ("", "NaN", "na", "N/A", "-inf", "2.", ".5", "1e", "1e5", " 1.5", "2.5\t", "abc", "0x1", "--1", "1e400", "1.5.2")
STATIONS = (("North", "Süd"), ('"N, 1"', "plain"), ('"say ""no"""', '""'), ('"a;b"', "c"), ("st. 1", ""))


def odd_log(seed: int) -> tuple[bytes, str]:
    """Return a log and its rows as text: mostly plain rows, and now and then one that is odd or bad."""
    draw = random.Random(seed)
    rate, stations, end = draw.choice([0.0, 0.01, 0.2]), draw.choice(STATIONS), draw.choice(["\n", "\r\n"])
    rows = []
    for _ in range(draw.choice([1, 30, 200])):
        readings = [
            draw.choice(ODD) if draw.random() < rate else draw.choice([f"{draw.gauss(2.5, 1):.5f}", "17", "1.5e-3"])
            for _ in range(3)
        ]
        row = [readings[0], draw.choice(stations), *readings[1:]]
        row = draw.choice([row[:3], [*row, "9"], ["\0", *row[1:]], []]) if draw.random() < rate / 4 else row
        rows.append(",".join(row) + end)
    rows.append(f"1,{stations[0]},2,3{end}")
    text = "".join(rows)
    return (",".join(STATION_COLUMNS) + end + text).encode(draw.choice(["utf-8", "latin-1"])), text


@pytest.mark.parametrize("seed", range(16))
def test_the_numbers_and_the_bad_rows_are_those_of_the_written_rule(seed: int) -> None:
    content, text = odd_log(seed)
    block = random.Random(seed).choice([200, 2_000, 1 << 20])
    source = LogSource(io.BytesIO(content), "night.csv", "night.csv", skip_bad_rows=True)
    values: dict[int, list[float]] = {2: [], 3: []}
    bad: set[int] = set()
    for rows in CsvReader(source, block=block).rows([2, 3]):
        bad |= {len(values[2]) + row for row in rows.faults}
        for column, numbers in values.items():
            numbers.extend(rows.values[column].tolist())
    expected, expected_bad = readings_of(text, len(STATION_COLUMNS), [2, 3])
    assert bad == expected_bad
    np.testing.assert_array_equal([values[2], values[3]], expected)


@pytest.mark.parametrize(
    "data",
    [
        b"1,a,2.5,3\n2,b.1,-.5,4e3\n",
        b"1,N 1,2.5,3\n2,,NaN,4\n",
        b"1,a,2.5,\n2,b,3.5,\n",
        b"1,st. Mary,NA,\n2,b, 3.5,\n",
    ],
)
def test_sound_rows_take_the_short_way(data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(RowGrammar, "by_line")
    monkeypatch.setattr(csv_rows, "_PIECE", 5)
    found = RowGrammar(Dialect(STATION_COLUMNS), [2], texts=[1]).at_once(data)
    (expected,), _ = readings_of(data.decode(), len(STATION_COLUMNS), [2])
    np.testing.assert_array_equal(found.values[2], expected)
    assert [text or "" for text in found.texts[1].to_list()] == [row[1] for row in cells_of(data.decode())]
    assert found.lines.to_list() == data.decode().replace("\r", "").split("\n")[:-1]
    for end in ("", " mg"):
        rows = f"x: 1.5 y: 2.5{end}\nx: 1.6 y: 2.6{end}\n"
        assert table(rows.encode()) == [(1.5, 2.5), (1.6, 2.6)]
    assert log(b'{"a,x": 1.5, "y": 2}\n{"a,x": 2.5, "y": 3}\n').header == b'"a,x",y'


def test_lines_of_another_kind_are_left_out_where_they_come_again() -> None:
    row, other = b"x: 1.5 y: 2.5\n", b"error: 5 of 7\n"
    assert len(table(3 * row + 2 * other + 9 * row)) == 12
    assert "night.csv:4: the row has 1 field" in complaint(3 * row + other + 9 * row)


def table(content: bytes, block: int = 1 << 20, skip_bad_rows: bool = False) -> list[tuple[float, ...]]:
    """All numbers of a log, row by row."""
    log = CsvReader(LogSource(BytesIO(content), "log.txt", "log.txt", skip_bad_rows=skip_bad_rows), block=block)
    every = range(len(log.names))
    return [row for rows in log.rows(every) for row in zip(*(rows.values[k].tolist() for k in every), strict=True)]


def test_a_first_line_of_numbers_is_a_row() -> None:
    headers = ("time,x,y", "x")
    counted = ("0,1,2", "1,2,3", ",0,1,2")  # as programs number columns that nobody named
    rows = {
        "   2.9840000e-02   3.3108000e+04\n": 2,
        "1.5,2,3\r\n": 3,
        "1.5, 2, 3": 3,
        "-1\t2": 2,
        "7": 1,
        "2026-05-01T12:00:00,5\n2026-05-01T12:00:01,6": 2,
        "nan 2": 2,
        "0,1,2.0": 3,
        ",1024,1030,20": 4,
        "7,,1030": 3,  # a first row may lack a cell
    }
    for line in (*headers, *counted):
        assert (dialect_of(line.splitlines()).has_header, dialect_of(line.splitlines()).first) == (True, 1), line
    for line, columns in rows.items():
        assert not dialect_of(line.splitlines()).has_header, line
        assert dialect_of(line.splitlines()).names == tuple(str(1 + k) for k in range(columns))
    for first, second, decimal in (("1,234", "5", "."), ("1,5", "2.5", "."), ("1,5", "2", ","), ("1,23", "1,234", ",")):
        assert dialect_of(["x,y", *[f'"{first}","{second}"'] * 3]).decimal == decimal
    assert dialect_of(["7,abc", "5,2", "3,4", "5,6"]).first == 1
    above = ["x,y", "begun at noon", "right,left", "1,2", "3,4"]
    assert (dialect_of(above).names, dialect_of(above).first) == (("right", "left"), 3)
    for marked, comments in ((6, ("#", "//", "%")), (7, ("//", "%"))):  # as most lines begin
        assert dialect_of(["1,2"] * 6 + ["#3,4"] * marked).comments == comments


def test_the_dialect_is_seen_at_the_top() -> None:
    for content, (names, separator, decimal, header, blanks) in {
        "time;x\n0,5;1\n1,5;2\n": (("time", "x"), ";", ",", True, False),
        "time;x\n1;2\n1;2,5\n": (("time", "x"), ";", ",", True, False),
        "time;x\n0.5;1\n": (("time", "x"), ";", ".", True, False),
        "time\tx\n0,5\t1,25\n": (("time", "x"), "\t", ",", True, False),
        "Time (s)\tx (m/s^2)\n0.5\t1.25\n": (("Time (s)", "x (m/s^2)"), "\t", ".", True, False),
        "time\tx\ty\n0\t1.25\t\n": (("time", "x", "y"), "\t", ".", True, False),
        "0\t1.25\t7\n1\t\t7\n": (("1", "2", "3"), "\t", ".", False, False),
        "time\t\tx\n0.5\t\t1.25\n": (("time", "x"), ",", ".", True, True),
        "time x\ty\n0.5 1.25\t7\n": (("time", "x", "y"), ",", ".", True, True),
        "0,5;1,25\n1,5;2,5\n": (("1", "2"), ";", ",", False, False),
        "note,x\na;b,1\n": (("note", "x"), ",", ".", True, False),
        "x,y,7\n1,2,3\n4,5,6\n": (("x", "y", "7"), ",", ".", True, False),
        "time,x,\n0,1\n1,2\n": (("time", "x"), ",", ".", True, False),
    }.items():
        found = dialect_of(content.splitlines())
        assert (found.names, found.separator, found.decimal) == (names, separator, decimal)
        assert (found.has_header, found.has_blanks, found.first) == (header, blanks, int(header))


def test_a_point_is_none_where_commas_are_decimal() -> None:
    """1.234 is more than a thousand there."""
    for cell in ("1.5", "1.234,5", "1,", "1,5,2"):
        with pytest.raises(InputError, match=f"log.txt:3: column 'x': '{cell}' is no number"):
            table(f"time;x\n0,5;1,5\n1,5;{cell}\n".encode())


def test_rows_without_a_value_below_the_names_are_rows() -> None:
    assert same(column(b"x,y\n,\n,\n1,2\n"), [nan, nan, 1.0])
    assert same(column(b"x,y\nV,V\n,\n1,2\n"), [nan, 1.0])
