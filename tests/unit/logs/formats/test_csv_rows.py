"""What a row of a CSV log is, and what is said of one that is none."""

from __future__ import annotations

import csv
import io
import struct
from math import inf, nan
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tiltcal.core.model import Array
from tiltcal.errors import InputError
from tiltcal.logs.formats.csv import CsvReader
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
    @pytest.mark.parametrize(
        ("cell", "value"),
        [
            ("2", 2.0),
            ("-2.5", -2.5),
            ("+2.5e-3", 0.0025),
            ("1E5", 1e5),
            (".5", 0.5),
            ("007", 7.0),
            (" 2.5 ", 2.5),
            ("1e400", inf),
            ("inf", inf),
            ("0.1000000000000000055511151231257827021181583404541015625", 0.1),
        ],
    )
    def test_a_number(self, cell: str, value: float) -> None:
        assert column(f"time,x,y\n1,{cell},3\n".encode()) == [value]

    @pytest.mark.parametrize("cell", ["", " ", "NaN", "nan", "-nan", "NA", "N/A", "null", "NULL", "None"])
    def test_a_missing_value(self, cell: str) -> None:
        assert same(column(f"time,x,y\n1,{cell},3\n1,2,3\n".encode()), [nan, 2.0])

    @pytest.mark.parametrize(
        "cell", ["abc", "2.", "1.e3", "1_000", "0x1F", "1e", "-", ".", "2,5".replace(",", ";"), "٣", "1 2", "--1"]
    )
    def test_anything_else_is_an_error_that_names_file_line_column_and_text(self, cell: str) -> None:
        said = complaint(f"time,x,y\n1,2,3\n1,{cell},3\n".encode())
        assert said == f"night.csv:3: column 'x': {cell!r} is no number"

    def test_columns_that_are_not_needed_may_hold_anything(self) -> None:
        content = "time,x,y\n2026-01-01T00:00:00.5Z,1,.\nvor 2. Mai,2,–\n".encode()
        assert column(content) == [1.0, 2.0]
        assert lines(content) == content.decode().splitlines()[1:]

    @given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=30))
    def test_every_double_comes_back(self, values: list[float]) -> None:
        content = "time,x,y\n" + "".join(f"0,{value!r},0\n" for value in values)
        assert [struct.pack("d", v) for v in column(content.encode())] == [struct.pack("d", v) for v in values]


class TestRowsThatAreNone:
    @pytest.mark.parametrize(
        ("row", "said"),
        [
            (b"1,2", "the row has 2 fields, the header 3"),
            (b"1,2,3,4", "the row has 4 fields, the header 3"),
            (b"1", "the row has 1 field, the header 3"),
            (b"", "the line is empty"),
            (b"1,2\0,3", "the row holds a NUL byte"),
            (b"1,2\r,3", "the row holds a bare CR"),
            (b'"1"x,2,3', "the row cannot be parsed: ',' expected after '\"'"),
            (b'"1",2', "the row has 2 fields, the header 3"),
            (b'1,2,"two\nlines"', "a quoted field does not end in its row: take the line end out of it"),
        ],
    )
    def test_are_named_with_file_and_line(self, row: bytes, said: str) -> None:
        content = b"time,x,y\n1,2,3\n" + row + b"\n4,5,6\n"
        assert complaint(content) == f"night.csv:3: {said}"
        assert complaint(content, block=5) == f"night.csv:3: {said}"

    @pytest.mark.parametrize(
        "tail", [b"2,2.5,2.", b"2,2.5,2.5e", b"2,2.5,-", b"2,2.5,", b"2,2.5", b"2", b'"2",2.5,1e-']
    )
    def test_a_torn_last_row(self, tail: bytes) -> None:
        content = b"time,x,y\n1,2,3\n" + tail
        assert complaint(content) == "night.csv:3: the last row is cut short"
        assert complaint(content, block=4) == "night.csv:3: the last row is cut short"

    @pytest.mark.parametrize("tail", [b"2,2.5,2", b"2,2.5,2.25", b"2,2.5,done", b"2,2.5,2\r"])
    def test_a_last_row_that_only_lacks_its_line_end(self, tail: bytes) -> None:
        assert column(b"time,x,y\n1,2,3\n" + tail) == [2.0, 2.5]


class TestSkippedRows:
    def kept(self, row: bytes) -> tuple[list[str], list[float]]:
        content = b"time,x,y\n1,2,3\n" + row + b"\n4,5,6\n"
        return lines(content, skip=True), column(content, skip=True)

    @pytest.mark.parametrize(
        ("row", "text"),
        [
            (b"1,2", '"1,2",,'),
            (b"", '"",,'),
            (b"1,2,3,4", '"1,2,3,4",,'),
            (b"1,oops,3", '"1,oops,3",,'),
            (b"1,2\0,3", '"1,2\0,3",,'),
            (b'"1"x,2,3', '"""1""x,2,3",,'),
            (b'"1,2",3', '"""1,2"",3",,'),
        ],
    )
    def test_keep_their_text_and_their_place_and_have_no_numbers(self, row: bytes, text: str) -> None:
        texts, numbers = self.kept(row)
        assert texts == ["1,2,3", text, "4,5,6"]
        assert same(numbers, [2.0, nan, 5.0])
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
        monkeypatch.setattr("tiltcal.logs.formats.csv._LONGEST_ROW", 100)
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
        "latin-1": "time,x,y\n20 °C,2,3\n".encode("latin-1"),
        "latin-1 with quotes": 'time,x,y\n"20 °C",2,3\n'.encode("latin-1"),
        "comment signs": b"time,x,y\n#1,2,3\n//,2,3\n",
        "blanks": b"time, x, y\n 1 , 2 , 3 \n",
        "every separator the engine could be given": bytes(range(1, 10))
        + bytes(range(14, 32))
        + b",x,y\n\x1f\x1e,2,3\n",
    }

    @pytest.mark.parametrize("name", CONTENTS)
    @pytest.mark.parametrize("block", [1, 7, 1 << 20])
    def test_passes_through_byte_for_byte(self, name: str, block: int) -> None:
        content = self.CONTENTS[name]
        door = log(content, block=block)
        end = door.line_end.encode()
        found = door.header + end
        for rows in door.rows([1]):
            found += b"".join(line.encode(rows.encoding) + end for line in rows.lines.to_list())
        assert found == content

    def test_a_byte_order_mark_belongs_to_no_name(self) -> None:
        door = log(b"\xef\xbb\xbftime,x,y\n1,2,3\n")
        assert door.names == NAMES
        assert door.header == b"\xef\xbb\xbftime,x,y"


class TestHeader:
    @pytest.mark.parametrize(
        ("content", "said"),
        [
            (b"", "night.csv: the log is empty"),
            (b"\n\n", "night.csv: the log is empty"),
            (b"\xef\xbb\xbf", "night.csv: the log is empty"),
            (b"time,x,y", "night.csv:2: the log has a header and no rows"),
            (b"time,x,y\n\n\n", "night.csv:2: the line is empty"),
            (b"\n1,2,3\n", "night.csv:1: the first line is empty: it must name the columns"),
            (b"time,x,x\n1,2,3\n", "night.csv:1: the header names column 'x' twice: rename one of them"),
            ("time,x,y\n".encode("utf-16"), "night.csv:1: this is no CSV text: save the log as CSV in UTF-8"),
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


@given(st.binary(max_size=200), st.integers(1, 50))
def test_any_bytes_are_rows_or_an_error_of_ours_and_skipping_keeps_every_row(content: bytes, block: int) -> None:
    content = b"time,x,y\n" + content
    try:
        found = [line for rows in log(content, skip=True, block=block).rows([1, 2]) for line in rows.lines.to_list()]
    except InputError:
        return
    body = content.removeprefix(b"time,x,y\n")
    assert len(found) == body.count(b"\n") + (not body.endswith(b"\n"))
