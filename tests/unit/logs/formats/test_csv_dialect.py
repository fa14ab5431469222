"""Logs as programs, phones and Europe write them: other separators, a decimal comma, no header, units in it."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest

from tiltcal.errors import InputError
from tiltcal.logs.columns import locate_columns
from tiltcal.logs.formats.csv import CsvReader
from tiltcal.logs.formats.csv_rows import Dialect, dialect_of
from tiltcal.logs.log import LogSource

NUMBERED = CsvReader(LogSource(BytesIO(b"4,5,6\n7,8,9\n"), "log.txt", "log.txt"))


def table(content: bytes, block: int = 1 << 20, skip_bad_rows: bool = False) -> list[tuple[float, ...]]:
    """All numbers of a log, row by row."""
    log = CsvReader(LogSource(BytesIO(content), "log.txt", "log.txt", skip_bad_rows=skip_bad_rows), block=block)
    every = range(len(log.names))
    return [row for rows in log.rows(every) for row in zip(*(rows.values[k].tolist() for k in every), strict=True)]


@pytest.mark.parametrize(
    ("line", "columns"),
    [
        ("   2.9840000e-02   3.3108000e+04\n", ("1", "2")),
        ("1.5,2,3\r\n", ("1", "2", "3")),
        ("1.5, 2, 3", ("1", "2", "3")),
        ("-1\t2", ("1", "2")),
        ("7", ("1",)),
        ("nan 2", ("1", "2")),
        ("time,x,y", None),
        ("x", None),
        ("1,2,x", None),
        ("", None),
        # Programs that number columns which nobody named write such a header.
        ("0,1,2", None),
        ("1,2,3", None),
        ("0,1,2.0", ("1", "2", "3")),
        # A first row may lack a cell; a table of pandas has no name above its index.
        (",1024,1030,20", ("1", "2", "3", "4")),
        ("7,,1030", ("1", "2", "3")),
        (",0,1,2", None),
        (",,", None),
    ],
)
def test_a_first_line_of_numbers_is_a_row(line: str, columns: tuple[str, ...] | None) -> None:
    dialect = dialect_of(line)
    assert dialect.has_header == (columns is None)
    assert columns is None or dialect.names == columns


@pytest.mark.parametrize("block", [1, 3, 1 << 20])
@pytest.mark.parametrize(
    "content",
    [
        b"time x\n1.5 2\n3 4\n",
        b"# time x\r\n1.5 2\r\n3 4\r\n",
        b"#time\tx\n1.5\t2\n3\t4\n",
        b"  time   x  \n  1.5  2  \n 3 4",
        b"\xef\xbb\xbftime x\n1.5 2\n3 4\n",
    ],
)
def test_names_may_be_parted_by_blanks_too(content: bytes, block: int) -> None:
    log = CsvReader(LogSource(BytesIO(content), "log.txt", "log.txt"), block=block)
    assert log.names == ("time", "x")
    assert log.header == b"time,x"
    values = np.concatenate([np.stack([rows.values[0], rows.values[1]], axis=1) for rows in log.rows([0, 1])])
    assert values.tolist() == [[1.5, 2.0], [3.0, 4.0]]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("time;x\n0,5;1\n1,5;2\n", Dialect(("time", "x"), ";", ",")),
        ("time;x\n1;2\n1;2,5\n", Dialect(("time", "x"), ";", ",")),
        ("time;x\r\n0.5;1\r\n", Dialect(("time", "x"), ";")),
        ("time\tx\n0,5\t1,25\n", Dialect(("time", "x"), "\t", ",")),
        ("Time (s)\tx (m/s^2)\n0.5\t1.25\n", Dialect(("Time (s)", "x (m/s^2)"), "\t")),
        ("0,5;1,25\n1,5;2,5\n", Dialect(("1", "2"), ";", ",", has_header=False)),
        ("a;b,c\n1;2,3\n", Dialect(("a;b", "c"))),
        ("note,x\na;b,1\n", Dialect(("note", "x"))),
    ],
)
def test_the_dialect_is_seen_at_the_top(content: str, expected: Dialect) -> None:
    assert dialect_of(content) == expected


class TestDecimalComma:
    CONTENT = "time;x;note\n0,5;1;a.b\n1,5;-2,5e-1;01.02.2026\n;NA;\n"

    @pytest.mark.parametrize("size", [None, 100])
    def test_numbers_and_text(self, size: int | None) -> None:
        """With the engine, and without it."""
        log = CsvReader(LogSource(BytesIO(self.CONTENT.encode()), "log.csv", "log.csv", size=size))
        (block,) = log.rows([0, 1])
        np.testing.assert_array_equal([block.values[0], block.values[1]], [[0.5, 1.5, np.nan], [1.0, -0.25, np.nan]])

    @pytest.mark.parametrize("cell", ["1.5", "1.234,5", "1,", "1,5,2"])
    def test_a_point_is_none(self, cell: str) -> None:
        """1.234 is more than a thousand where commas are decimal."""
        with pytest.raises(InputError, match=f"log.txt:3: column 'x': '{cell}' is no number"):
            table(f"time;x\n0,5;1,5\n1,5;{cell}\n".encode())


@pytest.mark.parametrize(
    ("name", "unit"),
    [("Acceleration x (m/s^2)", "m/s^2"), ("x [V]", "V"), ("x (left)", None), ("x", None), ("(V)", None)],
)
def test_a_unit_may_stand_in_the_header(name: str, unit: str | None) -> None:
    log = CsvReader(LogSource(BytesIO(f"time,{name}\n0,1\n".encode()), "log.csv", "log.csv"))
    assert log.unit(1) == unit
    bare = name if unit is None else name.partition(" ")[0] if name.startswith("x") else "Acceleration x"
    assert locate_columns(log, ("x",), {"x": bare}) == locate_columns(log, ("x",), {"x": name}) == {"x": 1}
