"""A short log is read and written without the engine, and comes out as the engine would have it."""

from __future__ import annotations

import io
from math import inf, nan

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.logs.formats.csv import short_text
from tiltcal.logs.formats.csv_dialect import Dialect
from tiltcal.logs.formats.csv_rows import RowGrammar

NAMES = ("time", "x", "note")
CELLS = ["1", "-2.5", "+.5", "1e-3", "2.", "1e400", "inf", "NaN", "n/a", "", " 7 ", "\t8", "1_0", "0x1", "abc", "1e"]
TEXTS = ["٣", "é", "\x0b1", "\xa01", "st. 1", '"a"', '"a,b"', '"say ""no"""', '"2.5"']


@pytest.mark.parametrize("decimal", [".", ","])
@given(
    rows=st.lists(st.lists(st.sampled_from(CELLS + TEXTS), min_size=3, max_size=3), min_size=1, max_size=4),
    line_end=st.sampled_from(["\n", "\r\n"]),
)
def test_both_ways_agree(decimal: str, rows: list[list[str]], line_end: str) -> None:
    dialect = Dialect(NAMES, "," if decimal == "." else ";", decimal)
    cells = rows if decimal == "." else [[cell.replace(",", ";").replace(".", ",") for cell in row] for row in rows]
    data = "".join(dialect.separator.join(row) + line_end for row in cells).encode()
    expected = RowGrammar(dialect, [0, 1], texts=[2])._by_engine(data)
    found = RowGrammar(dialect, [0, 1], texts=[2], short=True).parse(data)
    assert (expected is None) == bool(found.faults)
    if expected is not None:
        values, _, text, texts = expected
        assert found.text == text
        assert found.texts[2].to_list() == texts[2].to_list()
        np.testing.assert_array_equal([*found.values.values()], [*values.values()])


@pytest.mark.parametrize("decimal", [".", ","])
def test_numbers_are_written_as_the_engine_writes_them(decimal: str) -> None:
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
    pl.DataFrame({"": lines, "tilt_x": values, "flag": flags}).write_csv(
        written,
        include_header=False,
        quote_style="never",
        line_terminator="\r\n",
        separator=";",
        decimal_comma=decimal == ",",
    )
    found = short_text(lines, {"tilt_x": values, "flag": flags}, "\r\n", Dialect(NAMES, ";", decimal))
    assert found.encode() == written.getvalue()
