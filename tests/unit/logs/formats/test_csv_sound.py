"""Blocks of rows of which none is odd take a short way; no row may come out of it otherwise than the rule has it."""

from __future__ import annotations

import io
import random

import numpy as np
import pytest

from tests.support.row_grammar import cells_of, readings_of
from tiltcal.logs.formats import csv_rows
from tiltcal.logs.formats.csv import CsvReader
from tiltcal.logs.formats.csv_rows import Dialect, RowGrammar
from tiltcal.logs.log import LogSource

NAMES = ("time", "station", "x", "y")
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
    return (",".join(NAMES) + end + text).encode(draw.choice(["utf-8", "latin-1"])), text


@pytest.mark.parametrize("seed", range(24))
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
    expected, expected_bad = readings_of(text, len(NAMES), [2, 3])
    assert bad == expected_bad
    np.testing.assert_array_equal([values[2], values[3]], expected)


@pytest.mark.parametrize(
    "data",
    [
        b"1,a,2.5,3\n2,b.1,-.5,4e3\n",
        b"1,N 1,2.5,3\r\n2,,NaN,4\r\n",
        b"1,a,2.5,\n2,b,3.5,\n",
        b"1,st. Mary,NA,\n2,b, 3.5,\n",
    ],
)
def test_sound_rows_take_the_short_way(data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(RowGrammar, "_by_line")
    monkeypatch.setattr(csv_rows, "_PIECE", 5)
    found = RowGrammar(Dialect(NAMES), [2], texts=[1]).parse(data)
    (expected,), _ = readings_of(data.decode(), len(NAMES), [2])
    np.testing.assert_array_equal(found.values[2], expected)
    assert [text or "" for text in found.texts[1].to_list()] == [row[1] for row in cells_of(data.decode())]
    assert found.lines.to_list() == data.decode().replace("\r", "").split("\n")[:-1]
