"""A log that is still being written: what has arrived is read, and not one byte more is waited for."""

from __future__ import annotations

from typing import BinaryIO, cast

import polars as pl
import pytest

from tiltcal.logs.formats.csv import CsvReader
from tiltcal.logs.log import LogSource
from tiltcal.logs.text_to_numbers import seconds


class StillWritten:
    """Some bytes; asking for more before they are used would wait for ever."""

    def __init__(self, *arrivals: bytes) -> None:
        self.arrivals = list(arrivals)

    def read(self, size: int) -> bytes:
        if not self.arrivals:
            pytest.fail("waits for more before the rows that have arrived are read")
        return self.arrivals.pop(0)


@pytest.mark.parametrize(
    "arrivals",
    [(b"a,b\n1,2\n",), (b"a,b\n", b"1,2\n"), (b"5,2\n",), (b"5 2\n",), (b"a,b\n1", b",2\n3,")],
    ids=["with its header", "behind its header", "no header", "blanks", "in pieces"],
)
def test_a_row_is_read_when_its_line_ends(arrivals: tuple[bytes, ...]) -> None:
    log = CsvReader(LogSource(cast("BinaryIO", StillWritten(*arrivals)), "log", "log"))
    assert next(log.rows([0, 1])).values[1].tolist() == [2.0]


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("12.5", 12.5),
        ("1970-01-01T00:00:12.5Z", 12.5),
        ("1970-01-01 00:00:12", 12.0),
        ("1970-01-01T02:00:12+02:00", 12.0),
        ("1970-01-01T02:00:12.25+0200", 12.25),
        ("1969-12-31T23:59:59Z", -1.0),
    ],
)
def test_a_time_is_seconds_or_a_moment(cell: str, expected: float) -> None:
    assert seconds(pl.Series([cell, "1.0"])).tolist() == [expected, 1.0]


@pytest.mark.parametrize("cell", ["", "noon", "12:00:00", "2026-02-30T00:00:00Z", "nan"])
def test_what_is_neither_is_missing(cell: str) -> None:
    found = seconds(pl.Series([cell, "1.0"]))
    assert str(found[0]) == "nan"
    assert found[1] == 1.0
