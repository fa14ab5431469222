"""A short log comes out as the engine would have it, or goes to the engine."""

from __future__ import annotations

import io
from math import inf, nan

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.logs.formats.csv_rows import parse_rows
from tiltcal.logs.formats.csv_short import short_rows, short_text

NAMES = ("time", "x", "note")

CELLS = [
    "1",
    "-2.5",
    "+.5",
    "1e-3",
    "2.",
    "1e400",
    "inf",
    "NaN",
    "n/a",
    "",
    " 7 ",
    "\t8",
    "1_0",
    "0x1",
    "abc",
    "1e",
    "٣",
]
ODD_CELLS = ['"a"', '"a,b"', 'a"', "\r", "\0", "\x0b1", "\xa01", "é", "٣", ",", "\n", "\r\n", "\n\n"]


@given(
    st.lists(st.lists(st.sampled_from(CELLS), min_size=3, max_size=3), min_size=1, max_size=4),
    st.lists(st.tuples(st.integers(0, 20), st.sampled_from(ODD_CELLS)), max_size=1),
    st.sampled_from(["\n", "\r\n"]),
    st.booleans(),
)
def test_what_is_parsed_is_what_the_engine_parses(
    rows: list[list[str]], odd: list[tuple[int, str]], line_end: str, unended: bool
) -> None:
    text = "".join(",".join(row) + line_end for row in rows)
    for place, cell in odd:
        text = text[:place] + cell + text[place:]
    data = text.removesuffix(line_end).encode() + b"\n" if unended else text.encode()
    found = short_rows(data, len(NAMES), [0, 1], unended=unended)
    if found is None:
        return
    theirs = parse_rows(data, NAMES, [0, 1], unended=unended)
    assert not theirs.faults
    assert (list(found.lines), found.line_count) == (list(theirs.lines), theirs.line_count)
    for index, values in theirs.values.items():
        np.testing.assert_array_equal(found.values[index], values)


def test_plain_rows_are_parsed_here() -> None:
    found = short_rows(b"0.01,1024,still\r\n0.02, NaN,\r\n", 3, [0, 1])
    assert found is not None
    assert found.text == ["0.01,1024,still", "0.02, NaN,"]
    np.testing.assert_array_equal(found.values[1], [1024.0, nan])


@pytest.mark.parametrize(
    "line",
    ['1,2,"a"', "1,2", "1,2,3,4", "", "1,2.,3", "1,a,3", "1,1e400,3", "1,1_0,3", "1,2,\xe9", "1,2,\r3", "1,2,\0"],
)
def test_an_odd_row_goes_to_the_engine(line: str) -> None:
    assert short_rows(f"1,2,3\n{line}\n1,2,3\n".encode(), 3, [0, 1]) is None


def test_a_cut_last_row_goes_to_the_engine() -> None:
    assert short_rows(b"1,2,3\n1,2,3.\n", 3, [0, 1], unended=True) is None
    assert short_rows(b"1,2,3\n1,2,3.\n", 3, [0, 1]) is not None


def test_numbers_are_written_as_the_engine_writes_them() -> None:
    rng = np.random.default_rng(1)
    edges = [0.0, -0.0, nan, inf, -inf, 5e-324, 1.7976931348623157e308, 1e15, 1e16, 1e-4, 9.9999e-5, 1e-5, 1e-6, 1e-10]
    values = np.concatenate(
        [
            [*edges, *(-np.array(edges))],
            rng.uniform(-90.0, 90.0, 2000),
            rng.choice([-1.0, 1.0], 4000) * 10.0 ** rng.uniform(-12.0, 20.0, 4000),
            rng.integers(0, 2**64, 4000, dtype=np.uint64).view(np.float64),
        ]
    )
    flags = rng.integers(0, 100, len(values)).astype(np.uint8)
    lines = [f"row {row}" for row in range(len(values))]
    written = io.BytesIO()
    engine = pl.DataFrame({"": lines, "tilt_x": values, "flag": flags})
    engine.write_csv(written, include_header=False, quote_style="never", line_terminator="\r\n")
    assert short_text(lines, {"tilt_x": values, "flag": flags}, "\r\n") == written.getvalue()
